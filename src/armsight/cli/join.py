"""armsight join."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import REJECTED_SHOWN, figure
from armsight.errors import UsageError
from armsight.units import MS


@takes_tables
def join(
    measured: Annotated[Path, typer.Option(metavar="FILE", help="Measured poses or points, with t_s.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The table to write.")],
    kind: Annotated[
        str, typer.Option("--as", help="points (for calibrate arm), observed (robot-world) or pairs (hand-eye).")
    ] = "points",
    joints: Annotated[Path | None, typer.Option(help="The controller's joint log, with t_s on its own clock.")] = None,
    arm: Annotated[
        str | None, typer.Option(metavar="ARM", help=f"With --joints: {KNOWN_ARM}; nominal is enough.")
    ] = None,
    robot_stream: Annotated[Path | None, typer.Option(help="Instead of joints: poses of the flange, with t_s.")] = None,
    setup: Annotated[str, typer.Option(help="Of pairs: eye-in-hand or eye-to-hand.")] = "eye-in-hand",
    offset: Annotated[
        float | None, typer.Option(metavar="S", help="Add this to measured times. [default: it is found]")
    ] = None,
    still: Annotated[bool, typer.Option("--still", help="One row for each rest of the arm: the mean of it.")] = False,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Join a joint log and measurements on different clocks into points.csv, observed.csv or pairs.csv."""
    with CommandUI(as_json=json) as face:
        from armsight.app.join import JoinJob
        from armsight.app.join import join as run
        from armsight.calibrate.handeye import Setup

        if setup not in tuple(Setup):
            raise UsageError(f"no setup is called {setup!r}; there are {', '.join(Setup)}")
        job = JoinJob(
            measured=measured,
            out=out,
            kind=kind,
            joints=joints,
            arm=arm,
            robot_stream=robot_stream,
            setup=Setup(setup),
            offset_s=offset,
            still=still,
            table=table_options.format(face),
        )
        done = run(job)
        if done.offset_s is not None:
            std = "as stated" if done.offset_std_s is None else f"+- {figure(done.offset_std_s / MS, 2)} ms"
            face.say(f"Measured times {done.offset_s:+.6f} s are the robot's ({std})")
        for text in done.notes:
            face.say(f"- {text}")
        for item in done.rejected[:REJECTED_SHOWN]:
            face.say(f"  left out: row {item.row}: {item.why}")
        face.say(f"{done.n} rows of {done.kind} from {done.n_measured} measured, by {done.by}: {done.file}")
        face.result(done)
