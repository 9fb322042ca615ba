"""A path.csv read, changed by one tool, and written."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.control.paths import (
    corners,
    filleted,
    joined,
    moved_by,
    offset_along_tool,
    outliers,
    resampled,
    reversed_path,
    smoothed,
    tilted,
    without_rows,
)
from armsight.control.paths.outliers import LEAST_ROWS, PathOutlier
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.store.path_file import read_path, write_path

OUTLIERS = ("refuse", "drop", "keep")


@output
class PathChangeOutput(Output):
    """armsight path resample, fillet, offset, angle, reverse and join."""

    file: Annotated[str, Doc("The path.csv written.")]
    n_before: Annotated[int, Doc("Rows read, of all paths.")]
    n: Annotated[int, Doc("Rows written.")]
    length_m: Annotated[float, Doc("Length of the path written, m.")]
    corners: Annotated[list[int], Doc("Its corners, rows from 0.")]


@output
class PathSmoothOutput(PathChangeOutput):
    """armsight path smooth."""

    outliers: Annotated[list[PathOutlier], Doc("Rows that do not belong to the path.")]
    dropped: Annotated[bool, Doc("Whether they were left out.")]
    moved_max_m: Annotated[float, Doc("How far the row moved that moved most, m.")]
    moved_rms_m: Annotated[float, Doc("Root mean square of how far rows moved, m.")]
    turned_max_rad: Annotated[float, Doc("How far the row turned that turned most, rad.")]


def smooth(
    source: Path, out: Path, *, bound_m: float, bound_rad: float, on_outliers: str = "refuse"
) -> PathSmoothOutput:
    """Write the path smoothed; on_outliers: what becomes of rows that do not belong to it.

    Raises Inconsistent with the rows where there are some and on_outliers is refuse, UsageError, BadFile.
    """
    path = read_path(source)
    made, kept, found = smooth_path(
        path, bound_m=bound_m, bound_rad=bound_rad, on_outliers=on_outliers, where=str(source)
    )
    way, turn = moved_by(kept, made)
    return PathSmoothOutput(
        **_written(made, out, len(path)).to_dict(),
        outliers=list(found),
        dropped=kept is not path,
        moved_max_m=float(way.max()),
        moved_rms_m=float(np.sqrt(np.mean(way**2))),
        turned_max_rad=float(turn.max()),
    )


def smooth_path(
    path: TaughtPath, *, bound_m: float, bound_rad: float, on_outliers: str, where: str
) -> tuple[TaughtPath, TaughtPath, Sequence[PathOutlier]]:
    """Return the path smoothed, that without the rows that were dropped, and the outliers; where: names it in errors.

    Raises as smooth.
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
    return smoothed(kept, bound_m=bound_m, bound_rad=bound_rad), kept, found


def resample(source: Path, out: Path, *, step_m: float, spline: bool = False) -> PathChangeOutput:
    """Write the path with rows at most step_m apart; see control.paths.resampled."""
    path = read_path(source)
    return _written(resampled(path, step_m, spline=spline), out, len(path))


def fillet(source: Path, out: Path, *, radius_m: float) -> PathChangeOutput:
    """Write the path with its corners rounded to arcs of radius_m; see control.paths.filleted."""
    path = read_path(source)
    return _written(filleted(path, radius_m), out, len(path))


def offset(source: Path, out: Path, *, by_m: float) -> PathChangeOutput:
    """Write the path moved along the tool by by_m; see control.paths.offset_along_tool."""
    path = read_path(source)
    return _written(offset_along_tool(path, by_m), out, len(path))


def angle(source: Path, out: Path, *, travel_rad: float, work_rad: float) -> PathChangeOutput:
    """Write the path with the tool tilted about its tip; see control.paths.tilted."""
    path = read_path(source)
    return _written(tilted(path, travel_rad=travel_rad, work_rad=work_rad), out, len(path))


def reverse(source: Path, out: Path) -> PathChangeOutput:
    """Write the path from its end to its start; see control.paths.reversed_path."""
    path = read_path(source)
    return _written(reversed_path(path), out, len(path))


def join(sources: Sequence[Path], out: Path, *, gap_m: float, gap_rad: float) -> PathChangeOutput:
    """Write the paths one after the other; see control.paths.joined. Raises UsageError for fewer than two."""
    if len(sources) < 2:
        raise UsageError("one path alone is not joined", cure="Give two paths or more, in their order")
    paths = [read_path(source) for source in sources]
    made = reduce(lambda one, other: joined(one, other, gap_m=gap_m, gap_rad=gap_rad), paths)
    return _written(made, out, sum(len(path) for path in paths))


def _written(path: TaughtPath, out: Path, n_before: int) -> PathChangeOutput:
    found = corners(path) if len(path) > 1 and (np.diff(path.length_m) > 0.0).all() else ()
    write_path(out, path)
    return PathChangeOutput(
        file=str(out), n_before=n_before, n=len(path), length_m=float(path.length_m[-1]), corners=list(found)
    )
