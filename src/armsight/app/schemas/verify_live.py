"""verify --live and verify --mastering."""

from __future__ import annotations

from typing import Annotated

from scipy.spatial.transform import RigidTransform

from armsight.app.schemas.base import RejectedRow
from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class LiveAlarm(Output):
    """A level that was raised, or something that supervision lost."""

    t_s: Annotated[float, Doc("When, on the cameras' clock, s: the middle of the exposure that told it.")]
    level: Annotated[str, Doc("warn, stop, or blind: nothing could be compared for a while.")]
    why: Annotated[str, Doc("What was off and by how much, or what was lost.")]


@output
class LiveErrors(Output):
    """Errors of the poses compared."""

    rms_m: Annotated[float | None, Doc("Of the place, root mean square, m; null where nothing was compared.")]
    max_m: Annotated[float | None, Doc("Largest error of the place, m.")]
    rms_rad: Annotated[float | None, Doc("Of the rotation, root mean square, rad.")]
    max_rad: Annotated[float | None, Doc("Largest error of the rotation, rad.")]
    std_m: Annotated[
        float | None, Doc("What measurement and expectation may be off along the error, RMS of standard deviations, m.")
    ]
    std_rad: Annotated[float | None, Doc("The same of the rotation, rad.")]


@output
class LiveLevels(Output):
    """The levels as they were set; null: none."""

    warn_m: Annotated[float | None, Doc("Error of place that warns, m.")]
    stop_m: Annotated[float | None, Doc("Error of place that stops, m.")]
    warn_rad: Annotated[float | None, Doc("Error of rotation that warns, rad.")]
    stop_rad: Annotated[float | None, Doc("Error of rotation that stops, rad.")]


@output
class DecisionTime(Output):
    """Time from a pair of frames in memory to the decision on it, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class VerifyLiveOutput(Output):
    """armsight verify --live."""

    n: Annotated[int, Doc("Pairs of frames seen.")]
    n_compared: Annotated[int, Doc("Pairs that were compared.")]
    n_lost: Annotated[int, Doc("Pairs in which the target was not seen whole.")]
    n_stale: Annotated[int, Doc("Pairs for which the joints were not known.")]
    duration_s: Annotated[float, Doc("From the first pair to the last, s.")]
    rate_hz: Annotated[float | None, Doc("Pairs a second; null for fewer than two.")]
    missed: Annotated[int, Doc("Frames of the left camera that never arrived, by their numbers.")]
    level: Annotated[str, Doc("The gravest level raised: good, warn or stop; unknown where nothing was compared.")]
    stopped: Annotated[bool, Doc("Whether the robot was told to stop.")]
    alarms: Annotated[list[LiveAlarm], Doc("What was raised, in the order of time.")]
    errors: Annotated[LiveErrors, Doc("Measured minus expected.")]
    levels: Annotated[LiveLevels, Doc("The levels of alarm.")]
    blind_s: Annotated[float, Doc("Longest time in which nothing could be compared, s.")]
    decision_ms: Annotated[DecisionTime | None, Doc("How long a decision took; null without one.")]
    recording: Annotated[str | None, Doc("The recording; null where none was made.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]


@output
class MasteringPose(Output):
    """One of the poses to measure."""

    q: Annotated[list[float], Doc("What the controller shows there, rad or m.", unit="as named")]
    decides: Annotated[list[str], Doc("Which joints' zeros it tells most about, by name.")]


@output
class MasteringPlanOutput(Output):
    """armsight verify --mastering without measured poses."""

    poses: Annotated[list[MasteringPose], Doc("The poses, in the order to drive to them.")]
    expected_std_rad: Annotated[
        list[float | None],
        Doc("Standard deviation to expect of each joint's zero, rad or m; null where it is not judged."),
    ]
    file: Annotated[str, Doc("The table of joint targets that was written.")]
    notes: Annotated[list[str], Doc("What to know before driving.")]


@output
class MasteringJoint(Output):
    """One joint's zero; rad, of a slide m."""

    index: Annotated[int, Doc("Which joint, from 1.")]
    name: Annotated[str, Doc("Its name in the arm's file.")]
    judged: Annotated[bool, Doc("Whether these poses can tell its zero.")]
    why: Annotated[str, Doc("Why it is not judged; empty where it is.")]
    offset_rad: Annotated[float | None, Doc("Error of its zero, taken alone: to be added to readings.")]
    std_rad: Annotated[float | None, Doc("Standard deviation of that.")]


@output
class MasteringOutput(Output):
    """armsight verify --mastering."""

    n: Annotated[int, Doc("Poses compared.")]
    cause: Annotated[str, Doc("none, joint N, tool, several or undecided.")]
    offset_rad: Annotated[float | None, Doc("By how much that joint's zero is off, rad or m; null where none is.")]
    std_rad: Annotated[float | None, Doc("Standard deviation of that.")]
    rms_before_m: Annotated[float, Doc("Error of place as it was measured, RMS, m.")]
    rms_after_m: Annotated[float, Doc("The same with the cause taken out, m.")]
    tool_moved: Annotated[
        RigidTransform | None, Doc("Where the tool is now, in its old axes; where it is the cause.")
    ] = None
    joints: Annotated[list[MasteringJoint], Doc("The joints' zeros, each taken alone.")]
    rejected: Annotated[list[RejectedRow], Doc("Rows left out, and why.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]
