"""What is played, with what, what is read for it, and the cameras that watch it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from armsight.control.guard import Limits
from armsight.control.play import CameraPlacement, PlaySettings
from armsight.control.servo import Mount
from armsight.control.status import QueueSink
from armsight.errors import ArmsightError, UsageError
from armsight.measure.poses.pipeline import Setup
from armsight.ops.robot.opening import ClockedRobot
from armsight.ops.servo.vision import ServoDevices, Vision, watch
from armsight.records import PoseStatus, TargetPose
from armsight.store.handeye_file import HandEyeFile
from armsight.units import MM

STOP_MOST_M = 0.5
"""Off by so much the tip is anywhere: a larger --stop-at is millimetres, and would never stop."""
FRAMES = ("world", "base")


def check(frame: str, stop_m: float) -> None:
    """Raise UsageError for what cannot be meant."""
    if frame not in FRAMES:
        raise UsageError(
            f"{frame!r} is no frame of a path",
            consequence="Nothing is moved",
            cure=f"Give {' or '.join(FRAMES)} (--frame)",
        )
    if not (np.isfinite(stop_m) and stop_m > 0.0):
        raise UsageError(
            f"--stop-at {stop_m:g} is no distance", consequence="Nothing is moved", cure="Give m, more than zero"
        )
    if stop_m > STOP_MOST_M:
        raise UsageError(
            f"--stop-at {stop_m:g} is in m: the arm would not be stopped before its tip is so far off",
            consequence="Nothing is moved",
            cure=f"Give m: {stop_m:g} mm are {stop_m * MM:g}",
        )


def check_speeds(settings: PlaySettings, limits: Limits, share: float) -> None:
    """Raise UsageError for a speed that was asked for and that the limits forbid: mm/s given as m/s.

    share: of the guard's speeds, which limits are slowed by already.
    """
    usual = PlaySettings()
    most = limits.speed_m_s / share  # the share of it that is given slows what was asked for
    for flag, value, otherwise in (
        ("--path-speed", settings.speed_m_s, usual.speed_m_s),
        ("--approach-speed", settings.approach_speed_m_s, usual.approach_speed_m_s),
    ):
        if value > max(most, otherwise):
            raise UsageError(
                f"{flag} {value:g} is in m/s, and the guard allows the tool {most:g} m/s",
                consequence="Nothing is moved",
                cure=f"Give m/s: {value:g} mm/s are {value * MM:g}; or allow more (speed_m_s in --limits)",
            )


def require_cameras(**files: object) -> None:
    """Raise UsageError where cameras are to watch and what they need is missing."""
    missing = ", ".join(f"--{name}" for name, value in files.items() if value is None)
    if missing:
        raise UsageError(
            f"cameras are to watch, and {missing} is missing",
            consequence="Where they see the tip cannot be told, and nothing is moved",
            cure="Give rig, target and hand-eye calibration, or none of them and no camera",
        )


def sight_of(handeye: HandEyeFile) -> CameraPlacement:
    """Return how the cameras tell where the flange is."""
    return CameraPlacement(
        mount=Mount(handeye.setup.value),
        T_parent_camera=handeye.T_parent_camera,
        T_parent_target=handeye.T_parent_target,
    )


Seen = Callable[[TargetPose, float], None]
"""Is told a pose in rig axes, and when it was exposed on the loop's clock."""


class Watcher(Protocol):
    """Tells where cameras see the target while a path is played. stepped: whether their time is simulated."""

    sight: CameraPlacement
    stepped: bool

    def open(self, stack: ExitStack, sink: QueueSink, seen: Seen) -> None:
        """Tell what is seen until stack ends. Raises where nothing comes."""
        ...

    def counts(self) -> Mapping[PoseStatus, int]:
        """Return the frames so far by what they showed."""
        ...

    def failed(self) -> ArmsightError | None:
        """Return what ended it."""
        ...

    def contradiction(self) -> str:
        """Return what is wrong with the cameras, in words, so that nothing must move on what they show; else empty."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WatchedRobot(ClockedRobot):
    """A robot whose path somebody watches."""

    watcher: Watcher | None


class TargetMonitor:
    """Cameras that watch: robot and cameras of one clock, and what measuring needs. Nothing is open."""

    def __init__(self, devices: ServoDevices, setup: Setup, handeye: HandEyeFile) -> None:
        self.sight = sight_of(handeye)
        self.devices, self.setup = devices, setup
        self.stepped = devices.stepped is not None
        self._vision: Vision | None = None
        self._ended: Callable[[], ArmsightError | None] = lambda: None

    def open(self, stack: ExitStack, sink: QueueSink, seen: Seen) -> None:
        """Open the cameras and measure what they see until stack ends. Raises where too few frames come."""
        self._vision = Vision(self.setup, self.devices, sink)
        self._ended = watch(stack, self._vision, self.devices)
        self._vision.beside = seen

    def counts(self) -> Mapping[PoseStatus, int]:
        """Return the frames so far by what they showed."""
        return dict.fromkeys(PoseStatus, 0) if self._vision is None else self._vision.counts

    def failed(self) -> ArmsightError | None:
        """Return what ended the cameras."""
        return self._ended()

    def contradiction(self) -> str:
        """Return what is wrong with cameras or the rig."""
        return "" if self._vision is None else self._vision.contradiction
