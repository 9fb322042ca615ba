"""play."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


class PlayMeasuredOutput(Output):
    """The tip as the cameras saw it, from where it was told to be at the exposure, less the arm's lag."""

    n: int = Field(description="Frames compared.")
    rms_m: float | None = Field(description="RMS of the distance, m; null: no frame was.")
    max_m: float | None = Field(description="Largest distance, m.")
    last_m: float | None = Field(description="The newest distance, m.")
    mean_m: list[float] | None = Field(description="Mean of the difference in base axes (x, y, z), m.")
    arm_lag_s: float = Field(description="From a command to the arm's motion, s.")
    n_doubtful: int = Field(description="Frames whose pose does not fit the claims: not compared.")
    n_position_only: int = Field(description="Frames that told only where the target is: not compared.")
    n_lost: int = Field(description="Frames without the target.")


class PlayOutput(Output):
    """armsight play."""

    state: str = Field(description="The guard's last state: running, holding, retreating, disabled or stopped.")
    n_cycles: int = Field(description="Cycles of the control loop.")
    late: int = Field(description="Cycles that began more than half a cycle too late.")
    missed: int = Field(description="Cycles that never began.")
    stopped_by: str = Field(description="Why it ended: end (of the path), operator, or in words what stopped it.")
    finished: bool = Field(description="Whether the path was run to its end.")
    share: float = Field(description="Share of the path that was run, 0 to 1.")
    length_m: float = Field(description="Length of the path along its seam, m.")
    planned_s: float = Field(description="How long it was to take without pauses, at full override, s.")
    took_s: float = Field(description="How long it took, s.")
    slowest: str = Field(description="Where the arm's limits slow the path most, and to what; empty: nowhere.")
    planned_fastest_m_s: float = Field(
        description="Largest speed that tip or flange reach, also on the way to the path, at full override, m/s."
    )
    rounded_m: float = Field(description="How far rounding corners moved the path, at most, m.")
    measured: PlayMeasuredOutput | None = Field(description="What the cameras saw; null: none watched.")
    outside: str = Field(description="Which limits the arm stood outside of at the start, by how much; empty: none.")
    holds: list[str] = Field(description="Why the arm held, each reason once.")
    recording: str = Field(description="The recording: set points, commands, readings, poses and events.")
