"""armsight teach."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, OutFolder, quantity
from armsight.cli.servo import ARM, CAMERAS, SIMULATED, ServoLine, servo_tables
from armsight.errors import UsageError
from armsight.units import MM

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from armsight.app.schemas.teach import TeachOutput
    from armsight.app.servo.servo_job import ServoJob
    from armsight.app.teach import StandingJob, TeachJob
    from armsight.control.teach import PathRecorder

KEYS = "space: pause and go on; u: undo the last stretch; w: weld on; e: weld off"


def teach(
    out: OutFolder,
    robot: Annotated[
        str | None,
        typer.Option(metavar="DRIVER:DEVICE", help="Robot that follows the target meanwhile. [default: none]"),
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml of the cameras.")] = None,
    target: Annotated[Path | None, typer.Option(help="target.yaml of the lights that are led along.")] = None,
    handeye: Annotated[Path | None, typer.Option(help="handeye.yaml; with --robot.")] = None,
    world: Annotated[
        Path | None, typer.Option(help="world.yaml: where cameras that stand are; without --robot.")
    ] = None,
    poses: Annotated[
        Path | None, typer.Option("--from", metavar="poses.csv", help="Make the path of poses that were measured.")
    ] = None,
    tip: Annotated[
        Path | None, typer.Option(help="tip.yaml of the needle, in target axes. [default: the target's origin]")
    ] = None,
    every: Annotated[int, typer.Option(help="Frames per pose of the path.")] = 1,
    mean: Annotated[bool, typer.Option("--mean", help="A pose is the mean of its frames, not the last one.")] = False,
    path_speed: Annotated[
        float | None,
        typer.Option(help="Speed to be run at, written into the path. [default: left open]", **quantity("m/s")),
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Record nothing until the space key.")] = False,
    seconds: Annotated[float | None, typer.Option(help="End after so long. [default: Ctrl-C]")] = None,
    left: Annotated[
        str | None, typer.Option(metavar="SRC", help="Left camera, or its file.", rich_help_panel=CAMERAS)
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="SRC", help="Right camera, or its file.", rich_help_panel=CAMERAS)
    ] = None,
    image: Annotated[
        str | None, typer.Option(metavar="SRC", help="The one camera of a mirror rig.", rich_help_panel=CAMERAS)
    ] = None,
    latency: Annotated[
        float, typer.Option(help="From exposure to the frame in memory, s.", rich_help_panel=CAMERAS)
    ] = 0.03,
    exposure: Annotated[float | None, typer.Option(help="Exposure, s.", rich_help_panel=CAMERAS)] = None,
    distance: Annotated[
        float, typer.Option(help="How far along that axis the target is kept.", rich_help_panel=ARM, **quantity("m"))
    ] = 0.6,
    at: Annotated[str, typer.Option(help="Whose axis: camera or tool.", rich_help_panel=ARM)] = "camera",
    gain: Annotated[float | None, typer.Option(help="Gain in 1/s. [default: as servo]", rich_help_panel=ARM)] = None,
    rotation: Annotated[
        str, typer.Option(help="How the arm turns after the target: align, keep or hold.", rich_help_panel=ARM)
    ] = "align",
    arm: Annotated[Path | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}.", rich_help_panel=ARM)] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml: what the guard keeps.", rich_help_panel=ARM)] = None,
    speed: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of the limits' speeds, up to 1.", rich_help_panel=ARM)
    ] = 1.0,
    arm_lag: Annotated[
        float | None, typer.Option(help="From a command to the arm's motion, s.", rich_help_panel=ARM)
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(help="How the target is led: still, circle, trapezium, random.", rich_help_panel=SIMULATED),
    ] = None,
    hand_speed: Annotated[float, typer.Option(help="How fast.", rich_help_panel=SIMULATED, **quantity("m/s"))] = 0.05,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    json: AsJson = False,
) -> None:
    """Teach a path by leading the target along it: the path of the tip at each exposure goes into OUT/path.csv.

    With --robot the arm follows meanwhile; without one the cameras stand (--world), or --from takes poses.csv.
    """
    with CommandUI(as_json=json, until_stopped=seconds is None) as face:
        from armsight.app.servo.servo_job import ServoJob
        from armsight.app.teach import StandingJob, TeachJob, teach_poses

        job = TeachJob(out=out, tip=tip, every=every, mean=mean, path_speed_m_s=path_speed, wait=wait)
        cameras: dict[str, Any] = {
            "left": left,
            "right": right,
            "image": image,
            "exposure_s": exposure,
            "seconds_s": seconds,
        }
        if poses is not None:
            refuse_beside("--from", {"--robot": robot, "--rig": rig, "--left": left, "--image": image})
            done = teach_poses(job, poses, world=world)
        elif rig is not None and target is not None and robot is None:
            refuse_beside("no --robot", {"--handeye": handeye, "--arm": arm, "--limits": limits, "--hand": hand})
            done = standing_taught(face, job, StandingJob(rig=rig, target=target, world=world, **cameras))
        elif rig is not None and target is not None and robot is not None and handeye is not None:
            refuse_beside("--robot", {"--world": world})
            servo = ServoJob(
                robot=robot,
                rig=rig,
                target=target,
                handeye=handeye,
                out=out,
                at=at,
                distance_m=distance,
                gain=gain,
                rotation=rotation,
                arm=arm,
                limits=limits,
                speed=speed,
                arm_lag_s=arm_lag,
                latency_s=latency,
                hand=hand,
                hand_speed_m_s=hand_speed,
                **cameras,
            )
            done = following_taught(face, job, servo, yes=yes)
        else:
            needed = "--rig, --target" + (" and --handeye" if robot is not None else "")
            raise UsageError(
                f"{needed} are needed", consequence="Nothing is taught", cure="Give them, or --from poses.csv"
            )
        teach_tables(face, done)
        face.result(done)


def standing_taught(face: CommandUI, job: TeachJob, seen_by: StandingJob) -> TeachOutput:
    """Teach before cameras that stand, with keys to steer it."""
    from armsight.app.robot.jog_by_hand import listening
    from armsight.app.teach import teach_standing

    with ExitStack() as stack:

        def begun(recorder: PathRecorder) -> None:
            face.say(KEYS)
            stack.enter_context(listening(key_actions(recorder)))

        return teach_standing(job, seen_by, face.progress("teaching"), begun=begun)


def following_taught(face: CommandUI, job: TeachJob, servo: ServoJob, *, yes: bool) -> TeachOutput:
    """Teach while the arm follows, after asking, with keys to steer it."""
    from armsight.app.robot.jog_by_hand import listening
    from armsight.app.teach import teach_following

    recorders: list[PathRecorder] = []
    with ExitStack() as stack:

        def confirm(question: str) -> bool:
            face.say(question)
            try:
                agreed = yes or typer.confirm("Move?", err=True)
            except typer.Abort:  # nobody there to ask
                agreed = False
            if agreed:
                face.say(KEYS)
                stack.enter_context(listening(key_actions(recorders[0])))
            return agreed

        show, progress = ServoLine(face).show, face.progress("teaching")
        return teach_following(job, servo, confirm, show, progress, begun=recorders.append)


def refuse_beside(what: str, others: Mapping[str, object]) -> None:
    """Raise UsageError for options that mean nothing beside another."""
    given = ", ".join(name for name, value in others.items() if value is not None)
    if given:
        raise UsageError(f"with {what}, {given} means nothing", consequence="Nothing is taught", cure="Leave it out")


def key_actions(recorder: PathRecorder) -> dict[str, Callable[[], object]]:
    """Return what each key does."""
    from armsight.control.teach import Teaching
    from armsight.records import WELD_OFF, WELD_ON

    def space() -> None:
        if recorder.state is Teaching.RECORDING:
            recorder.pause()
        else:
            recorder.start()

    return {
        " ": space,
        "u": recorder.undo,
        "w": lambda: recorder.tag(WELD_ON),
        "e": lambda: recorder.tag(WELD_OFF),
    }


def teach_tables(face: CommandUI, done: TeachOutput) -> None:
    """Print what teaching came to."""
    if done.servo is not None:
        servo_tables(face, done.servo)
    face.say(
        f"{done.n_rows} poses over {done.length_m / MM:.1f} mm in {done.n_stretches} stretches, frame: {done.parent}; "
        f"of the frames while recording {done.n_ok} were taken, {done.n_position_only} told the place only, "
        f"{done.n_lost} did not show the target, {done.n_unplaced} came when the arm's place was not known; "
        f"ended by: {done.stopped_by}. Path: {done.path}"
    )
    if done.parent == "base":
        face.say("note: the path is in base axes: play it with --frame base")
    elif done.parent != "world":
        face.say("note: without --world the path is in the axes of poses.csv: play it only if those are the world's")
