"""verify."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PoseOutput, RejectedRow, absent


class VerifyTime(Output):
    """How the measured rows were laid on the arm's time."""

    offset_s: float | None = Field(description="Measured time plus this is the arm's; null where rows go by order.")
    std_s: float | None = Field(description="Its standard deviation; null where rows go by order.")
    drift_ppm: float | None = Field(description="Drift of the clocks that was taken out; 0 where none is proved.")
    bursts: bool = Field(description="Whether stamps were those of deliveries and were put on the sampling clock.")


class VerifyAlignment(Output):
    """Base and tool as they were laid."""

    free: list[str] = Field(description="What was laid where it fits best: base, tool, both or none.")
    T_measured_base: PoseOutput | None = Field(
        description="The arm's base in the measurements' frame; null of repeats alone."
    )
    T_flange_tool: PoseOutput | None = Field(
        description="What was measured, on the flange; of several points the first; null of repeats alone."
    )
    std: dict[str, float | None] = Field(description="Standard deviations, unit in the name; null: not determined.")
    undetermined: list[str] = Field(description="What these rows leave open of base, tool and the joints' zeros.")


class PoseError(Output):
    """Errors of place and rotation over all rows compared."""

    rms_m: float = Field(description="Of the place, root mean square of the distance, m.")
    rms_rad: float | None = Field(description="Of the rotation, root mean square of the angle; null of positions.")
    max_m: float = Field(description="Of the place, largest distance, m.")


class ErrorFigures(Output):
    """Figures of one component's error, measured minus expected, in the unit of its name."""

    me: float = Field(description="Mean.", json_schema_extra={"unit": "as named"})
    mae: float = Field(description="Mean of the absolute error.", json_schema_extra={"unit": "as named"})
    max: float = Field(description="Largest absolute error.", json_schema_extra={"unit": "as named"})
    sd: float = Field(description="Standard deviation about the mean.", json_schema_extra={"unit": "as named"})
    rms: float = Field(description="Root mean square.", json_schema_extra={"unit": "as named"})


class VerifyJoint(Output):
    """One joint; rad, of a slide m."""

    index: int = Field(description="Which joint, from 1.")
    name: str = Field(description="Its name in the arm's file.")
    me: float | None = Field(description="Mean error, measured minus reported; null where poses do not fix the joints.")
    mae: float | None = Field(description="Mean absolute error.")
    max: float | None = Field(description="Largest absolute error.")
    sd: float | None = Field(description="Standard deviation about the mean.")
    rms: float | None = Field(description="Root mean square.")
    measurement_std: float | None = Field(description="What the measurement leaves of it, RMS; null where unknown.")
    offset_rad: float | None = Field(description="Error of its zero: to be added to readings; null where not judged.")
    std_rad: float | None = Field(description="Standard deviation of that.")
    judged: bool = Field(description="Whether these poses can tell its zero.")
    why: str = Field(description="Why it is not judged; empty where it is.")
    gain_heldout: float | None = Field(description="Share it alone takes off squared errors of rows left out.")
    kind: str | None = Field(description="What of it would take off so much: zero offset, backlash, ...")


class CauseParameter(Output):
    """A parameter of what the joint named has wrong."""

    value: float = Field(description="Its value, unit in the name.")
    std: float = Field(description="Its standard deviation.")


class Explained(Output):
    """Shares of the squared error that are explained, on rows left out but for the measurement's."""

    measurement: float | None = Field(description="By the measurement's standard deviations; null where not known.")
    joint: float | None = Field(description="By the best single joint.")
    zeros: float | None = Field(description="By all joints' zeros.")
    model: float | None = Field(description="By the links' geometry and all zeros.")


class ConfigurationPairs(Output):
    """Commanded poses that two configurations of the arm reached: how far apart the measured places are."""

    n: int = Field(description="Pairs of rows.")
    mean_m: float = Field(description="Mean distance, m.")
    p95_m: float = Field(description="95 % are closer, m.")
    max_m: float = Field(description="Largest distance, m.")


class IsoFigure(Output):
    """A figure of ISO 9283."""

    value: float | None = Field(description="The figure; null where withheld.")
    n: int = Field(description="Visits that it rests on.")
    wanted: int = Field(description="Visits that the norm asks for.")
    withheld: str | None = Field(description="Why it is not given; null where it is.")
    std: float | None = Field(description="Its standard deviation.")
    corrected: float | None = Field(description="Without the measurement's own scatter; null where not known.")
    corrected_std: float | None = Field(description="Its standard deviation.")
    note: str = Field(description="What else to know of it; empty where nothing.")


class ComparedRun(Output):
    """The run that this one is compared with (--compare): its figures."""

    folder: str = Field(description="Its folder.")
    n: int = Field(description="Its rows compared.")
    after: PoseError | None = Field(description="Its errors; null of repeats alone.")
    cause: str = Field(description="Its cause.")


class VerifyOutput(Output):
    """armsight verify."""

    n: int = Field(description="Rows compared.")
    time: VerifyTime = Field(description="How measured rows and the arm's were laid on one time.")
    alignment: VerifyAlignment = Field(description="Base and tool.")
    before: PoseError | None = Field(
        description="Errors before anything is laid where it fits best; null of repeats alone."
    )
    after: PoseError | None = Field(description="Errors with base and tool as aligned; null of repeats alone.")
    task: dict[str, ErrorFigures] = Field(
        description="Errors in the base's axes: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."
    )
    measurement_std: dict[str, float | None] = Field(description="The measurement's own, RMS; null where not known.")
    joints: list[VerifyJoint] = Field(description="Errors and zeros of the joints; empty without an arm.")
    cause: str = Field(description="none, joint N, several joints, model, measurement or undecided.")
    kind: str | None = Field(description="What the joint named has wrong; null where none is named.")
    parameters: dict[str, CauseParameter] = Field(description="... with its values.")
    explained: Explained = Field(description="What explains how much.")
    configurations: ConfigurationPairs | None = Field(
        None, exclude_if=absent, description="Commanded poses reached by two configurations."
    )
    decide_by: list[list[float]] | None = Field(
        None, exclude_if=absent, description="Joint readings to measure at where nothing decides, rad or m."
    )
    iso9283: dict[str, IsoFigure] = Field(description="Figures of ISO 9283 by name, the worst place; 'NAME PLACE'.")
    rejected: list[RejectedRow] = Field(description="Rows of the measured file left out, and why.")
    doubts: list[str] = Field(description="What to know before believing it.")
    verdict: str = Field(description="What it comes to, in words.")
    compared: ComparedRun | None = Field(None, exclude_if=absent, description="The other run; with --compare.")


class PlannedCube(Output):
    """The test cube, in the arm's base frame."""

    centre_m: list[float] = Field(description="Its centre, x y z.")
    side_m: float = Field(description="Its side.")
    plane: str = Field(description="The test plane: a, b, c or d.")
    corners_m: dict[str, list[float]] = Field(description="C1 to C8, x y z.")


class PlannedPose(Output):
    """A test pose."""

    xyz_m: list[float] = Field(description="Position in world, x y z.")
    q: list[float] = Field(description="The controller's joint readings there, rad or m.")


class PlannedTest(Output):
    """A motion of the plan."""

    test: str = Field(description="Its name: the tag of its rows in plan.csv.")
    figures: list[str] = Field(description="What it is for.")
    repeats: int = Field(description="How often it is made.")
    n: int = Field(description="Its rows.")


class VerifyPlanOutput(Output):
    """armsight verify --plan."""

    arm: str = Field(description="The arm's name.")
    cube: PlannedCube = Field(description="The test cube.")
    quat_xyzw: list[float] = Field(description="The tool's orientation in world.")
    speed_m_s: float = Field(description="Speed along the paths: as wanted, or the highest that all joints allow.")
    poses: dict[str, PlannedPose] = Field(description="P1 to P5.")
    motions: list[PlannedTest] = Field(description="The motions written.")
    branch: list[str] = Field(description="The arm's configuration throughout.")
    singularity_distance: float = Field(description="The least over all motions.")
    limit_margin: float | None = Field(description="Least distance of a joint from a limit, rad or m; null: no limits.")
    refused: list[str] = Field(description="Larger cubes that were tried, and why not.")
    files: list[str] = Field(description="What was written.")
