"""verify --live and verify --mastering."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PoseOutput, RejectedRow, absent


class LiveAlarm(Output):
    """A level that was raised, or something that supervision lost."""

    t_s: float = Field(description="When, on the cameras' clock, s: the middle of the exposure that told it.")
    level: str = Field(description="warn, stop, or blind: nothing could be compared for a while.")
    why: str = Field(description="What was off and by how much, or what was lost.")


class LiveErrors(Output):
    """Errors of the poses compared."""

    rms_m: float | None = Field(description="Of the place, root mean square, m; null where nothing was compared.")
    max_m: float | None = Field(description="Largest error of the place, m.")
    rms_rad: float | None = Field(description="Of the rotation, root mean square, rad.")
    max_rad: float | None = Field(description="Largest error of the rotation, rad.")
    std_m: float | None = Field(
        description="What measurement and expectation may be off along the error, RMS of standard deviations, m."
    )
    std_rad: float | None = Field(description="The same of the rotation, rad.")


class LiveLevels(Output):
    """The levels as they were set; null: none."""

    warn_m: float | None = Field(description="Error of place that warns, m.")
    stop_m: float | None = Field(description="Error of place that stops, m.")
    warn_rad: float | None = Field(description="Error of rotation that warns, rad.")
    stop_rad: float | None = Field(description="Error of rotation that stops, rad.")


class DecisionTime(Output):
    """Time from a pair of frames in memory to the decision on it, ms."""

    median: float = Field(description="Median, ms.")
    p99: float = Field(description="99 of 100 took less, ms.")


class VerifyLiveOutput(Output):
    """armsight verify --live."""

    n: int = Field(description="Pairs of frames seen.")
    n_compared: int = Field(description="Pairs that were compared.")
    n_lost: int = Field(description="Pairs in which the target was not seen whole.")
    n_stale: int = Field(description="Pairs for which the joints were not known.")
    duration_s: float = Field(description="From the first pair to the last, s.")
    rate_hz: float | None = Field(description="Pairs a second; null for fewer than two.")
    missed: int = Field(description="Frames of the left camera that never arrived, by their numbers.")
    level: str = Field(description="The gravest level raised: good, warn or stop; unknown where nothing was compared.")
    stopped: bool = Field(description="Whether the robot was told to stop.")
    alarms: list[LiveAlarm] = Field(description="What was raised, in the order of time.")
    errors: LiveErrors = Field(description="Measured minus expected.")
    levels: LiveLevels = Field(description="The levels of alarm.")
    blind_s: float = Field(description="Longest time in which nothing could be compared, s.")
    decision_ms: DecisionTime | None = Field(description="How long a decision took; null without one.")
    recording: str | None = Field(description="The recording; null where none was made.")
    doubts: list[str] = Field(description="What to know before believing it.")
    verdict: str = Field(description="What it comes to, in words.")


class MasteringPose(Output):
    """One of the poses to measure."""

    q: list[float] = Field(
        description="What the controller shows there, rad or m.", json_schema_extra={"unit": "as named"}
    )
    decides: list[str] = Field(description="Which joints' zeros it tells most about, by name.")


class MasteringPlanOutput(Output):
    """armsight verify --mastering without measured poses."""

    poses: list[MasteringPose] = Field(description="The poses, in the order to drive to them.")
    expected_std_rad: list[float | None] = Field(
        description="Standard deviation to expect of each joint's zero, rad or m; null where it is not judged."
    )
    file: str = Field(description="The table of joint targets that was written.")
    notes: list[str] = Field(description="What to know before driving.")


class MasteringJoint(Output):
    """One joint's zero; rad, of a slide m."""

    index: int = Field(description="Which joint, from 1.")
    name: str = Field(description="Its name in the arm's file.")
    judged: bool = Field(description="Whether these poses can tell its zero.")
    why: str = Field(description="Why it is not judged; empty where it is.")
    offset_rad: float | None = Field(description="Error of its zero, taken alone: to be added to readings.")
    std_rad: float | None = Field(description="Standard deviation of that.")


class MasteringOutput(Output):
    """armsight verify --mastering."""

    n: int = Field(description="Poses compared.")
    cause: str = Field(description="none, joint N, tool, several or undecided.")
    offset_rad: float | None = Field(description="By how much that joint's zero is off, rad or m; null where none is.")
    std_rad: float | None = Field(description="Standard deviation of that.")
    rms_before_m: float = Field(description="Error of place as it was measured, RMS, m.")
    rms_after_m: float = Field(description="The same with the cause taken out, m.")
    tool_moved: PoseOutput | None = Field(
        None, exclude_if=absent, description="Where the tool is now, in its old axes; where it is the cause."
    )
    joints: list[MasteringJoint] = Field(description="The joints' zeros, each taken alone.")
    rejected: list[RejectedRow] = Field(description="Rows left out, and why.")
    doubts: list[str] = Field(description="What to know before believing it.")
    verdict: str = Field(description="What it comes to, in words.")
