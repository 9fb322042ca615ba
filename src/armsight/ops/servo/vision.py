"""From moments of frames to target poses for a servo, and the cameras, real or simulated, that they come from."""

from __future__ import annotations

import math
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from armsight.clock import Clock
from armsight.control.servo import ServoSource
from armsight.control.servo.law import CameraDelay
from armsight.control.status import QueueSink
from armsight.defaults import HAND_SPEED_M_S
from armsight.drivers import MomentSource, Views, moments_of, news_of
from armsight.errors import ArmsightError, BadFile, DeviceFailed, NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.measure.consistency.findings import LeftOut
from armsight.measure.consistency.live_cameras import WatchedTracker
from armsight.measure.poses.moments import lost_frames
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.measure.settings import SpotSettings
from armsight.ops.requests.motion import LATENCY_S, RobotJob, refuse_cameras
from armsight.ops.robot.opening import ClockedRobot, clocked_robot, refuse_settings
from armsight.ops.servo.cameras import CameraNames
from armsight.ops.servo.stepped import SteppedClock
from armsight.ops.simulation.following import watching_cell
from armsight.ops.simulation.scenarios import live_cell
from armsight.ops.sources.cameras import require_watching
from armsight.ops.sources.pace import live_pace
from armsight.optics import Rig, RigKind
from armsight.records import PoseStatus, Target, TargetPose
from armsight.store.handeye_file import HandEyeFile, read_handeye

CAMERA, TOOL = "camera", "tool"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServoDevices(ClockedRobot):
    """A robot and its cameras, not yet open. overlaid: one image holds both views.

    origin_s: tells the clock's time of the cameras' zero once they are open, None where only arrivals tell it.
    latency_s: from the middle of an exposure to the frame in memory, where only arrivals do. stepped: the clock of a
    simulated cell, which moves only as far as the loop waits; None: real time.
    """

    pairs: MomentSource
    overlaid: bool = False
    latency_s: float = LATENCY_S
    origin_s: Callable[[], float] | None = None
    stepped: SteppedClock | None = None


JOIN_S = 2.0
"""How long the end of the thread is waited for."""
NOISY_SHARE = 0.05
"""Share of an image's pixels that differ from one picture to the next where a sensor's noise is in them."""
SHOWN = 200
"""Pictures that are remembered: one of them that comes again shows nothing of now."""
PROBED = 15
"""Pairs of which the cameras' delay is measured before anything moves."""
PROBED_S = 5.0
"""Pairs that do not come within so long come too slowly to follow anything."""


class Beside(Protocol):
    """What goes on beside a servo: a path that is taught while the target is followed."""

    def begin(self, source: ServoSource, arm: Arm, clock: Clock, sink: QueueSink) -> None:
        """Take the source of an arm, before the first cycle, the loop's clock and what takes events."""
        ...

    def observe(self, pose: TargetPose, exposed_s: float) -> None:
        """Take what a frame shows, in rig axes, exposed at exposed_s on the loop's clock."""
        ...

    def forget_since(self, t_s: float) -> None:
        """Forget what was exposed after t_s, on the loop's clock: cameras turned out to be wrong."""
        ...


class Vision:
    """Measures moment after moment, and gives the poses to a source once there is one."""

    def __init__(self, setup: Setup, devices: ServoDevices, sink: QueueSink) -> None:
        self.source: ServoSource | None = None
        self.beside: Callable[[TargetPose, float], None] | None = None
        self.delay = CameraDelay()
        self.counts = dict.fromkeys(PoseStatus, 0)
        self.took_ms: list[float] = []
        self.newest: TargetPose | None = None
        self.contradictions: tuple[LeftOut, ...] = ()
        """What is wrong with cameras or the rig: nothing must move on it."""
        self.trusted_s = -math.inf
        """Exposure of the newest moment to which no camera contradicts the others."""
        self._setup = setup
        self._devices = devices
        self._clock: Clock = devices.clock
        self._sink = sink
        self._tracker = WatchedTracker(setup)
        self._last: Views = (None,) * len(setup.rig.names)
        self._shown: tuple[deque[int], ...] = tuple(deque(maxlen=SHOWN) for _ in setup.rig.names)
        self._noisy = [False] * len(setup.rig.names)
        self._standing: set[str] = set()
        self._lost: list[str] = []
        self._ahead_s = math.inf  # the clock's time at the cameras' zero

    def take(self, moment: Views) -> None:
        """Measure a moment and tell the source. Raises Inconsistent for frames that are not of the rig's size."""
        begun_s = time.perf_counter()
        for message in news_of(self._devices.pairs, self._lost):
            self._tell(message)
        measured = self._measured(moment)
        pose, zero_s = measured.pose, self._zero_s(moment)
        self._watch(zero_s)
        exposed_s, now_s = pose.t_s + zero_s, self._clock.now_s()
        self.delay.add(exposed_s, now_s)
        if self.source is not None:
            self.source.observe(pose, exposed_s, now_s)
        if self.beside is not None:
            self.beside(pose, exposed_s)
        self.took_ms.append((time.perf_counter() - begun_s) * 1e3)
        self.counts[pose.status] += 1
        self.newest = pose
        self._sink.pose(replace(pose, t_s=exposed_s))

    def _zero_s(self, moment: Views) -> float:
        """Return the clock's time at the cameras' zero: told, or by the frame that came soonest after its exposure."""
        if self._devices.origin_s is not None:
            return self._devices.origin_s()
        newest_s = max(frame.t_s for frame in moment if frame is not None)
        self._ahead_s = min(self._ahead_s, self._clock.now_s() - newest_s - self._devices.latency_s)
        return self._ahead_s

    def require_agreement(self) -> None:
        """Raise Inconsistent where cameras contradict each other by what was seen so far."""
        self._tracker.finish("Nothing is moved")

    @property
    def rig(self) -> Rig:
        """The cameras."""
        return self._setup.rig

    @property
    def contradiction(self) -> str:
        """What is wrong with cameras or the rig and what to do, in words; empty where nothing."""
        return " ".join(one.contradiction for one in self.contradictions)

    def _watch(self, zero_s: float) -> None:
        """Take what the tracker found of the rig, and tell it once."""
        before, self.contradictions = self.contradictions, self._tracker.contradictions
        self.trusted_s = self._tracker.trusted_s + zero_s
        for one in self.contradictions[len(before) :]:
            self._tell(one.contradiction)

    def _tell(self, message: str) -> None:
        self._sink.event(self._clock.now_s(), message, "warning", "cameras")

    def _stand(self, moment: Views) -> list[bool]:
        """Tell which cameras send one of their last pictures again. A sensor's noise never repeats; rendered pictures
        may. Of a pair noise is asked of both at one time."""
        last, self._last = self._last, moment
        both = [(a, b) for a, b in zip(last, moment, strict=True) if a is not None and b is not None]
        if not both or any(a.image.shape != b.image.shape for a, b in both):
            return [False] * len(moment)
        changed = [
            0.0 if a is None or b is None else float(np.mean(a.image[::8, ::8] != b.image[::8, ::8]))
            for a, b in zip(last, moment, strict=True)
        ]
        changed = [min(changed)] * len(changed) if self._setup.rig.is_pair else changed
        self._noisy = [noisy or share > NOISY_SHARE for noisy, share in zip(self._noisy, changed, strict=True)]
        again = [False] * len(moment)
        for s, (frame, shown) in enumerate(zip(moment, self._shown, strict=True)):
            if frame is not None:
                mark = zlib.crc32(frame.image[::8, ::8].tobytes())
                again[s] = mark in shown
                shown.append(mark)
        return [noisy and one for noisy, one in zip(self._noisy, again, strict=True)]

    def _measured(self, moment: Views) -> Measured:
        """Return what is measured; of three cameras and more without one whose pictures stand."""
        stand = self._stand(moment)
        seen = [None if one else frame for one, frame in zip(stand, moment, strict=True)]
        if any(stand) and (self._setup.rig.is_pair or not any(seen)):
            return lost_frames(moment, "a camera sends one of its last pictures again")
        for name, one in zip(self._setup.rig.names, stand, strict=True):
            if one and name not in self._standing:
                self._tell(f"the camera {name} sends one of its last pictures again: it is left out where it does")
                self._standing.add(name)
        return self._tracker.take(*seen)


class VisionThread:
    """Takes the moments of open cameras in a thread of its own. Leaving it ends the thread.

    A failure ends it too: the source then gets no more poses, the guard holds, and `failed` says why.
    """

    def __init__(self, vision: Vision, devices: ServoDevices) -> None:
        self.failed: ArmsightError | None = None
        self._vision = vision
        self._devices = devices
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servo vision", daemon=True)

    def __enter__(self) -> VisionThread:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        try:
            with closing(moments_of(self._devices.pairs)) as moments:
                for moment in moments:
                    self._vision.take(moment)
                    if self._end.is_set():
                        return
            self.failed = DeviceFailed("the cameras ended", consequence="The target is not seen", cure="Check them")
        except ArmsightError as error:
            self.failed = error
        except Exception as error:  # told by the main thread; the arm must not go on blind meanwhile
            self.failed = DeviceFailed(f"measuring failed: {error!r}", consequence="The target is not seen any more")


def watch(stack: ExitStack, vision: Vision, devices: ServoDevices) -> Callable[[], ArmsightError | None]:
    """Open the cameras and measure their pairs until stack ends; return what tells why they ended, once they came.

    Of a simulated clock as that moves, else in a thread. Raises as probe.
    """
    pairs = stack.enter_context(devices.pairs)
    failed: Callable[[], ArmsightError | None] = lambda: None  # noqa: E731
    if devices.stepped is not None:
        devices.stepped.watch(pairs, vision.take)  # type: ignore[arg-type]  # of a live cell, by number too
    else:
        thread = stack.enter_context(VisionThread(vision, devices))
        failed = lambda: thread.failed  # noqa: E731
    probe(vision, devices.clock, failed)
    return failed


def probe(vision: Vision, clock: Clock, failed: Callable[[], ArmsightError | None]) -> None:
    """Wait until the cameras' delay is known.

    Raises what failed; NotEnoughData for too few moments in PROBED_S, Inconsistent where cameras contradict each other.
    """
    until_s = clock.now_s() + PROBED_S
    while vision.delay.n < PROBED:
        error = failed()
        if error is not None:
            raise error
        if clock.now_s() >= until_s:
            raise NotEnoughData(
                f"only {vision.delay.n} {'pairs of frames' if vision.rig.is_pair else 'moments'} came within "
                f"{PROBED_S:g} s",
                consequence="The delay is not known, and nothing is moved",
                cure="Check the cameras, their exposure and their rate",
            )
        clock.sleep_until(clock.now_s() + 0.02)
    vision.require_agreement()


FEWEST_OF_ONE = 4
"""Lights that one camera needs; they may not share a plane."""


def measuring(rig: Rig, target: Target, devices: ServoDevices) -> Setup:
    """Return what measuring needs.

    Raises UsageError for a board, whose pose takes longer than a servo's cycle, and for a target that one camera sees
    in two tilts.
    """
    if target.is_board:
        raise UsageError("a board takes too long to find for a servo", cure="Give a target of lights (--target)")
    if rig.kind is RigKind.MIRROR and not devices.overlaid:
        raise UsageError("the rig has mirrors: both of its views are in one image", cure="Give --image")
    settings = SpotSettings(colour=target.colour)
    setup = Setup(rig=rig, target=target, settings=settings, overlaid=devices.overlaid, pace=live_pace())
    if len(rig.cameras) == 1 and (setup.model.flat or len(setup.model) < FEWEST_OF_ONE):
        raise UsageError(
            "one camera sees a flat target, or one of three lights, as well in one tilt as in its mirrored one",
            consequence="The arm might follow the wrong one, and nothing is moved",
            cure="Give four lights and more of which one stands out of the others' plane, or a rig of more cameras",
        )
    return setup


def placed_cameras(handeye: Path) -> HandEyeFile:
    """Return where the cameras are. Raises BadFile where there is no hand-eye calibration."""
    if not handeye.exists():
        raise BadFile(
            f"the hand-eye calibration {handeye} is missing",
            consequence="Where the cameras are on the robot is not known, and nothing is moved",
            cure="Make it with: armsight calibrate handeye",
        )
    return read_handeye(handeye)


SIM = "sim:"


def open_servo(
    job: RobotJob,
    rig: Rig,
    target: Target,
    arm: Arm | None,
    cameras: CameraNames,
    *,
    hand: str | None = None,
    hand_speed_m_s: float = HAND_SPEED_M_S,
) -> ServoDevices:
    """Return a robot with its cameras; nothing is opened yet.

    hand, hand_speed_m_s: how the target of a simulated cell is led. Raises UsageError, DeviceNotFound, BadFile.
    """
    if isinstance(job.device, ServoDevices):
        return job.device
    if job.follow is not None:
        return _following(job, job.follow, rig, arm, cameras, hand, hand_speed_m_s)
    if job.device is None and job.robot.startswith(SIM):
        refuse_settings(job)
        return _simulated(job.robot, rig, cameras, hand, hand_speed_m_s)
    if hand is not None:
        raise UsageError(f"--hand leads a simulated target, and {job.robot} is no simulated robot", cure="Leave it out")
    robot = clocked_robot(job, arm)
    require_watching(cameras.named().values(), "the target")
    moments = cameras.moments(rig, target, robot.clock)
    if moments is None:
        raise UsageError(
            "which cameras see the target is not said",
            cure="Give --left and --right, --camera NAME=SRC for each of another rig, or --image for a mirror rig",
        )
    pairs, overlaid = moments
    return ServoDevices(
        robot=robot.robot, clock=robot.clock, pairs=pairs, overlaid=overlaid, latency_s=cameras.latency_s
    )


def _simulated(robot: str, rig: Rig, cameras: CameraNames, hand: str | None, hand_speed_m_s: float) -> ServoDevices:
    """Return a simulated cell, whose time moves with the loop."""
    given = [*cameras.named(), *(["exposure_s"] if cameras.exposure_s is not None else [])]
    if given:
        raise UsageError(
            f"the simulated cell {robot} has its own cameras, and {', '.join(given)} is given", cure="Leave it out"
        )
    clock = SteppedClock()
    cell = live_cell(robot.removeprefix(SIM), clock, cameras=rig.names, hand=hand, speed_m_s=hand_speed_m_s)
    return ServoDevices(
        robot=cell.robot,
        pairs=cell.pairs,
        clock=clock,
        overlaid=cell.one_image,
        origin_s=lambda: float(cell.origin_s),
        stepped=clock,
    )


def _following(
    job: RobotJob,
    cell: str,
    rig: Rig,
    arm: Arm | None,
    cameras: CameraNames,
    hand: str | None,
    hand_speed_m_s: float,
) -> ServoDevices:
    """Return a robot with the simulated cameras that watch it, or that it carries, in real time."""
    refuse_cameras(cell, **cameras.named(), exposure=cameras.exposure_s)
    robot = clocked_robot(job, arm)
    seen = watching_cell(cell, robot.robot, robot.clock, cameras=rig.names, hand=hand, speed_m_s=hand_speed_m_s)
    return ServoDevices(
        robot=robot.robot,
        pairs=seen.pairs,
        clock=robot.clock,
        overlaid=seen.one_image,
        origin_s=lambda: float(seen.origin_s),
    )
