"""armsight calibrate camera, which may find its noise alone, and mirrors, which may check them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from armsight.cli.actions import add_action, show
from armsight.cli.command import calibrate
from armsight.cli.command_ui import CommandUI
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.ops.action import action_of
from armsight.ops.calibrate_cameras import calibrate_camera
from armsight.ops.calibrate_mirrors import calibrate_mirrors, check_mirrors


def noise_alone(face: CommandUI, asked: Mapping[str, Any]) -> bool:
    """Find a camera's noise where nothing else was given, and tell whether that is so."""
    if asked.get("noise") is None or any(asked.get(name) is not None for name in ("images", "board", "zoom")):
        return False
    from armsight.ops.calibration.camera_noise import run_noise

    found = run_noise(
        asked["noise"],
        asked["out"],
        side=asked.get("side"),
        every=asked["every"],
        limit=asked.get("frames"),
        settings=asked["camera_settings"],
        progress=face.progress("calibrating"),
    )
    show(face, found, asked["out"])
    return True


def mirrors_checked(face: CommandUI, asked: Mapping[str, Any]) -> bool:
    """Check the mirrors where that is asked, and tell whether it is."""
    from armsight.ops.calibration.mirrors import require_board

    if not asked["check"]:
        if asked.get("out") is None:
            raise UsageError("there is no file to write", cure="Give -o rig.yaml")
        return False
    if asked.get("images") is None:
        raise UsageError("nothing to check", cure="Give --image, and --rig rig.yaml as it was calibrated")
    if asked.get("target") is not None:
        raise UsageError(
            "mirrors are checked with a board, not with the lit target, whose lights turned mirrors pair wrongly",
            cure="Leave --target out and give --board",
        )
    require_board(asked.get("board"))
    done = action_of(check_mirrors)
    given = {name: value for name, value in {**asked, "image": asked["images"]}.items() if name in done.parameters}
    show(face, done.run(given, face.progress(done.working)), None)
    return True


def check_flags() -> dict[str, tuple[Any, Any]]:
    """Return the flags of the check, and the one that asks for it."""
    text = "Do not calibrate: tell how the mirrors stand, and which to turn."
    return {"check": (Annotated[bool, Doc(text)], False), **action_of(check_mirrors).flags()}


add_action(calibrate, calibrate_camera, noise_alone)
add_action(calibrate, calibrate_mirrors, mirrors_checked, check_flags)
