"""A servo under way: its loop beside its cameras, and what it came to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.requests.motion import ServoJob
from armsight.app.robot.guarding import noted, standing_outside
from armsight.app.robot.recorder import LoopRecorder
from armsight.app.robot.with_progress import run_with_progress
from armsight.app.servo.servo_job import ServoDevices
from armsight.app.servo.vision import Beside, Vision, VisionThread, probe
from armsight.control.events import QueueSink
from armsight.control.guard import Guard, GuardState, TargetState
from armsight.control.loop import ControlLoop
from armsight.control.servo import Gain, Mount, ServoSettings, ServoSource, chosen_gain
from armsight.control.setpoints import CycleState, Hold, SetPoint, ToolTwist
from armsight.control.status import RobotStatus, Timing
from armsight.drivers import Robot, RobotTraits
from armsight.errors import ArmsightError, Cancelled, Inconsistent
from armsight.fields import Doc
from armsight.geometry import pose_difference
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup
from armsight.records import PoseStatus, Progress
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
class ServoOutput(Output):
    """armsight servo."""

    state: Annotated[str, Doc("The guard's last state: running, holding, retreating, disabled or stopped.")]
    n_cycles: Annotated[int, Doc("Cycles of the control loop.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began.")]
    stopped_by: Annotated[str, Doc("Why it ended: time, operator, or in words what the guard stopped for.")]
    wrong_premise: Annotated[
        str | None,
        Doc("What the target's motion contradicts: hand-eye, rig, target, pictures or robot; null: nothing."),
    ]
    n_frames: Annotated[int, Doc("Pairs of frames measured.")]
    n_ok: Annotated[int, Doc("Pairs that showed the whole target.")]
    n_doubtful: Annotated[int, Doc("Pairs whose pose does not fit the claims: not followed.")]
    n_position_only: Annotated[int, Doc("Pairs that showed where it is, but not how it is turned.")]
    n_lost: Annotated[int, Doc("Pairs that did not show it.")]
    gain: Annotated[Gain, Doc("The gain, and what the delay allows.")]
    delay: Annotated[ServoDelayOutput, Doc("The delays that were measured.")]
    error: Annotated[ServoErrorOutput, Doc("How far the target was from where it is wanted.")]
    followed: Annotated[float, Doc("Share of the cycles in which the target was followed, 0 to 1.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    vision_ms: Annotated[ServoTimeOutput | None, Doc("How long measuring took; null: no pair came.")]
    recording: Annotated[str, Doc("The recording: set points, commands, readings, poses and events.")]


class RecordedSource:
    """A servo whose set points go into the recording."""

    name = "servo"

    def __init__(self, source: ServoSource, sink: QueueSink) -> None:
        self._source, self._sink = source, sink

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        wanted = self._source.next(now)
        self._sink.command(now.t_s, "set_point", set_point_values(wanted))
        return wanted

    def target(self, now_s: float) -> tuple[TargetState, float | None]:
        """Return what is known of the target, and the age in s of the newest frame that shows it."""
        return self._source.target(now_s)

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        self._source.warm_up()


def set_point_values(wanted: SetPoint) -> Mapping[str, Any]:
    """Return a servo's set point as JSON knows it."""
    if isinstance(wanted, ToolTwist):
        return {"velocity_m_s": wanted.velocity_m_s.tolist(), "angular_rad_s": wanted.angular_rad_s.tolist()}
    return {"hold": wanted.why if isinstance(wanted, Hold) else ""}


class Tally:
    """Counts cycles as the loop does them; given to it as what may end it."""

    def __init__(self, source: ServoSource, cancelled: Callable[[], bool]) -> None:
        self.cycles = self.followed = 0
        self.holds: list[str] = []
        self.last: RobotStatus | None = None
        self.last_m = self.last_rad = 0.0
        self._source = source
        self._cancelled = cancelled
        self._sum_m2 = self._max_m = 0.0

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last one: the operator let go, or the guard stopped."""
        self.last = status
        self.cycles += 1
        error = self._source.error
        if status.guard is GuardState.RUNNING and error is not None:
            self.followed += 1
            self.last_m = float(np.linalg.norm(error.translation_m))
            self.last_rad = float(np.linalg.norm(error.rotation_rad))
            self._sum_m2 += self.last_m**2
            self._max_m = max(self._max_m, self.last_m)
        elif status.why and status.reason not in self.holds:
            self.holds.append(status.reason)
        return self._cancelled() or status.guard is GuardState.STOPPED

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

    def stopped_by(self) -> str:
        """Return why the loop ended."""
        if self._cancelled():
            return "operator"
        stopped = self.last is not None and self.last.guard is GuardState.STOPPED
        return self.last.why if stopped and self.last is not None else "time"


def servo_output(
    tally: Tally, timing: Timing, vision: Vision, source: ServoSource, gain: Gain, recording: str, outside: str
) -> ServoOutput:
    """Return the figures of a servo that ended."""
    took = np.array(vision.took_ms)
    counts = vision.counts
    return ServoOutput(
        state="disabled" if tally.last is None else tally.last.guard.value,
        n_cycles=timing.n_cycles,
        late=timing.late,
        missed=timing.missed,
        stopped_by=tally.stopped_by(),
        wrong_premise=None if source.wrong is None else source.wrong.cause.value,
        n_frames=sum(counts.values()),
        n_ok=counts[PoseStatus.OK],
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
        gain=gain,
        delay=ServoDelayOutput(camera_s=source.camera_delay_s, arm_s=source.arm_lag_s),
        error=tally.error,
        followed=tally.followed / max(tally.cycles, 1),
        outside=outside,
        holds=tally.holds,
        vision_ms=ServoTimeOutput(median=float(np.median(took)), p99=float(np.percentile(took, 99)))
        if len(took)
        else None,
        recording=recording,
    )


RECORDING = "servo.mcap"
ARM_OFF_M, ARM_OFF_RAD = 0.02, 2.0 * DEG
"""A calibrated arm.yaml differs by millimetres from what the controller computes; beyond this it is another arm's."""
SHOWN_S = 0.2
"""Simulated time between two calls of show."""

Confirm = Callable[[str], bool]
"""Is asked whether the arm may move; the text says how."""


class ServoSession:
    """Robot, cameras, guard and how the target is followed, of one run."""

    def __init__(
        self,
        job: ServoJob,
        devices: ServoDevices,
        guard: Guard,
        settings: ServoSettings,
        setup: Setup,
        beside: Beside | None = None,
    ) -> None:
        self._job, self._devices, self._guard, self._settings, self._setup = job, devices, guard, settings, setup
        self._thread: VisionThread | None = None
        self._beside = beside
        self._moves = False

    @contextmanager
    def _recorder(self) -> Iterator[LoopRecorder]:
        """Record; nothing is left of a session that ended before the arm might move, or the next one would be refused
        beside it."""
        path, opened = self._job.out / RECORDING, False
        try:
            with LoopRecorder(path, self._devices.clock) as recorder:
                opened = True
                yield recorder
        finally:
            if opened and not self._moves:
                path.unlink(missing_ok=True)

    def run(self, confirm: Confirm, show: Show, progress: Progress) -> ServoOutput:
        """Follow the target and return what it came to. Raises as run_servo."""
        devices, clock = self._devices, self._devices.clock
        with ExitStack() as stack:
            robot = stack.enter_context(devices.robot)
            check_arm(robot, self._guard.arm)
            recorder = stack.enter_context(self._recorder())
            vision = Vision(self._setup, devices, self._job.latency_s, recorder.sink)
            self._watch(stack, vision)
            probe(vision, clock, self._failed)
            gain, source = self._source(vision)
            if self._beside is not None:
                self._beside.begin(source, self._guard.arm, clock, recorder.sink)
                vision.beside = self._beside.observe
            outside = standing_outside(self._guard, robot)
            if not confirm(
                question(robot, self._guard, gain, source) + noted(outside, self._guard, self._job, self._job.limits)
            ):
                raise Cancelled("not confirmed", consequence="Nothing was moved", cure="Give --yes to move unasked")
            self._moves = True
            tally = Tally(source, progress.cancelled)
            loop = ControlLoop(
                robot,
                self._guard,
                RecordedSource(source, recorder.sink),
                clock,
                enabled=lambda: not progress.cancelled(),
                sink=recorder.sink,
            )
            timing = self._follow(loop, source, tally, show, progress)
        failed = self._failed() or recorder.failed
        if failed is not None:
            raise failed
        return servo_output(tally, timing, vision, source, gain, str(self._job.out / RECORDING), outside)

    def _watch(self, stack: ExitStack, vision: Vision) -> None:
        """Open the cameras and take their pairs: as the simulated clock moves, or in a thread."""
        pairs = stack.enter_context(self._devices.pairs)
        if self._devices.stepped is not None:
            self._devices.stepped.watch(pairs, vision.take)  # type: ignore[arg-type]  # of a live cell, by number too
            return
        self._thread = stack.enter_context(VisionThread(vision, self._devices))

    def _source(self, vision: Vision) -> tuple[Gain, ServoSource]:
        """Return the gain that the measured delay allows, and the source, which sees from now on."""
        cycle_s, delay = self._guard.cycle_s, vision.delay
        delay_s = delay.delay_s + self._settings.arm_lag_s
        gain = chosen_gain(self._job.gain, max(cycle_s, delay.period_s), delay_s)
        setup, settings = self._setup, self._settings.with_gain(gain.used)
        source = ServoSource(self._guard.arm, setup.rig, setup.target, settings, cycle_s)
        source.warm_up()
        vision.source = source
        return gain, source

    def _failed(self) -> ArmsightError | None:
        return None if self._thread is None else self._thread.failed

    def _follow(self, loop: ControlLoop, source: ServoSource, tally: Tally, show: Show, progress: Progress) -> Timing:
        """Run the loop: in this thread where time is simulated, beside the telling where it is real."""
        clock = self._devices.clock
        for_s = math.inf if self._job.seconds_s is None else self._job.seconds_s
        started_s = clock.now_s()

        def show_progress() -> None:
            progress.update(clock.now_s() - started_s, 0.0 if math.isinf(for_s) else for_s)
            if loop.status is not None:
                show(loop.status, tally.error_m)

        def until(status: RobotStatus) -> bool:
            if source.contradiction:
                loop.stop(source.contradiction)
            ended = tally(status)
            return ended or self._failed() is not None

        if self._devices.stepped is None:
            return run_with_progress(lambda: loop.run(for_s=for_s, until=until), show_progress)
        every = max(1, round(SHOWN_S / self._guard.cycle_s))

        def until_and_show(status: RobotStatus) -> bool:
            if tally.cycles % every == 0:
                show_progress()
            return until(status)

        return loop.run(for_s=for_s, until=until_and_show)


def check_arm(robot: Robot, arm: Arm) -> None:
    """Raise Inconsistent where the controller computes another pose of the flange than the arm's file does."""
    if not RobotTraits.of(robot).takes_joints:
        return
    sent = robot.step_joints(np.zeros(arm.n))
    if sent.pose is None:
        return
    T_world_tool = RigidTransform.from_matrix(arm.fk(arm.values(sent.q)))
    off = pose_difference(arm.T_world_base.inv() * T_world_tool * arm.T_flange_tool.inv(), sent.pose)
    off_m, off_rad = float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]))
    if off_m > ARM_OFF_M or off_rad > ARM_OFF_RAD:
        raise Inconsistent(
            f"the controller of {robot.name} has its flange {off_m / MM:.0f} mm and {off_rad / DEG:.1f} deg from where "
            f"{arm.name} has it",
            consequence="The file is of another arm, and nothing is moved",
            cure="Give the file of this arm (--arm)",
        )


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
