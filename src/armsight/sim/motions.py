"""Motions: what joints are told, and where a hand or a turning base carries a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.records import frozen_array
from armsight.sim.scene import Path

Array = NDArray[np.float64]

TREMOR_HZ = (0.7, 9.0)
"""Frequencies of a hand that tries to hold still: slow sway to physiological tremor (8 to 12 Hz at the fingers)."""

TREMOR_WAVES = 4
"""Sines per axis: enough that the sum has no visible period within a run."""

DRAWN_STEP_S = 0.005
"""Spacing of a drawn path's record; at 0.1 m/s half a millimetre, joined by straight lines."""


class JointMotion(Protocol):
    """What the joints are told to be at any time."""

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        ...


def smooth_step(share: ArrayLike) -> Array:
    """Return the way (0..1) of a movement of least jerk after a share (0..1) of its time."""
    s = np.clip(np.asarray(share, dtype=float), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waypoints:
    """Joints that go from one of q (k, n) to the next; leave_s, arrive_s (k - 1,): when each way begins and ends."""

    q: Array
    leave_s: Array
    arrive_s: Array

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        share = smooth_step((np.asarray(t_s)[:, None] - self.leave_s) / (self.arrive_s - self.leave_s))  # (m, k - 1)
        return np.asarray(self.q[0] + share @ np.diff(self.q, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swing:
    """Joints that swing about home (n,) by amplitude (n,) with periods (n,) and phases (n,)."""

    home: Array
    amplitude: Array
    period_s: Array
    phase_rad: Array

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        angle = 2.0 * np.pi * np.asarray(t_s)[:, None] / self.period_s + self.phase_rad
        return np.asarray(self.home + self.amplitude * np.sin(angle))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turntable:
    """A target on a base that turns about world z: T_world_base, T_base_target at angle zero, the angles."""

    T_world_base: RigidTransform
    T_base_target: RigidTransform
    from_rad: float
    to_rad: float
    start_s: float
    lasts_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        share = smooth_step((np.asarray(t_s) - self.start_s) / self.lasts_s)
        angle = self.from_rad + share * (self.to_rad - self.from_rad)
        turn = RigidTransform.from_rotation(Rotation.from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0])))
        return self.T_world_base * turn * self.T_base_target


class Drawn:
    """A target led along corners (k, 3) in m at a speed, resting before and after, rounding corners as a hand does.

    smooth_s: standard deviation of the smoothing in time: at speed v a corner is cut by about 0.4 v smooth_s.
    """

    def __init__(
        self, corners_m: ArrayLike, R_world_target: Rotation, speed_m_s: float, smooth_s: float, start_s: float
    ) -> None:
        corners = np.asarray(corners_m, dtype=float)
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        at_s = start_s + np.concatenate([[0.0], np.cumsum(lengths)]) / speed_m_s
        self._t_s = np.arange(0.0, at_s[-1] + 5.0 * smooth_s + 1.0, DRAWN_STEP_S)
        sharp = np.column_stack([np.interp(self._t_s, at_s, axis) for axis in corners.T])
        self._xyz_m = gaussian_filter1d(sharp, smooth_s / DRAWN_STEP_S, axis=0, mode="nearest")
        self._R = R_world_target

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        xyz = np.column_stack([np.interp(t_s, self._t_s, axis) for axis in self._xyz_m.T])
        quat = np.broadcast_to(self._R.as_quat(), (len(xyz), 4))
        return RigidTransform.from_components(xyz, Rotation.from_quat(quat))


class HandJitter:
    """A path in a hand that shakes a little: sines of TREMOR_HZ about it, of given RMS per axis."""

    def __init__(self, path: Path, rms_m: float, rms_rad: float, rng: np.random.Generator) -> None:
        self._path = path
        self._hz = rng.uniform(*TREMOR_HZ, (6, TREMOR_WAVES))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (6, TREMOR_WAVES))
        share = np.sqrt(2.0 / TREMOR_WAVES)
        self._size = frozen_array("tremor", share * np.repeat([rms_m, rms_rad], 3), (6,))

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        waves = np.sin(2.0 * np.pi * self._hz * np.asarray(t_s)[:, None, None] + self._phase)  # (m, 6, waves)
        shake = self._size * waves.sum(axis=2)
        return self._path(t_s) * RigidTransform.from_components(shake[:, :3], Rotation.from_rotvec(shake[:, 3:]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Vibration:
    """A flange that vibrates: amplitude_m (3,) along its axes at hz (3,) with phases (3,)."""

    amplitude_m: Array
    hz: Array
    phase_rad: Array

    def __call__(self, t_s: Array) -> Array:
        """Return displacements (m, 3) in flange axes at times (m,)."""
        return np.asarray(self.amplitude_m * np.sin(2.0 * np.pi * self.hz * np.asarray(t_s)[:, None] + self.phase_rad))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Jumping:
    """A path that is beside itself by by_m (3,), in target axes, from start_s to end_s."""

    path: Path
    by_m: Array
    start_s: float
    end_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        t = np.asarray(t_s) + 1e-9  # frames at the very end, by rounding, are past it
        on = ((t >= self.start_s) & (t < self.end_s)).astype(float)
        return self.path(t) * RigidTransform.from_translation(on[:, None] * self.by_m)
