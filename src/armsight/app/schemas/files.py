"""record, convert, simulate."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, RejectedRow, absent


class RecordedSkew(Output):
    """Time between the frames of pairs, right minus left."""

    mean: float = Field(description="Mean, s.")
    largest: float = Field(description="Largest, s.")


class RecordOutput(Output):
    """armsight record."""

    file: str = Field(description="The recording.")
    format: str = Field(description="How frames are kept: png, raw or jpeg.")
    n_pairs: int = Field(description="Pairs recorded.")
    n_dropped: int = Field(description="Pairs that found no room: the disk or the processor is too slow.")
    n_missed: int = Field(description="Frames lost by the cameras or without a partner.")
    duration_s: float = Field(description="From the first pair to the last, s.")
    pairs_per_s: float | None = Field(description="Pairs a second.", json_schema_extra={"unit": "1/s"})
    size_bytes: int = Field(description="Size of the file, bytes.")
    skew_s: RecordedSkew | None = Field(description="Time between the frames of live pairs; null of other sources.")


class RepairOutput(Output):
    """armsight record --repair."""

    file: str = Field(description="The mended recording.")
    messages: dict[str, int] = Field(description="Messages saved by topic.")
    duration_s: float = Field(description="From the first message to the last, s.")
    lost_bytes: int = Field(description="Bytes that were not whole.")
    damaged_chunks: int = Field(description="Chunks whose checksum does not fit.")


class ExportOutput(Output):
    """armsight convert recording."""

    source: str = Field(alias="from", description="The recording.")
    out: str = Field(description="The folder or file written.")
    n: dict[str, int] = Field(description="Rows or frames by file.")


class ConvertOutput(Output):
    """armsight convert camera, convert rig, convert handeye, convert poses."""

    source: str = Field(alias="from", description="Kind of the file read: armsight, ros, opencv, kalibr; or of poses.")
    target: str = Field(alias="to", description="Kind of the files written.")
    files: list[str] = Field(description="The files written.")
    n: int | None = Field(description="Poses; null for cameras and rigs.")
    note: str = Field(description="What the new kind could not carry, or which zoom it is of; may be empty.")


class ConvertTableOutput(Output):
    """armsight convert table."""

    kind: str = Field(description="Which table it is: joints, poses, points, pairs, robot_poses or sweep.")
    how: str = Field(description="How the file was found to be written.")
    columns: list[str] = Field(description="The columns of ours that it came to.")
    ranges: dict[str, tuple[float, float] | None] = Field(
        description="Smallest and largest number of each column of numbers, in its unit; null where all of its "
        "cells are empty.",
    )
    n: int = Field(description="Rows.")
    notes: list[str] = Field(description="What was understood of units, rotations, times, frames and joints.")
    file: str | None = Field(description="The file written; null where none was asked for.")


class JoinOutput(Output):
    """armsight join."""

    kind: str = Field(description="The table written: points, observed or pairs.")
    by: str = Field(description="time, or order where one side has no times.")
    offset_s: float | None = Field(description="Added to measured times it gives the robot's, s; null by order.")
    offset_std_s: float | None = Field(description="Its standard deviation, s; null where it was stated, or by order.")
    drift_ppm: float | None = Field(
        description="How much faster the robot's clock runs, in parts of a million; null where no drift is proved.",
        json_schema_extra={"unit": "1e-6"},
    )
    n_measured: int = Field(description="Measured rows.")
    n: int = Field(description="Rows written.")
    rejected: list[RejectedRow] = Field(description="Measured rows left out, with the reason.")
    notes: list[str] = Field(description="What is to be known of times and columns.")
    file: str | None = Field(None, exclude_if=absent, description="The file written.")


class SimulateOutput(Output):
    """armsight simulate."""

    scenario: str = Field(description="The scenario's or cell's name.")
    seed: int = Field(description="The seed, which gives the same run again.")
    n_frames: int = Field(description="Frames of each view written.")
    n_dropped: int | None = Field(None, exclude_if=absent, description="Frames left out by the scenario's faults.")
    views: list[str] | None = Field(None, exclude_if=absent, description="The views: left, right or image.")
    out: str = Field(description="The folder.")
    commands: list[str] | None = Field(None, exclude_if=absent, description="What reads the set, run in its folder.")
