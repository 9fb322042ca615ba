"""armsight play: a path run with the tip, through the guard, watched by cameras where there are any."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from armsight.app.kinematics import load_arm
from armsight.app.measure.warm_up import prepare
from armsight.app.play.job import check, load_plan, tipped_guard
from armsight.app.play.played import PlayedSource, PlayTally, Show, play_output
from armsight.app.play.target_monitor import TargetMonitor, Watcher
from armsight.app.requests.motion import PlayJob
from armsight.app.robot.driver_settings import driver_settings
from armsight.app.robot.guarding import arm_of, beside_outside, guard_for, noted, standing, standing_outside
from armsight.app.robot.opening import open_robot
from armsight.app.robot.recorder import LoopRecorder
from armsight.app.robot.with_progress import run_with_progress
from armsight.app.schemas.play import PlayOutput
from armsight.app.servo.job import ServoDevices
from armsight.app.servo.run import LAG_CYCLES
from armsight.app.servo.session import TOLD_S, Confirm, check_arm
from armsight.clock import Clock, SystemClock
from armsight.control.events import QueueSink
from armsight.control.guard import Guard
from armsight.control.jitter import Timing
from armsight.control.loop import ControlLoop, LoopStatus
from armsight.control.play import PathPlan, PathSource, PlayWatch
from armsight.drivers import Robot
from armsight.errors import ArmsightError, Cancelled, UsageError
from armsight.records import Progress, Silent
from armsight.units import DEG, MM

Array = NDArray[np.float64]

RECORDING, SUMMARY = "play.mcap", "play.json"

Begun = Callable[[PathSource], None]
"""Is given the path once it may move, so that a key or a page may pause it and change its override."""


class PlaySession:
    """One run of a path: opened, planned, asked, run, told."""

    def __init__(self, job: PlayJob, robot: Robot, clock: Clock, guard: Guard, eyes: Watcher | None) -> None:
        self._job, self._robot, self._clock, self._guard, self._eyes = job, robot, clock, guard, eyes
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
                plan = load_plan(job, guard.arm, guard.limits, standing(robot, guard.arm.n))
            source = PathSource(plan, override=job.override)
            if not confirm(question(robot, guard, plan, self._eyes is not None) + noted(outside)):
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
        counts = None if self._eyes is None else self._eyes.counts()
        return play_output(tally, timing, source, self._watch, counts, str(job.out / RECORDING), outside)

    def _watching(self, stack: ExitStack, sink: QueueSink) -> PlayWatch | None:
        """Open the cameras, and return what compares; None without any."""
        eyes, guard = self._eyes, self._guard
        if eyes is None:
            return None
        watch = PlayWatch(
            eyes.sight,
            guard.arm.T_flange_tool,
            stop_m=self._job.stop_m,
            arm_lag_s=LAG_CYCLES * guard.cycle_s,
            cycle_s=guard.cycle_s,
        )
        eyes.open(stack, sink, lambda pose, exposed_s: watch.observe(pose, exposed_s, self._clock.now_s()))
        return watch

    def _failed(self) -> ArmsightError | None:
        return None if self._eyes is None else self._eyes.failed()

    def _loop(self, loop: ControlLoop, tally: PlayTally, source: PathSource, show: Show, progress: Progress) -> Timing:
        """Run the loop: in this thread where time is simulated, beside the telling where it is real."""

        def tell() -> None:
            at = source.progress
            progress.update(at.s_m / MM, at.length_m / MM, at.stage)
            if loop.status is not None:
                show(loop.status, at, None if self._watch is None else self._watch.figures)

        def until(status: LoopStatus) -> bool:
            if self._watch is not None and self._watch.exceeded:
                loop.stop(self._watch.exceeded)
            return tally(status) or self._failed() is not None

        if self._eyes is None or not self._eyes.stepped:
            return run_with_progress(lambda: loop.run(until=until), tell)
        every = max(1, round(TOLD_S / self._guard.cycle_s))

        def telling(status: LoopStatus) -> bool:
            if tally.cycles % every == 0:
                tell()
            return until(status)

        return loop.run(until=telling)


def run_play(
    job: PlayJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    opened: tuple[Robot, Clock, Watcher | None] | None = None,
    begun: Begun = lambda _: None,
    enabled: Callable[[], bool] = lambda: True,
) -> PlayOutput:
    """Run the path to its end, until the operator lets go or the guard stopped; write job.out.

    confirm: asked once, with the way in mm and degrees, before anything moves; all refusals come before. progress: its
    cancelled() is the operator's enable, let go of. devices: in place of robot and cameras of a watched job, opened: of
    robot and clock of another, and what watches it. enabled: whether a deadman is held besides; else it waits.
    Raises UsageError, DataRefused (a path with a jump, out of reach or singular; another arm's file; no hand-eye),
    DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    check(job)
    if (job.out / RECORDING).exists():
        raise UsageError(
            f"{job.out} holds a recording already", consequence="Nothing is moved", cure="Give another folder (-o)"
        )
    watcher: Watcher | None = None
    if job.watched:
        watcher = eyes = TargetMonitor(job, devices)
        robot, clock = eyes.devices.robot, eyes.devices.clock
    elif opened is not None:
        robot, clock, watcher = opened
    else:
        clock = SystemClock()
        model = None if job.arm is None else load_arm(str(job.arm))
        robot = open_robot(job.robot, clock, driver_settings(job.robot, arm=model, rsi_config=None))
    guard = guard_for(robot, job.arm, job.limits, share=job.speed)
    if arm_of(robot, job.arm) is None:
        raise UsageError(
            f"{robot.name} does not tell its arm's lengths",
            consequence="Where its tip goes is not known, and nothing is moved",
            cure="Give the arm's file (--arm)",
        )
    if job.watched:
        prepare(progress)
    session = PlaySession(job, robot, clock, tipped_guard(guard, job.tip), watcher)
    done = session.run(confirm, show, progress, begun, enabled)
    done.write(job.out / SUMMARY)
    return done


def question(robot: Robot, guard: Guard, plan: PathPlan, watched: bool) -> str:
    """Return what is asked before the path is run: how far the tip and each joint go."""
    legs = sum(leg.length_m for leg in plan.approach)
    revolute = np.asarray(guard.arm.revolute)
    way = np.ptp(plan.check.q, axis=0)
    told = []
    if revolute.any():
        told.append(f"joints turn over up to {float(way[revolute].max()) / DEG:.1f} deg")
    if not revolute.all():
        told.append(f"joints slide over up to {float(way[~revolute].max()) / MM:.1f} mm")
    slowed = f" It is slowed to {plan.slowest}." if plan.slowest else ""
    seen = "cameras watch" if watched else "no camera watches"
    return (
        f"{robot.name} brings the tip over {legs / MM:.1f} mm to the path and along {plan.length_m / MM:.1f} mm of it, "
        f"at up to {plan.fastest_m_s / MM:.1f} mm/s ({plan.fastest}), in about {plan.time_s:.0f} s; {', '.join(told)}; "
        f"corners are rounded by up to {plan.rounded_m / MM:.2f} mm; {seen}.{slowed} Move?"
    )
