"""robot test and robot jog."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output


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


@output
class JogOutput(Output):
    """robot jog: one joint moved by a given way, or the arm moved by hand."""

    asked: Annotated[float | None, Doc("The way asked for, rad or m; null where a hand moved the arm.")]
    sent: Annotated[list[float], Doc("Where the robot was last told to go, rad or m.")]
    reached: Annotated[list[float], Doc("What it reads at rest, rad or m.")]
    limited: Annotated[list[str], Doc("The limits that slowed the motion, in words.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    state: Annotated[str, Doc("What the robot can do now: ready, moving or stopped.")]
