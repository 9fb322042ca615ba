"""The command line: the modules of its commands, every action that has none, demo, and the laboratory's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli import (
    calibrate_cameras,
    files,
    identify,
    measure,
    motion,
    serve,
    verify,
)
from armsight.cli.actions import add_action, add_others
from armsight.cli.command import (
    SETS,
    SIMULATED,
    VIEWS,
    WITH_ARM,
    app,
    calibrate,
    command,
    elsewhere,
    history,
)
from armsight.cli.command_ui import CommandUI
from armsight.cli.examples import add_examples
from armsight.cli.tables import demo_tables
from armsight.fields import Bounds, Doc
from armsight.file_names import DEMO, MEASURED
from armsight.ops.flags import OutFolder
from armsight.ops.machine import Room, write_simulation
from armsight.ops.simulation import MOST_FRAMES

__all__ = [
    "app",
    "calibrate_cameras",
    "files",
    "identify",
    "measure",
    "motion",
    "serve",
    "verify",
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
    """See where a robot arm really is: one to eight cameras, light beacons, poses with honest uncertainty."""


@command(app, keeps=(*MEASURED, *SIMULATED, *VIEWS, DEMO, "pictures"), own=DEMO)
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
    from armsight.ops.demo import demo as run

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
    face.result(result)
    demo_tables(face, result, out)  # last stands what to do next


add_action(app, write_simulation, keeps=(*SIMULATED, *WITH_ARM, *VIEWS, *SETS))
add_others()
elsewhere(
    app,
    "lab",
    {
        "batch": "Run many measure, verify, identify, simulate, calibrate or kinematics commands, "
        "on all cores or a Dask cluster.",
        "design": "Tell what a planned rig will measure over a volume, what the deviations come from, "
        "and what to change.",
    },
)
elsewhere(
    calibrate,
    "lab",
    {"cell-plan": "Plan the motion that calibrates a cell best: two minutes that tell most of the tip over a volume."},
)
elsewhere(
    history,
    "lab",
    {
        "add": "File the result of an earlier run, or of one that could not be filed.",
        "list": "List runs, the newest first.",
        "show": "Show a run: what it was given, what it found, every number with its deviation.",
        "compare": "Hold two runs side by side: every number, its difference and deviation, "
        "and whether it exceeds that.",
        "export": "Write every number of every run as a table: CSV, Parquet, or JSON line by line.",
        "trend": "Say whether a joint zero, hand-eye, baseline or tool tip has drifted: what, since when, by how much.",
    },
)
add_examples(app)
