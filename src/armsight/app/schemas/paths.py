"""path smooth, resample, fillet, offset, angle, reverse, join, check, export and from-picks."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


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
