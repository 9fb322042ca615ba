"""What the calibration of a known arm comes to."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm.fit import ArmFit, LimitReached
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import Couplings
from armsight.calibrate.arm.other_arm import OtherArm
from armsight.calibrate.correlation import Correlation
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records import NamedCovariance
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Verdict


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
class ArmNoise(Output):
    """Noise of the measurements."""

    place_m: Annotated[float, Doc("Standard deviation of one coordinate of a place, m.")]
    rotation_rad: Annotated[float | None, Doc("Of an orientation about one axis, rad; null without orientations.")]


@output
class ArmCalibration(Output):
    """The calibration of a known arm's geometry.

    arm: corrected where gain, else nominal; base and tool fitted in both. cross_before, cross_after: errors on rows
    left out by cross-validation, in which all that looked at the rows, the kind of model included, is done again
    without them; left_before, left_after: on the holdout where one was given (held), else the same. model, fitted:
    names and values of the parameters (changes to the nominal arm), noise. outlier_rows: (row from 0, error in m).
    before_m, error_m: (m,) before and after, by row. position_noise_m: of one coordinate of the middle row.
    n_places: that the rows are readings of. correlation: of the errors in time, of samples of a stream; folds are
    blocks of time then, and covariance is widened for it.
    """

    arm: Arm
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
    n_places: int | None = None

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
        """Return the change of a parameter to the nominal arm."""
        return float(self.fitted.p[self.model.names.index(name)])
