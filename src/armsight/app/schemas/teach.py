"""teach."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output
from armsight.app.schemas.servo import ServoOutput


class TeachOutput(Output):
    """armsight teach."""

    state: str | None = Field(description="The guard's last state; null: no robot took part.")
    n_cycles: int = Field(description="Cycles of the control loop; 0 without a robot.")
    late: int = Field(description="Cycles that began more than half a cycle too late.")
    stopped_by: str = Field(description="Why it ended: time, operator, end (of the frames), or the guard's words.")
    path: str = Field(description="The path's file.")
    parent: str = Field(description="The frame of its poses: world, base, or as measured: that of poses.csv.")
    n_rows: int = Field(description="Poses of the path.")
    n_stretches: int = Field(description="Stretches between a start and a pause.")
    length_m: float = Field(description="Length of the path, m.")
    n_ok: int = Field(description="Frames whose pose was taken.")
    n_doubtful: int = Field(description="Frames whose pose does not fit the claims: not recorded.")
    n_position_only: int = Field(description="Frames that told only where the target is: not recorded.")
    n_lost: int = Field(description="Frames without the target: not recorded.")
    n_unplaced: int = Field(description="Frames at whose exposure the arm's place was not known: not recorded.")
    servo: ServoOutput | None = Field(description="How the arm followed; null: none did.")
