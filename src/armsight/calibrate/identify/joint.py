"""One joint's path: circle or line by maximum likelihood, and which of the two by the chi-square test of MATH 4.3."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from armsight.calibrate.identify.seen import Seen
from armsight.calibrate.identify.shapes import CIRCLE, LINE, Tilt, basis, circle, line, skew
from armsight.errors import NotConverged
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Problem, Settings, solve

Array = NDArray[np.float64]

SWUNG = 8
"""Normals tried, swung about the chord: with a short arc the plane fit may be anywhere about it (MATH 4.3)."""
GROSS = float(np.sqrt(chdtri(3, 1e-6)))
"""Readings beyond so many deviations are discarded."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathFit:
    """A circle (kind 'circle') or a line, fitted to the readings of one joint.

    point_m: the circle's centre, or a point of the line. direction: the axis, its sense by the commanded values.
    radius_m: 0 of a line. phase (N,): where on it the readings are (rad or m). chi2, dof: of the readings kept.
    residual (N, rows): whitened. fit: the engine's.
    """

    kind: str
    point_m: Array
    direction: Array
    radius_m: float
    phase: Array
    chi2: float
    dof: int
    residual: Array
    fit: Fit

    @property
    def p(self) -> float:
        """Probability that noise alone leaves as much."""
        return float(chdtrc(max(self.dof, 1), self.chi2))


def fit_line(seen: Seen, order: Array, *, coarse: bool = False) -> PathFit:
    """Return the line of greatest likelihood. order (N,): the commanded values, of which only the sense is used.

    coarse: a tenth of the cost is enough, as where the path is plainly bent.
    """
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    direction = np.linalg.svd(xyz - middle)[2][0]
    tilt = Tilt(B=basis(direction))

    def evaluate(p: Array, t: Array) -> Evaluation:
        X, J, Jt = line(tilt, middle, p, t[:, 0])
        return _evaluation(seen, X, J, Jt)

    problem = Problem(
        names=LINE, guess=np.zeros(4), evaluate=evaluate, n_residuals=seen.rows * len(xyz), local_names=("t_m",),
        local_guess=((xyz - middle) @ direction)[:, None], loss=_loss(seen),
    )  # fmt: skip
    fit = solve(problem, COARSE if coarse else ROUGH)
    d, _ = tilt.direction(fit.shared[2:])
    point, t = middle + tilt.B[:, :2] @ fit.shared[:2], fit.local[:, 0]
    sense = _sense(t, order)
    return _path("line", seen, fit, point, sense * d, 0.0, sense * t, len(LINE))


def fit_circle(seen: Seen, order: Array, near: PathFit | None = None, *, coarse: bool = False) -> PathFit:
    """Return the circle of greatest likelihood; started from the plane fit and from normals swung about the chord.

    near: a circle fitted before to nearly the same readings, tried first. coarse: a thousandth of the cost is enough.
    """
    best: PathFit | None = None
    for normal, centre, radius in _attempts(seen, near):
        found = _settled(seen, normal, centre, radius, order, coarse=coarse)
        if found is None:
            continue
        if best is None or found.fit.cost < best.fit.cost:
            best = found
        if _decided(found):
            break
    if best is None:
        raise NotConverged("no circle fits the readings", cure="Take readings over a longer arc")
    return best


def _attempts(seen: Seen, near: PathFit | None) -> Iterator[tuple[Array, Array, float]]:
    """Yield from where a circle is fitted, worked out only as far as it is needed."""
    if near is not None:
        yield near.direction, near.point_m, near.radius_m
    for start in _starts(seen):
        yield start[1:]


def _settled(seen: Seen, n: Array, centre: Array, radius: float, order: Array, *, coarse: bool) -> PathFit | None:
    """Return the circle from one start, settled roughly where it will not settle finely, None where it does neither."""
    for settings in (ROUGH,) if coarse else (SETTINGS, ROUGH):
        try:
            return _circle_from(seen, n, centre, radius, order, settings)
        except NotConverged:
            continue
    return None


def circle_misfit(seen: Seen) -> float:
    """Return chi-square of the best of the circles a fit would start from."""
    return _starts(seen)[0][0]


def line_misfit(seen: Seen) -> float:
    """Return chi-square of the line a fit would start from."""
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    direction = np.linalg.svd(xyz - middle)[2][0]
    r, _ = seen.residuals(middle + np.outer((xyz - middle) @ direction, direction), np.zeros((len(xyz), 3, 1)))
    return float((r**2).sum())


def _starts(seen: Seen) -> list[tuple[float, Array, Array, float]]:
    """Return chi-square, normal, centre, radius of circles with normals swung about the chord, the best first.

    Each is the circle of linear least squares in its plane through the middle, every reading put to its nearest place.
    """
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    chord, _, normal = np.linalg.svd(xyz - middle)[2]
    side = skew(chord) @ normal
    out, still = [], np.zeros((len(xyz), 3, 1))
    for angle in np.arange(SWUNG) * np.pi / SWUNG:
        n = np.cos(angle) * normal + np.sin(angle) * side
        E = basis(n)[:, :2]
        x = (xyz - middle) @ E
        A = np.column_stack([2.0 * x, np.ones(len(x))])
        a, b, c = np.linalg.lstsq(A, (x**2).sum(axis=1), rcond=None)[0]
        radius = float(np.sqrt(max(c + a * a + b * b, 1e-12)))
        from_centre = x - np.array([a, b])
        nearest = radius * from_centre / np.maximum(np.hypot(*from_centre.T), 1e-12)[:, None]
        centre = middle + E @ np.array([a, b])
        r, _ = seen.residuals(centre + nearest @ E.T, still)
        size = float((r**2).sum())
        out.append((size if np.isfinite(size) else np.inf, n, centre, radius))
    return sorted(out, key=lambda start: start[0])


def _decided(found: PathFit) -> bool:
    """Whether a fit is good enough not to try another start."""
    return found.p > 1e-3


def _circle_from(seen: Seen, n: Array, centre: Array, radius: float, order: Array, settings: Settings) -> PathFit:
    xyz = seen.sweeps.xyz_m
    tilt = Tilt(B=basis(n))
    local = (xyz - centre) @ tilt.B
    phi = np.arctan2(local[:, 1], local[:, 0])

    def evaluate(p: Array, phase: Array) -> Evaluation:
        X, J, Jt = circle(tilt, p, phase[:, 0])
        return _evaluation(seen, X, J, Jt)

    problem = Problem(
        names=CIRCLE, guess=np.array([*centre, 0.0, 0.0, radius]), evaluate=evaluate,
        n_residuals=seen.rows * len(xyz), local_names=("phase",), local_guess=phi[:, None], loss=_loss(seen),
    )  # fmt: skip
    fit = solve(problem, settings)
    p = fit.shared
    d, _ = tilt.direction(p[3:5])
    phase = np.unwrap(fit.local[np.argsort(order), 0])
    sense = 1.0 if phase[-1] >= phase[0] else -1.0
    back = np.empty(len(phase))
    back[np.argsort(order)] = phase
    return _path("circle", seen, fit, p[:3].copy(), sense * d, abs(float(p[5])), sense * back, len(CIRCLE))


ROUGH = Settings(max_iterations=200, allow_undetermined=True, cost_tolerance=1e-3, step_tolerance=1e-4)
"""For a line far from fitting, where it does not matter how far, and for a centre that the noise leaves open."""
COARSE = Settings(max_iterations=200, allow_undetermined=True, cost_tolerance=0.1, step_tolerance=1e-2)
"""For a line that cannot be."""
SETTINGS = Settings(max_iterations=100, allow_undetermined=True, cost_tolerance=1e-6, step_tolerance=1e-6)
"""For the circle: a short arc leaves its centre in a valley; a millionth of the cost is enough."""


def _loss(seen: Seen) -> Loss:
    return Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chdtri(seen.rows, 1e-3))), block=seen.rows)


def _evaluation(seen: Seen, X: Array, J: Array, Jt: Array) -> Evaluation:
    r, slopes = seen.residuals(X, np.concatenate([J, Jt[:, :, None]], axis=2))
    return Evaluation(residuals=r, shared=slopes[:, :, :-1], local=slopes[:, :, -1:])


def _path(
    kind: str, seen: Seen, fit: Fit, point: Array, direction: Array, radius: float, phase: Array, n_shared: int
) -> PathFit:
    r = fit.residuals
    dof = r.size - n_shared - len(r)
    return PathFit(
        kind=kind, point_m=point, direction=direction, radius_m=radius, phase=phase, chi2=float((r**2).sum()), dof=dof,
        residual=r, fit=fit,
    )  # fmt: skip


def _sense(t: Array, order: Array) -> float:
    return 1.0 if np.dot(t - t.mean(), order - order.mean()) >= 0.0 else -1.0
