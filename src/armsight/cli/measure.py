"""armsight measure and armsight record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from armsight.cli.actions import add_action
from armsight.cli.command import app
from armsight.cli.command_ui import CommandUI
from armsight.fields import Doc, Flag
from armsight.ops.measure import measure, record


def rates() -> dict[str, Any]:
    """Return what the person's settings say of frames without times and of live pairs."""
    from armsight.config import load_settings

    return load_settings().model_dump(include={"fps", "max_skew_s"})


def mended(face: CommandUI, asked: Mapping[str, Any]) -> bool:
    """Mend a broken recording where that is asked, and tell whether it is."""
    if asked.get("repair") is None:
        face.until_stopped = asked.get("frames") is None and asked.get("seconds_s") is None
        return False
    from armsight.ops.recording.record import mend

    done = mend(asked["repair"], asked.get("out"), overwrite=asked["overwrite"])
    total = sum(done.messages.values())
    lost = f"{done.lost_bytes} bytes were not whole" if done.lost_bytes else "nothing was lost"
    face.say(f"{total} messages over {done.duration_s:.1f} s are in {done.file}; {lost}")
    face.result(done)
    return True


def repair_flag() -> dict[str, tuple[Any, Any]]:
    """Return the flag of the recording to mend."""
    text = "Mend this broken recording and record nothing."
    return {"repair": (Annotated[Path | None, Doc(text), Flag(metavar="FILE.mcap")], None)}


add_action(app, measure, settled=rates)
add_action(app, record, mended, repair_flag)
