"""armsight servo, teach, play and robot: what asks, what shows a run, and the keys that steer it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.cli.actions import add_action
from armsight.cli.command import app, command, robot
from armsight.cli.command_ui import CommandUI, StatusLine
from armsight.fields import Doc
from armsight.ops import motion, robots
from armsight.ops.flags import CAMERAS as SETTINGS
from armsight.ops.requests.motion import ARM, CAMERAS, SIMULATED, TwinJob
from armsight.ops.teach import teach
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.control.play import PathSource, PlayProgress, WatchFigures
    from armsight.control.play.path_source import JointMotionSource
    from armsight.control.status import RobotStatus
    from armsight.control.teach import PathRecorder

Asked = Mapping[str, Any]

PLAY_KEYS = "space: pause and go on; + and -: faster and slower by a tenth of the planned speed"
TEACH_KEYS = "space: pause and go on; u: undo the last stretch; w: weld on; e: weld off"
STEP = 0.1
Yes = Annotated[bool, Doc("Move without asking.")]


def yes() -> dict[str, tuple[Any, Any]]:
    """Return the flag of commands that move a robot."""
    return {"yes": (Yes, False)}


class ServoLine(StatusLine):
    """The line of a servo."""

    def show(self, status: RobotStatus, error_m: float | None) -> None:
        """Tell of a cycle."""
        if self.due(f"{status.state}{status.why.split(',')[0]}"):
            away = "" if error_m is None or status.why else f"{error_m / MM:.2f} mm from where it is wanted"
            self.draw(f"{status.state.upper():9} {away or status.why}")


class PlayLine(StatusLine):
    """The line of a path that is run."""

    def show(self, status: RobotStatus, at: PlayProgress, seen: WatchFigures | None) -> None:
        """Tell of a cycle."""
        if not self.due(f"{status.state}{at.stage}{at.paused}{status.why.split(',')[0]}"):
            return
        line = f"{status.state.upper():9} {at.stage}{' (paused)' if at.paused else ''} {100.0 * at.share:.0f} %"
        line += f", {at.s_m / MM:.1f} of {at.length_m / MM:.1f} mm at {at.speed_m_s / MM:.1f} mm/s"
        if seen is not None and seen.last_m is not None:
            line += f", seen {seen.last_m / MM:.2f} mm off"
        self.draw(line + (f": {status.why}" if status.why else ""))


def teach_keys(recorder: PathRecorder) -> dict[str, Callable[[], object]]:
    """Return what each key does."""
    from armsight.control.teach import Teaching
    from armsight.records import WELD_OFF, WELD_ON

    def space() -> None:
        if recorder.state is Teaching.RECORDING:
            recorder.pause()
        else:
            recorder.start()

    return {" ": space, "u": recorder.undo, "w": lambda: recorder.tag(WELD_ON), "e": lambda: recorder.tag(WELD_OFF)}


def motion_keys(source: PathSource | JointMotionSource) -> dict[str, Callable[[], object]]:
    """Return what each key does."""

    def space() -> None:
        if source.paused:
            source.resume()
        else:
            source.pause()

    def by(step: float) -> None:
        source.override = min(max(source.override + step, STEP), 1.0)

    return {" ": space, "+": lambda: by(STEP), "-": lambda: by(-STEP)}


def _steered(face: CommandUI, told: str, keys: Mapping[str, Callable[[], object]]) -> None:
    """Tell what keys do, and do that when they are pressed, until the command ends."""
    from armsight.drivers.jog_inputs import listening

    face.say(told)
    face.held.enter_context(listening(keys))


def asks(face: CommandUI, asked: Asked) -> dict[str, Any]:
    """Return what asks whether the arm may move."""
    return {"confirm": face.moves(yes=asked["yes"])}


def _servo(face: CommandUI, asked: Asked) -> dict[str, Any]:
    face.until_stopped = asked.get("seconds_s") is None
    return {**asks(face, asked), "show": ServoLine(face).show}


def _teach(face: CommandUI, asked: Asked) -> dict[str, Any]:
    return {**_servo(face, asked), "begun": lambda recorder: _steered(face, TEACH_KEYS, teach_keys(recorder))}


def _run(face: CommandUI, asked: Asked) -> dict[str, Any]:
    return {**asks(face, asked), "begun": lambda source: _steered(face, PLAY_KEYS, motion_keys(source))}


def _play(face: CommandUI, asked: Asked) -> dict[str, Any]:
    return {**_run(face, asked), "show": PlayLine(face).show}


add_action(app, motion.servo, flags=yes, beside=_servo)
add_action(app, teach, flags=yes, beside=_teach, panels=(CAMERAS, ARM, SIMULATED))
add_action(app, motion.play, flags=yes, beside=_play)
add_action(robot, robots.jog, flags=yes, beside=asks)
add_action(robot, robots.run_motion, flags=yes, beside=_run, panels=(ARM, CAMERAS, SETTINGS))


@command(app, json=False)
def twin(face: CommandUI, job: TwinJob) -> None:
    """Emulate a robot's controller, for tests without a robot; Ctrl-C ends it. Prints what --robot takes."""
    face.until_stopped = True
    from armsight.ops.robot.twin import run_twin

    stop = face.progress("twin")
    on = lambda: not stop.cancelled()  # noqa: E731
    run_twin(**vars(job), on=on, ready=typer.echo, warn=face.say)
