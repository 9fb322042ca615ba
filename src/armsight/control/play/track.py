"""Ways of the tip by length: legs, sampled tracks and weaves, each with the speed allowed at every position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard.limits import JointBounds, Limits
from armsight.errors import UsageError
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


PATH_ACCELERATION_M_S2 = 0.2
PATH_JERK_M_S3 = 20.0
"""With which speed along the path changes: gentler than the guard's limits, which curves and weaves need."""
SPEED_SHARE, ACCELERATION_SHARE, JERK_SHARE = 0.85, 0.4, 0.3
"""Of the limits, which curves and weaves may use: the rest is for changes of speed, and the guard keeps some back."""
REACH_M = 1e-3
"""So far before and behind a slow position the speed is that of the position: braking takes its time to begin."""


def timed(s: Array, T: Array, joints: tuple[Array, Array], wanted: Array, limits: Limits, bounds: JointBounds) -> Array:
    """Return the speed (n,) along the path: as wanted, less where tool or joints would exceed their limits.

    joints: lengths (k,) and readings (k, n) there. Braking before a slow position begins early enough.
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


MOST_M = {"amplitude_m": 0.025, "wavelength_m": 0.1}
"""Wider or longer weaves are millimetres taken for metres: welding robots weave by 25 mm at most."""
HARMONICS = 3
"""Of a zigzag: its flanks are straight to a few per cent, its tips round, so that the arm need not stop there."""


class WeaveKind(StrEnum):
    """What a weave looks like from above."""

    NONE = "none"
    SINE = "sine"
    ZIGZAG = "zigzag"


@dataclass(frozen=True, slots=True, kw_only=True)
class Weave:
    """amplitude_m: from the seam to the farthest position on either side. wavelength_m: along the seam."""

    kind: WeaveKind = WeaveKind.NONE
    amplitude_m: float = 0.0
    wavelength_m: float = 0.0

    def __post_init__(self) -> None:
        if self.kind is WeaveKind.NONE:
            return
        for name in ("amplitude_m", "wavelength_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 < value <= MOST_M[name]):
                raise UsageError(
                    f"the weave's {name} is {value:g}, which is not above zero and up to {MOST_M[name]:g} m",
                    consequence="Nothing is moved",
                    cure="Give metres, for instance --weave sine:0.002:0.008",
                )

    @classmethod
    def parse(cls, text: str) -> Weave:
        """Return the weave of a text none, sine:AMPLITUDE:WAVELENGTH or zigzag:..., in m. Raises UsageError."""
        name, *numbers = text.split(":")
        try:
            kind = WeaveKind(name)
            values = [float(part) for part in numbers]
            if len(values) != (0 if kind is WeaveKind.NONE else 2):
                raise ValueError
        except ValueError:
            raise UsageError(
                f"{text[:60]!r} is no weave",
                consequence="Nothing is moved",
                cure="Give none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH in metres",
            ) from None
        return cls() if not values else cls(kind=kind, amplitude_m=values[0], wavelength_m=values[1])

    def offset_m(self, s_m: ArrayLike) -> Array:
        """Return the offset across the seam (n,) at lengths s_m (n,) along it; 0 at length 0."""
        s = np.asarray(s_m, dtype=np.float64)
        if self.kind is WeaveKind.NONE:
            return np.zeros_like(s)
        phase = s / self.wavelength_m
        if self.kind is WeaveKind.SINE:
            return np.asarray(self.amplitude_m * np.sin(2.0 * np.pi * phase))
        return self.amplitude_m * _zigzag(phase)


def _zigzag(phase: Array) -> Array:
    """Return a zigzag (n,) of height 1 with tips rounded: the first harmonics of a triangular wave."""
    angle = 2.0 * np.pi * phase
    rows = [(-1) ** k * np.sin((2 * k + 1) * angle) / (2 * k + 1) ** 2 for k in range(HARMONICS)]
    return np.asarray(np.sum(rows, axis=0) / sum(1.0 / (2 * k + 1) ** 2 for k in range(HARMONICS)))
