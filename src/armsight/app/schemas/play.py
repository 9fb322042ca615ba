"""play."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output


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
    measured: Annotated[PlayMeasuredOutput | None, Doc("What the cameras saw; null: none watched.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    recording: Annotated[str, Doc("The recording: set points, commands, readings, poses and events.")]
