"""What is played, with what, what is read for it, and the cameras that watch it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from armsight.app.measure.run import target_of
from armsight.app.requests.motion import PlayJob
from armsight.app.servo.run_servo import measuring
from armsight.app.servo.vision import ServoDevices, Vision, open_servo, watch
from armsight.control.guard import Guard, Limits
from armsight.control.play import CameraPlacement, PathPlan, PlaySettings, plan_path
from armsight.control.servo import Mount
from armsight.control.status import QueueSink
from armsight.errors import ArmsightError, UsageError
from armsight.kinematics import Arm
from armsight.ops.path.check import with_tip
from armsight.records import PoseStatus, TargetPose, TaughtPath
from armsight.store import read_rig
from armsight.store.handeye_file import HandEyeFile, read_handeye, read_tip
from armsight.units import MM

STOP_MOST_M = 0.5
"""Off by so much the tip is anywhere: a larger --stop-at is millimetres, and would never stop."""
FRAMES = ("world", "base")


def check(job: PlayJob) -> None:
    """Raise UsageError for what cannot be meant."""
    if job.frame not in FRAMES:
        raise UsageError(
            f"{job.frame!r} is no frame of a path",
            consequence="Nothing is moved",
            cure=f"Give {' or '.join(FRAMES)} (--frame)",
        )
    if job.stop_m is not None and not (np.isfinite(job.stop_m) and job.stop_m > 0.0):
        raise UsageError(
            f"--stop-at {job.stop_m:g} is no distance", consequence="Nothing is moved", cure="Give m, more than zero"
        )
    if job.stop_m is not None and job.stop_m > STOP_MOST_M:
        raise UsageError(
            f"--stop-at {job.stop_m:g} is in m: the arm would not be stopped before its tip is so far off",
            consequence="Nothing is moved",
            cure=f"Give m: {job.stop_m:g} mm are {job.stop_m * MM:g}",
        )


def tipped(arm: Arm, tip: Path | None) -> Arm:
    """Return the arm with its tool's frame moved to the tip of a tip.yaml, in flange axes. Raises BadFile."""
    return arm if tip is None else with_tip(arm, read_tip(tip).tip_m)


def tipped_guard(guard: Guard, tip: Path | None) -> Guard:
    """Return the same guard for the tip of a tip.yaml, which is then what keeps the limits of the tool."""
    return guard if tip is None else Guard(tipped(guard.arm, tip), guard.limits, guard.cycle_s)


def planned(job: PlayJob, path: TaughtPath, arm: Arm, limits: Limits, q: ArrayLike) -> PathPlan:
    """Return the path made ready, as the job says, for an arm that stands at q (n,) and whose tool is the tip.

    Nothing moves. Raises UsageError, NotEnoughData, and Inconsistent for a path that cannot be run, with why.
    """
    _check_speeds(job, limits)
    return plan_path(path, arm, limits, q, job.settings)


def _check_speeds(job: PlayJob, limits: Limits) -> None:
    """Raise UsageError for a speed that was asked for and that the limits forbid: mm/s given as m/s."""
    usual = PlaySettings()
    most = limits.speed_m_s / job.speed  # the share of it that is given slows what was asked for
    for flag, value, otherwise in (
        ("--path-speed", job.path_speed_m_s, usual.speed_m_s),
        ("--approach-speed", job.approach_speed_m_s, usual.approach_speed_m_s),
    ):
        if value > max(most, otherwise):
            raise UsageError(
                f"{flag} {value:g} is in m/s, and the guard allows the tool {most:g} m/s",
                consequence="Nothing is moved",
                cure=f"Give m/s: {value:g} mm/s are {value * MM:g}; or allow more (speed_m_s in --limits)",
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


class TargetMonitor:
    """Cameras that watch: robot and cameras of one clock, and what measuring needs. Nothing is open."""

    def __init__(self, job: PlayJob, devices: ServoDevices | None, arm: Arm | None) -> None:
        """devices: in place of those that the job names; arm: as given. Raises UsageError, BadFile, DeviceNotFound."""
        cameras = job.cameras()
        rig, target = read_rig(cameras.rig), target_of(cameras.target)
        self.sight = sight_of(read_handeye(cameras.handeye))
        self.devices = devices or open_servo(cameras, rig, target, arm=arm)
        self.setup = measuring(rig, target, self.devices)
        self.latency_s = job.latency_s
        self.stepped = self.devices.stepped is not None
        self._vision: Vision | None = None
        self._ended: Callable[[], ArmsightError | None] = lambda: None

    def open(self, stack: ExitStack, sink: QueueSink, seen: Seen) -> None:
        """Open the cameras and measure what they see until stack ends. Raises where too few frames come."""
        self._vision = Vision(self.setup, self.devices, self.latency_s, sink)
        self._ended = watch(stack, self._vision, self.devices)
        self._vision.beside = seen

    def counts(self) -> Mapping[PoseStatus, int]:
        """Return the frames so far by what they showed."""
        return dict.fromkeys(PoseStatus, 0) if self._vision is None else self._vision.counts

    def failed(self) -> ArmsightError | None:
        """Return what ended the cameras."""
        return self._ended()
