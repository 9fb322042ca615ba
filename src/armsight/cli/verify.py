"""armsight verify: rows of a file, a plan of a test, a running arm (--live), and an arm after a crash (--mastering)."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armsight.cli.actions import show
from armsight.cli.command import Command, add, app
from armsight.cli.command_ui import CommandUI, StatusLine
from armsight.cli.flags import PartialRequest
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.file_names import VERIFIED
from armsight.ops import mastering as after_crash
from armsight.ops import verify as ops
from armsight.ops.action import action_of
from armsight.ops.flags import (
    CAMERAS,
    LIVE,
    MASTERING,
    TABLES,
    OutFolder,
)
from armsight.ops.requests.plant import PLANT
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.records import TargetPose
    from armsight.verify.supervision import Compared, Level

VERIFY, PLANNING, SUPERVISION = action_of(ops.verify), action_of(ops.plan_verification), action_of(ops.supervise)
PROPOSAL, CHECK = action_of(after_crash.propose_mastering_poses), action_of(after_crash.check_mastering)
Mode = PartialRequest[dict[str, Any]]
VIEWS = ("--left", "--right")
"""Cameras, which a simulated cell brings."""
SCENE = ("--rig", "--target")
"""What cameras need to measure, and a tracker does not."""


def _taken() -> dict[str, tuple[Any, Any]]:
    live = Annotated[
        bool, Doc("Supervise a running arm before two live cameras, with --arm, --world."), Flag(panel=LIVE)
    ]
    mastering = Annotated[
        bool, Doc("After a crash: propose ten poses; with --measured, judge them."), Flag(panel=MASTERING)
    ]
    plan = Annotated[bool, Doc("Instead of verifying, plan the test of ISO 9283 for --arm.")]
    needed = inspect.Parameter.empty
    return {
        "out": (OutFolder, needed),
        "rows": (VERIFY.flags(), needed),
        "plan": (plan, False),
        "planned": (PLANNING.flags(), needed),
        "live": (live, False),
        "running": (SUPERVISION.flags(), needed),
        "mastering": (mastering, False),
        "crashed": (PROPOSAL.flags() | CHECK.flags(), needed),
    }


def verify(
    face: CommandUI,
    *,
    out: Path,
    rows: Mode,
    plan: bool,
    planned: Mode,
    live: bool,
    running: Mode,
    mastering: bool,
    crashed: Mode,
) -> None:
    """Compare measured poses with where the arm says it is, say what the difference comes from; figures of ISO 9283.

    Writes verify.json, errors.csv and report.html; with --plan plan.csv and plan.json.
    """
    of_rows = (*rows.given, *(("--plan",) if plan else ()), *planned.given)
    if live:
        others = (*of_rows, *(("--mastering",) if mastering else ()), *crashed.given)
        _supervise(face, running, _foreign(others, running.flags), out)
        return
    if mastering:
        _after_crash(face, crashed, _foreign((*of_rows, *running.given), crashed.flags), out)
        return
    foreign = _foreign((*running.given, *crashed.given), rows.flags)
    if foreign:
        raise UsageError(
            f"{', '.join(foreign)} only means something with --live or --mastering", cure="Add one, or leave it out"
        )
    _check_plan(plan, rows, planned)
    if plan:
        show(face, PLANNING.run(planned.made()), out)
        return
    if rows.missing:
        raise UsageError("no measurements were given", cure="Give --measured FILE, or --plan with --arm")
    show(face, VERIFY.run(rows.made()), out)


def _foreign(given: tuple[str, ...], known: tuple[str, ...]) -> list[str]:
    """Return the flags that a way of verifying knows nothing of, once each."""
    return [one for one in dict.fromkeys(given) if one not in known]


def _check_plan(plan: bool, rows: Mode, planned: Mode) -> None:
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
    if plan and "--arm" in planned.missing:
        raise UsageError("a plan is made for an arm, and none was given", cure="Give --arm with its file or preset")


def check_options(mode: str, missing: tuple[str, ...], foreign: list[str]) -> None:
    """Raise UsageError where options are missing that a mode needs, or given that it knows nothing of."""
    if missing:
        raise UsageError(f"{mode} lacks something", cure=f"Give {', '.join(missing)} with it")
    if foreign:
        raise UsageError(f"{', '.join(foreign)} means nothing with {mode}", cure="Leave it away")


def _supervise(face: CommandUI, asked: Mode, foreign: list[str], out: Path) -> None:
    brought = (*VIEWS, *SCENE) if "--tracker" in asked.given else VIEWS if "--follow" in asked.given else ()
    missing = tuple(one for one in asked.missing if one not in brought)
    check_options("--live", missing, foreign)
    given: dict[str, Any] = {"left": None, "right": None, "rig": None, "target": None, **asked.made()}
    face.until_stopped = "frames" not in given and "seconds_s" not in given
    given |= {"show": LiveLine(face).show, "tell": face.say}
    show(face, SUPERVISION.run(given, face.progress(SUPERVISION.working)), out)


def _after_crash(face: CommandUI, asked: Mode, foreign: list[str], out: Path) -> None:
    check_options("--mastering", tuple(one for one in asked.missing if one == "--arm"), foreign)
    given = asked.made()
    done = PROPOSAL if given.get("measured") is None else CHECK
    show(face, done.run({name: given.get(name) for name in done.flags() if name in given or name in NEEDED}), out)


NEEDED = ("around", "joints")
"""What one of both jobs after a crash takes in any case; None where it was not given."""


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


PANELS = (TABLES, LIVE, MASTERING, CAMERAS, PLANT)
add(
    app,
    "verify",
    inspect.getdoc(verify),
    Command(command="verify", function=verify, taken=_taken, keeps=VERIFIED, panels=PANELS, filed=True, judged=True),
)
