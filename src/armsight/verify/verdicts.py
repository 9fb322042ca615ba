"""What verifications come to: of a recording, of repeats alone, after a crash, of a running arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from armsight.records.result_parts import Verdict
from armsight.units import MM
from armsight.verify.alignment import FOREIGN
from armsight.verify.model import Kind

if TYPE_CHECKING:
    from armsight.verify.live import VerifyLiveOutput
    from armsight.verify.results import MasteringOutput, VerifyResult

MANY_FOREIGN = 0.1
"""Share of the rows that miss what the others agree on from which something moved: slips and lost targets are fewer."""
WATCHED = 0.95
"""Share of the pairs that are compared, below which a run without alarm is not called good without a word."""

VERIFY: Mapping[str, tuple[str, str]] = {
    "none": ("good", "Nothing: the tool is where it should be."),
    "measurement": ("good", "Correct nothing in the arm: only a better measurement would show more."),
    "several joints": (
        "bad",
        "Run `armsight calibrate arm` on these rows, which corrects zeros; then verify on others.",
    ),
    "model": (
        "care",
        "Run `armsight calibrate arm` on these rows and correct no joint before; then verify on others.",
    ),
    "drift": (
        "care",
        "Let arm and rig warm up, fasten what is loose, and verify again; correct nothing on these rows.",
    ),
    "undecided": (
        "care",
        "Correct nothing on these rows. Measure more poses, more different ones, and verify again.",
    ),
}
"""By cause: the level, and what to do."""
MASTERING: Mapping[str, tuple[str, str]] = {
    "none": ("good", "Nothing to correct."),
    "tool": (
        "bad",
        "Straighten the tool or calibrate it anew (`armsight calibrate tooltip`), then check again.",
    ),
    "several": ("bad", "Correct no zero on these poses: measure more of them, as told above."),
    "undecided": (
        "care",
        "Correct nothing on these poses: measure more of them, more different ones, and check again.",
    ),
}
LIVE: Mapping[str, tuple[str, str]] = {
    "good": ("good", "Nothing: go on, and keep watching."),
    "warn": (
        "care",
        "Find out why before you go on: look at the alarms below, then run `armsight verify`.",
    ),
    "stop": (
        "bad",
        "Keep the robot stopped until the cause is known: look whether something was hit or is loose, then run "
        "`armsight verify --mastering`.",
    ),
    "unknown": (
        "bad",
        "Do not rely on where the arm says it is: mend what the alarms below name, and watch again.",
    ),
}
COMPARE = "Hold the error against what the work allows; to learn its cause, give --arm and --joints as well."
FIND_MOVED = "Find out what moved at the rows left out (base, tool, target or rig), and verify each part by itself."
FIND_RIG = (
    "Correct nothing on these rows. They do not show where the tool is, as base and tool were laid best: find "
    "where the rig stands (`armsight calibrate robot-world`), and verify with --world."
)
HOLD = "Hold it against the arm's data sheet; for accuracy as well, give --commanded or --arm with --joints."
MORE = 'Measure again with what is asked for under "Withheld" below.'
WARM_UP = "Let the arm run until it is warm, and measure again; how far it goes in a shift, dAP and dRP tell."


def verify_verdict(done: VerifyResult) -> Verdict:
    """Return what a verification comes to. What base and tool, laid best, may hide is not called good, nor is a part of
    the rows where the others are gross."""
    if done.after is None:
        return _repeats(done)
    cause = done.cause
    level, todo = VERIFY.get(cause, ("bad", ""))
    if level == "good" and (_foreign(done) or _hides(done)):
        level, todo = "care", FIND_MOVED if _foreign(done) else FIND_RIG
    if not todo and done.kind == Kind.ZERO:
        todo = f"Correct the zero of {cause} (`armsight calibrate arm` on these rows does), then verify on others."
    elif not todo:
        todo = f"Have the drive of {cause} looked at: a corrected zero does not mend {done.kind}."
    with_arm = bool(done.joints)
    return Verdict(
        level=level,
        headline=f"Cause: {cause}" if with_arm else "No cause looked for",
        reasons=[done.verdict],
        next=[todo if with_arm else COMPARE],
    )


def _hides(done: VerifyResult) -> bool:
    """Whether base and tool, laid best, may hide more of the arm's own errors than is left over."""
    hidden_m, after = done.alignment.hidden_m, done.after
    return hidden_m is not None and after is not None and hidden_m > after.rms_m


def _foreign(done: VerifyResult) -> bool:
    """Whether so many rows were left out as gross that those left are only a part of what happened."""
    gross = sum(row.why.startswith(FOREIGN) for row in done.rejected)
    return gross > MANY_FOREIGN * (done.n + gross)


def _repeats(done: VerifyResult) -> Verdict:
    """Return what repeats alone come to: first of all the repeatability of the worst pose, and what that means."""
    worst, said = done.iso9283.get("RP_m"), done.verdict
    if worst is not None and worst.value is not None:
        poses = sum(name.startswith("RP_m ") for name in done.iso9283)
        among = f", the worst of {poses} poses" if poses > 1 else ""
        back = f"The tool comes back to within {worst.shown(MM)} mm of where it comes back on average (RP{among})."
        said = f"{back} {said}"
        if worst.std is None:
            return Verdict(level="care", headline="The visits drift", reasons=[said], next=[WARM_UP])
    if any(item.value is not None for item in done.iso9283.values()):
        return Verdict(level="good", headline="Repeatability", reasons=[said], next=[HOLD])
    return Verdict(level="care", headline="No figure can be given", reasons=[said], next=[MORE])


def mastering_verdict(done: MasteringOutput) -> Verdict:
    """Return what a check after a crash comes to."""
    cause = done.cause
    anew = f"Add the figure to the readings of {cause} (master it anew), then check again."
    level, todo = MASTERING.get(cause, ("bad", anew))
    if cause == "none" and not all(joint.judged for joint in done.joints):
        todo = "Nothing to correct in the joints judged; the others (below) are not proved."
    return Verdict(level=level, headline=f"Cause: {cause}", reasons=[done.verdict], next=[todo])


def live_verdict(done: VerifyLiveOutput) -> Verdict:
    """Return what a supervision comes to; where nothing could be compared, nobody watched."""
    (level, todo), headline = LIVE[done.level], done.level
    if done.level == "good" and done.n_compared < WATCHED * done.n:
        level, headline = "care", "good, with gaps"
    if done.level == "good" and all(value is None for value in done.levels.to_dict().values()):
        todo = "Give --warn-mm and --stop-mm: without a level nobody is warned."
    elif done.level == "good" and done.n_compared < done.n:
        todo = "Mend what left gaps (below) before you rely on it: where nothing could be compared, nobody watched."
    return Verdict(level=level, headline=headline, reasons=[done.verdict], next=[todo])
