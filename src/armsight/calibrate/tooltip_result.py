"""What the calibration of a tool's tip comes to: one tool that rests on one point, which may have been measured."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.correlation import Correlation
from armsight.calibrate.tooltip_rows import slopes
from armsight.columns import POSITION
from armsight.errors import Inconsistent
from armsight.fields import Doc
from armsight.fitting.quantiles import chi2_isf
from armsight.records import NamedCovariance, TargetPose
from armsight.records.checks import Shape, freeze
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
        freeze(self, tip_m=(3,), point_m=(3,), rotation_excitation_rms_rad=(3,), residuals_m=(None, 3))
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


FALSE_ALARM = 1e-6
"""Chance that a well measured point is told to be elsewhere."""
AGREED = 1e-6
"""Poses that agree to this (RMS; m, or rad) are of one tool, whatever their last digits say."""
FEWEST, SPLITS = 5, 60
"""Poses of a part; and how many places to part the rows at are tried at most."""
UNSEEN = 1e-12
"""A direction that gives less than this share of the best one's information stays as in the fit of all poses."""
MOST = 80
"""Rows, beyond which neighbours are judged by their means."""
PARTS = (slice(3), slice(3, 6), slice(6))
"""What may have moved: tip, point or both; camera, target or both."""
SURE = float(np.log(1000.0))
"""Logarithm of the odds from which on two settings are told: by Markov's inequality good rows whose errors drift as one
of the models have them once in 1,000 at most."""
SHARES, TIMES, LONGEST = (0.5, 0.85, 0.999), 4, 3.0
"""Drifts that are weighed against two settings: shares of the errors' variance, and over how many times, from the
spacing of the rows to so many lengths of the recording, which is a walk at random."""


def require_one_tool(R: Array, t: Array, rows: NDArray[np.intp], t_s: Array | None) -> None:
    """Raise Inconsistent where poses R (n, 3, 3), t (n, 3), in their order, fall into two parts with a tip each.

    rows (n,): numbers of the poses, from 0. t_s (n,): their times, where they are of one recording.
    """
    if (found := two_settings(R, t, rows.astype(np.float64) if t_s is None else t_s)) is None:
        return
    at, moved = found
    tip, point = (float(np.linalg.norm(v)) / MM for v in np.split(moved, 2))
    raise Inconsistent(
        f"from row {rows[at] + 1} on the poses want another tip than those before, by {tip:.3g} mm, and another "
        f"resting point, by {point:.3g} mm",
        consequence="The tool slipped or the point was moved in between, or two recordings were put together; no tip "
        "is given",
        cure=f"Calibrate the rows before row {rows[at] + 1} and those from it on apart, or record again with tool and "
        "point clamped",
    )


def two_settings(R: Array, t: Array, t_s: Array) -> tuple[int, Array] | None:
    """Return the first of poses R (n, 3, 3), t (n, 3) that have another tip or point than those before it.

    With what these moved by (6,), in the unit of t. None where one tip and point may serve all. t_s (n,): times of the
    poses, rising, in any unit. Bayes's factor over what may have moved (as far as one row tells it, Zellner 1986) and
    where, and over errors that are white or drift, in the axes that are fixed or in those that turn.
    """
    begin = np.unique(np.linspace(0, len(R), min(len(R), MOST) + 1)[:-1].astype(int))
    if len(begin) < 2 * FEWEST:
        return None
    J = slopes(R)
    r = J @ np.linalg.lstsq(J.reshape(-1, 6), -t.reshape(-1), rcond=None)[0] + t
    if (r**2).mean() < AGREED**2:
        return None
    count, rows = np.diff(begin, append=len(R))[:, None], np.concatenate([J, r[:, :, None]], axis=2)
    fixed, turning = (np.add.reduceat(a.reshape(-1, 21), begin) / count for a in (rows, R.mT @ rows))
    n, fixed, turning = len(fixed), fixed.reshape(-1, 3, 7), turning.reshape(-1, 3, 7)
    k = np.unique(np.linspace(FEWEST, n - FEWEST, SPLITS).astype(int))
    sums = (fixed.mT @ fixed).cumsum(axis=0)
    white = _odds(sums[-1], sums[-1] - sums[k - 1], sums[-1] - sums[k - 1], n)
    if _log_odds([white]) < SURE:  # drifts could but explain it
        return None
    t_s = np.add.reduceat(t_s, begin) / count[:, 0]
    gap, found = np.abs(t_s[:, None] - t_s), [white]
    for time_s, share in product(np.geomspace(gap.max() / n, LONGEST * gap.max(), TIMES), SHARES):
        V = share * np.exp(-gap / time_s) + (1.0 - share) * np.eye(n)
        P, logdet = np.linalg.inv(V), float(np.linalg.slogdet(V)[1])
        for all_ in (fixed.transpose(1, 0, 2), turning.transpose(1, 0, 2)):  # (3, n, 7)
            late = all_ * (np.arange(n) >= k[:, None])[:, None, :, None]  # (K, 3, n, 7)
            cross, both = late.mT @ (P @ all_), late.mT @ (P @ late)
            found.append(_odds((all_.mT @ (P @ all_)).sum(axis=0), cross.sum(axis=1), both.sum(axis=1), n, logdet))
    if _log_odds(found) < SURE:
        return None
    best = int(np.logaddexp.reduce([two for _, two, _ in found], axis=(0, 1)).argmax())
    return int(begin[k[best]]), white[2][best]


def _log_odds(found: list[tuple[float, Array, Array]]) -> float:
    """Return the logarithm of the odds of two settings over one, drifts and places to part at being alike before."""
    one, two = np.array([each[0] for each in found]), np.array([each[1] for each in found])
    return float(np.logaddexp.reduce(two, axis=None) - np.log(two[0].size) - np.logaddexp.reduce(one))


def _odds(N: Array, cross: Array, both: Array, n: int, logdet: float = 0.0) -> tuple[float, Array, Array]:
    """Return log likelihoods of one setting, and that PARTS moved at each of K rows (PARTS, K); and the moves (K, 6).

    N (7, 7): normal matrix of the slopes and residuals of n rows, cross (K, 7, 7): of the later ones with all, both
    (K, 7, 7): with each other; logdet: of the errors' correlation.
    """
    least, free = UNSEEN * float(np.trace(N[:6, :6])), 3 * n - 6
    H = N[:6, :6] + least * np.eye(6)
    x = -np.linalg.solve(H, N[:6, 6])
    left = max(float(N[6, 6] + N[6, :6] @ x), 1e-300)
    one = -0.5 * float(3.0 * logdet + np.linalg.slogdet(H)[1] + free * np.log(left))
    information = both[:, :6, :6] - cross[:, :6, :6] @ np.linalg.solve(H, cross[:, :6, :6].mT) + least * np.eye(6)
    pull = -(cross[:, :6, 6:] + cross[:, :6, :6] @ x[:, None])
    two = np.empty((len(PARTS), len(cross)))
    for i, part in enumerate(PARTS):
        move = np.linalg.solve(information[:, part, part], pull[:, part])
        gain = np.minimum((move * pull[:, part]).sum(axis=(1, 2)) / left, 1.0 - 1e-12) * n / (n + 1.0)
        two[i] = one - 0.5 * (move.shape[1] * np.log(n + 1.0) + free * np.log1p(-gain))
    return one, np.asarray(two), np.asarray(move[:, :, 0])


def require_point_there(free: ToolTipResult, xyz_m: Array, sigma_m: float) -> None:
    """Raise Inconsistent where the point, measured at xyz_m (3,) to sigma_m, is not where the poses alone find it."""
    C = free.covariance.matrix[3:, 3:] + sigma_m**2 * np.eye(3)
    off = xyz_m - free.point_m
    if float(off @ np.linalg.solve(C, off)) <= float(chi2_isf(FALSE_ALARM, 3)):
        return
    found = ",".join(f"{v:.5f}" for v in free.point_m)
    raise Inconsistent(
        f"the point was measured {np.linalg.norm(off) / MM:.3g} mm from where the tip rests, at {found} m by the poses",
        consequence="The tip would be drawn aside by it; none is given",
        cure="Leave the point out, the tip does not need it; or measure it in the frame of the poses, and say how well "
        "with --point-sigma",
    )
