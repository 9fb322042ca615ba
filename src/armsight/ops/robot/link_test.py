"""Whether the link to a robot keeps its pace. Nothing moves: nothing is sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.clock import Clock
from armsight.control.loop import LATE_SHARE, quiet_interpreter
from armsight.control.status import Jitter
from armsight.drivers import Robot, RobotState
from armsight.errors import Cancelled, DeviceFailed, StaleData, UsageError
from armsight.fields import Doc
from armsight.ops.robot.opening import ClockedRobot
from armsight.ops.robot.recorder import run_with_progress
from armsight.records import JointReading, Motion, Progress
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store.tracks import write_joints
from armsight.units import MS

UNPROVEN = "not proven yet: the first motion begins with a probe of 0.04 degrees"
GONE_S = 1.0
GONE_CYCLES = 20.0
"""A link without a new reading for longer than both is not there; what is shorter is told as its longest silence."""


@output
class PeriodOutput(Output):
    """Times between the beginnings of two cycles."""

    median: Annotated[float, Doc("Their median, ms.")]
    p99: Annotated[float, Doc("Their 99th percentile, ms.")]
    max: Annotated[float, Doc("The longest, ms.")]


@output
class RobotTestOutput(Output):
    """robot test: whether the link to a robot keeps its pace; nothing moves."""

    driver: Annotated[str, Doc("The robot's driver.")]
    cycle_s: Annotated[float, Doc("Time between two commands that the controller takes, s.")]
    n_cycles: Annotated[int, Doc("Cycles done, each with a reading.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began, because the one before took too long.")]
    period_ms: Annotated[PeriodOutput, Doc("Times between the beginnings of two cycles, ms.")]
    silence_ms: Annotated[float, Doc("The longest time without a new reading, ms.")]
    q: Annotated[list[float], Doc("The last reading, rad or m.")]
    state: Annotated[str, Doc("What the robot can do: ready, moving or stopped.")]
    measured_cycle_s: Annotated[
        float | None, Doc("The cycle that the controller keeps by its own clock, s; null where its driver tells none.")
    ]
    proof: Annotated[str, Doc("What is still to be shown before the robot moves; empty: nothing.")]
    notes: Annotated[list[str], Doc("What is not as it should be on its controller, and refuses nothing.")]

    def summary(self) -> Iterator[Shown]:
        """Yield how punctual the link is."""
        measured_s = self.measured_cycle_s
        clock = "" if measured_s is None else f"Its controller sends every {1e3 * measured_s:.3g} ms. "
        yield (
            f"{self.driver}: {self.n_cycles} cycles of {1e3 * self.cycle_s:g} ms, {self.late} late, {self.missed} "
            f"missed; periods {self.period_ms.median:.3f} ms median, {self.period_ms.p99:.3f} p99, "
            f"{self.period_ms.max:.3f} longest; new readings at most {self.silence_ms:.0f} ms apart. "
            f"{clock}The robot is {self.state}" + (f"; {self.proof}." if self.proof else ".")
        )
        yield from (f"note: {note}" for note in self.notes)


def test_robot(
    driver: str, device: ClockedRobot, for_s: float, progress: Progress, record: Path | None = None
) -> RobotTestOutput:
    """Read a robot once a cycle for a time, and return how punctual that was and where it stands.

    record: a joints.csv of what was read, by the link's own clock from its first reading on; also where the test is cut
    short. Raises UsageError, DeviceNotFound, BadFile, DeviceLost, StaleData, DeviceFailed, Cancelled.
    """
    arm, clock, shown = device.robot, device.clock, progress
    if record is not None and record.exists():
        raise UsageError(f"{record} is there already", consequence="Nothing is read", cure="Choose another name")
    readings: list[JointReading] = []
    with arm:
        start_s = clock.now_s()
        try:
            jitter, silence_s = run_with_progress(
                lambda: _watched(arm, for_s, shown.cancelled, clock, readings),
                lambda: shown.update(min(for_s, clock.now_s() - start_s), for_s),
            )
        finally:
            if record is not None and readings:
                t_s = np.array([reading.t_s for reading in readings])
                write_joints(record, Motion(t_s=t_s - t_s[0], q=np.array([reading.q for reading in readings])))
        state, measured_s = arm.state, getattr(arm, "measured_cycle_s", None)
        proven, notes = getattr(arm, "proven", True), list(getattr(arm, "notes", ()))
    timing = jitter.timing()
    median, p99, most = (value / MS for value in timing.period_s)
    return RobotTestOutput(
        driver=driver,
        cycle_s=arm.cycle_s,
        n_cycles=timing.n_cycles,
        late=timing.late,
        missed=timing.missed,
        period_ms=PeriodOutput(median=median, p99=p99, max=most),
        silence_ms=silence_s / MS,
        q=readings[-1].q.tolist(),
        state=state.value,
        measured_cycle_s=measured_s,
        proof="" if proven else getattr(arm, "unproven", UNPROVEN),
        notes=notes,
    )


def _watched(
    robot: Robot, for_s: float, cancelled: Callable[[], bool], clock: Clock, readings: list[JointReading]
) -> tuple[Jitter, float]:
    """Return how punctual cycles were that read the robot, and the longest time without a new reading.

    Each new reading is appended to readings.
    """
    jitter = Jitter(LATE_SHARE * robot.cycle_s)
    readings.append(robot.read())
    start_s = due_s = new_s = clock.now_s()
    silence_s = 0.0
    with quiet_interpreter():
        while due_s - start_s < for_s:
            due_s += robot.cycle_s
            clock.sleep_until(due_s)
            woke_s = clock.now_s()
            newest = _newest(robot, readings[-1])
            silence_s = max(silence_s, woke_s - new_s)
            if newest.sequence != readings[-1].sequence:
                new_s = woke_s
                readings.append(newest)
            _check(robot, woke_s - new_s)
            missed = int((woke_s - due_s) / robot.cycle_s)
            jitter.cycle(woke_s, woke_s - due_s, clock.now_s(), missed)
            due_s += missed * robot.cycle_s
            if cancelled():
                raise Cancelled("stopped", consequence="The link was not tested to the end")
    return jitter, silence_s


def _newest(robot: Robot, last: JointReading) -> JointReading:
    """Return what a robot reads; the last reading again where it has only an old one, for how long is told."""
    try:
        return robot.read()
    except StaleData:
        return last


def _check(robot: Robot, quiet_s: float) -> None:
    if robot.state is RobotState.CLOSED:
        raise DeviceFailed(f"{robot.name} closed the link", consequence="The test ends", cure="Look at its controller")
    if quiet_s > max(GONE_S, GONE_CYCLES * robot.cycle_s):
        raise StaleData(
            f"{robot.name}: no new reading for {quiet_s / MS:.0f} ms",
            consequence="The link does not work",
            cure="Check the cable, the controller's program and its cycle",
        )
