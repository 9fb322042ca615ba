"""What a measured run comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.measure.series import errors_of, losses_of, median_columns, series_of
from armsight.records import TargetPose
from armsight.records.verdict import Verdict
from armsight.units import figure_of

if TYPE_CHECKING:
    from armsight.measure.results import ConsistencyOutput, MeasureOutput

GOOD_SHARE = 0.95
"""Share of full poses from which a run is called complete."""
RESIDUALS = {"doubtful": ("care", "Doubtful"), "inconsistent": ("bad", "Inconsistent")}
"""How the verdict on the residuals shows."""
NEXT: Mapping[str, str] = {
    "Complete": "Use the poses with their standard deviations.",
    "With gaps": 'Use the full poses; mend what stands first under "What was lost" to get the others.',
    "No pose": 'Mend what stands first under "What was lost", and record again.',
    "Broken off": "Mend what ended the run, and measure the rest; the poses until then are kept.",
    "Claim doubted": "Do not rely on the claimed standard deviations: they are not the size of the errors here.",
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


def believed(done: MeasureOutput) -> ConsistencyOutput | None:
    """Return what is said of the residuals: the check's cause, or else what views at their own times say."""
    found, note = done.consistency, None if done.timing is None else done.timing.note
    if found is None or done.timing is None:
        return found
    if note and not found.sentence:
        found = replace(found, verdict="doubtful", sentence=f"{note[0].upper()}{note[1:]}.", advice="")
    return replace(found, verdict="inconsistent") if done.n_doubtful else found


def measure_verdict(done: MeasureOutput) -> Verdict:
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
    if broken:
        level, word, said = "bad", "Broken off", f"{broken.rstrip('.')}. Until then: {said}"
    todo = NEXT[word]
    if found is not None and found.advice and word in ("Doubtful", "Inconsistent"):
        todo = found.advice
    elif found is not None and found.verdict == "unchecked" and word == "Complete":
        todo = f"{todo} {UNCHECKED}"
    return Verdict(level=level, headline=word, reasons=[said], next=[todo])
