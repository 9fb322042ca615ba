"""armsight verify: rows of a file, a plan of a test, a running arm (--live), and an arm after a crash (--mastering)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armsight.app import requests
from armsight.app.requests.plant import PLANT
from armsight.cli.command import app, command
from armsight.cli.command_ui import CommandUI, StatusLine
from armsight.cli.flags import PartialRequest
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.file_names import VERIFIED
from armsight.ops.flags import (
    CAMERAS,
    LIVE,
    MASTERING,
    TABLES,
    Base,
    CameraFlags,
    OutFolder,
    Tip,
    TwoTableFlags,
)
from armsight.shown import REJECTED_SHOWN
from armsight.units import DEG, MM, MS, displayed_name

if TYPE_CHECKING:
    from armsight.app.verify.plan import VerifyPlanOutput
    from armsight.records import TargetPose
    from armsight.verify.results import VerifyJoint, VerifyLiveOutput, VerifyOutput
    from armsight.verify.supervision import Compared, Level


@command(app, keeps=VERIFIED, panels=(TABLES, LIVE, MASTERING, CAMERAS, PLANT), filed="verify", judged=True)
def verify(
    face: CommandUI,
    *,
    out: OutFolder,
    rows: PartialRequest[requests.verify.VerifyJob],
    plan: Annotated[bool, Doc("Instead of verifying, plan the test of ISO 9283 for --arm.")] = False,
    planned: PartialRequest[requests.verify.PlanJob],
    tip: Tip = None,
    base: Base = None,
    tables: PartialRequest[TwoTableFlags],
    live: Annotated[
        bool, Doc("Supervise a running arm before two live cameras, with --arm, --world."), Flag(panel=LIVE)
    ] = False,
    running: PartialRequest[requests.verify.LiveVerifyJob],
    mastering: Annotated[
        bool, Doc("After a crash: propose ten poses; with --measured, judge them."), Flag(panel=MASTERING)
    ] = False,
    crashed: PartialRequest[requests.verify.MasteringJob],
    cameras: PartialRequest[CameraFlags],
) -> None:
    """Compare measured poses with where the arm says it is, say what the difference comes from; figures of ISO 9283.

    Writes verify.json, errors.csv and report.html; with --plan plan.csv and plan.json.
    """
    of_plan = (*_named(plan=plan), *planned.given)
    of_rows = (*rows.given, *of_plan, *_named(tip=tip, base=base), *tables.given)
    if live:
        others = (*of_rows, *_named(mastering=mastering), *crashed.given)
        _supervise(face, running, cameras, _foreign(others, running.flags))
        return
    if mastering:
        others = (*of_rows, *running.given, *cameras.given)
        _after_crash(face, crashed, _foreign(others, crashed.flags))
        return
    others = (*running.given, *crashed.given, *cameras.given)
    foreign = _foreign(others, rows.flags)
    if foreign:
        raise UsageError(
            f"{', '.join(foreign)} only means something with --live or --mastering", cure="Add one, or leave it out"
        )
    _check_plan(plan, rows, planned)
    from armsight._files import arm_source
    from armsight.app.verify.plan import run_plan
    from armsight.app.verify.run import run_verify

    chosen: dict[str, Any] = {}
    if tip is not None or base is not None:
        chosen["arm"] = arm_source(_given(rows.value("arm")), tip=tip, base=base)
    if plan:
        proposed = run_plan(planned.made(**chosen))
        plan_table(face, proposed, out)
        face.result(proposed)
        return
    if rows.missing:
        raise UsageError("no measurements were given", cure="Give --measured FILE, or --plan with --arm")
    done = run_verify(rows.made(table=tables.made().made(face.say), **chosen))
    verify_tables(face, done, out)
    face.result(done)


def _named(**flags: object) -> tuple[str, ...]:
    return tuple(f"--{name}" for name, value in flags.items() if value not in (None, False))


def _foreign(given: tuple[str, ...], known: tuple[str, ...]) -> list[str]:
    """Return the flags that a way of verifying knows nothing of, once each."""
    return [one for one in dict.fromkeys(given) if one not in known]


def _given(arm: str | None) -> str:
    """Return the arm; UsageError where --tip or --base is of none."""
    if arm is None:
        raise UsageError("--tip and --base choose a chain of an arm, and none was given", cure="Give --arm FILE.urdf")
    return arm


def _check_plan(
    plan: bool, rows: PartialRequest[requests.verify.VerifyJob], planned: PartialRequest[requests.verify.PlanJob]
) -> None:
    """Raise UsageError where options of a plan and of a verification are mixed."""
    of_plan = [one for one in planned.given if one not in rows.flags]
    if not plan and of_plan:
        name = next((one for one in ("--side", "--speed") if one in of_plan), repr(planned.value("part")))
        raise UsageError(f"{name} goes with --plan", cure="Add --plan, or leave it out")
    if plan and _foreign(rows.given, planned.flags):
        raise UsageError(
            "--plan plans a test, and files to verify were given too",
            consequence="Nothing is planned or verified",
            cure="Plan with --plan, --arm and -o alone; verify without --plan",
        )


def plan_table(face: CommandUI, done: VerifyPlanOutput, out: Path) -> None:
    """Print a plan."""
    centre = ", ".join(f"{value:.3f}" for value in done.cube.centre_m)
    face.say(f"Cube of {done.cube.side_m / MM:.0f} mm about ({centre}) m in the base frame, {', '.join(done.branch)}")
    for text in done.refused:
        face.say(f"  not {text}")
    rows = [[motion.test, ", ".join(motion.figures), str(motion.repeats), str(motion.n)] for motion in done.motions]
    face.table("Motions", ["tag", "figures", "repeats", "rows"], rows)
    face.say(f"Speed {done.speed_m_s:.3g} m/s. The arm's body and the cell are not checked: run it slowly first.")
    face.say(f"Results: {out / 'plan.csv'}")


def verify_tables(face: CommandUI, done: VerifyOutput, out: Path) -> None:
    """Print a verification."""
    rows = []
    for name, item in done.task.items():
        stem, unit, factor = displayed_name(name)
        own = done.measurement_std.get(name)
        values = (item.me, item.mae, item.max, item.sd, own)
        shown = [figure(None if value is None else value / factor) for value in values]
        rows.append([f"{stem} {unit}", *shown])
    if rows:
        face.table("Measured minus expected", ["", "mean", "mean abs.", "largest", "sd", "measurement +-"], rows)
    _joints_and_frames(face, done)
    for text in done.doubts:
        face.say(f"  {text}")
    for left in done.rejected[:REJECTED_SHOWN]:
        face.say(f"  left out: row {left.row}: {left.why}")
    if len(done.rejected) > REJECTED_SHOWN:
        face.say(f"  ... and {len(done.rejected) - REJECTED_SHOWN} more, see verify.json")
    _iso_table(face, done)
    if done.compared is not None and done.compared.after is not None and done.after is not None:
        before, after = done.compared.after.rms_m / MM, done.after.rms_m / MM
        face.say(f"Beside {done.compared.folder}: {figure(before)} mm RMS there, {figure(after)} here")
    face.say(f"Cause: {done.cause}. {done.verdict}" if done.task else done.verdict)
    for q in done.decide_by or ():
        face.say("  measure at " + ", ".join(f"{value:.4f}" for value in q))
    face.say(f"Results: {out}; open {out / 'report.html'}")


def _joints_and_frames(face: CommandUI, done: VerifyOutput) -> None:
    if done.joints:
        header = ["joint", "mean deg", "mean abs.", "largest", "zero deg", "+-", "alone explains"]
        face.table("Joints", header, [_joint_row(joint) for joint in done.joints])
    if done.time.offset_s is not None and done.time.std_s is not None:
        face.say(f"Time offset {done.time.offset_s:.6f} s +- {figure(done.time.std_s / MS, 2)} ms")
    if done.alignment.undetermined:
        face.say(f"Not determined by these rows: {', '.join(done.alignment.undetermined)}")


def _iso_table(face: CommandUI, done: VerifyOutput) -> None:
    """Print the figures of ISO 9283 that are given, and why others are not."""
    from armsight.report.verify_report import symbol_of

    given = {name: item for name, item in done.iso9283.items() if " " not in name and item.n}
    rows = []
    for name, item in given.items():
        if item.value is not None:
            repeats = f"{item.n} of {item.wanted}" if item.n < item.wanted else str(item.n)
            symbol, unit, size = symbol_of(name)
            shown = (figure(None if one is None else one / size) for one in (item.value, item.std))
            rows.append([symbol, *shown, unit, repeats])
    if rows:
        face.table("ISO 9283, the worst place", ["figure", "value", "+-", "unit", "repeats"], rows)
    why: dict[str, list[str]] = {}
    for name, item in given.items():
        if item.withheld is not None:
            why.setdefault(item.withheld, []).append(name)
    for text, names in why.items():
        face.say(f"  withheld: {', '.join(names)}: {text}")


def _joint_row(joint: VerifyJoint) -> list[str]:
    values = (joint.me, joint.mae, joint.max, joint.offset_rad, joint.std_rad)
    shown = [figure(None if value is None else value / DEG) for value in values]
    gain = "-" if joint.gain_heldout is None else f"{100.0 * joint.gain_heldout:.1f} %"
    return [f"{joint.index} {joint.name}", *shown, gain if joint.judged else "not judged"]


def check_options(mode: str, missing: tuple[str, ...], foreign: list[str]) -> None:
    """Raise UsageError where options are missing that a mode needs, or given that it knows nothing of."""
    if missing:
        raise UsageError(f"{mode} lacks something", cure=f"Give {', '.join(missing)} with it")
    if foreign:
        raise UsageError(f"{', '.join(foreign)} means nothing with {mode}", cure="Leave it away")


def _supervise(
    face: CommandUI,
    asked: PartialRequest[requests.verify.LiveVerifyJob],
    cameras: PartialRequest[CameraFlags],
    foreign: list[str],
) -> None:
    face.until_stopped = asked.value("limit") is None and asked.value("seconds_s") is None
    from armsight.app.verify.live import run_verify_live

    check_options("--live", asked.missing, foreign)
    job = asked.made(camera_settings=cameras.made().made(face.say))
    line = LiveLine(face)
    done = run_verify_live(job, line.show, face.progress("supervising"), tell=face.say)
    live_tables(face, done, job.out)
    face.result(done)


def _after_crash(face: CommandUI, asked: PartialRequest[requests.verify.MasteringJob], foreign: list[str]) -> None:
    from armsight.app.verify.mastering import propose_mastering, run_mastering

    check_options("--mastering", asked.missing, foreign)
    job = asked.made()
    if job.measured is None:
        plan = propose_mastering(job)
        rows = [
            [f"{k}", *(f"{value:.4f}" for value in pose.q), " ".join(pose.decides)]
            for k, pose in enumerate(plan.poses, 1)
        ]
        header = ["pose", *(f"q{i + 1}" for i in range(len(plan.poses[0].q))), "decides"]
        face.table("Poses to measure, rad or m", header, rows)
        for note in plan.notes:
            face.say(f"- {note}")
        face.say(f"Drive to each and measure there; then give --measured poses.csv --joints {plan.file}")
        face.result(plan)
        return
    done = run_mastering(job)
    rows = []
    for joint in done.joints:
        shown = [figure(None if v is None else v / DEG) for v in (joint.offset_rad, joint.std_rad)]
        rows.append([f"{joint.index} {joint.name}", *shown, joint.why])
    face.table("Zeros", ["joint", "deg", "+-", ""], rows)
    for left in done.rejected:
        face.say(f"  left out: row {left.row}: {left.why}")
    for text in done.doubts:
        face.say(f"  {text}")
    face.say(f"Cause: {done.cause}. {done.verdict}")
    face.say(f"Results: {job.out}; open {job.out / 'report.html'}")
    face.result(done)


class LiveLine(StatusLine):
    """The line of a supervision."""

    def show(self, pose: TargetPose, compared: Compared | None, level: Level, lost: str) -> None:
        """Tell of a pair."""
        if not self.due((int(level), bool(lost))):
            return
        line = f"{pose.t_s:9.3f} s  "
        if compared is None:
            self.draw(f"{line}LOST  {lost}")
            return
        distance_mm, distance_std_mm = compared.error_m / MM, compared.std_m / MM
        turn, turn_std = compared.error_rad / DEG, compared.std_rad / DEG
        position_text = f"{distance_mm:.3f} +- {distance_std_mm:.3f} mm"
        self.draw(f"{line}{level.word.upper():4}  {position_text}  {turn:.3f} +- {turn_std:.3f} deg")


def live_tables(face: CommandUI, done: VerifyLiveOutput, out: Path) -> None:
    """Print what a supervision came to."""
    for alarm in done.alarms:
        face.say(f"  {alarm.t_s:.3f} s: {alarm.why}")
    rate = "-" if done.rate_hz is None else f"{done.rate_hz:.1f} a second"
    ms = "" if done.decision_ms is None else f"; decided in {figure(done.decision_ms.median)} ms (median)"
    face.say(
        f"{done.n} pairs, {rate}: {done.n_compared} compared, {done.n_lost} without the target, {done.n_stale} without "
        f"joints, {done.missed} never came{ms}"
    )
    if done.errors.rms_m is not None and done.errors.std_m is not None:
        face.say(
            f"Error of place {figure(done.errors.rms_m / MM)} mm RMS, of which noise explains "
            f"{figure(done.errors.std_m / MM)} mm; the decision's clock begins with a frame in memory"
        )
    for text in done.doubts:
        face.say(f"  {text}")
    face.say(done.verdict)
    face.say(f"Results: {out}; open {out / 'report.html'}")
