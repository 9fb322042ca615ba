"""armsight measure, armsight record, and convert recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.cli.command import ResultsDoubted, app, command, convert
from armsight.cli.command_ui import CommandUI
from armsight.cli.flags import PartialRequest
from armsight.cli.tables import measure_tables
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.file_names import MEASURED
from armsight.ops.flags import OUT

if TYPE_CHECKING:
    from armsight.drivers import PairSettings


@command(app, keeps=MEASURED, judged=True)
def measure(
    face: CommandUI,
    job: requests.measure.MeasureJob,
    set_zoom: Annotated[bool, Doc("Set live cameras to these first.")] = False,
) -> None:
    """Measure the target's pose in every pair of frames.

    Writes poses.csv, points.csv, spots.csv, poses.tum, measure.json and report.html. Exit code 3, with all of them
    written, where the run is inconsistent: its poses are doubtful.
    """
    from armsight.app.measure.run import measure as run
    from armsight.config import load_settings

    settings = load_settings()
    job = replace(
        job,
        fps=settings.fps if job.fps is None else job.fps,
        max_skew_s=settings.max_skew_s if job.max_skew_s is None else job.max_skew_s,
        camera_settings=_zoomed(job) if set_zoom else job.camera_settings,
    )
    summary = run(job, face.progress("measuring"))
    measure_tables(face, summary, job.out)
    face.result(summary)
    inconsistent = summary.consistency is not None and summary.consistency.verdict == "inconsistent"
    if inconsistent or (summary.timing is not None and summary.n_doubtful):
        raise ResultsDoubted


def _zoomed(job: requests.measure.MeasureJob) -> PairSettings:
    """Return what is asked of the cameras with the zoom to set of each. Raises UsageError where there is none."""
    from armsight.drivers import by_side

    if job.zoom == (None, None):
        raise UsageError(
            "--set-zoom is given, and no zoom to set", cure="Give --zoom-left and --zoom-right, or one of them"
        )
    left, right = by_side(job.camera_settings)
    return replace(left, zoom=job.zoom[0]), replace(right, zoom=job.zoom[1])


@command(app)
def record(
    face: CommandUI,
    asked: PartialRequest[requests.measure.RecordJob],
    repair: Annotated[
        Path | None, Doc("Mend this broken recording and record nothing."), Flag(metavar="FILE.mcap")
    ] = None,
) -> None:
    """Record both cameras into an MCAP file, or mend one that was cut off.

    Stop with Ctrl-C. Whatever happens to the program or the disk, all but the last second is readable.
    """
    face.until_stopped = asked.value("limit") is None and asked.value("seconds_s") is None
    from armsight.app.record.record import record as run

    if repair is not None:
        _mend(face, repair, asked.value("out"), asked.value("overwrite"))
        return
    if asked.value("out") is None:
        raise UsageError("the recording has no name", cure="Give -o FILE.mcap")
    done = run(asked.made(), face.progress("recording"))
    lost = f", {done.n_dropped} dropped because the disk or the processor is too slow" if done.n_dropped else ""
    lost += f", {done.n_missed} missed by the cameras" if done.n_missed else ""
    size = f"{done.size_bytes / 1e6:.1f} MB as {done.format}"
    face.say(f"{done.n_pairs} pairs in {done.duration_s:.1f} s{lost}; {size} in {done.file}")
    face.result(done)


@command(convert)
def recording(
    face: CommandUI,
    source: Annotated[Path, Doc("A recording."), Flag(positional=True, metavar="FILE.mcap")],
    out: Annotated[Path, Doc("A folder, or a .csv or .tum for the poses."), OUT],
    to: Annotated[str, Doc("files, or rosbag2: a bag of ROS 2, in a new folder.")] = "files",
) -> None:
    """Write a recording's content as PNG folders and tables, its poses as CSV or TUM, or all as a bag of ROS 2."""
    from armsight.app.record.export import export

    done = export(source, out, to=to, progress=face.progress("exporting"))
    face.say(", ".join(f"{name}: {count}" for name, count in done.n.items()) + f" in {out}")
    face.result(done)


def _mend(face: CommandUI, path: Path, out: Path | None, overwrite: bool) -> None:
    from armsight.app.record.record import mend

    done = mend(path, out, overwrite=overwrite)
    total = sum(done.messages.values())
    lost = f"{done.lost_bytes} bytes were not whole" if done.lost_bytes else "nothing was lost"
    face.say(f"{total} messages over {done.duration_s:.1f} s are in {done.file}; {lost}")
    face.result(done)
