"""What a measured run comes to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.fields import Doc
from armsight.file_names import REPORT
from armsight.measure.series import errors_of, losses_of, median_columns, series_of
from armsight.measure.track import PoseTrack
from armsight.records import TargetPose
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, BothCounts, BothSeconds, PoseStd, Skew, Verdict
from armsight.shown import REJECTED_SHOWN, Shown, Table, digits
from armsight.units import MM, MS, figure_of


@output
class FrameTime(Output):
    """How long a pair of frames takes, from the images to the written row."""

    median: Annotated[float | None, Doc("Median, ms.")]
    p99: Annotated[float | None, Doc("99th percentile, ms.")]


@output
class Candidates(Output):
    """Bright things in the images of both views, summed over the run."""

    n_seen: Annotated[int, Doc("How many were looked at.")]
    n_fitted: Annotated[int, Doc("How many have the form of a light.")]
    n_matched: Annotated[int, Doc("How many were matched to a light of the target.")]


@output
class PoseDeviations(Output):
    """Median standard deviations of the full poses."""

    total: Annotated[PoseStd, Doc("Of all causes together.")]
    random: Annotated[PoseStd, Doc("Of the spots' noise, anew in each frame.")]
    systematic: Annotated[PoseStd, Doc("Of rig and target, the same in all frames.")]


@output
class Estimated(Output):
    """One number of a cause."""

    estimate: Annotated[float, Doc("Its value, in the unit of the cause.")]
    std: Annotated[float, Doc("Its standard deviation, in the same unit.")]


@output
class OtherCause(Output):
    """A cause that explains the residuals less well than the first."""

    cause: Annotated[str, Doc("Its name.")]
    estimate: Annotated[float | None, Doc("How large it is, in `unit`.")]
    std: Annotated[float | None, Doc("Standard deviation of the estimate, in `unit`.")]
    unit: Annotated[str | None, Doc("1, m, rad or s; empty for a cause without one number.")]
    effect_m: Annotated[float, Doc("What it does to the poses' positions, RMS, m.")]
    log_odds: Annotated[float, Doc("Natural logarithm of its odds against the first cause.")]


@output
class ConsistencyOutput(Output):
    """Whether the residuals of a run agree with rig, target and noise, and what is wrong if not."""

    verdict: Annotated[str, Doc("ok, doubtful, inconsistent or unchecked.")]
    cause: Annotated[str | None, Doc("The likeliest cause, null where nothing is wrong.")]
    estimate: Annotated[float | None, Doc("How large it is, in `unit`.")]
    std: Annotated[float | None, Doc("Standard deviation of the estimate, in `unit`.")]
    unit: Annotated[str | None, Doc("1, m, rad or s; empty for a cause without one number.")]
    effect_m: Annotated[float | None, Doc("What the cause does to the poses' positions, RMS, m.")]
    effect_rad: Annotated[float | None, Doc("What the cause does to the poses' orientations, RMS, rad.")]
    since_s: Annotated[float | None, Doc("When it began, s of t_s, for a cause that came during the run.")]
    equally_likely: Annotated[list[str], Doc("Other causes that explain the residuals as well.")]
    others: Annotated[list[OtherCause], Doc("The next likely causes, likeliest first.")]
    components: Annotated[dict[str, Estimated], Doc("The numbers of the likeliest cause by name.")]
    chi2_per_dof: Annotated[float | None, Doc("Chi-square of all residuals per degree of freedom.")]
    noise_scale: Annotated[float, Doc("Noise of the residuals over the claimed noise, as standard deviations.")]
    refused: Annotated[float, Doc("Share of the frames, 0 to 1, that fit the target in no way.")]
    claimed_m: Annotated[float | None, Doc("RMS of the claimed standard deviation of a position, 3-D, m.")]
    n_frames: Annotated[int, Doc("Frames that were judged.")]
    undetected_m: Annotated[dict[str, float], Doc("By cause: the largest effect, m, that the run could not tell.")]
    sentence: Annotated[str, Doc("What is wrong in a sentence; empty where nothing is.")]
    advice: Annotated[str, Doc("What to do about it; empty where nothing is to be done.")]


@output
class FreeCamera(Output):
    """When one of the cameras that no wire joins exposed, by the first one's clock."""

    delay_s: Annotated[float, Doc("t_first = t + delay_s + 1e-6 drift_ppm t, s.")]
    drift_ppm: Annotated[float, Doc("How much faster the first camera's clock runs, parts in a million.")]
    readout_s: Annotated[float, Doc("From the first line's exposure to the last one's.")]
    delay_change_s: Annotated[float, Doc("By how much this recording itself moved the calibrated delay.")]
    delay_std_s: Annotated[float | None, Doc("Standard deviation of the delay in the middle of the recording.")]
    n_views: Annotated[int, Doc("Frames in which lights of the target were found.")]


@output
class FreeRunning(Output):
    """How a moving target was measured by cameras that no wire joins. What is of left and right is null of others."""

    delay_s: Annotated[float | None, Doc("t_left = t_right + delay_s + 1e-6 drift_ppm t_right, s.")]
    drift_ppm: Annotated[float | None, Doc("How much faster the left camera's clock runs, parts in a million.")]
    readout_s: Annotated[BothSeconds | None, Doc("From the first line's exposure to the last one's.")]
    delay_change_s: Annotated[float | None, Doc("By how much this recording itself moved the calibrated delay.")]
    delay_std_s: Annotated[float | None, Doc("Standard deviation of the delay in the middle of the recording.")]
    n_views: Annotated[BothCounts | None, Doc("Frames in which lights of the target were found.")]
    by_camera: Annotated[dict[str, FreeCamera] | None, Doc("Of a rig that is no pair: each camera's clock.")] = None
    n_starts: Annotated[int, Doc("How often the target was found anew.")]
    chi2_per_dof: Annotated[float | None, Doc("Chi-square of the spots about the motion, per degree of freedom.")]
    note: Annotated[str | None, Doc("Why the poses are to be doubted.")] = None
    speed_m_s: Annotated[float | None, Doc("RMS of the target's speed, m/s.")]
    nearest_pairs_m: Annotated[
        float | None,
        Doc("RMS of how far the target moves between a frame of the first camera and the others' nearest in time, m."),
    ]


@output
class ZoomAt(Output):
    """The camera of a zoom lens at the setting that was measured with."""

    zoom: Annotated[float, Doc("The setting.")]
    interpolated: Annotated[bool, Doc("Whether it lies between calibrated settings.")]
    fx_px: Annotated[float, Doc("Focal length along x, px.")]
    fx_std_px: Annotated[float, Doc("Its standard deviation, calibration and interpolation, px.")]
    fx_interpolation_px: Annotated[float, Doc("The part of it that the interpolation brings, px.")]
    pupil_m: Annotated[float, Doc("Where the centre of projection stands; 0 where the settings do not say it, m.")]


@output
class CameraPart(Output):
    """What one camera had of a run, of a rig that is no pair."""

    n_frames: Annotated[int, Doc("Moments in which it had a frame.")]
    n_used: Annotated[int, Doc("Moments whose pose took lights that it shows.")]
    rms_px: Annotated[float | None, Doc("RMS of its 2-D residual per light, px.")]
    left_out: Annotated[str | None, Doc("Why the run goes on without it; null where it counts.")]


@output
class MadeWith(Output):
    """Which rig and target a run was measured with, as fingerprints: equal only where their numbers are."""

    rig: Annotated[str, Doc("SHA-256 of the cameras' intrinsics and poses.")]
    target: Annotated[str, Doc("SHA-256 of the target's names and points.")]


@output
class MeasureResult(Output):
    """armsight measure; also OUT/measure.json.

    grounds: what the verdict rests on beside the figures. poses: all of them, in the order of time.
    """

    n_frames: Annotated[int, Doc("Pairs of frames.")]
    n_ok: Annotated[int, Doc("Pairs that gave a pose.")]
    n_doubtful: Annotated[int, Doc("Pairs that gave a pose that does not fit the claims, or whose run does not.")]
    n_position_only: Annotated[int, Doc("Pairs that gave a position without an orientation.")]
    n_lost: Annotated[int, Doc("Pairs that gave nothing.")]
    reprojection_rms_px: Annotated[float | None, Doc("RMS of the 2-D residual of lights in views known to 1 px, px.")]
    ms_per_frame: Annotated[FrameTime, Doc("How long a pair takes.", unit="ms")]
    reasons: Annotated[
        dict[str, int],
        Doc("How often each kind of cause (listed above) took a pose or its rotation away, or made it doubtful."),
    ]
    candidates: Annotated[Candidates | None, Doc("Bright things in all images.")] = None
    std: Annotated[PoseDeviations | None, Doc("Median standard deviations of the full poses.")] = None
    consistency: Annotated[ConsistencyOutput | None, Doc("Whether residuals, rig and target agree.")] = None
    skew: Annotated[Skew | None, Doc("Time between the frames of live pairs.")] = None
    timing: Annotated[FreeRunning | None, Doc("Where each view was taken at its own time.")] = None
    n_aside: Annotated[int | None, Doc("Sights known worse, as half-hidden lights, that no RMS counts.")] = None
    error: Annotated[str | None, Doc("Why the run ended early.")] = None
    assumed_fps: Annotated[float | None, Doc("Frames a second, assumed where nothing tells their times.")] = None
    zoom: Annotated[dict[str, ZoomAt] | None, Doc("The cameras that zoom, by left and right.")] = None
    made_with: Annotated[MadeWith | None, Doc("Which rig and target it was.")] = None
    by_camera: Annotated[dict[str, CameraPart] | None, Doc("Of a rig that is no pair: each camera's part.")] = None
    grounds: Grounds
    poses: PoseTrack

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return measure_verdict(self)

    @property
    def exit_code(self) -> int:
        """With which a command ends."""
        inconsistent = self.consistency is not None and self.consistency.verdict == "inconsistent"
        return 3 if inconsistent or (self.timing is not None and self.n_doubtful) else 0

    def plot(self) -> Any:
        """Return a plotly figure of the poses over time."""
        return self.poses.plot()

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield Table("Measured", ["", ""], _rows(self))
        if self.timing is not None and self.timing.note:
            yield f"Doubtful: {self.timing.note}"
        for kind, count in list(self.reasons.items())[:REJECTED_SHOWN]:
            yield f"  {count} x {REASONS.get(kind, kind)}"
        for name, part in (self.by_camera or {}).items():
            if part.left_out is None and note_of(part):
                yield f"  the camera {name} {note_of(part)}"
        found = self.consistency
        if found is not None and found.sentence:
            yield f"{LOUD if found.verdict == 'inconsistent' else 'Note: '}{found.sentence}"
            yield f"  {found.advice}".rstrip()
        yield f"Results: {{out}}; open {{out}}/{REPORT}"


def _rows(done: MeasureResult) -> list[list[str]]:
    """Return the rows of the figures that a terminal shows."""
    free, ms = done.timing, done.ms_per_frame
    one = "pair" if done.by_camera is None else "moment"
    counted, took = ("pairs of frames", "pair, median") if free is None else ("poses asked for", "view")
    counted, took = (counted, took) if done.by_camera is None else ("moments", "moment, median")
    aside = "" if done.n_aside is None else f", {done.n_aside} known to no 1 px aside"
    rows = [
        [counted, str(done.n_frames)],
        ["pose", str(done.n_ok)],
        ["doubtful", str(done.n_doubtful)],
        ["position only", str(done.n_position_only)],
        ["lost", str(done.n_lost)],
        [f"reprojection, px RMS{aside}", digits(done.reprojection_rms_px)],
        [f"ms per {took}", digits(ms.median)],
    ]
    rows += [[f"ms per {one}, 99 %", digits(ms.p99)]] if free is None else []
    rows += [] if done.assumed_fps is None else [["time", f"assumed at {done.assumed_fps:g} fps"]]
    for name, part in (done.by_camera or {}).items():
        used = f"used in {part.n_used} of {part.n_frames}, {digits(part.rms_px)} px RMS"
        rows.append([f"camera {name}", "left out" if part.left_out is not None else used])
    if done.skew is not None and done.by_camera is None:
        rows += [
            ["right after left, ms mean", digits(done.skew.mean_s / MS)],
            ["right after left, ms largest", digits(done.skew.largest_s / MS)],
            ["frames without a partner", str(done.skew.n_dropped)],
        ]
    if free is not None:
        moved_m = free.nearest_pairs_m
        if free.n_views is not None:
            rows.append(["views, left and right", f"{free.n_views.left} and {free.n_views.right}"])
        for name, clock in list((free.by_camera or {}).items())[1:]:
            rows.append([f"camera {name} late by, ms", digits(clock.delay_s / MS)])
        rows += [
            ["speed, mm/s RMS", digits(None if free.speed_m_s is None else free.speed_m_s / MM)],
            ["motion between nearest frames, mm RMS", digits(None if moved_m is None else moved_m / MM)],
        ]
    return rows


REASONS = {
    "no_spot": "no spot in a view: the lights must be on, and brighter than what is round them",
    "dark_path": "no two spots are both views of one light: one path of the mirrors may be dark",
    "ambiguous": "ambiguous: more than one way to name the lights fits",
    "overlapping": "a spot of one view may lie on one of the other's",
    "lights_missing": "too few of the target's lights are seen",
    "unreadable": "the image cannot be read",
    "no_board": "the board is not seen, of a pair in both views",
    "in_part": "the board is seen in part",
    "blurred": "the board is blurred",
    "only_once": "the board is seen in one view of two",
    "thrice": "the board is seen more than once in each view",
    "beyond_size": "the board goes on beyond its counts",
    "other": "something else, which the report tells",
    "crowd": "so much is bright that the target may be chance: mask the background, or lower the exposure",
    "deadline": "more is bright than can be looked at in time: mask the background, or lower the exposure",
    "unpaired": "no spot of one view belongs to one of the other",
    "swapped": "left and right look exchanged",
    "wrong_target": "the lights' size, distance or order is not the target's",
    "misfit": "the spots do not fit the target: its measures, the calibration or the moment of the exposures is off",
    "one_off": "one of the spots is off, and it is not clear which",
    "rotation_open": "the spots leave the rotation open",
    "small_target": "a target of one or two lights has no rotation",
    "no_point": "the spots give no place before the cameras",
    "motion": "the lights are not where the target's motion puts them",
    "half_hidden": "something covers a part of a light",
    "gap": "the target was not seen for too long",
    "beyond_claims": "doubtful: the spots fit by far not as well as they claim",
    "inconsistent": "doubtful: the run says that rig or target are wrong",
}
"""What the kinds of reasons in measure.json mean; the report has each frame's own words."""

GOOD_SHARE = 0.95
"""Share of full poses from which a run is called complete."""
LEFT_OUT, LOUD = "Without a camera", "INCONSISTENT: the poses are not to be trusted. "
RESIDUALS = {"doubtful": ("care", "Doubtful"), "inconsistent": ("bad", "Inconsistent")}
"""How the verdict on the residuals shows."""
NEXT: Mapping[str, str] = {
    "Complete": "Use the poses with their standard deviations.",
    "With gaps": 'Use the full poses; mend what stands first under "What was lost" to get the others.',
    "No pose": 'Mend what stands first under "What was lost", and record again.',
    "Broken off": "Mend what ended the run, and measure the rest; the poses until then are kept.",
    "Claim doubted": "Do not rely on the claimed standard deviations: they are not the size of the errors here.",
    LEFT_OUT: "Use the full poses, which are by the other cameras alone.",
    "Doubtful": "Do not rely on these poses before what is told is explained.",
    "Inconsistent": "Do not use these poses: mend what is told, and measure again.",
}
"""What to do, by the headline."""
UNCHECKED = "Check a known length first: these frames did not check rig and target."


@dataclass(frozen=True, slots=True, kw_only=True)
class Grounds:
    """What a run's verdict rests on beside its figures.

    lost: what took most of the poses away. known: to what half of the full poses are known in their worst direction, mm
    and degrees. error_mm: of the position against the truth, RMS; inside: the share of the errors inside their 95 %
    ellipsoid, and the range that chance alone leaves; None where no truth is known.
    """

    lost: str
    known: tuple[float, float]
    error_mm: float | None = None
    inside: tuple[float, float, float] | None = None


def grounds_of(poses: Sequence[TargetPose], truth: Sequence[RigidTransform] | None = None) -> Grounds:
    """Return what the verdict on these poses rests on. truth: the true ones, in step."""
    series, losses = series_of(poses), losses_of(poses)
    middle = median_columns(series.std[series.whole])
    lost, known = losses[0].why if losses else "", (float(np.max(middle[:3])), float(np.max(middle[3:])))
    if truth is None or not series.whole.any():
        return Grounds(lost=lost, known=known)
    errors = errors_of(poses, truth)
    error_mm = float(np.sqrt(np.nanmean((errors.values[:, :3] ** 2).sum(axis=1))))
    return Grounds(lost=lost, known=known, error_mm=error_mm, inside=errors.inside())


def believed(done: MeasureResult) -> ConsistencyOutput | None:
    """Return what is said of the residuals: the check's cause, or else what views at their own times say."""
    found, note = done.consistency, None if done.timing is None else done.timing.note
    if found is None or done.timing is None:
        return found
    if note and not found.sentence:
        found = replace(found, verdict="doubtful", sentence=f"{note[0].upper()}{note[1:]}.", advice="")
    return replace(found, verdict="inconsistent") if done.n_doubtful else found


HARDLY = 0.1
"""Share of its moments in which a camera takes part below which it is asked about."""


def note_of(part: CameraPart) -> str:
    """Return why a camera is left out, or what to look at where it hardly takes part; empty for any other."""
    if part.left_out is not None:
        return f"left out: {part.left_out}"
    if part.n_used >= HARDLY * part.n_frames:
        return ""
    return "hardly takes part: look whether it is out of focus or covered, or looks elsewhere"


def left_out_of(done: MeasureResult) -> list[str]:
    """Return the cameras that were left out of a run."""
    return [name for name, part in (done.by_camera or {}).items() if part.left_out is not None]


def measure_verdict(done: MeasureResult) -> Verdict:
    """Return what a run comes to."""
    n, ok, broken, seen = done.n_frames, done.n_ok + done.n_doubtful, done.error or "", done.grounds
    if ok == 0:
        why = f" Most often: {seen.lost.rstrip('.')}." if seen.lost else ""
        said = f"None of {n:,} frames gave a full pose.{why} {broken}"
        return Verdict(level="bad", headline="No pose", reasons=[said], next=[NEXT["No pose"]])
    said = (
        f"{ok:,} of {n:,} frames ({100 * ok / n:.1f} %) gave a full pose, half of them known to "
        f"{figure_of(seen.known[0], 'mm', digits=2)} and {figure_of(seen.known[1], '°', digits=2)} or better in their "
        "worst direction (one standard deviation)."
    )
    level, word = ("good", "Complete") if ok >= GOOD_SHARE * n else ("care", "With gaps")
    if seen.inside is not None:
        inside, low, high = seen.inside
        position = figure_of(seen.error_mm, "mm", digits=2)
        said += f" Against the truth: {position} RMS; {100 * inside:.1f} % inside their own 95 % ellipsoid."
        if not low <= inside <= high:
            level, word = "care", "Claim doubted"
    found = believed(done)
    if found is not None and found.verdict in RESIDUALS:
        level, word = RESIDUALS[found.verdict]
        said = f"{found.sentence} By what they claim: {said}"
    elif left_out_of(done):
        level, word, said = "care", LEFT_OUT, f"{found.sentence if found else ''} By the others: {said}"
    if broken:
        level, word, said = "bad", "Broken off", f"{broken.rstrip('.')}. Until then: {said}"
    todo = NEXT[word]
    if found is not None and found.advice and word in ("Doubtful", "Inconsistent"):
        todo = found.advice
    elif found is not None and word == LEFT_OUT:
        todo = f"{todo} {found.advice}"
    elif found is not None and found.verdict == "unchecked" and word == "Complete":
        todo = f"{todo} {UNCHECKED}"
    return Verdict(level=level, headline=word, reasons=[said], next=[todo])
