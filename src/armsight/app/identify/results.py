"""What an identification comes to, and a plan of sweeps."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import MEANING, RejectedRow, Verdict

Vector = tuple[float, float, float]


@output
class JointStd(Output):
    """Standard deviations of a joint's entries in the table; null where an entry is chosen, not measured."""

    theta_rad: Annotated[float | None, Doc("Of theta, rad.")]
    d_m: Annotated[float | None, Doc("Of d, m.")]
    a_m: Annotated[float | None, Doc("Of a, m.")]
    alpha_rad: Annotated[float | None, Doc("Of alpha, rad.")]
    beta_rad: Annotated[float | None, Doc("Of beta, rad.")]


@output
class JointAxis(Output):
    """The axis of a joint with all joints at zero, in rig axes (or those of the positions)."""

    point_m: Annotated[Vector, Doc("A point of it, m.")]
    direction: Annotated[Vector, Doc("Its direction, a unit vector.")]


@output
class IdentifiedJoint(Output):
    """A joint that was found (Denavit-Hartenberg, standard; beta after Hayati for parallel axes)."""

    index: Annotated[int, Doc("Which joint, from 1.")]
    type: Annotated[str, Doc("revolute or prismatic.")]
    a_m: Annotated[float, Doc("a, m.")]
    alpha_rad: Annotated[float, Doc("alpha, rad.")]
    d_m: Annotated[float, Doc("d, m; the zero of a prismatic joint.")]
    theta_rad: Annotated[float, Doc("theta, rad; the zero of a revolute joint.")]
    beta_rad: Annotated[float, Doc("beta, rad.")]
    lower: Annotated[float, Doc("Smallest reading of its sweep, rad or m.")]
    upper: Annotated[float, Doc("Largest reading of its sweep, rad or m.")]
    sign: Annotated[float, Doc("Sense of the readings: 1 or -1, times the joint's scale where one was found.")]
    std: Annotated[JointStd, Doc("Standard deviations of the entries.")]
    n: Annotated[int, Doc("Readings of its sweep.")]
    discarded: Annotated[list[RejectedRow], Doc("Readings left out.")]
    residual_rms_m: Annotated[float, Doc("Residual of the beacon's positions, RMS, m.")]
    residual_rms_px: Annotated[float | None, Doc("Residual of the beacon's pixels, RMS, px; null without a rig.")]
    p_line: Annotated[float, Doc("Probability that a straight path leaves as large residuals.")]
    decided: Annotated[bool, Doc("Whether the type is beyond doubt.")]
    radius_m: Annotated[float, Doc("Radius of the beacon's circle, m; 0 of a line.")]
    axis: Annotated[JointAxis, Doc("The joint's axis.")]


@output
class PlannedSweepOutput(Output):
    """A sweep of one joint."""

    joint: Annotated[int, Doc("Which joint moves, from 1.")]
    start: Annotated[float, Doc("Its first reading, rad or m.", key="from")]
    end: Annotated[float, Doc("Its last reading, rad or m.", key="to")]
    readings: Annotated[int, Doc("How many readings.")]
    rest: Annotated[list[float], Doc("Readings of all joints at the sweep's start, rad or m.")]
    way: Annotated[list[list[float]], Doc("Readings of all joints on the way there, rad or m.")]
    radius_m: Annotated[float, Doc("The beacon's distance from a turning joint's axis, m; 0 of a slide.")]
    ended_by: Annotated[tuple[str, str], Doc("What ends the range at both ends: limit or view.")]


@output
class PlanOutput(Output):
    """The sweeps that are planned, and the accuracy to expect of them."""

    sweeps: Annotated[list[PlannedSweepOutput], Doc("The sweeps in the order of moving.")]
    expected_std: Annotated[list[JointStd], Doc("Standard deviations to expect, by joint.")]
    noise_px: Annotated[float, Doc("Noise of a pixel coordinate that this rests on, px.")]
    notes: Annotated[list[str], Doc("What to know about the plan.")]


@output
class LeftOutJoint(Output):
    """A joint that was not swept: nothing of it is identified."""

    joint: Annotated[int, Doc("Number, from 1.")]
    held_at: Annotated[float, Doc("Where it stood during the sweeps, rad or m.")]


@output
class IdentifyOutput(Output):
    """armsight identify."""

    joints: Annotated[list[IdentifiedJoint], Doc("The joints, from the base on.")]
    method: Annotated[str, Doc("ml or paper.")]
    notes: Annotated[list[str], Doc("What to know about the result.")]
    noise: Annotated[float, Doc("Noise found: px with a rig, else m, or a factor on covariances given.")]
    misfit: Annotated[float, Doc("RMS of the readings' distances from the arm, in standard deviations of the noise.")]
    plan: Annotated[PlanOutput | None, Doc("The sweeps that were made; with --live.")] = None
    left_out: Annotated[
        list[LeftOutJoint] | None, Doc("Joints behind those of the result, held during the sweeps; --leave-out.")
    ] = None
    verdict_: Annotated[Verdict | None, Doc(MEANING)] = None


@output
class ProposedPlanOutput(Output):
    """armsight identify --live --propose."""

    plan: Annotated[PlanOutput, Doc("The sweeps that would be made.")]
    notes: Annotated[list[str], Doc("What to know about the plan.")]
