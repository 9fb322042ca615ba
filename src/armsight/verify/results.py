"""What a verification comes to: of a recording, and of an arm's zeros after a crash."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.fields import Doc
from armsight.kinematics import Arm, JointType
from armsight.records.by_value import Saveable
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, RejectedRow, Verdict
from armsight.shown import REJECTED_SHOWN, RESULTS, Bars, Shown, Table, digits
from armsight.units import DEG, MM, MS, displayed_name
from armsight.verify.iso9283.figure import IsoFigure, symbol_of
from armsight.verify.records import Columns, Figures, Measured, Repeats
from armsight.verify.repeats import about_mean
from armsight.verify.verdicts import mastering_verdict, verify_verdict
from armsight.verify.verification import Configurations, Verification


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

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = [
            [f"{k}", *(f"{value:.4f}" for value in pose.q), " ".join(pose.decides)]
            for k, pose in enumerate(self.poses, 1)
        ]
        header = ["pose", *(f"q{i + 1}" for i in range(len(self.poses[0].q))), "decides"]
        yield Table("Poses to measure, rad or m", header, rows)
        yield from (f"- {note}" for note in self.notes)
        yield f"Drive to each and measure there; then give --measured poses.csv --joints {self.file}"


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
    model: Arm | None = None

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return mastering_verdict(self)

    @property
    def slides(self) -> list[int]:
        """The indices, from 1, of the joints that slide."""
        joints = () if self.model is None else self.model.joints
        return [k for k, joint in enumerate(joints, 1) if joint.type is JointType.PRISMATIC]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = []
        for joint in self.joints:
            shown = [digits(None if one is None else one / DEG) for one in (joint.offset_rad, joint.std_rad)]
            rows.append([f"{joint.index} {joint.name}", *shown, joint.why])
        yield Table("Zeros", ["joint", "deg", "+-", ""], rows)
        yield from (f"  left out: row {left.row}: {left.why}" for left in self.rejected)
        yield from (f"  {text}" for text in self.doubts)
        yield f"Cause: {self.cause}. {self.verdict}"
        yield RESULTS


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
    backlash_rad: Annotated[float | None, Doc("Of its own, whatever the cause; null where it came from one side.")] = (
        None
    )
    backlash_std_rad: Annotated[float | None, Doc("Standard deviation of that.")] = None


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
class ComparedRun(Output):
    """The run that this one is compared with (--compare): its figures."""

    folder: Annotated[str, Doc("Its folder.")]
    n: Annotated[int, Doc("Its rows compared.")]
    after: Annotated[PoseError | None, Doc("Its errors; null of repeats alone.")]
    cause: Annotated[str, Doc("Its cause.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EarlierRun:
    """A run to stand beside this one: its folder's name, its result, its errors of place (k,) in m; None of repeats."""

    name: str
    result: VerifyResult
    error_m: Array | None


@output
class VerifyResult(Output, Saveable):
    """armsight verify.

    verification, model: what was compared, and the arm; None of repeats alone, whose rows are repeated. earlier: the
    run of --compare. These are for Python and for the page.
    """

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
    verification: Verification | None = None
    model: Arm | None = None
    repeated: tuple[Measured, Repeats] | None = None
    earlier: EarlierRun | None = None

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return verify_verdict(self)

    @property
    def table(self) -> Columns:
        """The columns of errors.csv: the errors row by row, or repeats about the mean of their pose."""
        if self.verification is not None:
            return _errors(self.verification)
        return {} if self.repeated is None else about_mean(*self.repeated)

    @property
    def errors(self) -> dict[str, Array | list[str]]:
        """Columns (n,) by row of what was compared: numbers where all cells are, NaN for empty ones, else texts."""
        return {name: _numbers(column) for name, column in self.table.items()}

    def bars(self) -> Bars:
        """Return each row's error of place, mm."""
        table = self.table
        error_m = table["error_m"] if "error_m" in table else table["from_mean_m"]
        values = [1e3 * float(one) for one in error_m]
        return Bars(self.verdict, [str(row) for row in table["row"]], values, "row", "error, mm")

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = []
        for name, item in self.task.items():
            stem, unit, factor = displayed_name(name)
            values = (item.me, item.mae, item.max, item.sd, self.measurement_std.get(name))
            rows.append([f"{stem} {unit}", *(digits(None if one is None else one / factor) for one in values)])
        if rows:
            yield Table("Measured minus expected", ["", "mean", "mean abs.", "largest", "sd", "measurement +-"], rows)
        yield from self._joints_and_frames()
        yield from (f"  {text}" for text in self.doubts)
        yield from (f"  left out: row {left.row}: {left.why}" for left in self.rejected[:REJECTED_SHOWN])
        if len(self.rejected) > REJECTED_SHOWN:
            yield f"  ... and {len(self.rejected) - REJECTED_SHOWN} more, see verify.json"
        yield from _iso_figures(self.iso9283)
        if self.compared is not None and self.compared.after is not None and self.after is not None:
            before, after = self.compared.after.rms_m / MM, self.after.rms_m / MM
            yield f"Beside {self.compared.folder}: {digits(before)} mm RMS there, {digits(after)} here"
        yield f"Cause: {self.cause}. {self.verdict}" if self.task else self.verdict
        for q in self.decide_by or ():
            yield "  measure at " + ", ".join(f"{value:.4f}" for value in q)
        yield RESULTS

    def _joints_and_frames(self) -> Iterator[Shown]:
        if self.joints:
            header = ["joint", "mean deg", "mean abs.", "largest", "zero deg", "+-", "alone explains"]
            yield Table("Joints", header, [_joint_row(joint) for joint in self.joints])
        if self.time.offset_s is not None and self.time.std_s is not None:
            yield f"Time offset {self.time.offset_s:.6f} s +- {digits(self.time.std_s / MS, 2)} ms"
        if self.alignment.undetermined:
            yield f"Not determined by these rows: {', '.join(self.alignment.undetermined)}"


def _errors(result: Verification) -> Columns:
    """Return errors by row: of place and rotation in the base's axes, and of the joints where they are known."""
    n, turned, at_s = len(result.task), result.task.shape[1] == 6, result.paired.at_s
    nothing = np.full(n, np.nan)
    columns: Columns = {
        "row": result.paired.measured.rows[result.kept],
        "t_s": nothing if at_s is None else at_s[result.kept],
        **{name: result.task[:, k] if k < 3 or turned else nothing for k, name in enumerate(POSE6)},
        "error_m": np.array([np.linalg.norm(error[:3]) for error in result.task]),
        "error_rad": np.array([np.linalg.norm(error[3:]) for error in result.task]) if turned else nothing,
    }
    dq = np.empty((n, 0)) if result.joints is None else result.joints.dq
    return columns | {f"dq{i + 1}": column for i, column in enumerate(dq.T)}


def _numbers(column: Array | NDArray[np.intp] | Sequence[str]) -> Array | list[str]:
    if isinstance(column, np.ndarray):
        return column.astype(float)
    try:
        return np.array([float(cell) if cell else np.nan for cell in column])
    except ValueError:
        return list(column)


def _joint_row(joint: VerifyJoint) -> list[str]:
    values = (joint.me, joint.mae, joint.max, joint.offset_rad, joint.std_rad)
    shown = [digits(None if one is None else one / DEG) for one in values]
    gain = "-" if joint.gain_heldout is None else f"{100.0 * joint.gain_heldout:.1f} %"
    return [f"{joint.index} {joint.name}", *shown, gain if joint.judged else "not judged"]


def _iso_figures(iso: Mapping[str, IsoFigure]) -> Iterator[Shown]:
    """Yield the figures of ISO 9283 that are given, and why others are not."""
    given = {name: item for name, item in iso.items() if " " not in name and item.n}
    rows = []
    for name, item in given.items():
        if item.value is not None:
            repeats = f"{item.n} of {item.wanted}" if item.n < item.wanted else str(item.n)
            symbol, unit, size = symbol_of(name)
            shown = (digits(None if one is None else one / size) for one in (item.value, item.std))
            rows.append([symbol, *shown, unit, repeats])
    if rows:
        yield Table("ISO 9283, the worst place", ["figure", "value", "+-", "unit", "repeats"], rows)
    why: dict[str, list[str]] = {}
    for name, item in given.items():
        if item.withheld is not None:
            why.setdefault(item.withheld, []).append(name)
    yield from (f"  withheld: {', '.join(names)}: {text}" for text, names in why.items())
