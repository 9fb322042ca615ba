"""Examples below each command's help, those of an action from its declaration; the panels of the overview."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import typer

from armsight.ops import actions
from armsight.ops.action import action_of

PANELS: Mapping[str, tuple[str, ...]] = {
    "Begin": ("console", "demo", "simulate", "doctor", "design"),
    "Measure": ("record", "verify", "report", "compare", "batch", "measure", "history"),
    "Calibrate and identify": ("identify", "reproduce", "calibrate"),
    "Arms and files": ("join", "convert", "kinematics"),
    "Robots": ("serve", "twin", "servo", "teach", "play", "path", "robot"),
}
"""Panel -> its commands and groups, in the order of the overview; the last one has what is not named."""
BEHIND = {"calibrate cell-plan": "calibrate arm"}
"""Commands of another distribution that stand behind an action in their group."""

RIG = "--rig rig.yaml --target target.yaml"
EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "console": (
        "armsight console --robot sim:webcam-cell",
        "armsight console --folder work",
        f"armsight console --folder work --left camera:0 --right camera:1 {RIG}",
    ),
    "demo": ("armsight demo", "armsight demo --room workshop -o demo"),
    "design": (
        "armsight design --size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 120mm --target target.yaml "
        "--volume=-0.2:0.2,-0.15:0.15,0.6:1 --board checkerboard:9x6:0.025 --views 20 --wanted-mm 0.5 -o design",
        "armsight design --rig rig.yaml --target target.yaml --volume=-0.2:0.2,-0.15:0.15,0.6:1 -o design",
    ),
    "report": ("armsight report measured --pdf", "armsight report rig.report.html --pdf -o rig.pdf"),
    "batch": (
        "armsight batch --each 'recordings/*.mcap' -o results -- measure --left {} --rig rig.yaml --target target.yaml",
        "armsight batch jobs.csv -o results --resume",
    ),
    "serve": (
        "armsight serve --robot sim:webcam-cell",
        "armsight serve --robot sim:webcam-cell --console work",
        "armsight serve --robot rsi:49152 --arm arm.yaml --bind 0.0.0.0 --tokens tokens.yaml --tls-cert cert.pem "
        "--tls-key key.pem",
    ),
    "twin": ("armsight twin rtde --port 30004", "armsight twin rsi --connect 127.0.0.1:49152"),
    "calibrate cell-plan": (
        f"armsight calibrate cell-plan --model arm.yaml {RIG} --world world.yaml "
        "--volume=-0.95:-0.75,-0.3:0.05,0.1:0.4 --start=0,-1.07,1.63,-0.57,1.73,0.16 --facing-deg 60 -o motion.csv",
        "armsight calibrate cell-plan --model arm.yaml --start=0,-1.07,1.63,-0.57,1.73,0.16 -o motion.csv",
    ),
    "history add": ("armsight history add handeye.yaml --cell weld-3",),
    "history list": ("armsight history list --cell weld-3 --command calibrate",),
    "history show": ("armsight history show 1",),
    "history compare": ("armsight history compare 1 2",),
    "history trend": (
        "armsight history trend --cell weld-3 -o drift",
        "armsight history trend --cell weld-3 --figure joint-zeros --figure residual_rms_m --since 2026-01-01 -o drift",
    ),
    "history export": ("armsight history export --cell weld-3 -o weld-3.csv",),
}
"""Command -> what to type, of commands that are no actions."""


def every_example() -> Mapping[str, Sequence[str]]:
    """Return what to type by command: of the actions, in their order, then of the other commands."""
    found: dict[str, Sequence[str]] = {}
    for done in map(action_of, actions()):
        found.setdefault(done.command, [f"armsight {done.command} {one}".rstrip() for one in done.examples])
    return {**found, **EXAMPLES}


def add_examples(app: typer.Typer) -> None:
    """Put the examples below each command's help, and the commands into panels and in order."""
    examples, panels = every_example(), {name: panel for panel, names in PANELS.items() for name in names}
    last, order = [*PANELS][-1], {name: k for k, name in enumerate({**panels, **examples})}
    at = {id(info): order.get(BEHIND.get(name, name), len(order)) for name, info in every_command(app)}
    for name, info in every_command(app):
        info.epilog = "\n\n".join(("Examples:", *examples[name])) if examples.get(name) else None
        info.rich_help_panel = None if " " in name else panels.get(name, last)
    app.registered_commands.sort(key=lambda info: at[id(info)])
    for group in app.registered_groups:
        group.rich_help_panel = panels.get(group.name or "", last)
        if group.typer_instance is not None:
            group.typer_instance.registered_commands.sort(key=lambda info: at[id(info)])


def every_command(app: typer.Typer) -> Iterator[tuple[str, typer.models.CommandInfo]]:
    """Yield each command with its full name."""
    for command in app.registered_commands:
        yield _name(command), command
    for group in app.registered_groups:
        if group.typer_instance is not None:
            for command in group.typer_instance.registered_commands:
                yield f"{group.name} {_name(command)}", command


def _name(command: typer.models.CommandInfo) -> str:
    return str(command.name or getattr(command.callback, "__name__", "")).replace("_", "-")
