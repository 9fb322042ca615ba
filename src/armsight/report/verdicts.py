"""The verdicts of verifications: of a recording, of repeats alone, after a crash, of a running arm."""

from __future__ import annotations

from armsight.records.verdict import Verdict
from armsight.report.html import in_degrees
from armsight.report.to_do import after_mastering, after_verify, after_watching, foreign, hides
from armsight.verify.results import MasteringOutput, VerifyLiveOutput, VerifyOutput

VERIFY = {"measurement": "good", "none": "good", "model": "care", "drift": "care", "undecided": "care"}
MASTERING = {"none": "good", "undecided": "care"}
LIVE = {"good": "good", "warn": "care", "stop": "bad", "unknown": "bad"}
WATCHED = 0.95
"""Share of the pairs that are compared, below which a run without alarm is not called good without a word."""


def verify_verdict(summary: VerifyOutput) -> Verdict:
    """Return what the page of a verification says first. What base and tool, laid best, may hide is not called good,
    nor is a part of the rows where the others are gross."""
    cause, with_arm = summary.cause, bool(summary.joints)
    level = VERIFY.get(cause, "bad")
    return Verdict(
        level="care" if level == "good" and (hides(summary) or foreign(summary)) else level,
        headline=f"Cause: {cause}" if with_arm else "No cause looked for",
        reasons=[in_degrees(summary.verdict)],
        next=[after_verify(summary, with_arm=with_arm)],
    )


def mastering_verdict(summary: MasteringOutput) -> Verdict:
    """Return what the page of a check after a crash says first."""
    return Verdict(
        level=MASTERING.get(summary.cause, "bad"),
        headline=f"Cause: {summary.cause}",
        reasons=[in_degrees(summary.verdict)],
        next=[after_mastering(summary.cause, all_judged=all(joint.judged for joint in summary.joints))],
    )


def live_verdict(summary: VerifyLiveOutput) -> Verdict:
    """Return what the page of a supervision says first."""
    gaps = summary.level == "good" and summary.n_compared < WATCHED * summary.n
    return Verdict(
        level="care" if gaps else LIVE[summary.level],
        headline="good, with gaps" if gaps else summary.level,
        reasons=[in_degrees(summary.verdict)],
        next=[
            after_watching(
                summary.level,
                levels_set=any(value is not None for value in summary.levels.to_dict().values()),
                gaps=summary.n_compared < summary.n,
            )
        ],
    )
