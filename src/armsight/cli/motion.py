"""armsight servo, armsight teach and armsight play."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.cli.command import ResultsDoubted, app, command
from armsight.cli.command_ui import CommandUI, StatusLine
from armsight.cli.flags import PartialRequest
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.ops.flags import OutFolder
from armsight.units import DEG, MM, MS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from armsight.app.play.play_path import PlayOutput
    from armsight.app.servo.run_servo import ServoOutput
    from armsight.app.teach import TeachOutput
    from armsight.control.play import PathSource, PlayProgress, WatchFigures
    from armsight.control.status import RobotStatus
    from armsight.control.teach import PathRecorder

PLAY_KEYS = "space: pause and go on; + and -: faster and slower by a tenth of the planned speed"
TEACH_KEYS = "space: pause and go on; u: undo the last stretch; w: weld on; e: weld off"
STEP = 0.1
Yes = Annotated[bool, Doc("Move without asking.")]


@command(app, keeps=("servo.json", "servo.mcap"))
def servo(face: CommandUI, job: requests.motion.ServoJob, yes: Yes = False) -> None:
    """Follow a target that the cameras see, through the guard. Ctrl-C brings the arm to rest."""
    face.until_stopped = job.seconds_s is None
    from armsight.app.servo.run_servo import run_servo

    done = run_servo(job, face.moves(yes=yes), ServoLine(face).show, face.progress("servo"))
    servo_tables(face, done)
    face.result(done)
    if done.wrong_premise is not None:
        raise ResultsDoubted


class ServoLine(StatusLine):
    """The line of a servo."""

    def show(self, status: RobotStatus, error_m: float | None) -> None:
        """Tell of a cycle."""
        if self.due(f"{status.state}{status.why.split(',')[0]}"):
            away = "" if error_m is None or status.why else f"{error_m / MM:.2f} mm from where it is wanted"
            self.draw(f"{status.state.upper():9} {away or status.why}")


def servo_tables(face: CommandUI, done: ServoOutput) -> None:
    """Print what a servo came to."""
    if done.gain.note:
        face.say(f"note: {done.gain.note}")
    face.say(
        f"{done.n_cycles} cycles, {done.late} late, {done.missed} missed; {done.n_frames} pairs of frames, {done.n_ok} "
        f"whole, {done.n_position_only} place only, {done.n_lost} without the target; ended by: {done.stopped_by}"
    )
    if done.error.rms_m is not None and done.error.max_m is not None and done.error.last_m is not None:
        face.say(
            f"followed in {100.0 * done.followed:.0f} % of the cycles; {figure(done.error.rms_m / MM)} mm RMS from "
            f"where it is wanted, {figure(done.error.max_m / MM)} mm at most, {figure(done.error.last_m / MM)} mm and "
            f"{figure((done.error.last_rad or 0.0) / DEG)} deg at the end"
        )
    for why in done.holds:
        face.say(f"  it held: {why}")
    face.say(
        f"gain {figure(done.gain.used)} 1/s; delay {done.delay.camera_s / MS:.0f} ms of the cameras, "
        f"{done.delay.arm_s / MS:.0f} ms of the arm. Recording: {done.recording}"
    )


@command(
    app,
    keeps=("teach.json", "path.csv", "targets.csv", "servo.json", "servo.mcap"),
    panels=("Cameras", "Arm and guard", "Simulated cell"),
)
def teach(
    face: CommandUI,
    *,
    out: OutFolder,
    servo: PartialRequest[requests.motion.FollowJob],
    world: requests.motion.StandingWorld = None,
    poses: Annotated[
        Path | None, Doc("Make the path of poses that were measured."), Flag("--from", metavar="poses.csv")
    ] = None,
    job: requests.motion.TeachJob,
    standing: PartialRequest[requests.motion.StandingJob],
    yes: Yes = False,
) -> None:
    """Teach a path by leading the target along it: the path of the tip at each exposure goes into OUT/path.csv.

    With --robot the arm follows meanwhile; without one the cameras stand (--world), or --from takes poses.csv.
    """
    seconds_s = standing.value("seconds_s")
    face.until_stopped = seconds_s is None
    from armsight.app.teach import teach_poses

    given = {name: servo.value(name) for name in ("robot", "rig", "target", "left", "image", "handeye", "arm")}
    if poses is not None:
        refuse_beside("--from", {f"--{name}": given[name] for name in ("robot", "rig", "left", "image")})
        done = teach_poses(job, poses, world=world)
    elif not standing.missing and given["robot"] is None:
        others = {f"--{name}": servo.value(name) for name in ("handeye", "arm", "limits", "hand")}
        refuse_beside("no --robot", others)
        done = standing_taught(face, job, standing.made())
    elif not servo.missing:
        refuse_beside("--robot", {"--world": world})
        done = following_taught(face, job, servo.made(seconds_s=seconds_s), yes=yes)
    else:
        needed = "--rig, --target" + (" and --handeye" if given["robot"] is not None else "")
        raise UsageError(f"{needed} are needed", consequence="Nothing is taught", cure="Give them, or --from poses.csv")
    teach_tables(face, done)
    face.result(done)
    if done.servo is not None and done.servo.wrong_premise is not None:
        raise ResultsDoubted


def standing_taught(
    face: CommandUI, job: requests.motion.TeachJob, seen_by: requests.motion.StandingJob
) -> TeachOutput:
    """Teach before cameras that stand, with keys to steer it."""
    from armsight.app.teach import teach_standing
    from armsight.drivers.jog_inputs import listening

    with ExitStack() as stack:

        def begun(recorder: PathRecorder) -> None:
            face.say(TEACH_KEYS)
            stack.enter_context(listening(teach_keys(recorder)))

        return teach_standing(job, seen_by, face.progress("teaching"), begun=begun)


def following_taught(
    face: CommandUI, job: requests.motion.TeachJob, servo: requests.motion.ServoJob, *, yes: bool
) -> TeachOutput:
    """Teach while the arm follows, after asking, with keys to steer it."""
    from armsight.app.teach import teach_following
    from armsight.drivers.jog_inputs import listening

    recorders: list[PathRecorder] = []
    asked = face.moves(yes=yes)
    with ExitStack() as stack:

        def confirm(question: str) -> bool:
            agreed = asked(question)
            if agreed:
                face.say(TEACH_KEYS)
                stack.enter_context(listening(teach_keys(recorders[0])))
            return agreed

        show, progress = ServoLine(face).show, face.progress("teaching")
        return teach_following(job, servo, confirm, show, progress, begun=recorders.append)


def refuse_beside(what: str, others: Mapping[str, object]) -> None:
    """Raise UsageError for options that mean nothing beside another."""
    given = ", ".join(name for name, value in others.items() if value is not None)
    if given:
        raise UsageError(f"with {what}, {given} means nothing", consequence="Nothing is taught", cure="Leave it out")


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


@command(app, keeps=("play.json", "play.mcap"))
def play(face: CommandUI, job: requests.motion.PlayJob, yes: Yes = False) -> None:
    """Run a path with the tip of the tool, through the guard. Ctrl-C brings the arm to rest.

    The whole way is checked first; before anything moves it is told in mm and degrees, and asked for.
    """
    from armsight.app.play.play_path import run_play
    from armsight.drivers.jog_inputs import listening

    with ExitStack() as stack:

        def begun(source: PathSource) -> None:
            face.say(PLAY_KEYS)
            stack.enter_context(listening(play_keys(source)))

        done = run_play(job, face.moves(yes=yes), PlayLine(face).show, face.progress("playing"), begun=begun)
        play_tables(face, done)
        face.result(done)
        if done.wrong_premise is not None:
            raise ResultsDoubted


def play_keys(source: PathSource) -> dict[str, Callable[[], None]]:
    """Return what each key does."""

    def space() -> None:
        if source.progress.paused:
            source.resume()
        else:
            source.pause()

    def by(step: float) -> None:
        source.override = min(max(source.override + step, STEP), 1.0)

    return {" ": space, "+": lambda: by(STEP), "-": lambda: by(-STEP)}


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


def play_tables(face: CommandUI, done: PlayOutput) -> None:
    """Print what playing came to."""
    face.say(
        f"{100.0 * done.share:.0f} % of {done.length_m / MM:.1f} mm in {done.took_s:.1f} s; {done.n_cycles} cycles, "
        f"{done.late} late, {done.missed} missed; ended by: {done.stopped_by}"
    )
    seen = done.measured
    if seen is not None and seen.rms_m is not None and seen.max_m is not None:
        face.say(
            f"the cameras saw the tip {figure(seen.rms_m / MM)} mm RMS from where it was told to be, "
            f"{figure(seen.max_m / MM)} mm at most, in {seen.n} frames (the arm lags by {seen.arm_lag_s / MS:.0f} ms)"
        )
    elif seen is not None:
        face.say(f"note: no frame showed the tip ({seen.n_lost} without the target): it was not watched")
    for why in done.holds:
        face.say(f"  it held: {why}")
    face.say(f"Recording: {done.recording}")
