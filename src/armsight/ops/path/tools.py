"""What a tool made of taught paths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.control.paths import corners, moved_by, outliers, smoothed, without_rows
from armsight.control.paths.outliers import LEAST_ROWS, PathOutlier
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.records import TaughtPath
from armsight.records.output import Output, extended, output
from armsight.shown import Shown
from armsight.store.path_file import write_path
from armsight.units import MM

OUTLIERS = ("refuse", "drop", "keep")


@output
class PathChangeOutput(Output):
    """armsight path resample, fillet, offset, angle, reverse and join."""

    file: Annotated[str, Doc("The path.csv written.")]
    n_before: Annotated[int, Doc("Rows read, of all paths.")]
    n: Annotated[int, Doc("Rows written.")]
    length_m: Annotated[float, Doc("Length of the path written, m.")]
    corners: Annotated[list[int], Doc("Its corners, rows from 0.")]
    taught: TaughtPath

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield f"{self.n} rows (of {self.n_before}), {self.length_m:.4f} m: {self.file}"

    def write(self, path: Path) -> None:
        """Write path.csv."""
        write_path(path, self.taught)


@output
class PathSmoothOutput(PathChangeOutput):
    """armsight path smooth."""

    outliers: Annotated[list[PathOutlier], Doc("Rows that do not belong to the path.")]
    dropped: Annotated[bool, Doc("Whether they were left out.")]
    moved_max_m: Annotated[float, Doc("How far the row moved that moved most, m.")]
    moved_rms_m: Annotated[float, Doc("Root mean square of how far rows moved, m.")]
    turned_max_rad: Annotated[float, Doc("How far the row turned that turned most, rad.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        for outlier in self.outliers:
            yield f"  {outlier.text}{'; left out' if self.dropped else ''}"
        yield f"moved by {self.moved_rms_m / MM:.3g} mm RMS, {self.moved_max_m / MM:.3g} mm at most"
        yield from PathChangeOutput.summary(self)


def changed(before: Sequence[TaughtPath], made: TaughtPath, out: Path | None) -> PathChangeOutput:
    """Return what a tool made of paths."""
    found = corners(made) if len(made) > 1 and (np.diff(made.length_m) > 0.0).all() else ()
    return PathChangeOutput(
        file=str(out),
        n_before=sum(map(len, before)),
        n=len(made),
        length_m=float(made.length_m[-1]),
        corners=list(found),
        taught=made,
    )


def smooth_path(
    path: TaughtPath, bound_m: float, bound_rad: float, on_outliers: str, *, where: str, out: Path | None
) -> PathSmoothOutput:
    """Return the path smoothed; on_outliers: what becomes of rows that do not belong to it; where: names it in errors.

    Raises Inconsistent with the rows where there are some and on_outliers is refuse, UsageError.
    """
    if on_outliers not in OUTLIERS:
        raise UsageError(f"{on_outliers!r} is nothing to do with outliers", cure=f"Use {', '.join(OUTLIERS)}")
    found = outliers(path) if len(path) >= LEAST_ROWS else ()
    if found and on_outliers == "refuse":
        more = f" and {len(found) - 3} more" if len(found) > 3 else ""
        raise Inconsistent(
            f"{where}: {'; '.join(outlier.text for outlier in found[:3])}{more}",
            consequence="The path is not smoothed",
            cure="Look at these rows; then leave them out with --outliers drop, or smooth over them with keep",
        )
    dropped = bool(found) and on_outliers == "drop"
    kept = without_rows(path, [outlier.row for outlier in found]) if dropped else path
    made = smoothed(kept, bound_m=bound_m, bound_rad=bound_rad)
    way, turn = moved_by(kept, made)
    return extended(
        changed([path], made, out),
        PathSmoothOutput,
        outliers=list(found),
        dropped=dropped,
        moved_max_m=float(way.max()),
        moved_rms_m=float(np.sqrt(np.mean(way**2))),
        turned_max_rad=float(turn.max()),
    )
