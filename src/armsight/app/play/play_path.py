"""Playback of a path by a robot, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armsight.app.arm_files import given_arm
from armsight.app.measure.warm_up import prepare
from armsight.app.play.play_job import check, planned, tipped_guard
from armsight.app.play.target_monitor import TargetMonitor, Watcher
from armsight.app.requests.motion import PlayJob
from armsight.app.robot.cycle_tally import CycleTally
from armsight.app.robot.guarding import arm_of, beside_outside, guard_for, noted, standing, standing_outside
from armsight.app.robot.opening import robot_of
from armsight.app.robot.recorder import LoopRecorder, require_new
from armsight.app.robot.with_progress import run_with_progress
from armsight.app.servo.run_servo import LAG_CYCLES
from armsight.app.servo.servo_job import ServoDevices
from armsight.app.servo.session import SHOWN_S, Confirm, check_arm
from armsight.clock import Clock, SystemClock
from armsight.control.events import QueueSink
from armsight.control.guard import Guard
from armsight.control.loop import ControlLoop
from armsight.control.play import PathPlan, PathSource, PlayProgress, PlayWatch, WatchFigures
from armsight.control.play.plan import TURNS_RAD
from armsight.control.setpoints import CycleState, Hold, SetPoint, ToolPose
from armsight.control.status import RobotStatus, Timing
from armsight.drivers import Robot
from armsight.errors import ArmsightError, Cancelled, UsageError
from armsight.fields import Doc
from armsight.geometry import xyz_quat
from armsight.records import PoseStatus, Progress, Silent, TaughtPath
from armsight.records.output import Output, output
from armsight.store.atomic import write_json
from armsight.store.path_file import read_path
from armsight.units import DEG, MM

Array = NDArray[np.float64]

Show = Callable[[RobotStatus, PlayProgress, WatchFigures | None], None]
"""Is told now and then of a cycle, of where the path is, and of what the cameras saw."""


@output
class PlayMeasuredOutput(Output):
    """The tip as the cameras saw it, from where it was told to be at the exposure, less the arm's lag."""

    n: Annotated[int, Doc("Frames compared.")]
    rms_m: Annotated[float | None, Doc("RMS of the distance, m; null: no frame was.")]
    max_m: Annotated[float | None, Doc("Largest distance, m.")]
    last_m: Annotated[float | None, Doc("The newest distance, m.")]
    mean_m: Annotated[list[float] | None, Doc("Mean of the difference in base axes (x, y, z), m.")]
    arm_lag_s: Annotated[float, Doc("From a command to the arm's motion, s.")]
    n_doubtful: Annotated[int, Doc("Frames whose pose does not fit the claims: not compared.")]
    n_position_only: Annotated[int, Doc("Frames that told only where the target is: not compared.")]
    n_lost: Annotated[int, Doc("Frames without the target.")]


@output
class PlayOutput(Output):
    """armsight play."""

    state: Annotated[str, Doc("The guard's last state: running, holding, retreating, disabled or stopped.")]
    n_cycles: Annotated[int, Doc("Cycles of the control loop.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began.")]
    stopped_by: Annotated[str, Doc("Why it ended: end (of the path), operator, or in words what stopped it.")]
    wrong_premise: Annotated[
        str | None,
        Doc("What the target's motion contradicts: hand-eye, rig, target, pictures or robot; null: nothing."),
    ]
    finished: Annotated[bool, Doc("Whether the path was run to its end.")]
    share: Annotated[float, Doc("Share of the path that was run, 0 to 1.")]
    length_m: Annotated[float, Doc("Length of the path along its seam, m.")]
    planned_s: Annotated[float, Doc("How long it was to take without pauses, at full override, s.")]
    took_s: Annotated[float, Doc("How long it took, s.")]
    slowest: Annotated[str, Doc("Where the arm's limits slow the path most, and to what; empty: nowhere.")]
    planned_fastest_m_s: Annotated[
        float, Doc("Largest speed that tip or flange reach, also on the way to the path, at full override, m/s.")
    ]
    rounded_m: Annotated[float, Doc("How far rounding corners moved the path, at most, m.")]
    rounded_rad: Annotated[float, Doc("How far rounding corners turned the tool, at most, rad.")]
    turns: Annotated[str, Doc("Where the tool turns though the tip hardly moves, and how far; empty: nowhere.")]
    turned_rad: Annotated[
        float, Doc("How far the tool is turned from what was asked, at most, by an arm that cannot turn it, rad.")
    ]
    measured: Annotated[PlayMeasuredOutput | None, Doc("What the cameras saw; null: none watched.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    recording: Annotated[str, Doc("The recording: set points, commands, readings, poses and events.")]


class PlayedSource:
    """A path whose set points and events go into the recording, and its commands to the watch."""

    def __init__(self, source: PathSource, sink: QueueSink, watch: PlayWatch | None) -> None:
        self.name = source.name
        self._source, self._sink, self._watch = source, sink, watch
        self._before = ("", False, False, False)

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        if self._watch is not None:
            self._watch.cycle(now)
        wanted = self._source.next(now)
        if isinstance(wanted, ToolPose):
            xyz, quat = xyz_quat(wanted.T_base_tool)
            self._sink.command(now.t_s, "set_point", {"xyz_m": list(xyz), "quat_xyzw": list(quat)})
        else:
            self._sink.command(now.t_s, "set_point", {"hold": wanted.why if isinstance(wanted, Hold) else ""})
        self._record(now.t_s)
        return wanted

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        self._source.warm_up()

    def _record(self, t_s: float) -> None:
        """Tell what changed along the path."""
        at = self._source.progress
        stage, paused, waiting, welding = self._before
        self._before = (at.stage, at.paused, at.waiting, at.welding)
        changes = (
            (at.stage != stage, at.stage),
            (at.paused != paused, "paused" if at.paused else "resumed"),
            (at.waiting != waiting, "waits for the arm" if at.waiting else "goes on"),
            (at.welding != welding, "weld_on" if at.welding else "weld_off"),
        )
        for changed, text in changes:
            if changed:
                self._sink.event(t_s, f"{text} at {at.s_m:.4f} m", "info", "play")


class PlayTally(CycleTally):
    """Counts cycles of a path as the loop does them; given to it as what may end it."""

    def __init__(self, source: PathSource, watch: PlayWatch | None, cancelled: Callable[[], bool]) -> None:
        super().__init__(cancelled)
        self._source, self._watch = source, watch

    @property
    def finished(self) -> bool:
        """Whether the path was run to its end."""
        return self._source.progress.stage == "finished"

    def stopped_by(self, *, finished: bool = False) -> str:
        """Return why the loop ended."""
        if self._watch is not None and self._watch.exceeded:
            return self._watch.exceeded
        return super().stopped_by(finished=finished or self.finished)


def play_output(
    tally: PlayTally,
    timing: Timing,
    source: PathSource,
    watch: PlayWatch | None,
    counts: Mapping[PoseStatus, int] | None,
    recording: str,
    outside: str,
) -> PlayOutput:
    """Return the figures of a path that ended."""
    plan = source.plan
    return PlayOutput(
        state="disabled" if tally.last is None else tally.last.guard.value,
        n_cycles=timing.n_cycles,
        late=timing.late,
        missed=timing.missed,
        stopped_by=tally.stopped_by(),
        wrong_premise=None if watch is None or watch.wrong is None else watch.wrong.cause.value,
        finished=tally.finished,
        share=source.progress.share,
        length_m=plan.length_m,
        planned_s=plan.time_s,
        took_s=tally.took_s,
        slowest=plan.slowest,
        planned_fastest_m_s=plan.fastest_m_s,
        rounded_m=plan.rounded_m,
        rounded_rad=plan.rounded_rad,
        turns=plan.turns,
        turned_rad=plan.turned_rad,
        measured=None if watch is None or counts is None else _measured(watch, counts),
        outside=outside,
        holds=tally.holds,
        recording=recording,
    )


def _measured(watch: PlayWatch, counts: Mapping[PoseStatus, int]) -> PlayMeasuredOutput:
    seen = watch.figures
    return PlayMeasuredOutput(
        n=seen.n,
        rms_m=seen.rms_m,
        max_m=seen.max_m,
        last_m=seen.last_m,
        mean_m=None if seen.mean_m is None else seen.mean_m.tolist(),
        arm_lag_s=watch.arm_lag_s,
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
    )


RECORDING, SUMMARY = "play.mcap", "play.json"

Begun = Callable[[PathSource], None]
"""Is given the path once it may move, so that a key or a page may pause it and change its override."""


class Opened(NamedTuple):
    """A robot with its clock, what watches it, and the path in place of the job's file."""

    robot: Robot
    clock: Clock
    watcher: Watcher | None = None
    path: TaughtPath | None = None


class PlaySession:
    """One run of a path: opened, planned, asked, run, told."""

    def __init__(
        self, job: PlayJob, path: TaughtPath, robot: Robot, clock: Clock, guard: Guard, monitor: Watcher | None
    ) -> None:
        self._job, self._path, self._robot, self._clock, self._guard = job, path, robot, clock, guard
        self._monitor = monitor
        self._watch: PlayWatch | None = None

    def run(
        self, confirm: Confirm, show: Show, progress: Progress, begun: Begun, enabled: Callable[[], bool]
    ) -> PlayOutput:
        """Run the path and return what it came to. Raises as run_play."""
        job, guard = self._job, self._guard
        with ExitStack() as stack:
            robot = stack.enter_context(self._robot)
            check_arm(robot, guard.arm)
            outside = standing_outside(guard, robot)
            with beside_outside(outside):
                plan = planned(job, self._path, guard.arm, guard.limits, standing(robot, guard.arm.n))
            source = PathSource(plan, override=job.override)
            if not confirm(
                question(robot, guard, plan, self._monitor is not None) + noted(outside, guard, job, job.limits)
            ):
                raise Cancelled("not confirmed", consequence="Nothing was moved", cure="Give --yes to move unasked")
            recorder = stack.enter_context(LoopRecorder(job.out / RECORDING, self._clock))
            self._watch = self._watching(stack, recorder.sink)
            begun(source)
            tally = PlayTally(source, self._watch, progress.cancelled)
            loop = ControlLoop(
                robot,
                guard,
                PlayedSource(source, recorder.sink, self._watch),
                self._clock,
                enabled=lambda: enabled() and not progress.cancelled(),
                sink=recorder.sink,
            )
            timing = self._loop(loop, tally, source, show, progress)
        failed = self._failed() or recorder.failed
        if failed is not None:
            raise failed
        counts = None if self._monitor is None else self._monitor.counts()
        return play_output(tally, timing, source, self._watch, counts, str(job.out / RECORDING), outside)

    def _watching(self, stack: ExitStack, sink: QueueSink) -> PlayWatch | None:
        """Open the cameras, and return what compares; None without any."""
        monitor, guard = self._monitor, self._guard
        if monitor is None:
            return None
        watch = PlayWatch(
            monitor.sight,
            guard.arm,
            stop_m=self._job.stop_m,
            arm_lag_s=LAG_CYCLES * guard.cycle_s,
            cycle_s=guard.cycle_s,
        )
        monitor.open(stack, sink, lambda pose, exposed_s: watch.observe(pose, exposed_s, self._clock.now_s()))
        return watch

    def _failed(self) -> ArmsightError | None:
        return None if self._monitor is None else self._monitor.failed()

    def _loop(self, loop: ControlLoop, tally: PlayTally, source: PathSource, show: Show, progress: Progress) -> Timing:
        """Run the loop: in this thread where time is simulated, beside the telling where it is real."""

        def show_progress() -> None:
            at = source.progress
            progress.update(at.s_m / MM, at.length_m / MM, at.stage)
            if loop.status is not None:
                show(loop.status, at, None if self._watch is None else self._watch.figures)

        def until(status: RobotStatus) -> bool:
            if self._watch is not None and self._watch.exceeded:
                loop.stop(self._watch.exceeded)
            return tally(status) or self._failed() is not None

        # simulated time passes as the loop waits for it: another thread would see it jump, and pictures come too late
        if self._monitor is None or not self._monitor.stepped:
            return run_with_progress(lambda: loop.run(until=until), show_progress)
        every = max(1, round(SHOWN_S / self._guard.cycle_s))

        def until_and_show(status: RobotStatus) -> bool:
            if tally.cycles % every == 0:
                show_progress()
            return until(status)

        return loop.run(until=until_and_show)


def run_play(
    job: PlayJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    opened: Opened | None = None,
    begun: Begun = lambda _: None,
    enabled: Callable[[], bool] = lambda: True,
) -> PlayOutput:
    """Run the path to its end, until the operator lets go or the guard stopped; write job.out.

    confirm: asked once, with the way in mm and degrees, before anything moves; all refusals come before. progress: its
    cancelled() is the operator's enable, let go of. devices: in place of robot and cameras of a watched job, opened: of
    another. enabled: whether a deadman is held besides; else it waits.
    Raises UsageError, DataRefused (a path with a jump, out of reach or singular; another arm's file; no hand-eye),
    DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    check(job)
    require_new(job.out, RECORDING)
    model, path = given_arm(job.arm), None
    monitor = TargetMonitor(job, devices, model) if job.watched else None
    watcher: Watcher | None = monitor
    if monitor is not None:
        robot, clock = monitor.devices.robot, monitor.devices.clock
    elif opened is not None:
        robot, clock, watcher, path = opened
    else:
        clock = SystemClock()
        robot = robot_of(job, clock, model)
    guard = guard_for(robot, model, job.limits, share=job.speed)
    if arm_of(robot, model) is None:
        raise UsageError(
            f"{robot.name} does not tell its arm's lengths",
            consequence="Where its tip goes is not known, and nothing is moved",
            cure="Give the arm's file (--arm)",
        )
    guard, path = tipped_guard(guard, job.tip), path or read_path(job.path, parent=job.frame)
    if job.watched:
        prepare(progress)  # before the robot is opened: at its first picture the arm would wait for compilers
    done = PlaySession(job, path, robot, clock, guard, watcher).run(confirm, show, progress, begun, enabled)
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def question(robot: Robot, guard: Guard, plan: PathPlan, watched: bool) -> str:
    """Return what is asked before the path is run: how far the tip and each joint go."""
    legs = sum(leg.length_m for leg in plan.approach)
    revolute = np.asarray(guard.arm.revolute)
    way = np.ptp(plan.check.q, axis=0)
    ways = []
    if revolute.any():
        ways.append(f"joints turn over up to {float(way[revolute].max()) / DEG:.1f} deg")
    if not revolute.all():
        ways.append(f"joints slide over up to {float(way[~revolute].max()) / MM:.1f} mm")
    notes = [f"corners are rounded by up to {plan.rounded_m / MM:.2f} mm and {plan.rounded_rad / DEG:.1f} deg"]
    if plan.turns:
        notes.append(plan.turns)
    if plan.turned_rad > TURNS_RAD:
        notes.append(f"{guard.arm.n} joints let the tool turn by up to {plan.turned_rad / DEG:.1f} deg")
    slowed = f" It is slowed to {plan.slowest}." if plan.slowest else ""
    seen = "cameras watch" if watched else "no camera watches"
    return (
        f"{robot.name} brings the tip over {legs / MM:.1f} mm to the path and along {plan.length_m / MM:.1f} mm of it, "
        f"at up to {plan.fastest_m_s / MM:.1f} mm/s ({plan.fastest}), in about {plan.time_s:.0f} s; {', '.join(ways)}; "
        f"{'; '.join(notes)}; {seen}.{slowed} Move?"
    )
