"""armsight robot, and armsight twin."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.app import requests
from armsight.app.requests.motion import ARM, CAMERAS
from armsight.app.requests.run_motion import RunMotionJob
from armsight.cli.command import app, command, robot
from armsight.cli.command_ui import CommandUI
from armsight.cli.flags import PartialRequest
from armsight.cli.motion import PLAY_KEYS, STEP
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.ops.flags import CAMERAS as SETTINGS

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.control.play.path_source import JointMotionSource


@command(robot)
def test(face: CommandUI, job: requests.motion.RobotTestJob) -> None:
    """Read a robot once a cycle and tell how punctual that is. Nothing moves."""
    from armsight.app.robot.link_test import test_robot as run

    done = run(job, face.progress("reading"))
    face.say(
        f"{done.driver}: {done.n_cycles} cycles of {1e3 * done.cycle_s:g} ms, {done.late} late, {done.missed} "
        f"missed; periods {done.period_ms.median:.3f} ms median, {done.period_ms.p99:.3f} p99, "
        f"{done.period_ms.max:.3f} longest; new readings at most {done.silence_ms:.0f} ms apart. "
        + (
            ""
            if done.measured_cycle_s is None
            else f"Its controller sends every {1e3 * done.measured_cycle_s:.3g} ms. "
        )
        + f"The robot is {done.state}"
        + (f"; {done.proof}." if done.proof else ".")
    )
    face.result(done)


@command(robot)
def jog(
    face: CommandUI,
    *,
    robot: requests.motion.RobotName,
    joint: Annotated[int | None, requests.motion.JOINT] = None,
    by: Annotated[float | None, requests.motion.HOW_FAR, requests.motion.A_WAY] = None,
    led: PartialRequest[requests.motion.HandJogJob],
    one: PartialRequest[requests.motion.JogJob],
    yes: Annotated[bool, Doc("Move without asking.")] = False,
) -> None:
    """Move one joint by a given way (--joint, --by), or the arm by hand (--with), through the guard.

    Ctrl-C brings it to rest.
    """
    from armsight.app.robot.jog import jog_by_hand, jog_robot

    hand = led.value("hand")
    if hand is not None and joint is None and by is None:
        done = jog_by_hand(led.made(), face.moves(yes=yes), face.progress("moving by hand"))
        face.say(f"the joints stand at {', '.join(figure(v, 6) for v in done.reached)} (rad or m)")
    elif hand is None and joint is not None and by is not None:
        done = jog_robot(one.made(), face.moves(yes=yes), face.progress("moving"))
        face.say(f"joint {joint} stands at {figure(done.reached[joint - 1], 6)} (rad or m); the robot is {done.state}")
    else:
        raise UsageError(
            "it is not clear what is to move",
            consequence="Nothing is moved",
            cure="Give --joint and --by for one way, or --with keyboard or gamepad alone",
        )
    face.result(done)


@command(robot, keeps=("motion.json", "motion.mcap", "joints.csv", "frames.mcap"), panels=(ARM, CAMERAS, SETTINGS))
def run(face: CommandUI, job: RunMotionJob, yes: Annotated[bool, Doc("Move without asking.")] = False) -> None:
    """Run a motion of the joints through the guard, and record the readings. Ctrl-C brings the arm to rest.

    The whole motion is checked first. Both cameras are recorded beside it, from before it until after it: one that
    fails or falls silent brings the arm to rest.
    """
    from armsight.app.robot.run_motion import run_motion
    from armsight.drivers.jog_inputs import listening

    with ExitStack() as stack:

        def begun(source: JointMotionSource) -> None:
            face.say(PLAY_KEYS)
            stack.enter_context(listening(run_keys(source)))

        done = run_motion(job, face.moves(yes=yes), face.progress("moving"), begun=begun)
    face.say(
        f"{100.0 * done.share:.0f} % of the motion in {done.took_s:.1f} s; {done.n_cycles} cycles, "
        f"{done.late} late, {done.missed} missed; ended by: {done.stopped_by}"
    )
    for why in done.holds:
        face.say(f"  it held: {why}")
    face.say(f"Recording: {done.recording}; readings: {done.joints}")
    for one in done.cameras:
        lost = f", {one.n_dropped} dropped" if one.n_dropped else ""
        face.say(f"{one.camera}: {one.n_frames} frames over {one.duration_s:.1f} s{lost}: {done.frames}")
    face.result(done)


def run_keys(source: JointMotionSource) -> dict[str, Callable[[], None]]:
    """Return what each key does."""

    def space() -> None:
        if source.paused:
            source.resume()
        else:
            source.pause()

    def by(step: float) -> None:
        source.override = min(max(source.override + step, STEP), 1.0)

    return {" ": space, "+": lambda: by(STEP), "-": lambda: by(-STEP)}


@command(app, json=False)
def twin(face: CommandUI, job: requests.motion.TwinJob) -> None:
    """Emulate a robot's controller, for tests without a robot; Ctrl-C ends it. Prints what --robot takes."""
    face.until_stopped = True
    from armsight.app.robot.twin import run_twin

    stop = face.progress("twin")
    on = lambda: not stop.cancelled()  # noqa: E731
    run_twin(**vars(job), on=on, ready=typer.echo, warn=face.say)
