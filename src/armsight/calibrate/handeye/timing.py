"""The time offset between the robot's poses and the camera's, from how fast both turn.

The angle between two poses of the flange equals that between the same two poses of the camera, wherever the camera
is mounted, so the two speeds of turning can be laid over each other before anything is calibrated. From frame to
frame noise drowns them; over windows of half a second they correlate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, Slerp

from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.units import DEG

Array = NDArray[np.float64]

WINDOW_S = 0.5
"""Turns are taken over this long: at 30 frames a second and 0.05 degrees a frame the noise of a speed is then 0.14
degrees a second, between neighbouring frames 2."""

LEAST_CORRELATION = 0.8
"""Two records of one motion correlate above 0.95 at the right offset; unrelated ones of some seconds below 0.7."""

RIVAL = 0.9
"""A second peak of more than this share of the first, more than a window away, leaves the offset open: the motion
repeats itself."""

LEAST_SPEED_RAD_S = 2.0 * DEG
STEP_S = 0.01
MIN_WINDOWS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeOffset:
    """offset_s: add it to the camera's times to get the robot's. std_s: its standard deviation. correlation: at the
    best offset, before refining."""

    offset_s: float
    std_s: float
    correlation: float


def time_offset(
    robot_t_s: ArrayLike, robot: Rotation, camera_t_s: ArrayLike, camera: Rotation, *, search_s: float = 2.0
) -> TimeOffset:
    """Return the offset between two time-stamped streams of orientations: of the flange in the base (n), and of the
    target in the camera (m), within +-search_s. Eye-in-hand and eye-to-hand alike.

    Raises NotEnoughData for too short records, Degenerate where nothing turns, Inconsistent where the records do not
    correlate, Ambiguous where the motion repeats itself.
    """
    a, b = _stream(robot_t_s, robot, "robot"), _stream(camera_t_s, camera, "camera")
    offsets, correlations = _correlate(a, b, search_s)
    best = int(np.argmax(correlations))
    top = float(correlations[best])
    if top < LEAST_CORRELATION:
        raise Inconsistent(
            f"the robot's and the camera's turns do not correlate at any offset within {search_s} s (best {top:.2f})",
            consequence="No offset can be given",
            cure="Check that both streams record the same motion, and widen the search",
        )
    far = np.abs(offsets - offsets[best]) > WINDOW_S
    if far.any() and correlations[far].max() > 1.0 - (1.0 - RIVAL) * top and correlations[far].max() > RIVAL * top:
        raise Ambiguous(
            "the motion repeats itself: two offsets fit alike "
            f"({offsets[best]:.2f} and {offsets[far][np.argmax(correlations[far])]:.2f} s)",
            consequence="No offset can be given",
            cure="Move irregularly while recording",
        )
    return _refine(a, b, float(offsets[best]), top)


_Stream = tuple[Array, Slerp]


def _stream(t_s: ArrayLike, rotations: Rotation, what: str) -> _Stream:
    """Return times and an interpolation."""
    t = np.asarray(t_s, float)
    if t.shape != (len(rotations),) or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise Inconsistent(f"the {what}'s {len(rotations)} orientations need as many increasing times")
    if len(t) < 2 or t[-1] - t[0] < 4.0 * WINDOW_S:
        raise NotEnoughData(
            f"the {what}'s record is shorter than {4.0 * WINDOW_S} s",
            consequence="No time offset can be given",
            cure="Record ten seconds of irregular turning",
        )
    return t, Slerp(t, rotations)


def _speeds(stream: _Stream, t: Array) -> Array:
    """Return the mean speed of turning (rad/s) over the window about each time; NaN outside the record."""
    times, at = stream
    inside = (t - 0.5 * WINDOW_S >= times[0]) & (t + 0.5 * WINDOW_S <= times[-1])
    out = np.full(len(t), np.nan)
    if inside.any():
        turn = at(t[inside] + 0.5 * WINDOW_S) * at(t[inside] - 0.5 * WINDOW_S).inv()
        out[inside] = turn.magnitude() / WINDOW_S
    return out


def _correlate(a: _Stream, b: _Stream, search_s: float) -> tuple[Array, Array]:
    """Return offsets on a grid and the correlation of the speeds at each."""
    t = np.arange(b[0][0], b[0][-1], STEP_S)
    speed_b = _speeds(b, t)
    offsets = np.arange(-search_s, search_s + 0.5 * STEP_S, STEP_S)
    grid = np.arange(t[0] - search_s - STEP_S, t[-1] + search_s + STEP_S, STEP_S)
    speed_grid = _speeds(a, grid)
    if max(np.nanmax(speed_b, initial=0.0), np.nanmax(speed_grid, initial=0.0)) < LEAST_SPEED_RAD_S:
        raise Degenerate(
            "nothing turns in these records",
            consequence="No time offset can be seen",
            cure="Turn the hand while both streams are recorded",
        )
    first = round((t[0] - grid[0]) / STEP_S)
    shift = np.round(offsets / STEP_S).astype(int)
    out = np.full(len(offsets), -1.0)
    for k, s in enumerate(shift):
        x = speed_grid[first + s : first + s + len(t)]
        y = speed_b[: len(x)]
        both = np.isfinite(x) & np.isfinite(y)
        if both.sum() * STEP_S < MIN_WINDOWS * STEP_S or both.sum() < 0.3 * np.isfinite(y).sum():
            continue
        x, y = x[both], y[both]
        if x.std() > 0.0 and y.std() > 0.0:
            out[k] = np.corrcoef(x, y)[0, 1]
    return offsets, out


def _refine(a: _Stream, b: _Stream, offset: float, correlation: float) -> TimeOffset:
    """Return the offset that lets the turns themselves, not only their size, agree best; with its standard
    deviation."""
    low, high = offset - 2.0 * STEP_S, offset + 2.0 * STEP_S
    half = 0.5 * WINDOW_S
    t = b[0][(b[0] - half >= b[0][0]) & (b[0] + half <= b[0][-1])]
    t = t[(t + low - half >= a[0][0]) & (t + high + half <= a[0][-1])]
    if len(t) < MIN_WINDOWS:
        raise NotEnoughData("the two records overlap too little", cure="Record both streams over the same time")
    beta = (b[1](t - half) * b[1](t + half).inv()).as_rotvec()
    fits = []
    for to_hand in (False, True):

        def turns(d: float, to_hand: bool = to_hand) -> Array:
            before, after = a[1](t + d - half), a[1](t + d + half)
            return np.asarray((before * after.inv()).as_rotvec() if to_hand else (before.inv() * after).as_rotvec())

        def misfit(d: float, turns: Callable[[float], Array] = turns) -> float:
            alpha = turns(d)
            return float(((alpha - beta @ _aligning(alpha, beta).T) ** 2).sum())

        found = minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-7})
        fits.append((float(found.fun), float(found.x), turns))
    _, d, turns = min(fits, key=lambda fit: fit[0])
    return TimeOffset(offset_s=d, std_s=_deviation(turns, beta, d, t), correlation=correlation)


def _deviation(turns: Callable[[float], Array], beta: Array, d: float, t: Array) -> float:
    """Return the offset's standard deviation from the scatter of the gradient over blocks of time.

    Windows overlap and share their noise; blocks of two windows hardly do.
    """
    h = 2e-3
    turned = beta @ _aligning(turns(d), beta).T
    low, middle, high = (((turns(x) - turned) ** 2).sum(axis=1) for x in (d - h, d, d + h))
    gradient, curvature = (high - low) / (2.0 * h), float((high - 2.0 * middle + low).sum()) / h**2
    block = ((t - t[0]) / (2.0 * WINDOW_S)).astype(int)
    sums = np.bincount(block, weights=gradient - gradient.mean())
    return float(np.sqrt((sums**2).sum() * len(sums) / max(len(sums) - 2, 1)) / max(curvature, 1e-300))


def _aligning(alpha: Array, beta: Array) -> Array:
    """Return the rotation (3, 3) that turns the vectors beta onto alpha (Kabsch)."""
    U, _, Vt = np.linalg.svd(alpha.T @ beta)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)
