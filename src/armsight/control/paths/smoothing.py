"""Noise taken out of a taught path within a stated bound; its corners stay sharp."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_splprep
from scipy.spatial.transform import Rotation

from armsight.control.paths.along import corners, moving, positive
from armsight.errors import UsageError
from armsight.records import TaughtPath
from armsight.units import DEG

Array = NDArray[np.float64]

BOUND_M, BOUND_RAD = 5e-4, 1.0 * DEG
LEAST_ROWS = 9
"""A stretch between corners of fewer rows holds no noise that could be told from its shape."""
ROUNDS = 6
"""Fits in which rows beyond the bound get twice the weight; what is beyond it still is brought back to it."""
SAME = 1e-12
"""Noise, as a share of the values, that is of rounding."""
MAD = 0.6745
"""Median of the absolute value of a standard normal variable."""


def smoothed(
    path: TaughtPath, *, bound_m: float = BOUND_M, bound_rad: float = BOUND_RAD, keep: Sequence[int] | None = None
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
            f"bound_rad is {bound_rad:g}, which is no bound",
            consequence="The path is left as it is",
            cure="Give an angle in rad, below half a turn",
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
    """Return steps (n, 3) none of which is longer than the bound."""
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, bound / np.maximum(length, 1e-300)))
