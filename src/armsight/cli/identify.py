"""armsight identify."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter
from typing import TYPE_CHECKING, Annotated, Any

from armsight.cli.actions import add_action, show
from armsight.cli.command import app
from armsight.cli.command_ui import CommandUI, agreed
from armsight.errors import UsageError
from armsight.fields import Doc, Flag, marks
from armsight.ops.action import action_of
from armsight.ops.flags import CAMERAS, TABLES
from armsight.ops.identify import identify_arm, identify_arm_live

if TYPE_CHECKING:
    from armsight.calibrate.identify.result import PlanOutput

NEEDED, VIEWS = ("rig", "target", "limits"), ("left", "right", "cameras")
OF_SWEEPS = {"joint": None, "joints": None, "increments": "known"}
"""What is not said of sweeps that are made live, with its default."""


def live_flags() -> dict[str, tuple[Any, Any]]:
    """Return the flags of the live identification; none is needed for that of a file."""
    taken = action_of(identify_arm_live).flags()
    asked = {name: (hint, None if default is Parameter.empty else default) for name, (hint, default) in taken.items()}
    return {**asked, "yes": (Annotated[bool, Doc("With --live: move without asking.")], False)}


def made_live(face: CommandUI, asked: Mapping[str, Any]) -> bool:
    """Make the sweeps where a robot is named, and tell whether one is. Raises UsageError for flags of the other way."""
    if asked.get("robot") is None:
        _refuse_flags_of_live(asked)
        return False
    seen = asked.get("follow") is not None or any(asked.get(name) for name in VIEWS)
    if not seen or any(asked.get(name) is None for name in NEEDED):
        raise UsageError(
            "--live lacks something",
            cure="Give --rig, --target, --limits, and --left and --right, --camera NAME=SRC for each, or --follow "
            "SCENARIO with it",
        )
    if any(asked.get(name) != default for name, default in OF_SWEEPS.items()):
        raise UsageError(
            "--live makes its own sweeps, of known values",
            cure="Leave --sweep, --joints and --increments away, or --live",
        )

    def show_plan(plan: PlanOutput) -> None:
        for one in plan.summary():
            face.say(one) if isinstance(one, str) else face.table(*one)

    def confirm(question: str) -> bool:
        return asked["yes"] or agreed(question)

    done = action_of(identify_arm_live)
    given = {name: asked.get(name) for name in done.parameters if name in asked or name in VIEWS}
    result = done.run({**given, "confirm": confirm, "show": show_plan}, face.progress(done.working))
    show(face, result, None if asked.get("propose") else asked["out"])
    return True


def _refuse_flags_of_live(asked: Mapping[str, Any]) -> None:
    own = action_of(identify_arm).flags()
    if (settings := asked.get("camera_settings")) is not None:
        settings.require_none("a sweep without --live")
    words = {name: next(iter(marks(hint, Flag)), Flag()).written(name) for name, (hint, _) in live_flags().items()}
    known = {next(iter(marks(hint, Flag)), Flag()).written(name) for name, (hint, _) in own.items()}
    given = [
        words[name]
        for name, (_, default) in live_flags().items()
        if words[name] not in known and name != "camera_settings" and asked.get(name) and asked[name] != default
    ]
    if given:
        raise UsageError(
            f"{', '.join(given)} only means something with --live", cure="Add --live ROBOT, or leave it out"
        )


add_action(app, identify_arm, made_live, live_flags, panels=(CAMERAS, TABLES))
