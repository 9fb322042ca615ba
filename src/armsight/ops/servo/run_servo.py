"""armsight servo: the arm follows a target, through the guard, until the operator or the time ends it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.control.guard import Guard, GuardState, TargetState
from armsight.control.servo import Gain, Mount, ServoSettings, ServoSource, Turning, chosen_gain
from armsight.control.servo.law import CameraDelay
from armsight.control.servo.premise_bank import named_cause
from armsight.control.status import QueueSink, RobotStatus, Timing
from armsight.drivers import Robot
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.file_names import SERVO
from armsight.measure.poses.pipeline import Setup
from armsight.ops.robot.robot_run import (
    CycleTally,
    RecordedSource,
    RobotRun,
    ToolRunOutput,
    check_arm,
)
from armsight.ops.servo.vision import CAMERA, TOOL, Beside, ServoDevices, Vision, watch
from armsight.records import PoseStatus
from armsight.records.output import Output, extended, output
from armsight.shown import Shown, digits
from armsight.store.atomic import write_json
from armsight.store.handeye_file import HandEyeFile
from armsight.units import DEG, MM, MS

LAG_CYCLES = 2.0
"""Cycles from a command to the arm's motion where nobody says: one until it is taken, one for the drives."""

Show = Callable[[RobotStatus, float | None], object]
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
    """Time from the frames of a moment in memory to its pose handed to the control loop, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class ServoOutput(ToolRunOutput):
    """armsight servo."""

    n_frames: Annotated[int, Doc("Moments measured; of two cameras pairs of frames.")]
    n_ok: Annotated[int, Doc("Moments that showed the whole target.")]
    n_doubtful: Annotated[int, Doc("Moments whose pose does not fit the claims: not followed.")]
    n_position_only: Annotated[int, Doc("Moments that showed where it is, but not how it is turned.")]
    n_lost: Annotated[int, Doc("Moments that did not show it.")]
    gain: Annotated[Gain, Doc("The gain, and what the delay allows.")]
    delay: Annotated[ServoDelayOutput, Doc("The delays that were measured.")]
    error: Annotated[ServoErrorOutput, Doc("How far the target was from where it is wanted.")]
    followed: Annotated[float, Doc("Share of the cycles in which the target was followed, 0 to 1.")]
    vision_ms: Annotated[ServoTimeOutput | None, Doc("How long measuring took; null: no moment came.")]
    of_pair: bool = True

    def summary(self) -> Iterator[Shown]:
        """Yield how well the target was followed, and where the arm held."""
        if self.gain.note:
            yield f"note: {self.gain.note}"
        seen = "pairs of frames" if self.of_pair else "moments"
        yield (
            f"{self.n_cycles} cycles, {self.late} late, {self.missed} missed; {self.n_frames} {seen}, "
            f"{self.n_ok} whole, {self.n_position_only} place only, {self.n_lost} without the target; ended by: "
            f"{self.stopped_by}"
        )
        error = self.error
        if error.rms_m is not None and error.max_m is not None and error.last_m is not None:
            yield (
                f"followed in {100.0 * self.followed:.0f} % of the cycles; {digits(error.rms_m / MM)} mm RMS from "
                f"where it is wanted, {digits(error.max_m / MM)} mm at most, {digits(error.last_m / MM)} mm and "
                f"{digits((error.last_rad or 0.0) / DEG)} deg at the end"
            )
        yield from self.held()
        yield (
            f"gain {digits(self.gain.used)} 1/s; delay {self.delay.camera_s / MS:.0f} ms of the cameras, "
            f"{self.delay.arm_s / MS:.0f} ms of the arm. Recording: {self.recording}"
        )

    def write(self, folder: Path) -> None:
        """Write servo.json into a folder."""
        write_json(folder / SERVO, self.to_dict())


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


def follow_target(
    run: RobotRun,
    devices: ServoDevices,
    setup: Setup,
    settings: ServoSettings,
    gain: float | None,
    for_s: float,
    show: Show,
    beside: Beside | None,
) -> ServoOutput:
    """Find the delay, ask, follow the target for so long, and return what it came to.

    settings: with a gain of zero. gain: None: the largest that the delay allows. beside: is told of each frame
    meanwhile. Raises Inconsistent for another arm's file, and for a gain that is not stable.
    """
    guard, progress, clock = run.guard, run.progress, run.clock
    with ExitStack() as stack:
        stack.enter_context(run)
        check_arm(run.robot, guard.arm)
        sink = stack.enter_context(run.recorded())
        vision = Vision(setup, devices, sink)
        run.failed = watch(stack, vision, devices)
        chosen, source = _source(gain, guard, vision.delay, settings, setup)
        vision.source = source  # which sees from now on
        if beside is not None:
            beside.begin(source, guard.arm, clock, sink)
            vision.beside = beside.observe
        with run.planning():
            asked = question(run.robot, guard, chosen, source)
        run.ask(asked)
        tally, started_s = ServoTally(source, progress.cancelled), clock.now_s()

        def show_progress(status: RobotStatus | None) -> None:
            progress.update(clock.now_s() - started_s, 0.0 if math.isinf(for_s) else for_s)
            if status is not None:
                show(status, tally.error_m)

        recorded, stepped = FollowedSource(source, sink), devices.stepped is not None
        doubt = lambda: vision.contradiction or source.contradiction  # noqa: E731
        timing = run.follow(recorded, sink, tally, show_progress, for_s=for_s, doubt=doubt, stepped=stepped)
    if beside is not None and vision.contradictions:
        beside.forget_since(vision.trusted_s)
    return _output(run, tally, timing, vision, source, chosen)


def _output(
    run: RobotRun, tally: ServoTally, timing: Timing, vision: Vision, source: ServoSource, gain: Gain
) -> ServoOutput:
    """Return the figures of a servo that ended."""
    took, counts = np.array(vision.took_ms), vision.counts
    return extended(
        run.output(tally, timing, tally.stopped_by()),
        ServoOutput,
        state=tally.state,
        wrong_premise=named_cause(source.wrong, vision.contradiction),
        outside=run.outside,
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
        of_pair=vision.rig.is_pair,
    )


def _source(
    gain: float | None, guard: Guard, delay: CameraDelay, settings: ServoSettings, setup: Setup
) -> tuple[Gain, ServoSource]:
    """Return the gain that the measured delay allows, and the source."""
    chosen = chosen_gain(gain, max(guard.cycle_s, delay.period_s), delay.delay_s + settings.arm_lag_s)
    source = ServoSource(guard.arm, setup.rig, setup.target, settings.with_gain(chosen.used), guard.cycle_s)
    source.warm_up()
    return chosen, source


def require_axis(at: str, handeye: HandEyeFile, file: Path) -> None:
    """Raise UsageError where the target is wanted on neither the camera's nor the tool's axis.

    Raises Inconsistent for the axis of cameras (handeye.yaml: file) that stand beside the robot.
    """
    if at not in (CAMERA, TOOL):
        raise UsageError(f"--at {at} is neither {CAMERA} nor {TOOL}", cure="Say whose axis the target is wanted on")
    if handeye.setup.value == Mount.EYE_TO_HAND.value and at == CAMERA:
        raise Inconsistent(
            f"by {file} the cameras stand beside the robot, and the target is wanted on their axis",
            consequence="The robot cannot bring it there",
            cure="Give --at tool: the tool then goes where the target is, at --distance",
        )


def turning(name: str) -> Turning:
    """Return how the arm turns after a target, by its name. Raises UsageError."""
    try:
        return Turning(name)
    except ValueError as error:
        raise UsageError(
            f"{name!r} is no way to turn after a target",
            consequence="Nothing is moved",
            cure=f"Give {', '.join(Turning)} (--rotation)",
        ) from error


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
