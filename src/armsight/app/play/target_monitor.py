"""Cameras that watch a path while it is played."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Protocol

from armsight.app.measure.run import target_of
from armsight.app.play.play_job import sight_of
from armsight.app.requests.motion import PlayJob
from armsight.app.servo.run_servo import measuring
from armsight.app.servo.servo_job import ServoDevices
from armsight.app.servo.vision import Vision, open_servo, watch
from armsight.control.events import QueueSink
from armsight.control.play import CameraPlacement
from armsight.errors import ArmsightError
from armsight.kinematics import Arm
from armsight.records import PoseStatus, TargetPose
from armsight.store import read_rig
from armsight.store.handeye_file import read_handeye

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
