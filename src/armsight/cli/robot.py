"""armsight robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, quantity
from armsight.errors import UsageError

robot = typer.Typer(name="robot", help="Test the link to a robot, and move one of its joints.", no_args_is_help=True)

RobotName: TypeAlias = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="DRIVER:DEVICE",
        help="sim:SCENARIO, alter:/dev/PORT, rsi:UDP_PORT, egm:UDP_PORT, rtde:HOST[:PORT] or ws://HOST:PORT.",
    ),
]


RsiConfig: TypeAlias = Annotated[
    Path | None,
    typer.Option("--rsi-config", metavar="FILE.xml", help="Of rsi: the RSI Ethernet configuration, for its own tags."),
]


@robot.command()
def test(
    robot: RobotName,
    for_s: Annotated[float, typer.Option("--for", metavar="S", help="How many seconds to read it.")] = 5.0,
    rsi_config: RsiConfig = None,
    json: AsJson = False,
) -> None:
    """Read a robot once a cycle and tell how punctual that is. Nothing moves."""
    with CommandUI(as_json=json) as face:
        from armsight.app.robot.link_test import test_robot as run

        done = run(robot, for_s=for_s, progress=face.progress("reading"), rsi_config=rsi_config)
        face.say(
            f"{done.driver}: {done.n_cycles} cycles of {1e3 * done.cycle_s:g} ms, {done.late} late, {done.missed} "
            f"missed; periods {done.period_ms.median:.3f} ms median, {done.period_ms.p99:.3f} p99, "
            f"{done.period_ms.max:.3f} longest; new readings at most {done.silence_ms:.0f} ms apart. "
            f"The robot is {done.state}."
        )
        face.result(done)


@robot.command()
def jog(
    robot: RobotName,
    joint: Annotated[int | None, typer.Option(help="Which joint, from 1.")] = None,
    by: Annotated[float | None, typer.Option(help="How far.", **quantity("rad or m"))] = None,
    hand: Annotated[
        str | None,
        typer.Option("--with", metavar="keyboard|gamepad", help="Move by hand, while a key or the enable is held."),
    ] = None,
    frame: Annotated[
        str, typer.Option(metavar="joints|base|tool", help="Of --with: what moves, and along which axes.")
    ] = "joints",
    speed: Annotated[float, typer.Option(metavar="SHARE", help="Share of the limits' speeds, up to 1.")] = 0.5,
    arm: Annotated[
        Path | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}; without it only joints are limited, and slow.")
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml: what the guard keeps. [default: its own]")] = None,
    record: Annotated[Path | None, typer.Option(help="An .mcap file for commands, readings and events.")] = None,
    rsi_config: RsiConfig = None,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    json: AsJson = False,
) -> None:
    """Move one joint by a given way (--joint, --by), or the arm by hand (--with), through the guard.

    Ctrl-C brings it to rest.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.robot.jog import JogJob, jog_robot
        from armsight.app.robot.jog_by_hand import HandJogJob, jog_by_hand
        from armsight.cli.tables import figure

        def confirm(question: str) -> bool:
            face.say(question)
            try:
                return yes or typer.confirm("Move?", err=True)
            except typer.Abort:  # nobody there to ask
                return False

        common: dict[str, Any] = {"robot": robot, "speed": speed, "arm": arm, "limits": limits, "record": record}
        if hand is not None and joint is None and by is None:
            led = HandJogJob(**common, by=hand, frame=frame, rsi_config=rsi_config)
            done = jog_by_hand(led, confirm, face.progress("moving by hand"))
            face.say(f"the joints stand at {', '.join(figure(v, 6) for v in done.reached)} (rad or m)")
        elif hand is None and joint is not None and by is not None:
            job = JogJob(**common, joint=joint, by=by, rsi_config=rsi_config)
            done = jog_robot(job, confirm, face.progress("moving"))
            face.say(
                f"joint {joint} stands at {figure(done.reached[joint - 1], 6)} (rad or m); the robot is {done.state}"
            )
        else:
            raise UsageError(
                "it is not clear what is to move",
                consequence="Nothing is moved",
                cure="Give --joint and --by for one way, or --with keyboard or gamepad alone",
            )
        face.result(done)
