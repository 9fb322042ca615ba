"""A servo under way: its loop beside its cameras, and what it came to."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.app.requests.motion import ServoJob
from armsight.app.robot.robot_run import (
    Confirm,
    CycleTally,
    RecordedSource,
    RobotRun,
    ToolRunOutput,
    check_arm,
    run_figures,
)
from armsight.app.servo.servo_job import ServoDevices
from armsight.app.servo.vision import Beside, Vision, watch
from armsight.control.events import QueueSink
from armsight.control.guard import Guard, GuardState, TargetState
from armsight.control.servo import Gain, Mount, ServoSettings, ServoSource, chosen_gain
from armsight.control.status import RobotStatus, Timing
from armsight.drivers import Robot
from armsight.fields import Doc
from armsight.measure.poses.pipeline import Setup
from armsight.records import PoseStatus
from armsight.records.output import Output, output
from armsight.units import DEG, MM, MS

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
    return ServoOutput(
        **run_figures(tally, timing, tally.stopped_by(), recording),
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


RECORDING = "servo.mcap"


class ServoSession:
    """How the target is followed in one run: its cameras, its settings, and what goes on beside."""

    def __init__(
        self,
        job: ServoJob,
        devices: ServoDevices,
        settings: ServoSettings,
        setup: Setup,
        beside: Beside | None = None,
    ) -> None:
        self._job, self._devices, self._settings, self._setup = job, devices, settings, setup
        self._beside = beside

    def run(self, run: RobotRun, confirm: Confirm, show: Show) -> ServoOutput:
        """Follow the target and return what it came to. Raises as run_servo."""
        job, devices, guard, progress = self._job, self._devices, run.guard, run.progress
        for_s = math.inf if job.seconds_s is None else job.seconds_s
        with ExitStack() as stack:
            stack.enter_context(run)
            check_arm(run.robot, guard.arm)
            sink = stack.enter_context(run.recorded(job.out / RECORDING))
            vision = Vision(self._setup, devices, job.latency_s, sink)
            run.failed = watch(stack, vision, devices)
            gain, source = self._source(vision, guard)
            if self._beside is not None:
                self._beside.begin(source, guard.arm, run.clock, sink)
                vision.beside = self._beside.observe
            with run.planning():
                asked = question(run.robot, guard, gain, source)
            run.ask(confirm, asked)
            tally, started_s = ServoTally(source, progress.cancelled), run.clock.now_s()

            def show_progress(status: RobotStatus | None) -> None:
                progress.update(run.clock.now_s() - started_s, 0.0 if math.isinf(for_s) else for_s)
                if status is not None:
                    show(status, tally.error_m)

            timing = run.follow(
                FollowedSource(source, sink),
                sink,
                tally,
                show_progress,
                for_s=for_s,
                doubt=lambda: source.contradiction,
                stepped=devices.stepped is not None,
            )
        return servo_output(tally, timing, vision, source, gain, job.out / RECORDING, run.outside)

    def _source(self, vision: Vision, guard: Guard) -> tuple[Gain, ServoSource]:
        """Return the gain that the measured delay allows, and the source, which sees from now on."""
        delay, setup = vision.delay, self._setup
        delay_s = delay.delay_s + self._settings.arm_lag_s
        gain = chosen_gain(self._job.gain, max(guard.cycle_s, delay.period_s), delay_s)
        settings = self._settings.with_gain(gain.used)
        source = ServoSource(guard.arm, setup.rig, setup.target, settings, guard.cycle_s)
        source.warm_up()
        vision.source = source
        return gain, source


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
