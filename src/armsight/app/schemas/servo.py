"""servo."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output


@output
class ServoGainOutput(Output):
    """The gain, and what the measured delay allows (MATH 3.3)."""

    used: Annotated[float, Doc("Gain of translation and rotation, 1/s.")]
    no_overshoot: Annotated[float, Doc("Up to this one the error decays without overshoot, 1/s.")]
    stable: Annotated[float, Doc("From this one on the arm would swing up, 1/s; it is refused.")]
    cycle_s: Annotated[float, Doc("The servo's cycle: the cameras' or the controller's, the longer one, s.")]
    n_delay: Annotated[int, Doc("Cycles of delay, begun ones counted whole.")]
    note: Annotated[str, Doc("What to know about the gain; empty for nothing.")]


@output
class ServoDelayOutput(Output):
    """Delays, measured while it ran."""

    camera_s: Annotated[float, Doc("From the middle of an exposure to its pose in memory, median, s.")]
    arm_s: Annotated[float, Doc("From a command to the arm's motion, s.")]


@output
class ServoErrorOutput(Output):
    """How far the target was from where it is wanted, as the cameras and the arm's model tell."""

    rms_m: Annotated[float | None, Doc("RMS of the place while the target was followed, m; null: it never was.")]
    max_m: Annotated[float | None, Doc("Largest error of the place, m.")]
    last_m: Annotated[float | None, Doc("The last one, m.")]
    last_rad: Annotated[float | None, Doc("The last error of the rotation, rad.")]


@output
class ServoTimeOutput(Output):
    """Time from a pair of frames in memory to its pose handed to the control loop, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class ServoOutput(Output):
    """armsight servo."""

    state: Annotated[str, Doc("The guard's last state: running, holding, retreating, disabled or stopped.")]
    n_cycles: Annotated[int, Doc("Cycles of the control loop.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began.")]
    stopped_by: Annotated[str, Doc("Why it ended: time, operator, or in words what the guard stopped for.")]
    n_frames: Annotated[int, Doc("Pairs of frames measured.")]
    n_ok: Annotated[int, Doc("Pairs that showed the whole target.")]
    n_doubtful: Annotated[int, Doc("Pairs whose pose does not fit the claims: not followed.")]
    n_position_only: Annotated[int, Doc("Pairs that showed where it is, but not how it is turned.")]
    n_lost: Annotated[int, Doc("Pairs that did not show it.")]
    gain: Annotated[ServoGainOutput, Doc("The gain, and what the delay allows.")]
    delay: Annotated[ServoDelayOutput, Doc("The delays that were measured.")]
    error: Annotated[ServoErrorOutput, Doc("How far the target was from where it is wanted.")]
    followed: Annotated[float, Doc("Share of the cycles in which the target was followed, 0 to 1.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    vision_ms: Annotated[ServoTimeOutput | None, Doc("How long measuring took; null: no pair came.")]
    recording: Annotated[str, Doc("The recording: set points, commands, readings, poses and events.")]
