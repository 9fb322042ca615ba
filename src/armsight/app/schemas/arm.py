"""calibrate arm, calibrate robot-world, identify."""

from __future__ import annotations

from typing import Annotated

from scipy.spatial.transform import RigidTransform

from armsight.records.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import PoseStd, RejectedRow

Vector = tuple[float, float, float]


@output
class ToolErrors(Output):
    """Errors at the tool's point."""

    mean_m: Annotated[float, Doc("Mean, m.")]
    rms_m: Annotated[float, Doc("Root mean square, m.")]
    max_m: Annotated[float, Doc("Largest, m.")]


@output
class BeforeAfter(Output):
    """Errors with the nominal arm and with the one kept."""

    before: Annotated[ToolErrors, Doc("With the nominal geometry, base and tool fitted.")]
    after: Annotated[ToolErrors, Doc("With the geometry kept, base and tool fitted.")]


@output
class FixedParameter(Output):
    """A parameter that is as in the nominal arm."""

    name: Annotated[str, Doc("Its name.")]
    why: Annotated[str, Doc("Why it was not freed.")]


@output
class Outlier(Output):
    """A row that does not fit."""

    row: Annotated[int, Doc("The row of points.csv, from 1.")]
    error_m: Annotated[float, Doc("Its error, m.")]


@output
class CouplingOutput(Output):
    """A joint whose reading another joint's moves along."""

    joint: Annotated[str, Doc("The joint.")]
    by: Annotated[str, Doc("The joint that moves it along.")]
    share: Annotated[float, Doc("How much of that joint's reading.")]


@output
class ArmNoise(Output):
    """Noise of the measurements."""

    place_m: Annotated[float, Doc("Standard deviation of one coordinate of a place, m.")]
    rotation_rad: Annotated[float | None, Doc("Of an orientation about one axis, rad; null without orientations.")]


@output
class LimitOutput(Output):
    """A correction as large as the nominal arm is believed to."""

    name: Annotated[str, Doc("The parameter.")]
    change: Annotated[float, Doc("Its change to the nominal arm, unit in the name.")]
    limit: Annotated[float, Doc("What the nominal arm is believed to, unit in the name.")]
    flag: Annotated[str | None, Doc("The option that raises it; null where there is none.")]


@output
class MisfitOutput(Output):
    """A figure of the nominal arm that the measurements contradict."""

    name: Annotated[str, Doc("Its name: a joint's a_m, d_m, alpha_rad, beta_rad or scale.")]
    nominal: Annotated[float, Doc("As the nominal arm has it, unit in the name.")]
    wanted: Annotated[float, Doc("As the measurements want it.")]
    std: Annotated[float, Doc("Standard deviation of what they want.")]


@output
class KnownArmOutput(Output):
    """An arm known by name that fits the measurements as it is."""

    name: Annotated[str, Doc("Its name.")]
    error_m: Annotated[float, Doc("Median error of a place, base and tool fitted, m.")]


@output
class OtherArmOutput(Output):
    """Why the nominal arm is that of another one."""

    misfits: Annotated[list[MisfitOutput], Doc("Figures that the measurements contradict, the worst first.")]
    known: Annotated[KnownArmOutput | None, Doc("The arm known by name that fits far better; null for none.")]
    nominal_error_m: Annotated[float, Doc("Median error of a place with the nominal arm, m.")]


@output
class ArmCalibrationOutput(Output):
    """The calibration of a known arm's geometry."""

    n: Annotated[int, Doc("Rows given.")]
    n_effective: Annotated[float | None, Doc("Independent rows that they are worth; of samples of a stream only.")] = (
        None
    )
    correlation_time_s: Annotated[
        float | None, Doc("After which a drift of the errors is forgotten, s; of a stream only.")
    ] = None
    before: Annotated[ToolErrors, Doc("Errors on the rows used, nominal geometry, base and tool fitted.")]
    after: Annotated[ToolErrors, Doc("Errors on the rows used, geometry kept, base and tool fitted.")]
    crossval: Annotated[BeforeAfter, Doc("Errors on rows left out by nested cross-validation, refitted fully.")]
    holdout: Annotated[BeforeAfter | None, Doc("Errors on the rows of --holdout.")] = None
    free: Annotated[list[str], Doc("Parameters that were corrected.")]
    fixed: Annotated[list[FixedParameter], Doc("Parameters that were not.")]
    std: Annotated[dict[str, float], Doc("Standard deviations of corrections, base and tool, unit in the name.")]
    corrections: Annotated[
        dict[str, float], Doc("Changes to the nominal arm, unit in the name; sag in rad per m of lever.")
    ]
    condition: Annotated[float, Doc("Condition number of the freed parameters' information, scaled.")]
    outliers: Annotated[list[Outlier], Doc("Rows that do not fit.")]
    still: Annotated[list[str], Doc("Joints that did not move.")]
    couplings: Annotated[list[CouplingOutput], Doc("Readings that are coupled to other joints'.")]
    noise: Annotated[ArmNoise, Doc("Noise of the measurements.")]
    at_limit: Annotated[list[LimitOutput], Doc("Corrections that stand at the limit of their tolerance.")]
    notes: Annotated[list[str], Doc("What to know about the result.")]
    model: Annotated[str, Doc("Which kind of model was taken.")]
    verdict: Annotated[str, Doc("Whether the correction is worth it, in words.")]
    gain: Annotated[bool, Doc("Whether left-out errors fall beyond their own uncertainty.")]
    other_arm: Annotated[
        OtherArmOutput | None,
        Doc("Where the nominal arm is another one than was measured: why; nothing is corrected then. Else null."),
    ]


@output
class ArmOutput(ArmCalibrationOutput):
    """armsight calibrate arm."""

    proposals: Annotated[
        list[list[float]] | None, Doc("Further joint readings to measure at, rad or m; with --propose.")
    ] = None
    expected_std: Annotated[dict[str, float] | None, Doc("Standard deviations to expect with those measured too.")] = (
        None
    )
    urdf: Annotated[str | None, Doc("The URDF written; null for scales, sag and couplings, which it cannot hold.")]


@output
class RobotWorldOutput(Output):
    """armsight calibrate robot-world."""

    T_base_rig: Annotated[RigidTransform, Doc("Where the rig stands, in base axes.")]
    std: Annotated[PoseStd, Doc("Standard deviations of T_base_rig.")]
    residual_rms_m: Annotated[float, Doc("Residual of a point, RMS, m.")]
    n_used: Annotated[int, Doc("Rows that the result rests on.")]
    rejected: Annotated[list[RejectedRow], Doc("Rows left out.")]
    notes: Annotated[list[str], Doc("What to know about the result.")]


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


@output
class ProposedPlanOutput(Output):
    """armsight identify --live --propose."""

    plan: Annotated[PlanOutput, Doc("The sweeps that would be made.")]
    notes: Annotated[list[str], Doc("What to know about the plan.")]
