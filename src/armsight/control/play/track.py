"""Ways of the tip by length: straight legs and sampled tracks, each with the speed allowed at every place."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.geometry import pose_difference

Array = NDArray[np.float64]

ARM_M = 0.1
"""Turning by a radian counts as a way of so much, so that a leg that only turns has a length: 20 mm/s are 0.2 rad/s."""


class Way(Protocol):
    """A way of the tip in base axes. length_m: where it ends."""

    length_m: float

    def pose(self, s_m: float) -> RigidTransform:
        """Return T_base_tip at a length."""
        ...

    def speed_at(self, s_m: float) -> float:
        """Return the speed allowed at a length, in m/s along the way."""
        ...


class Leg:
    """A straight way from one pose to another, turning evenly; its length counts the turning too (ARM_M)."""

    def __init__(self, start: RigidTransform, end: RigidTransform, speed_m_s: float) -> None:
        difference = pose_difference(start, end)
        self._start, self._speed = start, speed_m_s
        self._xyz_m = np.asarray(end.translation - start.translation)
        self._turn_rad = (end.rotation * start.rotation.inv()).as_rotvec()
        self.length_m = max(float(np.linalg.norm(difference[:3])), ARM_M * float(np.linalg.norm(difference[3:])))

    def pose(self, s_m: float) -> RigidTransform:
        """Return T_base_tip at a length."""
        share = 1.0 if self.length_m <= 0.0 else min(max(s_m / self.length_m, 0.0), 1.0)
        return RigidTransform.from_components(
            self._start.translation + share * self._xyz_m,
            Rotation.from_rotvec(share * self._turn_rad) * self._start.rotation,
        )

    def speed_at(self, s_m: float) -> float:
        """Return the speed, the same all along."""
        return self._speed


class Track:
    """A way through sampled poses, smooth between them; s_m (n,) growing from 0, speed_m_s (n,) allowed there."""

    def __init__(self, T_base_tip: Array, s_m: Array, speed_m_s: Array) -> None:
        self.length_m = float(s_m[-1])
        self._s_m, self._speed_m_s = s_m, speed_m_s
        self._spline = CubicSpline(s_m, np.concatenate([T_base_tip[:, :3, 3], quats(T_base_tip)], axis=1))

    def pose(self, s_m: float) -> RigidTransform:
        """Return T_base_tip at a length."""
        values = self._spline(min(max(s_m, 0.0), self.length_m))
        return RigidTransform.from_components(values[:3], Rotation.from_quat(values[3:]))

    def speed_at(self, s_m: float) -> float:
        """Return the speed allowed at a length."""
        return float(np.interp(s_m, self._s_m, self._speed_m_s))


def quats(T: Array) -> Array:
    """Return the quaternions (n, 4) of poses (n, 4, 4), each on the side of the one before."""
    out = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    flips = np.where(np.sum(out[1:] * out[:-1], axis=1) < 0.0, -1.0, 1.0)
    out[1:] *= np.cumprod(flips)[:, None]
    return np.asarray(out)
