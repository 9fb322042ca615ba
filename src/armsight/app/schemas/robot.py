"""robot test and robot jog."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


class PeriodOutput(Output):
    """Times between the beginnings of two cycles."""

    median: float = Field(description="Their median, ms.")
    p99: float = Field(description="Their 99th percentile, ms.")
    max: float = Field(description="The longest, ms.")


class RobotTestOutput(Output):
    """robot test: whether the link to a robot keeps its pace; nothing moves."""

    driver: str = Field(description="The robot's driver.")
    cycle_s: float = Field(description="Time between two commands that the controller takes, s.")
    n_cycles: int = Field(description="Cycles done, each with a reading.")
    late: int = Field(description="Cycles that began more than half a cycle too late.")
    missed: int = Field(description="Cycles that never began, because the one before took too long.")
    period_ms: PeriodOutput = Field(description="Times between the beginnings of two cycles, ms.")
    silence_ms: float = Field(description="The longest time without a new reading, ms.")
    q: list[float] = Field(description="The last reading, rad or m.")
    state: str = Field(description="What the robot can do: ready, moving or stopped.")


class JogOutput(Output):
    """robot jog: one joint moved by a given way, or the arm moved by hand."""

    asked: float | None = Field(description="The way asked for, rad or m; null where a hand moved the arm.")
    sent: list[float] = Field(description="Where the robot was last told to go, rad or m.")
    reached: list[float] = Field(description="What it reads at rest, rad or m.")
    limited: list[str] = Field(description="The limits that slowed the motion, in words.")
    outside: str = Field(description="Which limits the arm stood outside of at the start, by how much; empty: none.")
    state: str = Field(description="What the robot can do now: ready, moving or stopped.")
