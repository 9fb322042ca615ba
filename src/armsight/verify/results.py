"""What a verification comes to: of a recording, live, and of an arm's zeros."""

from __future__ import annotations

from typing import Annotated

from scipy.spatial.transform import RigidTransform

from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, RejectedRow, Verdict
from armsight.units import figure_of, with_deviation
from armsight.verify.records import Figures
from armsight.verify.supervision import Limits
from armsight.verify.verdicts import live_verdict, mastering_verdict, verify_verdict
from armsight.verify.verification import Configurations


@output
class LiveAlarm(Output):
    """A level that was raised, or something that supervision lost."""

    t_s: Annotated[float, Doc("When, on the cameras' clock, s: the middle of the exposure that told it.")]
    level: Annotated[str, Doc("warn, stop, or blind: nothing could be compared for a while.")]
    why: Annotated[str, Doc("What was off and by how much, or what was lost.")]


@output
class LiveErrors(Output):
    """Errors of the poses compared."""

    rms_m: Annotated[float | None, Doc("Of the place, root mean square, m; null where nothing was compared.")]
    max_m: Annotated[float | None, Doc("Largest error of the place, m.")]
    rms_rad: Annotated[float | None, Doc("Of the rotation, root mean square, rad.")]
    max_rad: Annotated[float | None, Doc("Largest error of the rotation, rad.")]
    std_m: Annotated[
        float | None, Doc("What measurement and expectation may be off along the error, RMS of standard deviations, m.")
    ]
    std_rad: Annotated[float | None, Doc("The same of the rotation, rad.")]


@output
class DecisionTime(Output):
    """Time from a pair of frames in memory to the decision on it, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class VerifyLiveOutput(Output):
    """armsight verify --live."""

    n: Annotated[int, Doc("Pairs of frames seen.")]
    n_compared: Annotated[int, Doc("Pairs that were compared.")]
    n_lost: Annotated[int, Doc("Pairs in which the target was not seen whole.")]
    n_stale: Annotated[int, Doc("Pairs for which the joints were not known.")]
    duration_s: Annotated[float, Doc("From the first pair to the last, s.")]
    rate_hz: Annotated[float | None, Doc("Pairs a second; null for fewer than two.")]
    missed: Annotated[int, Doc("Frames of the left camera that never arrived, by their numbers.")]
    level: Annotated[str, Doc("The gravest level raised: good, warn or stop; unknown where nothing was compared.")]
    stopped: Annotated[bool, Doc("Whether the robot was told to stop.")]
    alarms: Annotated[list[LiveAlarm], Doc("What was raised, in the order of time.")]
    errors: Annotated[LiveErrors, Doc("Measured minus expected.")]
    levels: Annotated[Limits, Doc("The levels of alarm.")]
    blind_s: Annotated[float, Doc("Longest time in which nothing could be compared, s.")]
    decision_ms: Annotated[DecisionTime | None, Doc("How long a decision took; null without one.")]
    recording: Annotated[str | None, Doc("The recording; null where none was made.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return live_verdict(self)


@output
class MasteringPose(Output):
    """One of the poses to measure."""

    q: Annotated[list[float], Doc("What the controller shows there, rad or m.", unit="as named")]
    decides: Annotated[list[str], Doc("Which joints' zeros it tells most about, by name.")]


@output
class MasteringPlanOutput(Output):
    """armsight verify --mastering without measured poses."""

    poses: Annotated[list[MasteringPose], Doc("The poses, in the order to drive to them.")]
    expected_std_rad: Annotated[
        list[float | None],
        Doc("Standard deviation to expect of each joint's zero, rad or m; null where it is not judged."),
    ]
    file: Annotated[str, Doc("The table of joint targets that was written.")]
    notes: Annotated[list[str], Doc("What to know before driving.")]


@output
class MasteringJoint(Output):
    """One joint's zero; rad, of a slide m."""

    index: Annotated[int, Doc("Which joint, from 1.")]
    name: Annotated[str, Doc("Its name in the arm's file.")]
    judged: Annotated[bool, Doc("Whether these poses can tell its zero.")]
    why: Annotated[str, Doc("Why it is not judged; empty where it is.")]
    offset_rad: Annotated[float | None, Doc("Error of its zero as the cause has it: to be added to readings.")]
    std_rad: Annotated[float | None, Doc("Standard deviation of that.")]


@output
class MasteringOutput(Output):
    """armsight verify --mastering."""

    n: Annotated[int, Doc("Poses compared.")]
    cause: Annotated[str, Doc("none, joint N, tool, several or undecided.")]
    offset_rad: Annotated[float | None, Doc("By how much that joint's zero is off, rad or m; null where none is.")]
    std_rad: Annotated[float | None, Doc("Standard deviation of that.")]
    rms_before_m: Annotated[float, Doc("Error of place as it was measured, RMS, m.")]
    rms_after_m: Annotated[float, Doc("The same with the cause taken out, m.")]
    tool_moved: Annotated[
        RigidTransform | None, Doc("Where the tool is now, in its old axes; where it is the cause.")
    ] = None
    joints: Annotated[list[MasteringJoint], Doc("The joints' zeros as they are believed, with the cause that is told.")]
    rejected: Annotated[list[RejectedRow], Doc("Rows left out, and why.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return mastering_verdict(self)


@output
class VerifyTime(Output):
    """How the measured rows were laid on the arm's time."""

    offset_s: Annotated[float | None, Doc("Measured time plus this is the arm's; null where rows go by order.")]
    std_s: Annotated[float | None, Doc("Its standard deviation; null where rows go by order.")]
    drift_ppm: Annotated[float | None, Doc("Drift of the clocks that was taken out; 0 where none is proved.")]
    bursts: Annotated[bool, Doc("Whether stamps were those of deliveries and were put on the sampling clock.")]


@output
class VerifyAlignment(Output):
    """Base and tool as they were laid."""

    free: Annotated[list[str], Doc("What was laid where it fits best: base, tool, both or none.")]
    T_measured_base: Annotated[
        RigidTransform | None, Doc("The arm's base in the measurements' frame; null of repeats alone.")
    ]
    T_flange_tool: Annotated[
        RigidTransform | None,
        Doc("What was measured, on the flange; of several points the first; null of repeats alone."),
    ]
    std: Annotated[dict[str, float | None], Doc("Standard deviations, unit in the name; null: not determined.")]
    undetermined: Annotated[list[str], Doc("What these rows leave open of base, tool and the joints' zeros.")]
    hidden_m: Annotated[
        float | None,
        Doc(
            "What base and tool, laid best, may have taken up of the arm's own errors of place, RMS, m; null where "
            "nothing was laid or no cause was looked for."
        ),
    ] = None


@output
class PoseError(Output):
    """Errors of place and rotation over all rows compared."""

    rms_m: Annotated[float, Doc("Of the place, root mean square of the distance, m.")]
    rms_rad: Annotated[float | None, Doc("Of the rotation, root mean square of the angle; null of positions.")]
    max_m: Annotated[float, Doc("Of the place, largest distance, m.")]


@output
class VerifyJoint(Output):
    """One joint; rad, of a slide m."""

    index: Annotated[int, Doc("Which joint, from 1.")]
    name: Annotated[str, Doc("Its name in the arm's file.")]
    me: Annotated[float | None, Doc("Mean error, measured minus reported; null where poses do not fix the joints.")]
    mae: Annotated[float | None, Doc("Mean absolute error.")]
    max: Annotated[float | None, Doc("Largest absolute error.")]
    sd: Annotated[float | None, Doc("Standard deviation about the mean.")]
    rms: Annotated[float | None, Doc("Root mean square.")]
    measurement_std: Annotated[float | None, Doc("What the measurement leaves of it, RMS; null where unknown.")]
    offset_rad: Annotated[float | None, Doc("Error of its zero: to be added to readings; null where not judged.")]
    std_rad: Annotated[float | None, Doc("Standard deviation of that.")]
    judged: Annotated[bool, Doc("Whether these poses can tell its zero.")]
    why: Annotated[str, Doc("Why it is not judged; empty where it is.")]
    gain_heldout: Annotated[float | None, Doc("Share it alone takes off squared errors of rows left out.")]
    kind: Annotated[str | None, Doc("What of it would take off so much: zero offset, backlash, ...")]


@output
class CauseParameter(Output):
    """A parameter of what the joint named has wrong."""

    value: Annotated[float, Doc("Its value, unit in the name.")]
    std: Annotated[float, Doc("Its standard deviation.")]


@output
class Explained(Output):
    """Shares of the squared error that are explained, on rows left out but for the measurement's."""

    measurement: Annotated[float | None, Doc("By the measurement's standard deviations; null where not known.")]
    joint: Annotated[float | None, Doc("By the best single joint.")]
    zeros: Annotated[float | None, Doc("By all joints' zeros.")]
    model: Annotated[float | None, Doc("By the links' geometry and all zeros.")]


@output
class IsoFigure(Output):
    """A figure of ISO 9283."""

    value: Annotated[float | None, Doc("The figure; null where withheld.")]
    n: Annotated[int, Doc("Visits that it rests on.")]
    wanted: Annotated[int, Doc("Visits that the norm asks for.")]
    withheld: Annotated[str | None, Doc("Why it is not given; null where it is.")]
    std: Annotated[float | None, Doc("Its standard deviation.")]
    corrected: Annotated[float | None, Doc("Without the measurement's own scatter; null where not known.")]
    corrected_std: Annotated[float | None, Doc("Its standard deviation.")]
    note: Annotated[str, Doc("What else to know of it; empty where nothing.")]

    def shown(self, factor: float) -> str:
        """Return it ± its standard deviation, where it has one, both to the same digit; a dash where withheld."""
        if self.value is None or not self.std:
            return figure_of(None if self.value is None else self.value / factor)
        return " ± ".join(with_deviation(self.value / factor, self.std / factor))


@output
class ComparedRun(Output):
    """The run that this one is compared with (--compare): its figures."""

    folder: Annotated[str, Doc("Its folder.")]
    n: Annotated[int, Doc("Its rows compared.")]
    after: Annotated[PoseError | None, Doc("Its errors; null of repeats alone.")]
    cause: Annotated[str, Doc("Its cause.")]


@output
class VerifyOutput(Output):
    """armsight verify."""

    n: Annotated[int, Doc("Rows compared.")]
    time: Annotated[VerifyTime, Doc("How measured rows and the arm's were laid on one time.")]
    alignment: Annotated[VerifyAlignment, Doc("Base and tool.")]
    before: Annotated[
        PoseError | None, Doc("Errors before anything is laid where it fits best; null of repeats alone.")
    ]
    after: Annotated[PoseError | None, Doc("Errors with base and tool as aligned; null of repeats alone.")]
    task: Annotated[dict[str, Figures], Doc("Errors in the base's axes: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad.")]
    measurement_std: Annotated[dict[str, float | None], Doc("The measurement's own, RMS; null where not known.")]
    joints: Annotated[list[VerifyJoint], Doc("Errors and zeros of the joints; empty without an arm.")]
    cause: Annotated[str, Doc("none, joint N, several joints, model, measurement, drift or undecided.")]
    kind: Annotated[str | None, Doc("What the joint named has wrong; null where none is named.")]
    parameters: Annotated[dict[str, CauseParameter], Doc("... with its values.")]
    explained: Annotated[Explained, Doc("What explains how much.")]
    configurations: Annotated[Configurations | None, Doc("Commanded poses reached by two configurations.")] = None
    decide_by: Annotated[
        list[list[float]] | None, Doc("Joint readings to measure at where nothing decides, rad or m.")
    ] = None
    iso9283: Annotated[dict[str, IsoFigure], Doc("Figures of ISO 9283 by name, the worst place; 'NAME PLACE'.")]
    rejected: Annotated[list[RejectedRow], Doc("Rows of the measured file left out, and why.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]
    compared: Annotated[ComparedRun | None, Doc("The other run; with --compare.")] = None

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return verify_verdict(self)
