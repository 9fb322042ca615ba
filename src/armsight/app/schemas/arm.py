"""calibrate arm, calibrate robot-world, identify."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PoseOutput, PoseStd, RejectedRow, absent

Vector = tuple[float, float, float]


class ToolErrors(Output):
    """Errors at the tool's point."""

    mean_m: float = Field(description="Mean, m.")
    rms_m: float = Field(description="Root mean square, m.")
    max_m: float = Field(description="Largest, m.")


class BeforeAfter(Output):
    """Errors with the nominal arm and with the one kept."""

    before: ToolErrors = Field(description="With the nominal geometry, base and tool fitted.")
    after: ToolErrors = Field(description="With the geometry kept, base and tool fitted.")


class FixedParameter(Output):
    """A parameter that is as in the nominal arm."""

    name: str = Field(description="Its name.")
    why: str = Field(description="Why it was not freed.")


class Outlier(Output):
    """A row that does not fit."""

    row: int = Field(description="The row of points.csv, from 1.")
    error_m: float = Field(description="Its error, m.")


class CouplingOutput(Output):
    """A joint whose reading another joint's moves along."""

    joint: str = Field(description="The joint.")
    by: str = Field(description="The joint that moves it along.")
    share: float = Field(description="How much of that joint's reading.")


class ArmNoise(Output):
    """Noise of the measurements."""

    place_m: float = Field(description="Standard deviation of one coordinate of a place, m.")
    rotation_rad: float | None = Field(description="Of an orientation about one axis, rad; null without orientations.")


class LimitOutput(Output):
    """A correction as large as the nominal arm is believed to."""

    name: str = Field(description="The parameter.")
    change: float = Field(description="Its change to the nominal arm, unit in the name.")
    limit: float = Field(description="What the nominal arm is believed to, unit in the name.")
    flag: str | None = Field(description="The option that raises it; null where there is none.")


class MisfitOutput(Output):
    """A figure of the nominal arm that the measurements contradict."""

    name: str = Field(description="Its name: a joint's a_m, d_m, alpha_rad, beta_rad or scale.")
    nominal: float = Field(description="As the nominal arm has it, unit in the name.")
    wanted: float = Field(description="As the measurements want it.")
    std: float = Field(description="Standard deviation of what they want.")


class KnownArmOutput(Output):
    """An arm known by name that fits the measurements as it is."""

    name: str = Field(description="Its name.")
    error_m: float = Field(description="Median error of a place, base and tool fitted, m.")


class OtherArmOutput(Output):
    """Why the nominal arm is that of another one."""

    misfits: list[MisfitOutput] = Field(description="Figures that the measurements contradict, the worst first.")
    known: KnownArmOutput | None = Field(description="The arm known by name that fits far better; null for none.")
    nominal_error_m: float = Field(description="Median error of a place with the nominal arm, m.")


class ArmCalibrationOutput(Output):
    """The calibration of a known arm's geometry."""

    n: int = Field(description="Rows given.")
    n_effective: float | None = Field(
        None, exclude_if=absent, description="Independent rows that they are worth; of samples of a stream only."
    )
    correlation_time_s: float | None = Field(
        None, exclude_if=absent, description="After which a drift of the errors is forgotten, s; of a stream only."
    )
    before: ToolErrors = Field(description="Errors on the rows used, nominal geometry, base and tool fitted.")
    after: ToolErrors = Field(description="Errors on the rows used, geometry kept, base and tool fitted.")
    crossval: BeforeAfter = Field(description="Errors on rows left out by nested cross-validation, refitted fully.")
    holdout: BeforeAfter | None = Field(None, exclude_if=absent, description="Errors on the rows of --holdout.")
    free: list[str] = Field(description="Parameters that were corrected.")
    fixed: list[FixedParameter] = Field(description="Parameters that were not.")
    std: dict[str, float] = Field(description="Standard deviations of corrections, base and tool, unit in the name.")
    corrections: dict[str, float] = Field(
        description="Changes to the nominal arm, unit in the name; sag in rad per m of lever."
    )
    condition: float = Field(description="Condition number of the freed parameters' information, scaled.")
    outliers: list[Outlier] = Field(description="Rows that do not fit.")
    still: list[str] = Field(description="Joints that did not move.")
    couplings: list[CouplingOutput] = Field(description="Readings that are coupled to other joints'.")
    noise: ArmNoise = Field(description="Noise of the measurements.")
    at_limit: list[LimitOutput] = Field(description="Corrections that stand at the limit of their tolerance.")
    notes: list[str] = Field(description="What to know about the result.")
    model: str = Field(description="Which kind of model was taken.")
    verdict: str = Field(description="Whether the correction is worth it, in words.")
    gain: bool = Field(description="Whether left-out errors fall beyond their own uncertainty.")
    other_arm: OtherArmOutput | None = Field(
        description="Where the nominal arm is another one than was measured: why; nothing is corrected then. Else null."
    )


class ArmOutput(ArmCalibrationOutput):
    """armsight calibrate arm."""

    proposals: list[list[float]] | None = Field(
        None, exclude_if=absent, description="Further joint readings to measure at, rad or m; with --propose."
    )
    expected_std: dict[str, float] | None = Field(
        None, exclude_if=absent, description="Standard deviations to expect with those measured too."
    )
    urdf: str | None = Field(description="The URDF written; null for scales, sag and couplings, which it cannot hold.")


class RobotWorldOutput(Output):
    """armsight calibrate robot-world."""

    T_base_rig: PoseOutput = Field(description="Where the rig stands, in base axes.")
    std: PoseStd = Field(description="Standard deviations of T_base_rig.")
    residual_rms_m: float = Field(description="Residual of a point, RMS, m.")
    n_used: int = Field(description="Rows that the result rests on.")
    rejected: list[RejectedRow] = Field(description="Rows left out.")
    notes: list[str] = Field(description="What to know about the result.")


class JointStd(Output):
    """Standard deviations of a joint's entries in the table; null where an entry is chosen, not measured."""

    theta_rad: float | None = Field(description="Of theta, rad.")
    d_m: float | None = Field(description="Of d, m.")
    a_m: float | None = Field(description="Of a, m.")
    alpha_rad: float | None = Field(description="Of alpha, rad.")
    beta_rad: float | None = Field(description="Of beta, rad.")


class JointAxis(Output):
    """The axis of a joint with all joints at zero, in rig axes (or those of the positions)."""

    point_m: Vector = Field(description="A point of it, m.")
    direction: Vector = Field(description="Its direction, a unit vector.")


class IdentifiedJoint(Output):
    """A joint that was found (Denavit-Hartenberg, standard; beta after Hayati for parallel axes)."""

    index: int = Field(description="Which joint, from 1.")
    type: str = Field(description="revolute or prismatic.")
    a_m: float = Field(description="a, m.")
    alpha_rad: float = Field(description="alpha, rad.")
    d_m: float = Field(description="d, m; the zero of a prismatic joint.")
    theta_rad: float = Field(description="theta, rad; the zero of a revolute joint.")
    beta_rad: float = Field(description="beta, rad.")
    lower: float = Field(description="Smallest reading of its sweep, rad or m.")
    upper: float = Field(description="Largest reading of its sweep, rad or m.")
    sign: float = Field(description="Sense of the readings: 1 or -1, times the joint's scale where one was found.")
    std: JointStd = Field(description="Standard deviations of the entries.")
    n: int = Field(description="Readings of its sweep.")
    discarded: list[RejectedRow] = Field(description="Readings left out.")
    residual_rms_m: float = Field(description="Residual of the beacon's positions, RMS, m.")
    residual_rms_px: float | None = Field(description="Residual of the beacon's pixels, RMS, px; null without a rig.")
    p_line: float = Field(description="Probability that a straight path leaves as large residuals.")
    decided: bool = Field(description="Whether the type is beyond doubt.")
    radius_m: float = Field(description="Radius of the beacon's circle, m; 0 of a line.")
    axis: JointAxis = Field(description="The joint's axis.")


class PlannedSweepOutput(Output):
    """A sweep of one joint."""

    joint: int = Field(description="Which joint moves, from 1.")
    start: float = Field(alias="from", description="Its first reading, rad or m.")
    end: float = Field(alias="to", description="Its last reading, rad or m.")
    readings: int = Field(description="How many readings.")
    rest: list[float] = Field(description="Readings of all joints at the sweep's start, rad or m.")
    way: list[list[float]] = Field(description="Readings of all joints on the way there, rad or m.")
    radius_m: float = Field(description="The beacon's distance from a turning joint's axis, m; 0 of a slide.")
    ended_by: tuple[str, str] = Field(description="What ends the range at both ends: limit or view.")


class PlanOutput(Output):
    """The sweeps that are planned, and the accuracy to expect of them."""

    sweeps: list[PlannedSweepOutput] = Field(description="The sweeps in the order of moving.")
    expected_std: list[JointStd] = Field(description="Standard deviations to expect, by joint.")
    noise_px: float = Field(description="Noise of a pixel coordinate that this rests on, px.")
    notes: list[str] = Field(description="What to know about the plan.")


class LeftOutJoint(Output):
    """A joint that was not swept: nothing of it is identified."""

    joint: int = Field(description="Number, from 1.")
    held_at: float = Field(description="Where it stood during the sweeps, rad or m.")


class IdentifyOutput(Output):
    """armsight identify."""

    joints: list[IdentifiedJoint] = Field(description="The joints, from the base on.")
    method: str = Field(description="ml or paper.")
    notes: list[str] = Field(description="What to know about the result.")
    noise: float = Field(description="Noise found: px with a rig, else m, or a factor on covariances given.")
    misfit: float = Field(
        description="RMS of the readings' distances from the arm, in standard deviations of the noise."
    )
    plan: PlanOutput | None = Field(None, exclude_if=absent, description="The sweeps that were made; with --live.")
    left_out: list[LeftOutJoint] | None = Field(
        None, exclude_if=absent, description="Joints behind those of the result, held during the sweeps; --leave-out."
    )


class ProposedPlanOutput(Output):
    """armsight identify --live --propose."""

    plan: PlanOutput = Field(description="The sweeps that would be made.")
    notes: list[str] = Field(description="What to know about the plan.")
