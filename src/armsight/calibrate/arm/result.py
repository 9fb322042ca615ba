"""What the calibration of a known arm comes to, and where a rig stands to one."""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.fit import ArmFit, LimitReached, Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import Couplings
from armsight.calibrate.arm.other_arm import OtherArm
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.arm.propose import in_view, propose
from armsight.calibrate.correlation import Correlation
from armsight.columns import POSE6
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.geometry import euler_rad
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.records import NamedCovariance, checked_array, require_count, require_kind, require_rigid
from armsight.records.output import Output, Row, TitledOutput, figure, output, pose_rows
from armsight.records.result_parts import MANY_REJECTED, MEANING, PoseStd, RejectedRow, Verdict
from armsight.shown import REJECTED_SHOWN, Bars, Shown, Table, digits, parameter_row, point_rows, rotation_rows
from armsight.units import MM


@output
class Errors(Output):
    """Errors at the tool's point."""

    mean_m: Annotated[float, Doc("Mean, m.")]
    rms_m: Annotated[float, Doc("Root mean square, m.")]
    max_m: Annotated[float, Doc("Largest, m.")]

    @classmethod
    def of(cls, size_m: Array) -> Errors:
        """Return the figures of errors (m,)."""
        return cls(mean_m=float(size_m.mean()), rms_m=float(np.sqrt(np.mean(size_m**2))), max_m=float(size_m.max()))


@output
class BeforeAfter(Output):
    """Errors with the nominal arm and with the one kept."""

    before: Annotated[Errors, Doc("With the nominal geometry, base and tool fitted.")]
    after: Annotated[Errors, Doc("With the geometry kept, base and tool fitted.")]


class FixedParameter(NamedTuple):
    """A parameter that is as in the nominal arm."""

    name: Annotated[str, Doc("Its name.")]
    why: Annotated[str, Doc("Why it was not freed.")]


class Outlier(NamedTuple):
    """A row that does not fit."""

    row: Annotated[int, Doc("The row of points.csv, from 1.")]
    error_m: Annotated[float, Doc("Its error, m.")]


@output
class TouchedFeature(Output):
    """What the tip rested on, as the touches have it, in base axes."""

    name: Annotated[str, Doc("Its name.")]
    kind: Annotated[str, Doc("point, plane, sphere or gauge.")]
    n: Annotated[int, Doc("Touches of it, those in one posture counted once.")]
    rms_m: Annotated[float, Doc("By what they miss it, RMS, m.")]
    place_m: Annotated[list[float], Doc("Point or centre, m; of a plane or gauge a point on it.")]
    normal: Annotated[list[float] | None, Doc("Direction of a plane or gauge; null of others.")]
    radius_m: Annotated[float | None, Doc("Radius of a sphere, m; null of others.")]


@output
class ArmNoise(Output):
    """Noise of the measurements."""

    place_m: Annotated[float, Doc("Standard deviation of one coordinate of a place, m.")]
    rotation_rad: Annotated[float | None, Doc("Of an orientation about one axis, rad; null without orientations.")]


@output
class ArmResult(TitledOutput):
    """armsight calibrate arm.

    arm: corrected where a gain is proved, else nominal; base and tool fitted in both. points: the measurements.
    tolerance: what the nominal arm was believed to. cross_before, cross_after: errors on rows
    left out by cross-validation, in which all that looked at the rows, the kind of model included, is done again
    without them; left_before, left_after: on the holdout where one was given (held), else the same. model, fitted:
    names and values of the parameters (changes to the nominal arm), noise. outlier_rows: (row from 0, error in m).
    before_m, error_m: (m,) before and after, by row. position_noise_m: of one coordinate of the middle row.
    n_places: that the rows are readings of. doubt: what of it errors of the held geometry would do too. correlation:
    of the errors in time, of samples of a stream; folds are blocks of time then, and covariance is widened for it.
    """

    arm: Arm
    points: ArmPoints
    tolerance: Tolerance
    model: ArmModel
    fitted: ArmFit
    gain: Annotated[bool, Doc("Whether left-out errors fall beyond their own uncertainty.")]
    level: Annotated[str, Doc("Which kind of model was taken.", key="model")]
    before: Annotated[Errors, Doc("Errors on the rows used, nominal geometry, base and tool fitted.")]
    after: Annotated[Errors, Doc("Errors on the rows used, geometry kept, base and tool fitted.")]
    cross_before: Errors
    cross_after: Errors
    left_before: Errors
    left_after: Errors
    held: bool
    free: Annotated[tuple[str, ...], Doc("Parameters that were corrected.")]
    fixed: Annotated[tuple[FixedParameter, ...], Doc("Parameters that were not.")]
    condition: Annotated[float, Doc("Condition number of the freed parameters' information, scaled.")]
    covariance: NamedCovariance | None
    outlier_rows: tuple[tuple[int, float], ...]
    couplings: Annotated[Couplings, Doc("Readings that are coupled to other joints'.")]
    still: Annotated[tuple[str, ...], Doc("Joints that did not move.")]
    at_limit: Annotated[tuple[LimitReached, ...], Doc("Corrections that stand at the limit of their tolerance.")]
    notes: Annotated[tuple[str, ...], Doc("What to know about the result.")]
    verdict: Annotated[str, Doc("Whether the correction is worth it, in words.")]
    error_m: Array
    before_m: Array
    position_noise_m: float
    other_arm: Annotated[
        OtherArm | None,
        Doc("Where the nominal arm is another one than was measured: why; nothing is corrected then. Else null."),
    ]
    correlation: Correlation | None = None
    doubt: str = ""
    n_places: int | None = None
    proposals: Annotated[
        list[list[float]] | None, Doc("Further joint readings to measure at, rad or m; with --propose.")
    ] = None
    expected_std: Annotated[dict[str, float] | None, Doc("Standard deviations to expect with those measured too.")] = (
        None
    )
    urdf: Annotated[str | None, Doc("The URDF written; null where no rigid arm is near.")]
    features: Annotated[tuple[TouchedFeature, ...] | None, Doc("What was touched; with --touch.")] = None

    @property
    def nominal(self) -> Arm:
        """The arm that was given."""
        return self.model.arm

    @figure("Rows given.")
    def n(self) -> int:
        return len(self.error_m)

    @figure("Independent rows that they are worth; of samples of a stream and of repeated readings.", optional=True)
    def n_effective(self) -> float | None:
        if self.correlation is not None:
            return self.correlation.n_effective
        return None if self.n_places is None or self.n_places == self.n else float(self.n_places)

    @figure("After which a drift of the errors is forgotten, s; of a stream only.", optional=True)
    def correlation_time_s(self) -> float | None:
        return None if self.correlation is None or self.correlation.counted else self.correlation.time_s

    @figure("Errors on rows left out by nested cross-validation, refitted fully.")
    def crossval(self) -> BeforeAfter:
        return BeforeAfter(before=self.cross_before, after=self.cross_after)

    @figure("Errors on the rows of --holdout.", optional=True)
    def holdout(self) -> BeforeAfter | None:
        return BeforeAfter(before=self.left_before, after=self.left_after) if self.held else None

    @figure("Standard deviations of corrections, base and tool, unit in the name.", key="std")
    def deviations(self) -> dict[str, float]:
        return self.std()

    @figure("Changes to the nominal arm, unit in the name; sag in rad per m of lever.")
    def corrections(self) -> dict[str, float]:
        return {name: self.change(name) for name in self.free}

    @figure("Rows that do not fit.")
    def outliers(self) -> tuple[Outlier, ...]:
        return tuple(Outlier(row + 1, error_m) for row, error_m in self.outlier_rows)

    @figure("Noise of the measurements.")
    def noise(self) -> ArmNoise:
        turned = self.fitted.sigma_rad if self.model.turned else None
        return ArmNoise(place_m=self.position_noise_m, rotation_rad=turned)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        level, headline = "care", "No gain"
        todo = "Go on with the nominal arm. For a gain, measure more joint positions, spread over all the arm's range."
        if self.other_arm is not None:
            level, headline = "bad", "Another arm"
            todo = "Correct nothing. Compare the arm's file with the arm's data sheet, then calibrate again."
        elif self.gain and self.doubt:
            headline = "Better, and not for sure its joints"
            todo = "Do what the verdict says of the geometry that is held, then calibrate again."
        elif self.gain and self.at_limit:
            headline = "Better"
            todo = "Before you use it, look whether what is corrected so far is typed right or really built so."
        elif self.gain:
            level, headline = "good", "Better"
            todo = "Use the corrected arm in place of the nominal one; then run `armsight verify` on new measurements."
        return Verdict(level=level, headline=headline, reasons=[self.verdict], next=[todo])

    def std(self) -> dict[str, float]:
        """Return the standard deviations of the freed parameters, base and tool."""
        return {} if self.covariance is None else self.covariance.std()

    def change(self, name: str) -> float:
        """Return the change of a parameter to the nominal arm. Raises UsageError for a name that it has not."""
        if name not in self.model.names:
            raise UsageError(f"the arm has no parameter {name!r}", cure=f"Use one of: {', '.join(self.model.names)}")
        return float(self.fitted.p[self.model.names.index(name)])

    def propose(self, n: int, *, rig: Rig | None = None, T_base_rig: RigidTransform | ArrayLike | None = None) -> Array:
        """Return joint readings (n, joints) to measure at next, those that tell most first.

        rig, T_base_rig: only what both cameras of a rig that stands there see. Raises NotEnoughData where nothing is
        seen.
        """
        require_count("n", n, least=1)
        if (rig is None) != (T_base_rig is None):
            raise UsageError("of rig and T_base_rig only one is given", cure="Give both, or neither")
        seen = None
        if rig is not None and T_base_rig is not None:
            require_kind("rig", rig, Rig)
            seen = in_view(rig, _as_pose("T_base_rig", T_base_rig))
        found = propose(self.model, self.fitted, self.points, n, tolerance=self.tolerance, visible=seen)
        return self.nominal.readings(found.q)

    def save(self, path: str | PathLike[str]) -> Any:
        """Write arm.yaml, or a URDF where the name ends in .urdf, and return its path."""
        return self.arm.save(path)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Arm {self.arm.name} calibrated from {self.n} measurements"

    def rows(self) -> list[Row]:
        """Return the errors before and after, and the verdict."""
        pairs = (("fitted rows", self.before, self.after), ("left-out rows", self.cross_before, self.cross_after))
        rows = [(name, f"{a.rms_m / MM:.3g} mm RMS before, {b.rms_m / MM:.3g} mm after") for name, a, b in pairs]
        return [*rows, ("freed", ", ".join(self.free) or "nothing"), ("verdict", self.verdict)]

    def bars(self) -> Bars:
        """Return each row's error after calibration, mm."""
        return Bars(self.title, [str(row) for row in range(self.n)], (self.error_m / MM).tolist(), "row", "error, mm")

    def summary(self) -> Iterator[Shown]:
        """Yield the errors, the corrections, what to know of them, and where to measure next."""
        named = [("rows used", self.before, self.after)]
        named += [("rows left out by cross-validation", self.crossval.before, self.crossval.after)]
        named += [("rows of the holdout", self.holdout.before, self.holdout.after)] if self.holdout is not None else []
        rows = [
            [name, *(digits(value / MM, 4) for part in (before, after) for value in (part.mean_m, part.max_m))]
            for name, before, after in named
        ]
        yield Table("Error at the tool's point, mm", ["", "before: mean", "max", "after: mean", "max"], rows)
        if self.free:
            freed = [parameter_row(name, self.corrections[name], self.deviations[name]) for name in self.free]
            yield Table("Corrections", ["", "by", "+-"], freed)
        if self.features is not None:
            touched = [[one.name, one.kind, str(one.n), digits(one.rms_m / MM)] for one in self.features]
            yield Table("Touched", ["", "kind", "touches", "RMS, mm"], touched)
        yield self.verdict
        yield from (f"  {note}." for note in self.notes if note not in self.verdict)
        if self.still:
            yield "Did not move: " + ", ".join(self.still) + ". Nothing of them is corrected by these rows."
        for item in self.outliers[:REJECTED_SHOWN]:
            yield f"  row {item.row} misses by {digits(item.error_m / MM)} mm"
        for q in self.proposals or ():
            yield "  measure at " + ", ".join(f"{value:.4f}" for value in q)
        if self.expected_std is not None:
            expected = [parameter_row(name, value) for name, value in self.expected_std.items()]
            yield Table("Standard deviations to expect with those measured too", ["", "+-"], expected)


def _as_pose(name: str, T: RigidTransform | ArrayLike) -> RigidTransform:
    """Return a pose of its matrix (4, 4). Raises Inconsistent for what is no rigid transform."""
    matrix = checked_array(name, T.as_matrix() if isinstance(T, RigidTransform) else T, (4, 4))
    require_rigid(name, matrix[None])
    return RigidTransform.from_matrix(matrix)


@output
class RobotWorldResult(TitledOutput):
    """armsight calibrate robot-world.

    pose: T_base_rig; covariance: of it, dt, dw in base axes. residual_m (m,). rejected_rows: (row from 0, why).
    doubts: the notes by which it may be wrong beyond its deviations.
    """

    pose: Annotated[RigidTransform, Doc("Where the rig stands, in base axes.", key="T_base_rig")]
    covariance: NamedCovariance
    residual_m: Array
    rejected_rows: tuple[tuple[int, str], ...]
    notes: Annotated[tuple[str, ...], Doc("What to know about the result.")]
    doubts: tuple[str, ...] = ()

    @property
    def T_base_rig(self) -> Array:
        """Pose of the rig in the base (4, 4)."""
        return np.asarray(self.pose.as_matrix())

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."""
        return self.covariance.std()

    @figure("Standard deviations of T_base_rig.", key="std")
    def std_pose(self) -> PoseStd:
        return PoseStd(**self.std)

    @figure("Residual of a point, RMS, m.")
    def residual_rms_m(self) -> float:
        used = np.delete(self.residual_m, [row for row, _ in self.rejected_rows])
        return float(np.sqrt(np.mean(used**2)))

    @figure("Rows that the result rests on.")
    def n_used(self) -> int:
        return len(self.residual_m) - len(self.rejected_rows)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        position_mm = 1.96 * max(self.std_pose.translation_m) / MM
        said = f"Where the rig stands is known to {position_mm:.2g} mm (95 %) from {self.n_used} points"
        level, headline, todo = "good", "Good", "Use it; calibrate again when the rig or the arm's base has moved."
        if self.doubts:
            level, headline, todo = "care", "Scale in doubt", f"{self.doubts[0]}."
        elif len(self.rejected_rows) > MANY_REJECTED * len(self.residual_m):
            level, headline = "care", "Usable, with rows left out"
            said += f", which {len(self.rejected_rows)} others contradict"
            todo = "Look at the rows left out: readings of other moments, or a beacon that slipped."
        return Verdict(level=level, headline=headline, reasons=[f"{said}."], next=[todo])

    @figure("Rows left out.")
    def rejected(self) -> tuple[RejectedRow, ...]:
        return tuple(RejectedRow(row=row + 1, why=why) for row, why in self.rejected_rows)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"T_base_rig from {self.n_used} points"

    def rows(self) -> list[Row]:
        """Return the pose with standard deviations, and the residual."""
        values = [*self.pose.translation.tolist(), *euler_rad(self.pose.rotation).tolist()]
        rows = pose_rows(dict(zip(POSE6, values, strict=True)), self.std)
        return [*rows, ("residual", f"{self.residual_rms_m / MM:.3g} mm RMS")]

    def bars(self) -> Bars:
        """Return each point's residual, mm."""
        rows = [str(row) for row in range(len(self.residual_m))]
        return Bars(self.title, rows, (np.abs(self.residual_m) / MM).tolist(), "row", "error, mm")

    def summary(self) -> Iterator[Shown]:
        """Yield the rig's pose, what it rests on, the rows left out, and what to know of it."""
        T, std = self.pose, self.std_pose
        places = [[f"{axis}, mm", *rest] for axis, *rest in point_rows(T.translation.tolist(), std.translation_m)]
        turns = rotation_rows(T.rotation.as_rotvec().tolist(), std.rotation_rad)
        yield Table("T_base_rig", ["", "value", "+-"], [*places, *turns])
        yield f"{self.n_used} points, residual {digits(self.residual_rms_m / MM)} mm RMS."
        yield from (f"  left out: row {item.row}: {item.why}" for item in self.rejected[:REJECTED_SHOWN])
        yield from (f"- {note}" for note in self.notes)
