"""Every joint's path: line or circle, gross readings discarded, the noise found from all of them; and as the paper has
it (MATH 4.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc

from armsight.arrays import Array
from armsight.calibrate.identify.chain import Axis
from armsight.calibrate.identify.path_fit import PathFit, basis, circle_starts, fit_circle, fit_line, gross, line_misfit
from armsight.calibrate.identify.sweeps import SweepResiduals, Sweeps
from armsight.errors import Inconsistent, NotConverged, NotEnoughData
from armsight.fitting.quantiles import chauvenet

DECIDED = 1e-4
"""A line is rejected below this probability: one slide in ten thousand is then called a turning joint."""
HIDDEN_RAD = 0.3
"""A path that may be an arc of so much is not certainly a line."""
STILL = 2.0
"""A beacon whose positions spread by less than so many standard deviations of the noise has not moved."""
LOST_SHARE = 0.3
"""With more readings discarded the path is not that of one joint."""
POOR = 1e-12
"""Probability of a path's misfit below which it is neither line nor circle."""
PLAINLY = 0.01
"""A path is plainly bent where a circle leaves less than this share of the misfit a line leaves."""
LOOSE_PRIOR = 1e3
"""Factor on the noise with which nothing counts as gross, while the noise itself is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """A joint's path, the rows of its sweep that were kept, and the readings discarded.

    Of several sweeps the path is that of the one that tells most, main its rows; rows are those of all.
    """

    path: PathFit
    main: NDArray[np.intp]
    rows: NDArray[np.intp]
    discarded: tuple[tuple[int, str], ...]
    p_line: float
    line_chi2: float
    decided: bool


def find_paths(seen: SweepResiduals, sigma: float | None) -> tuple[list[JointPath], SweepResiduals]:
    """Return every joint's path, and the readings with the noise found from all of them."""
    sweeps = seen.sweeps
    parts = [(j, rows) for j in range(sweeps.n) for rows in sweeps.sweeps(j)]
    if sigma is None:
        first = [_noise(seen.take(rows), sweeps.q[rows, j]) for j, rows in parts]
        known = [value for value in first if np.isfinite(value)]
        if not known:
            raise NotEnoughData(
                "three readings of every joint leave nothing to find the noise by",
                consequence="No standard deviations can be given",
                cure="Give the noise (sigma), or take more readings",
            )
        seen = seen.at(seen.sigma * max(float(np.median(known)), 1e-9))
    each = [_one_path(seen, j, rows) for j, rows in parts]
    if sigma is None:  # once more with the noise of the shapes that were chosen
        total = sum(item.path.chi2 for item in each)
        dof = sum(item.path.dof for item in each)
        if dof > 0:
            factor = float(np.sqrt(max(total / dof, 1e-18)))
            seen = seen.at(seen.sigma * factor)
            each = [_judged(item, factor, dof) for item in each]
    return [_together([one for (k, _), one in zip(parts, each, strict=True) if k == j]) for j in range(sweeps.n)], seen


def _together(found: list[JointPath]) -> JointPath:
    """Return a joint's path from those of its sweeps: of the one that shows its type most plainly and went furthest."""
    best = max(found, key=lambda item: (item.decided, item.path.kind == "circle", float(np.ptp(item.path.phase))))
    return replace(
        best,
        rows=np.concatenate([item.rows for item in found]),
        discarded=tuple(one for item in found for one in item.discarded),
    )


def _judged(item: JointPath, factor: float, dof: int) -> JointPath:
    """Return a path with the probability of a line by an F test: the noise was found from dof residuals."""
    if item.path.kind == "line":
        return replace(item, p_line=float(chdtrc(max(item.path.dof, 1), item.path.chi2 / factor**2)))
    # a line is a circle without curvature: of two parameters more, noise gains chi-square of two degrees of freedom
    gained = max(item.line_chi2 - item.path.chi2, 0.0) / factor**2
    return replace(item, p_line=float(fdtrc(2, max(dof, 1), gained / 2.0)))


def _noise(seen: SweepResiduals, order: Array) -> float:
    """Return the noise of one sweep over the assumed one, by the median of the better shape's residuals."""
    loose = seen.at(LOOSE_PRIOR * seen.sigma if seen.rig is not None else LOOSE_PRIOR)
    starts = circle_starts(loose)
    bent = starts[0][0]
    path = None if bent < PLAINLY * line_misfit(loose) else fit_line(loose, order)
    if path is None or path.dof < 1 or bent < 0.25 * path.chi2:
        try:
            path = fit_circle(loose, order, starts=starts, coarse=True)
        except NotConverged:
            return float("nan")
    if path.dof < 1:
        return float("nan")
    # a median, over that of chi-square: what gross readings leave alone
    spread = float(np.median((path.residual**2).sum(axis=1)) / chdtri(path.dof / len(path.residual), 0.5))
    return float(np.sqrt(spread)) * loose.sigma / seen.sigma


def _one_path(seen: SweepResiduals, joint: int, rows: NDArray[np.intp]) -> JointPath:
    """Return the path of one sweep, gross readings discarded."""
    count = len(rows)
    out: list[tuple[int, str]] = []
    _check_moved(seen.take(rows), joint)
    for _ in range(4):
        part, order = seen.take(rows), seen.sweeps.q[rows, joint]
        straight = fit_line(part, order)
        path = fit_circle(part, order) if straight.p < DECIDED else straight
        size = np.sqrt((path.residual**2).sum(axis=1))
        bad = size > gross(part)
        if not bad.any() or len(rows) - bad.sum() < 3:
            break
        worst = bad & (size >= size.max() * 0.5)
        out += [
            (int(row), f"off its path by {s:.0f} standard deviations")
            for row, s in zip(rows[worst], size[worst], strict=True)
        ]
        rows = rows[~worst]
    if len(out) > LOST_SHARE * count or (path.dof > 0 and path.p < POOR):
        off = f": {len(out)} of {count} readings are off" if out else ", by more than noise can be"
        raise Inconsistent(
            f"the path of joint {joint + 1} is neither a line nor a circle{off}",
            consequence="The joint is not identified",
            cure="Two joints may have moved (coupled gears do that), or a reflection was taken for the beacon: look at "
            "its points, sweep again",
        )
    return JointPath(
        path=path,
        main=rows,
        rows=rows,
        discarded=tuple(out),
        p_line=straight.p,
        line_chi2=straight.chi2,
        decided=_decided(straight, part),
    )


def _check_moved(seen: SweepResiduals, joint: int) -> None:
    xyz = seen.sweeps.xyz_m
    spread, _ = seen.residuals(np.tile(xyz.mean(axis=0), (len(xyz), 1)), np.zeros((len(xyz), 3, 1)))
    if np.sqrt(np.mean((spread**2).sum(axis=1)) / np.mean(seen.counts)) < STILL:
        raise NotEnoughData(
            f"the beacon did not move beyond the noise in the sweep of joint {joint + 1}",
            consequence="Its axis cannot be found",
            cure="The joint stood still, or the beacon lies on its axis: move it further, or put the beacon elsewhere",
        )


def _decided(straight: PathFit, seen: SweepResiduals) -> bool:
    """Whether the type is beyond doubt: the line is rejected, or no arc worth the name could hide in the noise.

    The arc's angle is the bend of the path, by weighted least squares of t^2 in the directions across the line, times
    the stroke.
    """
    if straight.p < DECIDED:
        return True
    t = straight.phase - straight.phase.mean()
    xyz = seen.sweeps.xyz_m
    across = basis(straight.direction)[:, :2]
    C = seen.sweeps.covariance_m2
    variance = np.tile(seen.sigma**2 * np.eye(3), (len(t), 1, 1)) if C is None else seen.relative**2 * C
    A = np.stack([np.ones_like(t), t, t**2], axis=1)
    if len(t) < 4:
        return False
    bend, uncertainty = 0.0, 0.0
    for e in across.T:
        w = 1.0 / np.sqrt(np.einsum("i,mij,j->m", e, variance, e))
        H = np.linalg.inv((A * w[:, None]).T @ (A * w[:, None]))
        b = H @ (A * (w**2)[:, None]).T @ (xyz @ e - xyz.mean(axis=0) @ e)
        bend, uncertainty = np.hypot(bend, b[2]), np.hypot(uncertainty, np.sqrt(H[2, 2]))
    return bool(2.0 * (bend + 3.0 * uncertainty) * np.ptp(t) < HIDDEN_RAD)


def measured(item: JointPath, sweeps: Sweeps) -> Axis:
    """Return a joint's axis as its own sweep saw it; a slide's goes through the middle of its path."""
    point = item.path.point_m if item.path.kind == "circle" else sweeps.xyz_m[item.main].mean(axis=0)
    return Axis(point_m=point, direction=item.path.direction, revolute=item.path.kind == "circle")


# Kapucu and Baysec (2005) as printed, with MATH 4.1's corrections: all triples, Chauvenet's criterion, means.


def triple_circle(xyz_m: Array, order: Array) -> tuple[Array, Array, float]:
    """Return centre, axis and radius as the means over all combinations of three points (MATH 4.1)."""
    P = xyz_m[np.argsort(order)]
    i = np.array(list(combinations(range(len(P)), 3)))
    a, b = P[i[:, 1]] - P[i[:, 0]], P[i[:, 2]] - P[i[:, 0]]
    n = np.cross(a, b)
    size = np.linalg.norm(n, axis=1)
    good = size > 1e-12 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    a, b, n, size, first = a[good], b[good], n[good], size[good], P[i[good, 0]]
    aa, bb = (a * a).sum(axis=1)[:, None], (b * b).sum(axis=1)[:, None]
    # c = P1 + (|a|^2 b x n + |b|^2 n x a) / (2 |n|^2), n = a x b: no frames to turn into and back (MATH 4.1)
    centres = first + (aa * np.cross(b, n) + bb * np.cross(n, a)) / (2.0 * size[:, None] ** 2)
    radii = np.linalg.norm(centres - first, axis=1)
    axes = n / size[:, None]
    kept = chauvenet(np.column_stack([centres, radii]))
    axis = axes[kept].mean(axis=0)
    return centres[kept].mean(axis=0), axis / np.linalg.norm(axis), float(radii[kept].mean())


def pair_line(xyz_m: Array, order: Array) -> tuple[Array, Array]:
    """Return a point and the direction of the line as the means over all pairs of points."""
    P = xyz_m[np.argsort(order)]
    i = np.array(list(combinations(range(len(P)), 2)))
    d = P[i[:, 1]] - P[i[:, 0]]
    directions = d / np.linalg.norm(d, axis=1)[:, None]
    mean = directions[chauvenet(directions)].mean(axis=0)
    return P.mean(axis=0), mean / np.linalg.norm(mean)
