"""record, convert, simulate."""

from __future__ import annotations

from typing import Annotated

from armsight.app.schemas.base import RejectedRow
from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class RecordedSkew(Output):
    """Time between the frames of pairs, right minus left."""

    mean: Annotated[float, Doc("Mean, s.")]
    largest: Annotated[float, Doc("Largest, s.")]


@output
class RecordOutput(Output):
    """armsight record."""

    file: Annotated[str, Doc("The recording.")]
    format: Annotated[str, Doc("How frames are kept: png, raw or jpeg.")]
    n_pairs: Annotated[int, Doc("Pairs recorded.")]
    n_dropped: Annotated[int, Doc("Pairs that found no room: the disk or the processor is too slow.")]
    n_missed: Annotated[int, Doc("Frames lost by the cameras or without a partner.")]
    duration_s: Annotated[float, Doc("From the first pair to the last, s.")]
    pairs_per_s: Annotated[float | None, Doc("Pairs a second.", unit="1/s")]
    size_bytes: Annotated[int, Doc("Size of the file, bytes.")]
    skew_s: Annotated[RecordedSkew | None, Doc("Time between the frames of live pairs; null of other sources.")]


@output
class RepairOutput(Output):
    """armsight record --repair."""

    file: Annotated[str, Doc("The mended recording.")]
    messages: Annotated[dict[str, int], Doc("Messages saved by topic.")]
    duration_s: Annotated[float, Doc("From the first message to the last, s.")]
    lost_bytes: Annotated[int, Doc("Bytes that were not whole.")]
    damaged_chunks: Annotated[int, Doc("Chunks whose checksum does not fit.")]


@output
class ExportOutput(Output):
    """armsight convert recording."""

    source: Annotated[str, Doc("The recording.", key="from")]
    out: Annotated[str, Doc("The folder or file written.")]
    n: Annotated[dict[str, int], Doc("Rows or frames by file.")]


@output
class ConvertOutput(Output):
    """armsight convert camera, convert rig, convert handeye, convert poses."""

    source: Annotated[str, Doc("Kind of the file read: armsight, ros, opencv, kalibr; or of poses.", key="from")]
    target: Annotated[str, Doc("Kind of the files written.", key="to")]
    files: Annotated[list[str], Doc("The files written.")]
    n: Annotated[int | None, Doc("Poses; null for cameras and rigs.")]
    note: Annotated[str, Doc("What the new kind could not carry, or which zoom it is of; may be empty.")]


@output
class ConvertTableOutput(Output):
    """armsight convert table."""

    kind: Annotated[str, Doc("Which table it is: joints, poses, points, pairs, robot_poses or sweep.")]
    how: Annotated[str, Doc("How the file was found to be written.")]
    columns: Annotated[list[str], Doc("The columns of ours that it came to.")]
    ranges: Annotated[
        dict[str, tuple[float, float] | None],
        Doc(
            "Smallest and largest number of each column of numbers, in its unit; null where all of its cells are empty."
        ),
    ]
    n: Annotated[int, Doc("Rows.")]
    notes: Annotated[list[str], Doc("What was understood of units, rotations, times, frames and joints.")]
    file: Annotated[str | None, Doc("The file written; null where none was asked for.")]


@output
class JoinOutput(Output):
    """armsight join."""

    kind: Annotated[str, Doc("The table written: points, observed or pairs.")]
    by: Annotated[str, Doc("time, or order where one side has no times.")]
    offset_s: Annotated[float | None, Doc("Added to measured times it gives the robot's, s; null by order.")]
    offset_std_s: Annotated[float | None, Doc("Its standard deviation, s; null where it was stated, or by order.")]
    drift_ppm: Annotated[
        float | None,
        Doc(
            "How much faster the robot's clock runs, in parts of a million; null where no drift is proved.", unit="1e-6"
        ),
    ]
    n_measured: Annotated[int, Doc("Measured rows.")]
    n: Annotated[int, Doc("Rows written.")]
    rejected: Annotated[list[RejectedRow], Doc("Measured rows left out, with the reason.")]
    notes: Annotated[list[str], Doc("What is to be known of times and columns.")]
    file: Annotated[str | None, Doc("The file written.")] = None


@output
class SimulateOutput(Output):
    """armsight simulate."""

    scenario: Annotated[str, Doc("The scenario's or cell's name.")]
    seed: Annotated[int, Doc("The seed, which gives the same run again.")]
    n_frames: Annotated[int, Doc("Frames of each view written.")]
    n_dropped: Annotated[int | None, Doc("Frames left out by the scenario's faults.")] = None
    views: Annotated[list[str] | None, Doc("The views: left, right or image.")] = None
    out: Annotated[str, Doc("The folder.")]
    commands: Annotated[list[str] | None, Doc("What reads the set, run in its folder.")] = None
