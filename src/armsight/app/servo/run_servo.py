"""armsight servo: the arm follows a target, through the guard, until the operator or the time ends it."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.app.measure.run import target_of
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.motion import ServoJob, require_handeye
from armsight.app.robot.recorder import require_new
from armsight.app.robot.robot_run import (
    Confirm,
    CycleTally,
    RecordedSource,
    RobotRun,
    ToolRunOutput,
    check_arm,
    run_output,
)
from armsight.app.servo.vision import CAMERA, TOOL, Beside, ServoDevices, Vision, open_servo, watch
from armsight.control.guard import Guard, GuardState, TargetState
from armsight.control.servo import Gain, Mount, ServoSettings, ServoSource, Turning, chosen_gain, on_axis
from armsight.control.servo.law import CameraDelay
from armsight.control.status import QueueSink, RobotStatus, Timing
from armsight.drivers import Robot
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.ops.arm_files import given_arm
from armsight.ops.sources.pace import live_pace
from armsight.optics import Rig, RigKind
from armsight.records import PoseStatus, Progress, Silent, Target
from armsight.records.output import Output, extended, output
from armsight.store import read_rig
from armsight.store.atomic import write_json
from armsight.store.handeye_file import HandEyeFile, read_handeye
from armsight.units import DEG, MM, MS

RECORDING, SUMMARY = "servo.mcap", "servo.json"
LAG_CYCLES = 2.0
"""Cycles from a command to the arm's motion where nobody says: one until it is taken, one for the drives."""

Show = Callable[[RobotStatus, float | None], None]
"""Is told now and then of a cycle, and of the error of position in m where the target is followed."""


@output
class ServoDelayOutput(Output):
    """Delays, measured while it ran."""

    camera_s: Annotated[float, Doc("From the middle of an exposure to its pose in memory, median, s.")]
    arm_s: Annotated[float, Doc("From a command to the arm's motion, s.")]


@output
class ServoErrorOutput(Output):
    """How far the target was from where it is wanted, as the cameras and the arm's model tell."""

    rms_m: Annotated[float | None, Doc("RMS of the place while the target was followed, m; null: it never was.")]
    max_m: Annotated[float | None, Doc("Largest error of the place, m.")]
    last_m: Annotated[float | None, Doc("The last one, m.")]
    last_rad: Annotated[float | None, Doc("The last error of the rotation, rad.")]


@output
class ServoTimeOutput(Output):
    """Time from a pair of frames in memory to its pose handed to the control loop, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class ServoOutput(ToolRunOutput):
    """armsight servo."""

    n_frames: Annotated[int, Doc("Pairs of frames measured.")]
    n_ok: Annotated[int, Doc("Pairs that showed the whole target.")]
    n_doubtful: Annotated[int, Doc("Pairs whose pose does not fit the claims: not followed.")]
    n_position_only: Annotated[int, Doc("Pairs that showed where it is, but not how it is turned.")]
    n_lost: Annotated[int, Doc("Pairs that did not show it.")]
    gain: Annotated[Gain, Doc("The gain, and what the delay allows.")]
    delay: Annotated[ServoDelayOutput, Doc("The delays that were measured.")]
    error: Annotated[ServoErrorOutput, Doc("How far the target was from where it is wanted.")]
    followed: Annotated[float, Doc("Share of the cycles in which the target was followed, 0 to 1.")]
    vision_ms: Annotated[ServoTimeOutput | None, Doc("How long measuring took; null: no pair came.")]


class FollowedSource(RecordedSource):
    """A servo whose set points go into the recording."""

    def __init__(self, source: ServoSource, sink: QueueSink) -> None:
        super().__init__(source, sink)
        self._source = source

    def target(self, now_s: float) -> tuple[TargetState, float | None]:
        """Return what is known of the target, and the age in s of the newest frame that shows it."""
        return self._source.target(now_s)


class ServoTally(CycleTally):
    """Counts the cycles of a servo: how far the target is in those in which it is followed."""

    def __init__(self, source: ServoSource, cancelled: Callable[[], bool]) -> None:
        super().__init__(cancelled, stuck_s=math.inf)  # however long the target is away, the arm waits for it
        self.followed = 0
        self.last_m = self.last_rad = 0.0
        self._source = source
        self._sum_m2 = self._max_m = 0.0

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last one: the operator let go, or the guard stopped."""
        error = self._source.error
        if status.guard is GuardState.RUNNING and error is not None:
            self.followed += 1
            self.last_m = float(np.linalg.norm(error.translation_m))
            self.last_rad = float(np.linalg.norm(error.rotation_rad))
            self._sum_m2 += self.last_m**2
            self._max_m = max(self._max_m, self.last_m)
        return super().__call__(status)

    @property
    def error_m(self) -> float | None:
        """The error of position just now; None where the target is not followed."""
        error = self._source.error
        return None if error is None else float(np.linalg.norm(error.translation_m))

    @property
    def error(self) -> ServoErrorOutput:
        """How far the target was from where it is wanted."""
        if not self.followed:
            return ServoErrorOutput(rms_m=None, max_m=None, last_m=None, last_rad=None)
        return ServoErrorOutput(
            rms_m=float(np.sqrt(self._sum_m2 / self.followed)),
            max_m=self._max_m,
            last_m=self.last_m,
            last_rad=self.last_rad,
        )

    def stopped_by(self, *, finished: bool = False) -> str:
        """Return why the loop ended: what the arm held for just then did not end it."""
        stopped = self.last is not None and self.last.guard is GuardState.STOPPED
        return super().stopped_by(finished=finished) if stopped or self._cancelled() else "time"


def servo_output(
    tally: ServoTally,
    timing: Timing,
    vision: Vision,
    source: ServoSource,
    gain: Gain,
    recording: Path,
    outside: str,
) -> ServoOutput:
    """Return the figures of a servo that ended."""
    took = np.array(vision.took_ms)
    counts = vision.counts
    return extended(
        run_output(tally, timing, tally.stopped_by(), recording),
        ServoOutput,
        state=tally.state,
        wrong_premise=None if source.wrong is None else source.wrong.cause.value,
        outside=outside,
        n_frames=sum(counts.values()),
        n_ok=counts[PoseStatus.OK],
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
        gain=gain,
        delay=ServoDelayOutput(camera_s=source.camera_delay_s, arm_s=source.arm_lag_s),
        error=tally.error,
        followed=tally.followed / max(tally.cycles, 1),
        vision_ms=ServoTimeOutput(median=float(np.median(took)), p99=float(np.percentile(took, 99)))
        if len(took)
        else None,
    )


def run_servo(
    job: ServoJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    beside: Beside | None = None,
) -> ServoOutput:
    """Follow the target until the operator lets go, seconds_s have passed or the guard stopped; write job.out.

    confirm: asked once, with gain, limits and delay, before anything moves. progress: its cancelled() is the operator's
    enable, let go of. show: told of the newest cycle now and then. devices: in place of those the job names.
    beside: is told of each frame meanwhile. Raises UsageError, DataRefused (another arm's file, no hand-eye, a gain
    that is not stable), DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    _check(job)
    require_new(job.out, RECORDING)
    rig, target, handeye = read_rig(job.rig), target_of(job.target), _handeye(job)
    arm = given_arm(job.arm)
    devices = devices or open_servo(job, rig, target, arm=arm)
    run = RobotRun(job, devices.robot, arm, devices.clock, progress)
    run.require_lengths("Where its cameras are is not known, and nothing is moved")
    settings = _settings(job, handeye, run.guard.arm, devices.robot.cycle_s)
    prepare(progress)
    setup = measuring(rig, target, devices)
    done = _followed(run, job, devices, settings, setup, beside, confirm, show)
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def _followed(
    run: RobotRun,
    job: ServoJob,
    devices: ServoDevices,
    settings: ServoSettings,
    setup: Setup,
    beside: Beside | None,
    confirm: Confirm,
    show: Show,
) -> ServoOutput:
    """Find the delay, ask, follow the target, and return what it came to."""
    guard, progress, clock = run.guard, run.progress, run.clock
    for_s = math.inf if job.seconds_s is None else job.seconds_s
    with ExitStack() as stack:
        stack.enter_context(run)
        check_arm(run.robot, guard.arm)
        sink = stack.enter_context(run.recorded(job.out / RECORDING))
        vision = Vision(setup, devices, job.latency_s, sink)
        run.failed = watch(stack, vision, devices)
        gain, source = _source(job, guard, vision.delay, settings, setup)
        vision.source = source  # which sees from now on
        if beside is not None:
            beside.begin(source, guard.arm, clock, sink)
            vision.beside = beside.observe
        with run.planning():
            asked = question(run.robot, guard, gain, source)
        run.ask(confirm, asked)
        tally, started_s = ServoTally(source, progress.cancelled), clock.now_s()

        def show_progress(status: RobotStatus | None) -> None:
            progress.update(clock.now_s() - started_s, 0.0 if math.isinf(for_s) else for_s)
            if status is not None:
                show(status, tally.error_m)

        recorded, stepped = FollowedSource(source, sink), devices.stepped is not None
        doubt = lambda: source.contradiction  # noqa: E731
        timing = run.follow(recorded, sink, tally, show_progress, for_s=for_s, doubt=doubt, stepped=stepped)
    return servo_output(tally, timing, vision, source, gain, job.out / RECORDING, run.outside)


def _source(
    job: ServoJob, guard: Guard, delay: CameraDelay, settings: ServoSettings, setup: Setup
) -> tuple[Gain, ServoSource]:
    """Return the gain that the measured delay allows, and the source."""
    gain = chosen_gain(job.gain, max(guard.cycle_s, delay.period_s), delay.delay_s + settings.arm_lag_s)
    source = ServoSource(guard.arm, setup.rig, setup.target, settings.with_gain(gain.used), guard.cycle_s)
    source.warm_up()
    return gain, source


def _check(job: ServoJob) -> None:
    if job.at not in (CAMERA, TOOL):
        raise UsageError(f"--at {job.at} is neither {CAMERA} nor {TOOL}", cure="Say whose axis the target is wanted on")
    positive = (
        ("--latency", job.latency_s),
        ("--arm-lag", job.arm_lag_s),
        ("--hand-speed", job.hand_speed_m_s),
        ("--resume-mm", job.resume_m),
        ("--resume-deg", job.resume_rad),
    )
    for name, value in positive:
        if value is not None and not (np.isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value:g} cannot be", cure="Give a number, zero or more")
    if job.seconds_s is not None and not job.seconds_s > 0.0:
        raise UsageError(f"--seconds {job.seconds_s:g} is no time", cure="Give seconds, more than zero")


def _handeye(job: ServoJob) -> HandEyeFile:
    """Return the hand-eye calibration. Raises BadFile where it is missing, Inconsistent where it does not fit."""
    require_handeye(job.handeye)
    handeye = read_handeye(job.handeye)
    if handeye.setup.value == Mount.EYE_TO_HAND.value and job.at == CAMERA:
        raise Inconsistent(
            f"by {job.handeye} the cameras stand beside the robot, and the target is wanted on their axis",
            consequence="The robot cannot bring it there",
            cure="Give --at tool: the tool then goes where the target is, at --distance",
        )
    return handeye


def _settings(job: ServoJob, handeye: HandEyeFile, arm: Arm, cycle_s: float) -> ServoSettings:
    """Return how the target is followed, with a gain of zero: it waits for the delay."""
    T_flange_frame = handeye.T_parent_camera if job.at == CAMERA else arm.T_flange_tool
    return ServoSettings(
        mount=Mount(handeye.setup.value),
        T_parent_camera=handeye.T_parent_camera,
        T_flange_desired=on_axis(T_flange_frame, job.distance_m),
        gain_t=0.0,
        gain_r=0.0,
        arm_lag_s=LAG_CYCLES * cycle_s if job.arm_lag_s is None else job.arm_lag_s,
        predict=job.predict,
        turning=_turning(job.rotation),
        resume_m=job.resume_m,
        resume_rad=job.resume_rad,
    )


def _turning(name: str) -> Turning:
    try:
        return Turning(name)
    except ValueError as error:
        raise UsageError(
            f"{name!r} is no way to turn after a target",
            consequence="Nothing is moved",
            cure=f"Give {', '.join(Turning)} (--rotation)",
        ) from error


def measuring(rig: Rig, target: Target, devices: ServoDevices) -> Setup:
    """Return what measuring needs. Raises UsageError for a board, whose pose takes longer than a servo's cycle."""
    if target.is_board:
        raise UsageError("a board takes too long to find for a servo", cure="Give a target of lights (--target)")
    if rig.kind is RigKind.MIRROR and not devices.overlaid:
        raise UsageError("the rig has mirrors: both of its views are in one image", cure="Give --image")
    settings = SpotSettings(colour=target.colour)
    return Setup(rig=rig, target=target, settings=settings, overlaid=devices.overlaid, pace=live_pace())


NOT_SEEN = (
    " Note: cameras beside the robot do not see the arm, and a wrong hand-eye calibration does not show: the tool "
    "would go to a wrong place, within the guard's limits."
)


def question(robot: Robot, guard: Guard, gain: Gain, source: ServoSource) -> str:
    """Return what is asked before the arm follows."""
    limits, mount = guard.limits, source.settings.mount
    noted = f" Note: {gain.note}." if gain.note else ""
    blind = "" if mount is Mount.EYE_IN_HAND else NOT_SEEN
    return (
        f"{robot.name} follows the target with gain {gain.used:.3g} 1/s ({mount}, delay "
        f"{(gain.n_delay * gain.cycle_s) / MS:.0f} ms, arm's lag taken as {source.arm_lag_s / MS:.0f} ms), at up to "
        f"{limits.speed_m_s / MM:.0f} mm/s and {limits.turn_rad_s / DEG:.0f} deg/s."
        f"{noted}{blind} It may start at once. Move?"
    )
