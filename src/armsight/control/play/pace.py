"""How fast a tip may go along its path: as wanted, and slower where a curve or a weave asks too much of the arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.spatial.transform import Rotation

from armsight.control.guard.limits import JointBounds, Limits

Array = NDArray[np.float64]

PATH_ACCELERATION_M_S2 = 0.2
PATH_JERK_M_S3 = 20.0
"""With which speed along the path changes: gentler than the guard's limits, which curves and weaves need."""
SPEED_SHARE, ACCELERATION_SHARE, JERK_SHARE = 0.85, 0.4, 0.3
"""Of the limits, which curves and weaves may use: the rest is for changes of speed, and the guard keeps some back."""
REACH_M = 1e-3
"""So far before and behind a slow place the speed is that of the place: braking takes its time to begin."""


def timed(s: Array, T: Array, joints: tuple[Array, Array], wanted: Array, limits: Limits, bounds: JointBounds) -> Array:
    """Return the speed (n,) along the path: as wanted, less where tool or joints would exceed their limits.

    joints: lengths (k,) and readings (k, n) there. Braking before a slow place begins early enough.
    """
    most = np.minimum(wanted, SPEED_SHARE * limits.speed_m_s)
    R = Rotation.from_matrix(T[:, :3, :3])
    turned = np.concatenate([[np.zeros(3)], np.cumsum((R[1:] * R[:-1].inv()).as_rotvec(), axis=0)])
    of_tool = (limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3)
    of_turn = (limits.turn_rad_s, limits.turn_acceleration_rad_s2, limits.turn_jerk_rad_s3)
    for values, (v, a, j) in ((T[:, :3, 3], of_tool), (turned, of_turn)):
        sizes = [np.linalg.norm(d, axis=1) for d in _derivatives(s, values)]
        most = np.minimum(most, _speed_of(sizes, v, a, j))
    at, q = joints
    by_joint = np.full(len(at), np.inf)
    for k, (v, a, j) in enumerate(zip(bounds.speed, bounds.acceleration, bounds.jerk, strict=True)):
        sizes = [np.abs(d[:, 0]) for d in _derivatives(at, q[:, k : k + 1])]
        by_joint = np.minimum(by_joint, _speed_of(sizes, v, a, j))
    most = np.minimum(most, np.interp(s, at, by_joint))
    reach = max(1, int(REACH_M / (s[1] - s[0])))
    return _braked(s, minimum_filter1d(most, 2 * reach + 1, mode="nearest"))


def _derivatives(s: Array, values: Array) -> list[Array]:
    """Return the first three derivatives (m, n) by the length."""
    first = np.gradient(values, s, axis=0)
    second = np.gradient(first, s, axis=0)
    return [first, second, np.gradient(second, s, axis=0)]


def _speed_of(sizes: list[Array], speed: float, acceleration: float, jerk: float) -> Array:
    """Return the speed along the path (m,) at which a value with these derivatives keeps its shares of the limits."""
    first, second, third = (np.maximum(size, 1e-12) for size in sizes)
    return np.asarray(
        np.minimum.reduce(
            [
                SPEED_SHARE * speed / first,
                np.sqrt(ACCELERATION_SHARE * acceleration / second),
                np.cbrt(JERK_SHARE * jerk / third),
            ]
        )
    )


def _braked(s: Array, most: Array) -> Array:
    """Return speeds (n,) that change no faster than PATH_ACCELERATION allows, half of it kept for the jerk."""
    squared = most**2
    gain = PATH_ACCELERATION_M_S2 * np.diff(s)
    for i in range(len(s) - 2, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + gain[i])
    for i in range(1, len(s)):
        squared[i] = min(squared[i], squared[i - 1] + gain[i - 1])
    return np.asarray(np.sqrt(squared))
