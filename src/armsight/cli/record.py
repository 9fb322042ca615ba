"""armsight record, and convert recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC, AsJson, Fps, Limit, Seed

if TYPE_CHECKING:
    from armsight.store.recording import ImageFormat


@takes_cameras
def record(
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.mcap", help="The recording.")] = None,
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    cell: Annotated[str | None, typer.Option(help="A simulated cell in place of cameras, such as hand-cell.")] = None,
    seed: Seed = 0,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml: its calibration goes into the recording.")] = None,
    target: Annotated[Path | None, typer.Option(help="target.yaml that goes into the recording.")] = None,
    kind: Annotated[
        str, typer.Option("--format", help="png (bit for bit, small), raw (bit for bit, quick) or jpeg (smallest).")
    ] = "png",
    colour: Annotated[bool, typer.Option("--colour", help="Keep the colours; else grey is recorded.")] = False,
    fps: Fps = None,
    frames: Limit = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="Stop after so many seconds.")] = None,
    max_skew: Annotated[
        float | None, typer.Option(min=0.0, help="Largest time in s between live frames of a pair. [default: 1/60]")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file of this name.")] = False,
    repair: Annotated[
        Path | None, typer.Option(metavar="FILE.mcap", help="Mend this broken recording and record nothing.")
    ] = None,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Record both cameras into an MCAP file, or mend one that was cut off.

    Stop with Ctrl-C. Whatever happens to the program or the disk, all but the last second is readable.
    """
    with CommandUI(as_json=json, until_stopped=frames is None and seconds is None) as face:
        from armsight.app.record.record import RecordJob
        from armsight.app.record.record import record as run
        from armsight.drivers.live import MAX_SKEW_S
        from armsight.errors import UsageError

        if repair is not None:
            _mend(face, repair, out, overwrite)
            return
        if out is None:
            raise UsageError("the recording has no name", cure="Give -o FILE.mcap")
        job = RecordJob(
            out=out,
            left=left,
            right=right,
            cell=cell,
            seed=seed,
            rig=rig,
            target=target,
            kind=_format(kind),
            colour=colour,
            fps=fps,
            limit=frames,
            seconds_s=seconds,
            max_skew_s=MAX_SKEW_S if max_skew is None else max_skew,
            overwrite=overwrite,
            camera_settings=camera_options.settings(),
        )
        done = run(job, face.progress("recording"))
        lost = f", {done.n_dropped} dropped because the disk or the processor is too slow" if done.n_dropped else ""
        lost += f", {done.n_missed} missed by the cameras" if done.n_missed else ""
        size = f"{done.size_bytes / 1e6:.1f} MB as {done.format}"
        face.say(f"{done.n_pairs} pairs in {done.duration_s:.1f} s{lost}; {size} in {done.file}")
        face.result(done)


def recording(
    source: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="A recording.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="A folder, or a .csv or .tum for the poses.")],
    to: Annotated[str, typer.Option("--to", help="files, or rosbag2: a bag of ROS 2, in a new folder.")] = "files",
    json: AsJson = False,
) -> None:
    """Write a recording's content as PNG folders and tables, its poses as CSV or TUM, or all as a bag of ROS 2."""
    with CommandUI(as_json=json) as face:
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


def _format(text: str) -> ImageFormat:
    from armsight.errors import UsageError
    from armsight.store.recording import ImageFormat

    try:
        return ImageFormat(text.lower())
    except ValueError:
        known = ", ".join(kind.value for kind in ImageFormat)
        raise UsageError(f"frames are not kept as {text!r}", cure=f"Choose one of {known}") from None
