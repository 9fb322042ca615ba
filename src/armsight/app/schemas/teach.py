"""teach."""

from __future__ import annotations

from typing import Annotated

from armsight.app.schemas.servo import ServoOutput
from armsight.fields import Doc
from armsight.records.output import Output, output


@output
class TeachOutput(Output):
    """armsight teach."""

    state: Annotated[str | None, Doc("The guard's last state; null: no robot took part.")]
    n_cycles: Annotated[int, Doc("Cycles of the control loop; 0 without a robot.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    stopped_by: Annotated[str, Doc("Why it ended: time, operator, end (of the frames), or the guard's words.")]
    path: Annotated[str, Doc("The path's file.")]
    parent: Annotated[str, Doc("The frame of its poses: world, base, or as measured: that of poses.csv.")]
    n_rows: Annotated[int, Doc("Poses of the path.")]
    n_stretches: Annotated[int, Doc("Stretches between a start and a pause.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    n_ok: Annotated[int, Doc("Frames whose pose was taken.")]
    n_doubtful: Annotated[int, Doc("Frames whose pose does not fit the claims: not recorded.")]
    n_position_only: Annotated[int, Doc("Frames that told only where the target is: not recorded.")]
    n_lost: Annotated[int, Doc("Frames without the target: not recorded.")]
    n_unplaced: Annotated[int, Doc("Frames at whose exposure the arm's place was not known: not recorded.")]
    servo: Annotated[ServoOutput | None, Doc("How the arm followed; null: none did.")]
