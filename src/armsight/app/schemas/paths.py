"""path smooth, resample, fillet, offset, angle, reverse, join, check, export and from-picks."""

from __future__ import annotations

from typing import Annotated

from armsight.app.schemas.base import PointStd
from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class PathChangeOutput(Output):
    """armsight path resample, fillet, offset, angle, reverse and join."""

    file: Annotated[str, Doc("The path.csv written.")]
    n_before: Annotated[int, Doc("Rows read, of all paths.")]
    n: Annotated[int, Doc("Rows written.")]
    length_m: Annotated[float, Doc("Length of the path written, m.")]
    corners: Annotated[list[int], Doc("Its corners, rows from 0.")]


@output
class PathOutlierOutput(Output):
    """A row that does not belong to the path."""

    row: Annotated[int, Doc("The row of the path read, from 0.")]
    off_m: Annotated[float, Doc("How far it is from where its neighbours say, m.")]
    off_rad: Annotated[float, Doc("How far it is turned from what they say, rad.")]
    text: Annotated[str, Doc("The same in words.")]


@output
class PathSmoothOutput(PathChangeOutput):
    """armsight path smooth."""

    outliers: Annotated[list[PathOutlierOutput], Doc("Rows that do not belong to the path.")]
    dropped: Annotated[bool, Doc("Whether they were left out.")]
    moved_max_m: Annotated[float, Doc("How far the row moved that moved most, m.")]
    moved_rms_m: Annotated[float, Doc("Root mean square of how far rows moved, m.")]
    turned_max_rad: Annotated[float, Doc("How far the row turned that turned most, rad.")]


@output
class PathIssueOutput(Output):
    """Trouble at a row of a path, or on the way to it."""

    row: Annotated[int, Doc("The row, from 0.")]
    trouble: Annotated[
        str, Doc("unreached, limits, jump, speed, turn, joint_speed, singular, branch, workspace or forbidden.")
    ]
    value: Annotated[float | None, Doc("How much there, rad, m, or per s; of a singularity its distance.")]
    limit: Annotated[float | None, Doc("What is allowed, in the same unit.")]
    text: Annotated[str, Doc("The same in words.")]


@output
class PathCheckOutput(Output):
    """armsight path check."""

    arm: Annotated[str, Doc("The arm's name.")]
    ok: Annotated[bool, Doc("Whether the arm can run the whole path; the exit code is 3 where it cannot.")]
    n: Annotated[int, Doc("Rows of the path.")]
    n_reached: Annotated[int, Doc("Rows from the start that are reached.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    duration_s: Annotated[float, Doc("How long it takes at its speeds, s.")]
    troubles: Annotated[dict[str, int], Doc("How many issues there are of each kind.")]
    issues: Annotated[list[PathIssueOutput], Doc("All trouble, row by row.")]
    start_q: Annotated[list[float] | None, Doc("Readings at the first row, rad or m; null where not reached.")]


@output
class PathExportOutput(Output):
    """armsight path export."""

    file: Annotated[str, Doc("The file written.")]
    format: Annotated[str, Doc("urscript, krl, rapid, csv or python.")]
    n: Annotated[int, Doc("Rows written, those of the approach among them.")]
    length_m: Annotated[float, Doc("Length of the path with them, m.")]
    checked: Annotated[bool, Doc("Whether the path was checked for an arm; it is not without --arm.")]
    start_q: Annotated[
        list[float] | None,
        Doc("Readings to which the program goes first, rad; null where it goes there on a straight line."),
    ]


@output
class PickedPointOutput(Output):
    """A point of the path and how it was found."""

    pick: Annotated[int, Doc("The pick that it is, or that it follows on its edge; row of picks.csv from 0.")]
    px: Annotated[tuple[float, float], Doc("Its place in the picked view, px.")]
    other_px: Annotated[tuple[float, float], Doc("Its place in the other view, px.")]
    std_px: Annotated[float, Doc("Standard deviation of that place along the epipolar line, px.")]
    correlation: Annotated[float, Doc("Normalised correlation of both patches.")]
    second: Annotated[float, Doc("That of the best other place on the line; 0 for none.")]
    xyz_m: Annotated[tuple[float, float, float], Doc("The point in the path's frame, m.")]
    std: Annotated[PointStd, Doc("Its standard deviations, of pick and match; not of the rig or its place.")]


@output
class RefusedPickOutput(Output):
    """A place that was not found in the other view."""

    pick: Annotated[int, Doc("The pick, or the one before it on its edge; row of picks.csv from 0.")]
    u_px: Annotated[float, Doc("Its place in the picked view, px.")]
    v_px: Annotated[float, Doc("Its place in the picked view, px.")]
    kind: Annotated[str, Doc("The class of the refusal, one of `armsight.errors`.")]
    why: Annotated[str, Doc("Why it was not found, in words.")]


@output
class PathPicksOutput(Output):
    """armsight path from-picks."""

    file: Annotated[str, Doc("The path.csv written.")]
    frame: Annotated[str, Doc("The frame of the path: rig, or world or base with --world.")]
    n: Annotated[int, Doc("Rows written.")]
    n_picks: Annotated[int, Doc("Picks read.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    points: Annotated[list[PickedPointOutput], Doc("The points of the path.")]
    refused: Annotated[list[RefusedPickOutput], Doc("Places left out with --skip.")]
