"""path smooth, resample, fillet, offset, angle, reverse, join, check, export and from-picks."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PointStd


class PathChangeOutput(Output):
    """armsight path resample, fillet, offset, angle, reverse and join."""

    file: str = Field(description="The path.csv written.")
    n_before: int = Field(description="Rows read, of all paths.")
    n: int = Field(description="Rows written.")
    length_m: float = Field(description="Length of the path written, m.")
    corners: list[int] = Field(description="Its corners, rows from 0.")


class PathOutlierOutput(Output):
    """A row that does not belong to the path."""

    row: int = Field(description="The row of the path read, from 0.")
    off_m: float = Field(description="How far it is from where its neighbours say, m.")
    off_rad: float = Field(description="How far it is turned from what they say, rad.")
    text: str = Field(description="The same in words.")


class PathSmoothOutput(PathChangeOutput):
    """armsight path smooth."""

    outliers: list[PathOutlierOutput] = Field(description="Rows that do not belong to the path.")
    dropped: bool = Field(description="Whether they were left out.")
    moved_max_m: float = Field(description="How far the row moved that moved most, m.")
    moved_rms_m: float = Field(description="Root mean square of how far rows moved, m.")
    turned_max_rad: float = Field(description="How far the row turned that turned most, rad.")


class PathIssueOutput(Output):
    """Trouble at a row of a path, or on the way to it."""

    row: int = Field(description="The row, from 0.")
    trouble: str = Field(
        description="unreached, limits, jump, speed, turn, joint_speed, singular, branch, workspace or forbidden."
    )
    value: float | None = Field(description="How much there, rad, m, or per s; of a singularity its distance.")
    limit: float | None = Field(description="What is allowed, in the same unit.")
    text: str = Field(description="The same in words.")


class PathCheckOutput(Output):
    """armsight path check."""

    arm: str = Field(description="The arm's name.")
    ok: bool = Field(description="Whether the arm can run the whole path; the exit code is 3 where it cannot.")
    n: int = Field(description="Rows of the path.")
    n_reached: int = Field(description="Rows from the start that are reached.")
    length_m: float = Field(description="Length of the path, m.")
    duration_s: float = Field(description="How long it takes at its speeds, s.")
    troubles: dict[str, int] = Field(description="How many issues there are of each kind.")
    issues: list[PathIssueOutput] = Field(description="All trouble, row by row.")
    start_q: list[float] | None = Field(description="Readings at the first row, rad or m; null where not reached.")


class PathExportOutput(Output):
    """armsight path export."""

    file: str = Field(description="The file written.")
    format: str = Field(description="urscript, krl, rapid, csv or python.")
    n: int = Field(description="Rows written, those of the approach among them.")
    length_m: float = Field(description="Length of the path with them, m.")
    checked: bool = Field(description="Whether the path was checked for an arm; it is not without --arm.")
    start_q: list[float] | None = Field(
        description="Readings to which the program goes first, rad; null where it goes there on a straight line."
    )


class PickedPointOutput(Output):
    """A point of the path and how it was found."""

    pick: int = Field(description="The pick that it is, or that it follows on its edge; row of picks.csv from 0.")
    px: tuple[float, float] = Field(description="Its place in the picked view, px.")
    other_px: tuple[float, float] = Field(description="Its place in the other view, px.")
    std_px: float = Field(description="Standard deviation of that place along the epipolar line, px.")
    correlation: float = Field(description="Normalised correlation of both patches.")
    second: float = Field(description="That of the best other place on the line; 0 for none.")
    xyz_m: tuple[float, float, float] = Field(description="The point in the path's frame, m.")
    std: PointStd = Field(description="Its standard deviations, of pick and match; not of the rig or its place.")


class RefusedPickOutput(Output):
    """A place that was not found in the other view."""

    pick: int = Field(description="The pick, or the one before it on its edge; row of picks.csv from 0.")
    u_px: float = Field(description="Its place in the picked view, px.")
    v_px: float = Field(description="Its place in the picked view, px.")
    kind: str = Field(description="The class of the refusal, one of `armsight.errors`.")
    why: str = Field(description="Why it was not found, in words.")


class PathPicksOutput(Output):
    """armsight path from-picks."""

    file: str = Field(description="The path.csv written.")
    frame: str = Field(description="The frame of the path: rig, or world or base with --world.")
    n: int = Field(description="Rows written.")
    n_picks: int = Field(description="Picks read.")
    length_m: float = Field(description="Length of the path, m.")
    points: list[PickedPointOutput] = Field(description="The points of the path.")
    refused: list[RefusedPickOutput] = Field(description="Places left out with --skip.")
