"""What is in front of the simulated cameras: lights on a moving target, and what goes wrong on command or by plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.records import frozen_array

LEAST_SIGMA_PX = 0.3
"""Below this a lens would be sharper than its pixels by far and a disc's outline would need thousands of nodes."""


class Path(Protocol):
    """Where a target is at any time."""

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at the times t_s (n,)."""
        ...


ALL_BEFORE_IT_DEG = 90.0
"""Of a light that is seen from all before it: how far from where it faces."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rest:
    """A path that stays at one pose T_world_target."""

    T_world_target: RigidTransform

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the same pose for every time."""
        poses = np.broadcast_to(self.T_world_target.as_matrix(), (len(t_s), 4, 4))
        return RigidTransform(poses, normalize=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothTrajectory:
    """A smooth path about centre_m (3,) and tilt: each coordinate and each angle swings as a sine of its own.

    swing_m (3,), swing_rad (3,): amplitudes, in world axes and as a rotation vector after tilt. period_s (6,) and
    phase_rad (6,): of x, y, z, then of the angles.
    """

    centre_m: Array
    tilt: Rotation
    swing_m: Array
    swing_rad: Array
    period_s: Array
    phase_rad: Array

    def __post_init__(self) -> None:
        for name, size in (("centre_m", 3), ("swing_m", 3), ("swing_rad", 3), ("period_s", 6), ("phase_rad", 6)):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (size,)))
        if not (self.period_s > 0.0).all():
            raise Inconsistent("a path's periods must be positive")

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at the times t_s (n,)."""
        swing = np.sin(2.0 * np.pi * np.asarray(t_s)[:, None] / self.period_s + self.phase_rad)  # (n, 6)
        poses = np.zeros((len(swing), 4, 4))
        poses[:, :3, :3] = (self.tilt * Rotation.from_rotvec(swing[:, 3:] * self.swing_rad)).as_matrix()
        poses[:, :3, 3] = self.centre_m + swing[:, :3] * self.swing_m
        poses[:, 3, 3] = 1.0
        return RigidTransform(poses, normalize=False)  # from_components takes four times as long


BLUR_PX = 2.0
"""Spread of a point light in the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Light:
    """A light fixed to the target.

    xyz_m, facing (unit): place and direction of shining in target axes; it is not seen from behind, unless
    facing is zero: then it shines everywhere. level:
    peak of the spread function above the background in grey levels (of a disc: its plateau). sigma_px: spread of
    a point light, or the lens blur at the edge of a disc. diameter_m: None for a point, else of a flat disc
    normal to facing. bgr: share of each channel in a colour camera. wide_deg: how far from facing it is seen.
    """

    name: str
    xyz_m: tuple[float, float, float]
    level: float = 180.0
    sigma_px: float = BLUR_PX
    diameter_m: float | None = None
    facing: tuple[float, float, float] = (0.0, 0.0, -1.0)
    bgr: tuple[float, float, float] = (1.0, 1.0, 1.0)
    wide_deg: float = ALL_BEFORE_IT_DEG

    def __post_init__(self) -> None:
        if not (self.level >= 0.0 and self.sigma_px >= LEAST_SIGMA_PX):
            raise Inconsistent(f"light {self.name}: level {self.level} or sigma {self.sigma_px} px cannot be")
        if self.diameter_m is not None and not self.diameter_m > 0.0:
            raise Inconsistent(f"light {self.name}: a diameter of {self.diameter_m} m is not positive")

    def edge_m(self, nodes: int) -> Array:
        """Return nodes evenly spaced points (nodes, 3) on the edge of a disc, in target axes."""
        n = np.asarray(self.facing, float) / np.linalg.norm(self.facing)
        helper = np.eye(3)[np.argmin(np.abs(n))]
        e1 = np.cross(n, helper)
        e1 /= np.linalg.norm(e1)
        e2 = np.cross(n, e1)
        angle = 2.0 * np.pi * np.arange(nodes) / nodes
        radius = 0.5 * (self.diameter_m or 0.0)
        circle = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2  # (nodes, 3)
        return np.asarray(np.asarray(self.xyz_m) + radius * circle)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ghost:
    """A reflection: a spot that stands still in the image, where no light of the target is."""

    uv_px: tuple[float, float]
    level: float = 120.0
    sigma_px: float = BLUR_PX
    bgr: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Event:
    """Something that goes wrong in the frames first <= k < last of one camera, or of both.

    side: a camera's name, or 'both' or 'all', which mean every one. hidden: lights that are covered. ghosts:
    reflections that appear.
    """

    first: int
    last: int
    side: str
    note: str
    hidden: tuple[str, ...] = ()
    ghosts: tuple[Ghost, ...] = field(default=())

    def applies(self, index: int, side: str) -> bool:
        """Tell whether the event is on in frame index of camera side."""
        return self.first <= index < self.last and self.side in (side, "both", "all")


def hidden_lights(events: Sequence[Event], index: int, side: str) -> frozenset[str]:
    """Return the names of the lights covered in frame index of camera side."""
    return frozenset(name for event in events if event.applies(index, side) for name in event.hidden)


def ghosts_seen(events: Sequence[Event], index: int, side: str) -> tuple[Ghost, ...]:
    """Return the reflections in frame index of camera side."""
    return tuple(ghost for event in events if event.applies(index, side) for ghost in event.ghosts)


LEAST_FRAMES = 25
"""Below this nothing goes wrong: the shortest fault would be a large part of the run."""


def planned_events(frames: int, names: tuple[str, ...], size_px: tuple[int, int], sigma_px: float) -> tuple[Event, ...]:
    """Return the faults of a run over a target of three lights or more; none in runs below LEAST_FRAMES.

    At 15 % of the run the third light is covered in the left view for 3 % of the frames (two lights left: position
    only), at 35 % the second in both for 2 %, at 50 % all in both for 2 % (lost), at 65 % the first two in the
    right for 1 % (one light left); at 80 % a reflection stands in the right view for 4 % (nothing is lost by it).
    Each lasts one frame at least.
    """
    if frames < LEAST_FRAMES:
        return ()
    first, second, third = names[:3]
    width, height = size_px
    ghost = Ghost(uv_px=(0.17 * width, 0.22 * height), level=140.0, sigma_px=sigma_px)
    plan = (
        (0.15, 0.03, "left", (third,), (), f"light {third} covered in the left view"),
        (0.35, 0.02, "both", (second,), (), f"light {second} covered in both views"),
        (0.50, 0.02, "both", names, (), "all lights covered in both views"),
        (0.65, 0.01, "right", (first, second), (), f"lights {first} and {second} covered in the right view"),
        (0.80, 0.04, "right", (), (ghost,), "a reflection in the right view"),
    )
    events = []
    for start, share, side, hidden, ghosts, note in plan:
        at = int(start * frames)
        last = at + max(1, round(share * frames))
        events.append(Event(first=at, last=last, side=side, note=note, hidden=hidden, ghosts=ghosts))
    return tuple(events)
