"""armsight calibrate timing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC, AsJson, Fps, Inverted, Limit, Threshold
from armsight.cli.tables import figure

if TYPE_CHECKING:
    from armsight.calibrate.timing import TimingCalibration

MS = 1e3
TABLE = "table t_s,u_px,v_px[,su_px,sv_px][,spot]"


@takes_cameras
def timing(
    rig: Annotated[Path, typer.Option(help="rig.yaml of the two cameras, from `armsight calibrate stereo`.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="rig.yaml to write, with the timing.")],
    target: Annotated[
        Path | None, typer.Option(help="target.yaml of the lights, where they are named in tables.")
    ] = None,
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[
        str | None, typer.Option(metavar="SRC", help="Right frames, each with its camera's stamp.")
    ] = None,
    left_spots: Annotated[Path | None, typer.Option(metavar="CSV", help=f"Instead of frames: {TABLE}.")] = None,
    right_spots: Annotated[Path | None, typer.Option(metavar="CSV", help="The same of the right camera.")] = None,
    fps: Fps = None,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Find delay, drift, read-outs and jitter of two free-running cameras from lights waved before them for 10-20 s."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.timing import TimingJob, calibrate_cameras_timing

        job = TimingJob(
            rig=rig,
            out=out,
            target=target,
            left=left,
            right=right,
            left_spots=left_spots,
            right_spots=right_spots,
            fps=fps,
            limit=frames,
            threshold=threshold,
            inverted=inverted,
            camera_settings=camera_options.settings(),
        )
        done = calibrate_cameras_timing(job, face.progress("calibrating"))
        timing_tables(face, done, out)
        face.result(done)


def timing_tables(face: CommandUI, done: TimingCalibration, out: Path) -> None:
    """Print the timing of two cameras."""
    std = done.std
    rows = [
        [
            what,
            *(f"{figure(MS * getattr(both, s), 4)} +- {figure(MS * std[f'{s}.{key}'], 2)}" for s in ("left", "right")),
        ]
        for what, both, key in (("read-out ms", done.readout_s, "readout_s"), ("jitter ms", done.jitter_s, "jitter_s"))
    ]
    rows.append(["period ms", *(figure(MS * getattr(done.period_s, s), 6) for s in ("left", "right"))])
    rows.append(["frames lost", str(done.lost.left), str(done.lost.right)])
    face.table("Cameras", ["", "left", "right"], rows)
    rows = [
        ["delay ms", f"{MS * done.delay_s:.3f}", figure(MS * std["delay_s"], 2)],
        ["drift ppm", f"{done.drift_ppm:.2f}", figure(std["drift_ppm"], 2)],
        [f"t_left - t_right ms, at {done.middle_s:.1f} s", _shift(done), figure(MS * done.std_middle_s, 2)],
    ]
    face.table("Right stamps to left ones", ["", "", "+-"], rows)
    face.say(f"{done.n_frames} frames, {done.common_s:.1f} s seen by both cameras, lights: {', '.join(done.lights)}")
    face.say(f"Residual {figure(done.residual_px.left)} and {figure(done.residual_px.right)} px RMS")
    face.say(f"Verdict: {done.verdict}")
    face.say(f"Result: {out}")


def _shift(done: TimingCalibration) -> str:
    return f"{MS * (done.delay_s + 1e-6 * done.drift_ppm * done.middle_s):.3f}"


def add_to(calibrate: typer.Typer) -> None:
    """Add the command to `armsight calibrate`."""
    calibrate.command("timing")(timing)
