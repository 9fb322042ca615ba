"""The commands: each parses, calls one function of armsight.app and prints what it says.

Imports of the program itself stand inside the commands, so that `armsight --help` does not load the compiler.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.app.simulate import MOST_FRAMES
from armsight.cli import arm, handeye, mirrors, target, timing
from armsight.cli.calibrate import calibrate
from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.compare import compare
from armsight.cli.console import console
from armsight.cli.convert import convert
from armsight.cli.examples import add_examples, every_command
from armsight.cli.identify import identify
from armsight.cli.join import join
from armsight.cli.kinematics import convert_arm, kinematics
from armsight.cli.options import (
    SRC,
    AsJson,
    Bits,
    FiniteCommand,
    Fps,
    Inverted,
    Limit,
    OutFolder,
    Seed,
    Strict,
    Threshold,
    quantity,
)
from armsight.cli.path import path
from armsight.cli.play import play
from armsight.cli.record import record
from armsight.cli.report import report
from armsight.cli.reproduce import reproduce
from armsight.cli.result_folders import (
    ARM,
    MEASURED,
    SETS,
    VERIFIED,
    VIEWS,
    WORLD,
    ResultsDoubted,
    keep_inputs,
    keeps_results,
)
from armsight.cli.robot import robot
from armsight.cli.serve import serve
from armsight.cli.servo import servo
from armsight.cli.tables import demo_tables, doctor_tables, measure_tables
from armsight.cli.teach import teach
from armsight.cli.twin import twin
from armsight.cli.verify import verify
from armsight.cli.verify_live import with_live
from armsight.units import MM

app = typer.Typer(
    name="armsight",
    help="See where a robot arm really is: two cameras, light beacons, poses with honest uncertainty.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(calibrate, name="calibrate")
handeye.add_to(calibrate)
arm.add_to(calibrate)
mirrors.add_to(calibrate)
target.add_to(calibrate)
timing.add_to(calibrate)
convert.command("arm")(convert_arm)
app.add_typer(convert, name="convert")
app.command()(record)
app.command()(identify)
app.command()(keeps_results(*VERIFIED)(with_live(verify)))
app.command()(keeps_results("reproduce.json", "report.html")(reproduce))
app.command()(join)
app.command()(report)
app.command()(keeps_results("compare.json", "report.html")(compare))
app.command()(serve)
app.command()(twin)
app.command()(console)
app.command()(keeps_results("servo.json", "servo.mcap")(servo))
app.command()(keeps_results("teach.json", "path.csv", "targets.csv", "servo.json", "servo.mcap")(teach))
app.command()(keeps_results("play.json", "play.mcap")(play))
app.add_typer(kinematics, name="kinematics")
app.add_typer(path, name="path")
app.add_typer(robot, name="robot")


def _version(wanted: bool) -> None:
    if wanted:
        from armsight import __version__

        typer.echo(f"armsight {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """See where a robot arm really is: two cameras, light beacons, poses with honest uncertainty."""


@app.command()
@keeps_results(*MEASURED)
@takes_cameras
def measure(
    rig: Annotated[Path, typer.Option(help="rig.yaml of the two cameras, from `armsight calibrate stereo`.")],
    target: Annotated[
        Path,
        typer.Option(
            help="target.yaml: the lights or the board that is looked for; or a board as checkerboard:9x6:0.025."
        ),
    ],
    out: OutFolder,
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    image: Annotated[
        str | None,
        typer.Option(
            metavar="SRC", help="Images that hold both views: side by side, or one upon the other (mirror rig)."
        ),
    ] = None,
    times: Annotated[Path | None, typer.Option(help="times.csv with a column t_s, one row per frame.")] = None,
    world: Annotated[Path | None, typer.Option(help="world.yaml: give the poses in this frame.")] = None,
    fps: Fps = None,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    stills: Annotated[
        bool, typer.Option("--stills", help="The frames are single shots, not a motion: measure each by itself.")
    ] = False,
    bits: Bits = None,
    strict: Strict = False,
    mask: Annotated[Path | None, typer.Option(help="Image that is black where no light may be looked for.")] = None,
    max_skew: Annotated[
        float | None, typer.Option(min=0.0, help="Largest time in s between live frames of a pair. [default: 1/60]")
    ] = None,
    method: Annotated[
        str,
        typer.Option(help="likelihood (a light's model is fitted) or seed (Pachidis 2005: threshold, cross, mean)."),
    ] = "likelihood",
    timing: Annotated[
        str,
        typer.Option(
            help="pairs: the views of a pair are of one moment. free: each view at its own time, for cameras that no "
            "wire joins. auto: free where rig.yaml has `timing`."
        ),
    ] = "auto",
    rate: Annotated[
        float | None, typer.Option(min=1e-3, help="With free cameras: poses a second. [default: the left frames]")
    ] = None,
    at: Annotated[
        Path | None, typer.Option(help="With free cameras: poses at the t_s of this joints.csv, or of bag:FILE:/topic.")
    ] = None,
    left_spots: Annotated[
        Path | None, typer.Option(help="t_s,u_px,v_px[,su_px,sv_px][,spot]: spots of the left camera found elsewhere.")
    ] = None,
    right_spots: Annotated[Path | None, typer.Option(help="The same of the right camera.")] = None,
    zoom_left: Annotated[
        float | None, typer.Option(help="Where the left zoom lens stands, of a rig with them.")
    ] = None,
    zoom_right: Annotated[float | None, typer.Option(help="Where the right zoom lens stands.")] = None,
    set_zoom: Annotated[bool, typer.Option("--set-zoom", help="Set live cameras to these first.")] = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Measure the target's pose in every pair of frames.

    Writes poses.csv, points.csv, spots.csv, poses.tum, measure.json and report.html. Exit code 3, with all of them
    written, where the run is inconsistent: its poses are doubtful.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.measure.run import MeasureJob
        from armsight.app.measure.run import measure as run
        from armsight.config import load_settings
        from armsight.drivers.live import MAX_SKEW_S

        settings, zoom = load_settings(), (zoom_left, zoom_right)
        job = MeasureJob(
            rig=rig,
            target=target,
            out=out,
            left=left,
            right=right,
            image=image,
            times=times,
            world=world,
            mask=mask,
            fps=fps if fps is not None else settings.fps,
            max_skew_s=max_skew or settings.max_skew_s or MAX_SKEW_S,
            limit=frames,
            threshold=threshold,
            inverted=inverted,
            stills=stills,
            bits=bits,
            strict=strict,
            method=method,
            timing=timing,
            rate_hz=rate,
            at=at,
            left_spots=left_spots,
            right_spots=right_spots,
            zoom=zoom,
            camera_settings=camera_options.settings_by_side(zoom) if set_zoom else camera_options.settings(),
        )
        summary = run(job, face.progress("measuring"))
        measure_tables(face, summary, out)
        face.result(summary)
        inconsistent = summary.consistency is not None and summary.consistency.verdict == "inconsistent"
        if inconsistent or (summary.timing is not None and summary.n_doubtful):
            raise ResultsDoubted


@app.command()
@keeps_results(*MEASURED, *WORLD, *VIEWS, "demo.json", "pictures", own="demo.json")
def demo(
    out: OutFolder = Path("demo"),
    seed: Seed = 1,
    frames: Annotated[int, typer.Option(min=1, max=MOST_FRAMES, help="How many pairs of frames.")] = 300,
    cell: Annotated[str, typer.Option(help="Which simulated cell.")] = "hand-cell",
    room: Annotated[
        str | None,
        typer.Option(help="Behind the target: dark, workshop, office, plain or a picture. [default: its own]"),
    ] = None,
    keep_frames: Annotated[bool, typer.Option("--keep-frames", help="Write the frames as PNG files too.")] = False,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Leave the real pictures out.")] = False,
    json: AsJson = False,
) -> None:
    """Do the main job on a simulated cell: frames, poses, report, and how far the poses are from the truth.

    Then calibrate two real cameras from pictures of a board, and measure the board.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.demo import demo as run

        result = run(
            out,
            seed=seed,
            frames=frames,
            cell=cell,
            room=room,
            keep_frames=keep_frames,
            pictures=not no_pictures,
            progress=face.progress("demo"),
        )
        demo_tables(face, result, out)
        face.result(result)


@app.command()
@keeps_results(*WORLD, *ARM, *VIEWS, *SETS)
def simulate(
    scenario: Annotated[str, typer.Argument(help="A scenario's name or file; or the name of a cell or set.")],
    out: OutFolder,
    seed: Annotated[
        int | None, typer.Option(min=0, help="The same seed gives the same run. [default: the file's]")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(min=1, max=MOST_FRAMES, help="How many frames, or rows. [default: the file's]")
    ] = None,
    room: Annotated[
        str | None,
        typer.Option(help="Behind the target: dark, workshop, office, plain or a picture. [default: its own]"),
    ] = None,
    zoom: Annotated[
        float | None, typer.Option(help="Zoom lenses before the cameras, at this setting, 100 to 500 where not said.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Write the frames of a simulated cell, its files and the truth into a folder; or a set for one calibration."""
    with CommandUI(as_json=json) as face:
        from armsight.app.simulate.run import simulate as run

        done = run(scenario, out, seed=seed, frames=frames, room=room, zoom=zoom, progress=face.progress("simulating"))
        if done.commands is None:
            face.say(f"{done.n_frames} frames of each view and the truth are in {out}")
        else:
            pictures = f"{done.n_frames} pictures, tables" if done.n_frames else "tables"
            face.say(f"{pictures} and the truth are in {out}; in that folder, try:")
            for command in done.commands:
                face.say(f"  {command}")
        face.result(done)


@app.command()
def doctor(
    rig: Annotated[Path | None, typer.Option(help="Tell what this rig can tell apart at distances.")] = None,
    depth: Annotated[
        list[float] | None, typer.Option(help="Distance for the rig's table; may be repeated.", **quantity("m", 1e-6))
    ] = None,
    sigma: Annotated[
        float | None, typer.Option(min=1e-6, help="Standard deviation of a spot's centre in px. [default: 0.1]")
    ] = None,
    accuracy: Annotated[
        float | None,
        typer.Option(
            metavar="MM", min=1e-6, help="With --rig and --depth: what reaches this standard deviation of a point."
        ),
    ] = None,
    json: AsJson = False,
) -> None:
    """Tell what this machine can do: versions, cameras, drivers, compiled kernels; and a rig's resolution."""
    with CommandUI(as_json=json) as face:
        from armsight.app.doctor import doctor as run
        from armsight.optics.resolution import CENTROID_SIGMA_PX

        found = run(
            rig,
            depths_m=depth or (),
            sigma_px=sigma or CENTROID_SIGMA_PX,
            accuracy_m=None if accuracy is None else accuracy * MM,
        )
        doctor_tables(face, found)
        face.result(found)


keep_inputs(app, in_place=("calibrate timing",))
add_examples(app)
for _, command in every_command(app):
    command.cls = FiniteCommand
