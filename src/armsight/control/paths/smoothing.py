"""Noise taken out of a taught path within a stated bound, its corners kept sharp, or rounded by fillets."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_splprep
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.control.paths.along import corners, moving, poses_at, positions_at, positive, with_poses
from armsight.defaults import SMOOTHING_M, SMOOTHING_RAD
from armsight.errors import Degenerate, Inconsistent, UsageError
from armsight.records import TaughtPath
from armsight.units import DEG

STEP_RAD = 5.0 * DEG
"""Between two rows of an arc: its chords stay within a thousandth of the radius."""
STRAIGHT = 0.02
"""How far, as a share of the radius, a leg of a corner may be from straight."""


@dataclass(frozen=True, slots=True, eq=False)
class _Arc:
    """An arc from length first_m to last_m of the path: positions (k, 3) and the lengths (k,) they stand for."""

    row: int
    first_m: float
    last_m: float
    xyz_m: Array
    at_m: Array


def filleted(path: TaughtPath, radius_m: float, *, at: Sequence[int] | None = None) -> TaughtPath:
    """Return the path with its corners (the rows at; found by `corners` where None) rounded to arcs of radius_m.

    An arc touches both legs at radius_m tan(turn / 2) from the corner; rotations run on along it. A tag of a row that
    gives way stays at the row of the arc nearest to it along the path. Raises Inconsistent where legs are too short or
    not straight, or two arcs overlap, Degenerate where the path turns back on itself.
    """
    positive("radius_m", radius_m)
    s = moving(path)
    rows = sorted(range(len(path))[row] for row in (corners(path) if at is None else at))
    arcs = [_arc(path, s, row, radius_m) for row in rows]
    for one, other in itertools.pairwise(arcs):
        if one.last_m > other.first_m + 1e-12:
            raise Inconsistent(
                f"the arcs of {radius_m:g} m at rows {one.row} and {other.row} overlap",
                consequence="The corners are not rounded",
                cure="Take a smaller radius",
            )
    if not arcs:
        return path
    kept = np.ones(len(s), dtype=bool)
    for arc in arcs:
        kept &= (s < arc.first_m - 1e-9) | (s > arc.last_m + 1e-9)
    lengths = np.concatenate([s[kept], *(arc.at_m for arc in arcs)])
    positions = np.concatenate([path.xyz_m[kept], *(arc.xyz_m for arc in arcs)])
    order = np.argsort(lengths, kind="stable")
    T = poses_at(path, lengths[order])
    T[:, :3, 3] = positions[order]
    return with_poses(path, T, lengths[order], _tags(path, s, lengths[order]))


def _arc(path: TaughtPath, s: Array, row: int, radius_m: float) -> _Arc:
    if not 0 < row < len(path) - 1:
        raise Inconsistent(f"row {row} is an end of the path and no corner", consequence="It is not rounded")
    corner = path.xyz_m[row]
    into, out, turn = _legs(path, s, row, min(s[row] - s[row - 1], s[row + 1] - s[row]))
    into, out, turn = _legs(path, s, row, radius_m * math.tan(0.5 * min(turn, 0.5 * math.pi)))
    if turn > math.pi - 1.0 * DEG or turn < 1e-6:
        raise Degenerate(
            f"the path turns by {turn / DEG:.3g} deg at row {row}", consequence="It has no arc", cure="Leave it out"
        )
    leg = radius_m * math.tan(0.5 * turn)
    if leg > s[row] + 1e-12 or leg > s[-1] - s[row] + 1e-12:
        raise _unfit(row, radius_m, f"it needs {leg:.4g} m of path on both sides")
    inside = np.flatnonzero(np.abs(s - s[row]) < leg)
    ends = positions_at(path, np.array([s[row] - leg, s[row] + leg]))
    along = (s[inside] - s[row])[:, None]
    line = corner + np.where(along < 0.0, along * into, along * out)
    off = np.concatenate([path.xyz_m[inside] - line, ends - np.array([corner - leg * into, corner + leg * out])])
    worst = float(np.linalg.norm(off, axis=1).max())
    if worst > STRAIGHT * radius_m:
        raise _unfit(row, radius_m, f"its legs bend by {worst:.3g} m over the {leg:.4g} m that the arc takes")
    count = max(2, math.ceil(turn / STEP_RAD - 1e-9))
    angle = np.linspace(0.0, turn, count + 1)
    aside = out - (out @ into) * into
    aside = aside / np.linalg.norm(aside)
    start = corner - leg * into
    xyz = start + radius_m * (np.sin(angle)[:, None] * into + (1.0 - np.cos(angle))[:, None] * aside)
    at = s[row] - leg + 2.0 * leg * angle / turn
    return _Arc(row, float(at[0]), float(at[-1]), xyz, at)


def _legs(path: TaughtPath, s: Array, row: int, length_m: float) -> tuple[Array, Array, float]:
    """Return the directions (3,) of the chords of length_m before and behind a row, and the angle between them."""
    length_m = max(length_m, 1e-9)
    ends = positions_at(path, np.array([max(s[row] - length_m, 0.0), min(s[row] + length_m, s[-1])]))
    into, out = path.xyz_m[row] - ends[0], ends[1] - path.xyz_m[row]
    into, out = into / np.linalg.norm(into), out / np.linalg.norm(out)
    return into, out, math.atan2(float(np.linalg.norm(np.cross(into, out))), float(into @ out))


def _unfit(row: int, radius_m: float, why: str) -> Inconsistent:
    return Inconsistent(
        f"an arc of {radius_m:g} m does not fit the corner at row {row}: {why}",
        consequence="The corners are not rounded",
        cure="Take a smaller radius, or smooth the path first",
    )


def _tags(path: TaughtPath, s: Array, lengths: Array) -> tuple[str, ...]:
    tags = [""] * len(lengths)
    for row, tag in enumerate(path.tags):
        if not tag:
            continue
        nearest = int(np.argmin(np.abs(lengths - s[row])))
        if tags[nearest]:
            raise Inconsistent(
                f"the tags {tags[nearest]} and {tag} would meet at one row",
                consequence="The corners are not rounded",
                cure="Take a smaller radius",
            )
        tags[nearest] = tag
    return tuple(tags)


LEAST_ROWS = 9
"""A stretch between corners of fewer rows holds no noise that could be told from its shape."""
ROUNDS = 6
"""Fits in which rows beyond the bound get twice the weight; what is beyond it still is brought back to it."""
SAME = 1e-12
"""Noise, as a share of the values, that is of rounding."""
MAD = 0.6745
"""Median of the absolute value of a standard normal variable."""


def smoothed(
    path: TaughtPath,
    *,
    bound_m: float = SMOOTHING_M,
    bound_rad: float = SMOOTHING_RAD,
    keep: Sequence[int] | None = None,
) -> TaughtPath:
    """Return the path smoothed between its corners (the rows keep; `corners` where None), row for row.

    No row moves by more than bound_m or turns by more than bound_rad. Each stretch is made as smooth as the noise that
    its rows show against their neighbours allows (cubic splines with the fewest knots, Dierckx 1982; residual as large
    as the noise, Morozov 1966), so that a path without noise stays as it is. A corner becomes the mean of where both
    stretches end. Raises UsageError for a bound that is none, Inconsistent where the path stands, NotEnoughData below
    two rows.
    """
    positive("bound_m", bound_m)
    if not 0.0 < bound_rad <= math.pi:
        raise UsageError(
            f"a bound of {bound_rad / DEG:g} degrees is none", cure="Give more than 0 degrees, 180 (pi rad) at most"
        )
    s = moving(path)
    chosen = corners(path) if keep is None else keep
    kept = sorted({0, len(path) - 1, *(range(len(path))[row] for row in chosen)})
    xyz = _between(path.xyz_m, s, kept, bound_m)
    R = Rotation.from_matrix(path.T_world_tip[:, :3, :3])
    quat = _between(_continuous(R.as_quat()), s, kept, 0.5 * bound_rad)  # a quaternion moves by half the angle
    way = xyz - path.xyz_m
    turn = (R.inv() * Rotation.from_quat(quat)).as_rotvec()
    T = path.T_world_tip.copy()
    T[:, :3, 3] += _within(way, bound_m)
    T[:, :3, :3] = (R * Rotation.from_rotvec(_within(turn, bound_rad))).as_matrix()
    return replace(path, T_world_tip=T)


def moved_by(before: TaughtPath, after: TaughtPath) -> tuple[Array, Array]:
    """Return how far each row moved (n,) in m and turned (n,) in rad between two paths of the same rows."""
    turn = (before.poses.rotation.inv() * after.poses.rotation).magnitude()
    return np.linalg.norm(after.xyz_m - before.xyz_m, axis=1), np.atleast_1d(turn)


def _between(y: Array, s: Array, kept: Sequence[int], bound: float) -> Array:
    """Return y (n, k) at lengths s (n,), smoothed stretch by stretch; kept rows are the mean of their stretches."""
    ends: dict[int, list[Array]] = {row: [] for row in kept}
    parts = []
    for a, b in itertools.pairwise(kept):
        z = _stretch(y[a : b + 1], s[a : b + 1], bound)
        ends[a].append(z[0])
        ends[b].append(z[-1])
        parts.append(z)
    out = y.copy()
    for (a, b), z in zip(itertools.pairwise(kept), parts, strict=True):
        share = ((s[a : b + 1] - s[a]) / (s[b] - s[a]))[:, None]
        first, last = np.mean(ends[a], axis=0) - z[0], np.mean(ends[b], axis=0) - z[-1]
        out[a : b + 1] = z + (1.0 - share) * first + share * last
    return out


def _stretch(y: Array, s: Array, bound: float) -> Array:
    """Return z (n, k) on the spline with fewest knots that leaves noise as residual, drawn to rows beyond the bound."""
    if len(y) < LEAST_ROWS:
        return y
    x = (s - s[0]) / (s[-1] - s[0])
    residual = _noise(y, x)
    if residual <= SAME * float(np.abs(y).max()):
        return y
    weights = np.ones(len(y))
    for _ in range(ROUNDS):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # that the residual could not be met is judged below
            spline = make_splprep(y.T, u=x, w=weights, s=len(y) * residual**2)[0]
        z = np.asarray(spline(x)).T  # (n, k)
        beyond = np.linalg.norm(z - y, axis=1) > bound
        if not beyond.any():
            break
        weights = np.where(beyond, 2.0 * weights, weights)
    return z if math.sqrt(float(np.mean((z - y) ** 2) * y.shape[1])) <= 1.1 * residual else y


def _noise(y: Array, x: Array) -> float:
    """Return the standard deviation of a row of y (n, k), from what rows are off the cubic through four neighbours."""
    n = len(x)
    near = np.arange(2, n - 2)[:, None] + np.array([-2, -1, 1, 2])  # (n - 4, 4)
    at, of = x[2:-2, None] - x[near], x[near][:, :, None] - x[near][:, None, :]
    weights = np.ones((n - 4, 4))
    for j in range(4):
        for k in range(4):
            if j != k:
                weights[:, j] *= at[:, k] / of[:, j, k]  # Lagrange
    off = y[2:-2] - np.einsum("nj,njk->nk", weights, y[near])
    off = off / np.sqrt(1.0 + np.sum(weights**2, axis=1, keepdims=True))
    return math.sqrt(float(np.sum((np.median(np.abs(off), axis=0) / MAD) ** 2)))


def _continuous(quat: Array) -> Array:
    """Return quaternions (n, 4) with signs such that neighbours are near to each other."""
    flips = np.where(np.sum(quat[1:] * quat[:-1], axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(quat * np.concatenate([[1.0], np.cumprod(flips)])[:, None])


def _within(step: Array, bound: float) -> Array:
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, bound / np.maximum(length, 1e-300)))
