"""What the calibration of a tool's tip comes to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.correlation import Correlation
from armsight.columns import POSITION
from armsight.fields import Doc
from armsight.records import NamedCovariance, TargetPose, frozen_array
from armsight.records.checks import Shape
from armsight.records.output import Row, TitledOutput, figure, output, with_std
from armsight.records.result_parts import MANY_REJECTED, MEANING, PointStd, RejectedRow, Verdict
from armsight.shown import Bars, Shown, Table, digits, point_rows
from armsight.units import DEG, MM

Vector = Annotated[Array, Shape((3,))]

TURNED_RAD = 20.0 * DEG
"""Turn of the tool about its second axis, RMS, from which nothing is asked for any more."""


@output
class ToolTipResult(TitledOutput):
    """armsight calibrate tooltip.

    tip_m, point_m: (3,); covariance of both by name, widened so that +- 1.96 std holds 95 %. residuals_m (n, 3):
    R tip + t - point of all poses; left_out_m (n, 3): the same by the other poses (by those further away in time, where
    they are of one recording), NaN where these do not tell. used (n,). rejected_rows: (row from 0, why). correlation:
    of the errors in time, where times were given. n_places: of the tool, at which the used poses were read, where not.
    """

    tip_m: Annotated[Vector, Doc("The tool's tip in the axes of the turned frame, target or flange, m.")]
    point_m: Annotated[Vector, Doc("The point on which it rested, in the poses' parent frame, m.")]
    covariance: NamedCovariance
    residuals_m: Array
    left_out_m: Array
    used: NDArray[np.bool_]
    rejected_rows: tuple[tuple[int, str], ...]
    rotation_excitation_rms_rad: Annotated[
        Vector, Doc("Turns of the tool about its principal axes, falling, RMS, rad.", key="turning_rms_rad")
    ]
    mean_tip_m: Annotated[Vector | None, Doc("The mean of Pachidis eq. (13), m; where the point was measured.")] = None
    correlation: Correlation | None = None
    n_places: int | None = None
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("tip_m", "point_m", "rotation_excitation_rms_rad"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (3,)))
        object.__setattr__(self, "residuals_m", frozen_array("residuals_m", self.residuals_m, (None, 3)))
        self.left_out_m.setflags(write=False)

    @figure("Standard deviations of the tip.", key="std")
    def std_tip(self) -> PointStd:
        return PointStd(**self.std)

    @figure("Distance of the tip from the point, RMS over the used poses, m.")
    def residual_rms_m(self) -> float:
        return float(np.sqrt((self.residuals_m[self.used] ** 2).sum(axis=1).mean()))

    @figure("The same by the tip of the other poses, RMS, m; with times: of those further away in time.", optional=True)
    def loo_rms_m(self) -> float | None:
        squares = (self.left_out_m[self.used] ** 2).sum(axis=1)
        squares = squares[np.isfinite(squares)]
        return float(np.sqrt(squares.mean())) if len(squares) else None

    @figure("Poses that the result rests on.")
    def n_used(self) -> int:
        return int(self.used.sum())

    @figure("Independent poses that they are worth; of poses with times and of repeated readings.", optional=True)
    def n_effective(self) -> float | None:
        if self.correlation is not None:
            return self.correlation.n_effective
        return None if self.n_places is None or self.n_places == self.n_used else float(self.n_places)

    @figure("After which a drift of the errors is forgotten, s; with times only.", optional=True)
    def correlation_time_s(self) -> float | None:
        return None if self.correlation is None else self.correlation.time_s

    @figure("Poses left out.")
    def rejected(self) -> tuple[RejectedRow, ...]:
        return tuple(RejectedRow(row=row + 1, why=why) for row, why in self.rejected_rows)

    @figure("What to know of the result, and to do.")
    def notes(self) -> tuple[str, ...]:
        told = () if self.correlation is None else self.correlation.warnings(self.n_used)
        if self.n_places is not None and self.n_places < self.n_used:
            told = (
                f"The {self.n_used} poses are repeated readings at {self.n_places} places of the tool, which share the "
                f"errors of their place: they are worth {self.n_places} poses.",
            )
        return (*told, *self.remarks)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        std_mm = float(np.linalg.norm(self.std_tip.translation_m)) / MM
        said = f"The tip is known to {std_mm:.2g} mm (one standard deviation) from {self.n_used} poses"
        level, headline, todo = (
            "good",
            "Good",
            "Use it; calibrate again when the tool was changed or has hit something.",
        )
        if len(self.rejected_rows) > MANY_REJECTED * len(self.used):
            level, headline = "care", "Usable, with poses left out"
            todo = "Look at the poses left out: the tip may have left its point there."
        elif self.rotation_excitation_rms_rad[1] < TURNED_RAD:
            level, headline = "care", "Turned too little"
            said += f", which turn by {self.rotation_excitation_rms_rad[1] / DEG:.2g} degrees about the second axis"
            todo = f"Turn the tool by more than {TURNED_RAD / DEG:.0f} degrees to several sides, and calibrate again."
        return Verdict(level=level, headline=headline, reasons=[f"{said}."], next=[todo])

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the tip: x_m, y_m, z_m."""
        whole = self.covariance.std()
        return {name: whole[f"tip.{name}"] for name in POSITION}

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Tool tip from {self.n_used} of {len(self.used)} poses"

    def rows(self) -> list[Row]:
        """Return the tip's coordinates with standard deviations, and the residual."""
        named = zip(self.std.items(), self.tip_m.tolist(), strict=True)
        rows = [(name.removesuffix("_m"), with_std(value / MM, std / MM, "mm")) for (name, std), value in named]
        return [*rows, ("residual", f"{self.residual_rms_m / MM:.3g} mm RMS")]

    def summary(self) -> Iterator[Shown]:
        """Yield the tip, what it rests on, what to know of it, and the poses left out."""
        yield Table("Tip", ["", "mm", "+-"], point_rows(self.tip_m.tolist(), self.std.values()))
        effective = "" if self.n_effective is None else f", worth {self.n_effective:.0f} independent ones"
        left_out = "" if self.loo_rms_m is None else f", left out {digits(self.loo_rms_m / MM)} mm"
        yield f"{self.n_used} poses{effective}, residual {digits(self.residual_rms_m / MM)} mm RMS{left_out}."
        yield from self.notes
        yield from (f"  left out: row {item.row}: {item.why}" for item in self.rejected)

    def bars(self) -> Bars:
        """Return each pose's residual, mm."""
        values = np.linalg.norm(self.residuals_m, axis=1) / MM
        return Bars(self.title, [str(row) for row in range(len(values))], values.tolist(), "row", "error, mm")


@output
class PivotCalibration(ToolTipResult):
    """armsight calibrate pivot. taken: the poses that were taken, which go beside tip.yaml."""

    goal_m: Annotated[float, Doc("Standard deviation of the tip that was good enough, m.")]
    reached: Annotated[bool, Doc("Whether the tip is known so well.")]
    taken: tuple[TargetPose, ...] = ()

    def summary(self) -> Iterator[Shown]:
        """Yield what a tip's calibration shows, and whether the goal is reached."""
        yield from ToolTipResult.summary(self)  # slots make another class of it than super() knows
        yield "Good enough." if self.reached else "Not yet as good as wanted: pivot on, or lower the goal."
