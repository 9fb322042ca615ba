"""The command line: the modules of its commands, and demo, simulate and doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from armsight.app.requests.shared import OutFolder
from armsight.app.simulate import MOST_FRAMES
from armsight.cli import (
    batch,
    calibrate_cameras,
    calibrate_cell,
    calibrate_robot,
    cell_plan,
    convert,
    design,
    files,
    history,
    identify,
    kinematics,
    measure,
    motion,
    path,
    robot,
    serve,
    verify,
)
from armsight.cli.command import ARM, MEASURED, SETS, VIEWS, WORLD, app, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.examples import add_examples
from armsight.cli.tables import demo_tables, doctor_tables
from armsight.fields import Bounds, Doc, Flag
from armsight.units import MM

__all__ = [
    "app",
    "batch",
    "calibrate_cameras",
    "calibrate_cell",
    "calibrate_robot",
    "cell_plan",
    "convert",
    "design",
    "files",
    "history",
    "identify",
    "kinematics",
    "measure",
    "motion",
    "path",
    "robot",
    "serve",
    "verify",
]

Room: TypeAlias = Annotated[
    str | None, Doc("Behind the target: dark, workshop, office, plain or a picture. [default: its own]")
]


def _version(wanted: bool) -> None:
    if wanted:
        from armsight._version import __version__

        typer.echo(f"armsight {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """See where a robot arm really is: two cameras, light beacons, poses with honest uncertainty."""


@command(app, keeps=(*MEASURED, *WORLD, *VIEWS, "demo.json", "pictures"), own="demo.json")
def demo(
    face: CommandUI,
    out: OutFolder = Path("demo"),
    seed: Annotated[int, Doc("The same seed gives the same frames."), Bounds(least=0)] = 1,
    frames: Annotated[int, Doc("How many pairs of frames."), Bounds(least=1, most=MOST_FRAMES)] = 300,
    cell: Annotated[str, Doc("Which simulated cell.")] = "hand-cell",
    room: Room = None,
    keep_frames: Annotated[bool, Doc("Write the frames as PNG files too.")] = False,
    no_pictures: Annotated[bool, Doc("Leave the real pictures out.")] = False,
) -> None:
    """Do the main job on a simulated cell: frames, poses, report, and how far the poses are from the truth.

    Then calibrate two real cameras from pictures of a board, and measure the board.
    """
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


@command(app, keeps=(*WORLD, *ARM, *VIEWS, *SETS))
def simulate(
    face: CommandUI,
    scenario: Annotated[str, Doc("A scenario's name or file; or the name of a cell or set."), Flag(positional=True)],
    out: OutFolder,
    seed: Annotated[int | None, Doc("The same seed gives the same run. [default: the file's]"), Bounds(least=0)] = None,
    frames: Annotated[
        int | None, Doc("How many frames, or rows. [default: the file's]"), Bounds(least=1, most=MOST_FRAMES)
    ] = None,
    room: Room = None,
    zoom: Annotated[
        float | None, Doc("Zoom lenses before the cameras, at this setting, 100 to 500 where not said.")
    ] = None,
) -> None:
    """Write the frames of a simulated cell, its files and the truth into a folder; or a set for one calibration."""
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


@command(app)
def doctor(
    face: CommandUI,
    rig: Annotated[Path | None, Doc("Tell what this rig can tell apart at distances.")] = None,
    depth: Annotated[
        list[float] | None,
        Doc("Distance for the rig's table; may be repeated."),
        Bounds(least=1e-6),
        Flag(quantity="m"),
    ] = None,
    sigma: Annotated[
        float | None, Doc("Standard deviation of a spot's centre in px. [default: 0.1]"), Bounds(least=1e-6)
    ] = None,
    accuracy: Annotated[
        float | None,
        Doc("With --rig and --depth: what reaches this standard deviation of a point."),
        Bounds(least=1e-6),
        Flag("--accuracy", metavar="MM", unit=MM),
    ] = None,
    compile_ahead: Annotated[
        bool, Doc("First compile all that is not compiled yet: no command then waits for it."), Flag("--compile")
    ] = False,
) -> None:
    """Tell what this machine can do: versions, cameras, drivers, compiled kernels; and a rig's resolution."""
    from armsight.app.doctor import doctor as run
    from armsight.optics.resolution import CENTROID_SIGMA_PX

    found = run(
        rig,
        depths_m=depth or (),
        sigma_px=sigma or CENTROID_SIGMA_PX,
        accuracy_m=accuracy,
        compile_ahead=compile_ahead,
        progress=face.progress("doctor") if compile_ahead else None,
    )
    doctor_tables(face, found)
    face.result(found)


add_examples(app)
