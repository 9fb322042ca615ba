"""What the reader of a page should do next, for the verdicts that are found elsewhere."""

from __future__ import annotations

from collections.abc import Mapping

from armsight.verify import Kind
from armsight.verify.alignment import FOREIGN
from armsight.verify.results import VerifyOutput

VERIFY: Mapping[str, str] = {
    "none": "Nothing: the tool is where it should be.",
    "measurement": "Correct nothing in the arm: only a better measurement would show more.",
    "several joints": "Run `armsight calibrate arm` on these rows, which corrects zeros; then verify on others.",
    "model": "Run `armsight calibrate arm` on these rows and correct no joint before; then verify on others.",
    "drift": "Let arm and rig warm up, fasten what is loose, and verify again; correct nothing on these rows.",
    "undecided": "Correct nothing on these rows. Measure more poses, more different ones, and verify again.",
}
MEASURE: Mapping[str, str] = {
    "Complete": "Use the poses with their standard deviations.",
    "With gaps": 'Use the full poses; mend what stands first under "What was lost" to get the others.',
    "No pose": 'Mend what stands first under "What was lost", and record again.',
    "Broken off": "Mend what ended the run, and measure the rest; the poses until then are kept.",
    "Claim doubted": "Do not rely on the claimed standard deviations: they are not the size of the errors here.",
    "Doubtful": "Do not rely on these poses before what is told is explained.",
    "Inconsistent": "Do not use these poses: mend what is told, and measure again.",
}
MASTERING: Mapping[str, str] = {
    "none": "Nothing to correct.",
    "tool": "Straighten the tool or calibrate it anew (`armsight calibrate tooltip`), then check again.",
    "several": "Correct no zero on these poses: measure more of them, as told above.",
    "undecided": "Correct nothing on these poses: measure more of them, more different ones, and check again.",
}
LIVE: Mapping[str, str] = {
    "good": "Nothing: go on, and keep watching.",
    "warn": "Find out why before you go on: look at the alarms below, then run `armsight verify`.",
    "stop": "Keep the robot stopped until the cause is known: look whether something was hit or is loose, then run "
    "`armsight verify --mastering`.",
    "unknown": "Do not rely on where the arm says it is: mend what the alarms below name, and watch again.",
}


def after_measuring(word: str, unchecked: bool = False, advice: str = "") -> str:
    """Return the next step after a measurement. word: of its verdict; unchecked: the residuals could not be checked."""
    if word in ("Doubtful", "Inconsistent") and advice:
        return advice
    unproved = " Check a known length first: these frames did not check rig and target."
    return MEASURE[word] + (unproved if word == "Complete" and unchecked else "")


def hides(summary: VerifyOutput) -> bool:
    """Whether base and tool, laid best, may hide more of the arm's own errors than is left over."""
    hidden, after = summary.alignment.hidden_m, summary.after
    return hidden is not None and after is not None and hidden > after.rms_m


MANY_FOREIGN = 0.1
"""Share of the rows that miss what the others agree on from which something moved: slips and lost targets are fewer."""


def foreign(summary: VerifyOutput) -> bool:
    """Whether so many rows were left out as gross that those left are only a part of what happened."""
    gross = sum(row.why.startswith(FOREIGN) for row in summary.rejected)
    return gross > MANY_FOREIGN * (summary.n + gross)


def after_verify(summary: VerifyOutput, *, with_arm: bool) -> str:
    """Return the next step after a verification."""
    cause = summary.cause
    if not with_arm:
        return "Hold the error against what the work allows; to learn its cause, give --arm and --joints as well."
    if cause in ("none", "measurement") and foreign(summary):
        return "Find out what moved at the rows left out (base, tool, target or rig), and verify each part by itself."
    if cause in ("none", "measurement") and hides(summary):
        return (
            "Correct nothing on these rows. They do not show where the tool is, as base and tool were laid best: find "
            "where the rig stands (`armsight calibrate robot-world`), and verify with --world."
        )
    if cause in VERIFY:
        return VERIFY[cause]
    if summary.kind == Kind.ZERO:
        return f"Correct the zero of {cause} (`armsight calibrate arm` on these rows does), then verify on others."
    return f"Have the drive of {cause} looked at: a corrected zero does not mend {summary.kind}."


def after_mastering(cause: str, *, all_judged: bool) -> str:
    """Return the next step after a check for a crash; all_judged: the zero of every joint could be told."""
    if cause == "none" and not all_judged:
        return "Nothing to correct in the joints judged; the others (below) are not proved."
    return MASTERING.get(cause, f"Add the figure to the readings of {cause} (master it anew), then check again.")


def after_watching(level: str, *, levels_set: bool, gaps: bool) -> str:
    """Return the next step after a supervision; gaps: some pairs of frames could not be compared."""
    if level == "good" and not levels_set:
        return "Give --warn-mm and --stop-mm: without a level nobody is warned."
    if level == "good" and gaps:
        return "Mend what left gaps (below) before you rely on it: where nothing could be compared, nobody watched."
    return LIVE[level]
