"""armsight calibrate cell-plan, and armsight robot run: a motion that calibrates a cell, planned and run."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

from armsight.app.requests.cell_plan import KNOWN, MOTION, CellPlanJob, RunMotionJob
from armsight.app.requests.motion import ARM, CAMERAS
from armsight.app.requests.shared import CAMERAS as SETTINGS
from armsight.cli.command import calibrate, command, robot
from armsight.cli.command_ui import CommandUI
from armsight.cli.motion import PLAY_KEYS, STEP
from armsight.cli.tables import figure
from armsight.fields import Doc
from armsight.units import MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.app.calibrate.cell_plan import CellPlanOutput
    from armsight.control.play.joint_motion import JointMotionSource

MOST_M = 0.1
"""A tip known no better than this is not known."""


@command(calibrate, "cell-plan", panels=(KNOWN, MOTION))
def cell_plan(face: CommandUI, job: CellPlanJob) -> None:
    """Plan the motion that calibrates a cell best: two minutes that tell most of the tip over a volume.

    Within the limits, in view of both cameras, clear of the boxes. Run it with armsight robot run. `calibrate cell
    --plan` is the same.
    """
    from armsight.app.calibrate.cell_plan import run_cell_plan

    done = run_cell_plan(job, face.progress("planning"))
    plan_tables(face, done)
    face.result(done)


def plan_tables(face: CommandUI, done: CellPlanOutput) -> None:
    """Print what a motion leads to."""
    moved = ", ".join(figure(value, 3) for value in done.moved)
    face.say(f"{done.kind}: {done.duration_s:.0f} s, {done.n_rows} rows; joints over {moved} (rad or m)")
    if done.kinds:
        rows = [[one.name, _before(one.before_m), figure(one.after_m / MM), ""] for one in done.kinds]
        for name, *values in (
            ("tip, cameras", done.measured_before_m, done.measured_after_m, done.measured_least_m),
            ("tip, joints", done.commanded_before_m, done.commanded_after_m, done.commanded_least_m),
        ):
            rows.append([name, _before(values[0]), *(figure(None if v is None else v / MM) for v in values[1:])])
        title = "Deviation of the tip over the volume, mm RMS"
        face.table(title, ["", "before", "after", "not to be told by motion"], rows)
    if done.seen is not None:
        face.say(f"both cameras see all lights in {100.0 * done.seen:.0f} % of the time")
    if done.untold:
        face.say("Not told by it: " + ", ".join(done.untold))
    for note in done.notes:
        face.say(f"- {note}")
    face.say(f"Motion: {done.file}")


def _before(value_m: float | None) -> str:
    """Return what is known beforehand in mm; that it is nothing, where it is far beyond what is linear."""
    return "unknown" if value_m is None or value_m > MOST_M else figure(value_m / MM)


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


@command(robot, keeps=("motion.json", "motion.mcap", "joints.csv", "frames.mcap"), panels=(ARM, CAMERAS, SETTINGS))
def run(face: CommandUI, job: RunMotionJob, yes: Annotated[bool, Doc("Move without asking.")] = False) -> None:
    """Run a motion of the joints through the guard, and record the readings. Ctrl-C brings the arm to rest.

    The whole motion is checked first. Both cameras are recorded beside it, from before it until after it: one that
    fails or falls silent brings the arm to rest.
    """
    from armsight.app.robot.jog_by_hand import listening
    from armsight.app.robot.run_motion import run_motion

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
