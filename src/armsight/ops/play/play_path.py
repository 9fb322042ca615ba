"""Playback of a path by a robot, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.control.guard import Guard
from armsight.control.play import PathPlan, PathSource, PlayProgress, PlayWatch, WatchFigures
from armsight.control.play.plan import TURNS_RAD
from armsight.control.servo.premise_bank import named_cause
from armsight.control.setpoints import CycleState, SetPoint
from armsight.control.status import QueueSink, RobotStatus, Timing
from armsight.drivers import Robot
from armsight.fields import Doc
from armsight.file_names import PLAY
from armsight.ops.play.play_job import Watcher
from armsight.ops.robot.opening import standing
from armsight.ops.robot.robot_run import (
    CycleTally,
    RecordedSource,
    RobotRun,
    ToolRunOutput,
    check_arm,
)
from armsight.ops.servo.run_servo import LAG_CYCLES
from armsight.records import PoseStatus
from armsight.records.output import Output, extended, output
from armsight.shown import Shown, digits
from armsight.store.atomic import write_json
from armsight.units import DEG, MM, MS

Show = Callable[[RobotStatus, PlayProgress, WatchFigures | None], object]
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
class PlayOutput(ToolRunOutput):
    """armsight play."""

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

    def summary(self) -> Iterator[Shown]:
        """Yield how far it was run, what the cameras saw, and where it held."""
        yield (
            f"{100.0 * self.share:.0f} % of {self.length_m / MM:.1f} mm in {self.took_s:.1f} s; {self.n_cycles} "
            f"cycles, {self.late} late, {self.missed} missed; ended by: {self.stopped_by}"
        )
        seen = self.measured
        if seen is not None and seen.rms_m is not None and seen.max_m is not None:
            yield (
                f"the cameras saw the tip {digits(seen.rms_m / MM)} mm RMS from where it was told to be, "
                f"{digits(seen.max_m / MM)} mm at most, in {seen.n} frames (the arm lags by "
                f"{seen.arm_lag_s / MS:.0f} ms)"
            )
        elif seen is not None:
            yield f"note: no frame showed the tip ({seen.n_lost} without the target): it was not watched"
        yield from self.held()
        yield f"Recording: {self.recording}"

    def write(self, folder: Path) -> None:
        """Write play.json into a folder."""
        write_json(folder / PLAY, self.to_dict())


class PlayedSource(RecordedSource):
    """A path whose set points and events go into the recording, and its commands to the watch."""

    def __init__(self, source: PathSource, sink: QueueSink, watch: PlayWatch | None) -> None:
        super().__init__(source, sink)
        self._source, self._watch = source, watch
        self._before = ("", False, False, False)

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        if self._watch is not None:
            self._watch.cycle(now)
        wanted = super().next(now)
        self._record(now.t_s)
        return wanted

    def _record(self, t_s: float) -> None:
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


def _output(
    run: RobotRun,
    tally: CycleTally,
    timing: Timing,
    source: PathSource,
    watch: PlayWatch | None,
    measured: PlayMeasuredOutput | None,
    doubt: str,
) -> PlayOutput:
    """Return the figures of a path that ended."""
    plan, finished = source.plan, source.progress.stage == "finished"
    return extended(
        run.output(tally, timing, doubt or tally.stopped_by(finished=finished)),
        PlayOutput,
        state=tally.state,
        wrong_premise=None if watch is None else named_cause(watch.wrong, "" if watch.exceeded else doubt),
        outside=run.outside,
        finished=finished,
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
        measured=measured,
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


Begun = Callable[[PathSource], object]
"""Is given the path once it may move, so that a key or a page may pause it and change its override."""


def run_path(
    run: RobotRun,
    plan: Callable[[Array], PathPlan],
    watcher: Watcher | None,
    *,
    override: float,
    stop_m: float,
    show: Show,
    begun: Begun,
    enabled: Callable[[], bool],
) -> PlayOutput:
    """Plan the path from where the arm stands, ask, run it, and return what it came to.

    plan: of the readings (n,) at which the arm stands. enabled: whether a deadman is held besides; else it waits.
    """
    guard, progress = run.guard, run.progress
    with ExitStack() as stack:
        stack.enter_context(run)
        check_arm(run.robot, guard.arm)
        with run.planning():
            made = plan(standing(run.robot, guard.arm.n))
        source, tally = PathSource(made, override=override), CycleTally(progress.cancelled)
        run.ask(question(run.robot, guard, made, watcher is not None))
        sink = stack.enter_context(run.recorded())
        watch = None if watcher is None else _watch(run, watcher, stack, sink, stop_m)
        begun(source)

        def show_progress(status: RobotStatus | None) -> None:
            at = source.progress
            progress.update(at.s_m / MM, at.length_m / MM, at.stage)
            if status is not None:
                show(status, at, None if watch is None else watch.figures)

        timing = run.follow(
            PlayedSource(source, sink, watch),
            sink,
            tally,
            show_progress,
            enabled=lambda: enabled() and not progress.cancelled(),
            doubt=lambda: _doubt(watch, watcher),
            stepped=watcher is not None and watcher.stepped,
        )
    measured = None if watch is None or watcher is None else _measured(watch, watcher.counts())
    return _output(run, tally, timing, source, watch, measured, _doubt(watch, watcher))


def _doubt(watch: PlayWatch | None, watcher: Watcher | None) -> str:
    """Return what the robot is to be stopped for, in words."""
    return "" if watch is None or watcher is None else watch.exceeded or watcher.contradiction()


def _watch(run: RobotRun, watcher: Watcher, stack: ExitStack, sink: QueueSink, stop_m: float) -> PlayWatch:
    """Open the cameras until stack ends, and return what compares."""
    guard, clock = run.guard, run.clock
    lag_s = LAG_CYCLES * guard.cycle_s
    watch = PlayWatch(watcher.sight, guard.arm, stop_m=stop_m, arm_lag_s=lag_s, cycle_s=guard.cycle_s)
    run.failed = watcher.failed
    watcher.open(stack, sink, lambda pose, exposed_s: watch.observe(pose, exposed_s, clock.now_s()))
    return watch


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
