"""The consistency check as a run goes: of pairs, and of views each at its own time; and its verdict in words.

It widens poses by what it has found. A frame that was refused, or of which lights were left out, is fitted as a whole
for it: no pose, but what it tells. Views at their own times give the same sums, the motion eliminated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array
from armsight.errors import Unseen
from armsight.measure.consistency import kernels
from armsight.measure.consistency.all_sights import refit_views, with_all_sights
from armsight.measure.consistency.causes import RECALIBRATE, REMEASURE
from armsight.measure.consistency.diagnosis import NOISY, VERY_NOISY, judge, possible
from armsight.measure.consistency.evidence import (
    BLOCKS,
    WINDOW,
    Block,
    Evidence,
    StillLights,
    frame_of,
    rig_of,
)
from armsight.measure.consistency.findings import Consistency, Finding
from armsight.measure.consistency.other_setups import what_fits
from armsight.measure.motion.estimate import Filtered, Start
from armsight.measure.motion.states import View
from armsight.measure.poses.correspondence import match_known
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pairs import pair_spots
from armsight.measure.poses.pose import NamedSpots, solve_pose, stack_spots
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.tracking import expected
from armsight.records import PoseStatus, TargetPose
from armsight.units import DEG, MM

NEXT_LOOK = 1.5
"""... and each next time after so many times more."""


MOST_KEPT = 12
"""Moments by which other setups are tried where the given one does not fit."""

MOST_REFITTED = 200
"""Refused frames that are looked at again (some milliseconds each): a run that is refused throughout says no more."""


DOUBT = "the residuals of the run say that rig or target are wrong"


def finalise(pose: TargetPose, *, inconsistent: bool) -> TargetPose:
    """Return a pose with the status that the verdict on its run gives it; doubt about the frame itself stays."""
    if inconsistent and pose.status is PoseStatus.OK:
        return replace(pose, status=PoseStatus.DOUBTFUL, why=DOUBT)
    if not inconsistent and pose.status is PoseStatus.DOUBTFUL and pose.why == DOUBT:
        return replace(pose, status=PoseStatus.OK, why="")
    return pose


class RunCheck:
    """Sees every moment of a run in order; widens what comes once the residuals prove that rig or target are wrong.

    known: what was found when it was looked at last.
    """

    def __init__(self, setup: Setup) -> None:
        self._evidence = Evidence.of(setup)
        self._refitted = self._refused = self._complete = 0
        self._causes = possible(self._evidence)
        self._next = float(WINDOW)
        self.known: Consistency | None = None
        self._kept: list[Measured] = []

    def add(self, measured: Measured) -> Measured:
        """Take one moment; return it with the pose's covariance widened by what is known to be wrong by now.

        Noise above the claimed one multiplies the part of the covariance that the spots make; a fault of rig or
        target adds its expected effect on this pose to the part that repeats.
        """
        if len(self._kept) < MOST_KEPT and min(len(spots) for spots in measured.seen) >= 3:
            self._kept.append(measured)
        self._evidence.add(self._telling(measured))
        if self._evidence.frames >= self._next:
            self.known = self._judge(changes=False)
            self._next = NEXT_LOOK * self._evidence.frames
        return measured if self.known is None else self.widened(measured, self.known)

    def widened(self, measured: Measured, known: Consistency) -> Measured:
        """Return one moment as what is known to be wrong leaves its pose."""
        wider = self._widened(measured, known)
        pose = finalise(wider.pose, inconsistent=known.verdict == "inconsistent")
        return wider if pose is wider.pose else replace(wider, pose=pose, cause=Unseen.INCONSISTENT)

    @property
    def looks_next(self) -> float:
        """The number of frames from which it is looked at anew."""
        return self._next

    @property
    def inconsistent(self) -> bool:
        """Whether the run was inconsistent when it was judged last."""
        return self.known is not None and self.known.verdict == "inconsistent"

    def finish(self) -> Consistency:
        """Return the verdict over the whole run."""
        self._evidence.finish()
        found = self._judge(changes=True)
        told = (
            bool(found.findings) and self._complete > self._refused
        )  # with its size and deviation, which another lacks
        if self._complete and (found.verdict != "inconsistent" or told):
            return found
        other = what_fits(self._evidence.setup, self._kept) if self._evidence.setup.rig.is_pair else None
        return found if other is None else replace(found, instead=other.words, remedy=other.cure)

    def with_changes(self) -> Consistency:
        """Return the verdict so far, causes that began during the run among those looked for."""
        return self._judge(changes=True)

    def _judge(self, *, changes: bool) -> Consistency:
        share = self._refused / max(self._refused + self._complete, 1)
        return judge(self._evidence, self._causes, share, changes=changes)

    def _telling(self, measured: Measured) -> Measured:
        """Return the moment with all its lights, where it was refused or some were left out."""
        setup, pair = self._evidence.setup, self._evidence.setup.rig.is_pair
        ok = measured.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL)
        self._complete += ok
        if ok and not pair:
            return with_all_sights(setup, measured)
        if (ok and not measured.notes) or self._refitted >= MOST_REFITTED:
            return measured
        found = refit(setup, measured) if pair else refit_views(setup, measured)
        if found is None:
            return measured
        self._refitted += 1
        self._refused += not ok
        return found

    def _widened(self, measured: Measured, known: Consistency) -> Measured:
        fault, factor = known.second_moment, known.noise_factor
        if fault is None and factor <= 1.0:
            return measured
        frame, pose = frame_of(self._evidence.setup, measured), measured.pose
        found = None if frame is None else self._evidence.slopes(frame, self._evidence.backward(frame))
        if found is None or pose.covariance is None:
            return measured
        _, _, _, S, C = found
        systematic = np.zeros((6, 6)) if pose.systematic_covariance is None else np.array(pose.systematic_covariance)
        own = pose.covariance - systematic  # the spots' part, widened already where this frame's residuals are large
        own = own * max(1.0, factor * float(np.trace(C[:3, :3]) / np.trace(own[:3, :3])))
        if fault is not None:
            systematic += S @ fault @ S.T
        wider = replace(
            pose,
            covariance=own + systematic,
            systematic_covariance=systematic if fault is not None else pose.systematic_covariance,
        )
        return replace(measured, pose=wider)


REFIT_SLACKS = (8.0, 32.0)
"""Factors on the slack, one after the other: residuals of 2 px, and of 8 px as of a camera knocked by half a degree."""


def refit(setup: Setup, measured: Measured) -> Measured | None:
    """Return the moment with all of its lights named and placed, however badly they fit; None where not clear.

    A frame that does not fit the target says more about what is wrong than those that just do. Three lights or more.
    """
    left, right, model = measured.left_seen, measured.right_seen, setup.model
    whole = min(len(model), len(left), len(right))
    if measured.busy or whole < 3 or setup.target.is_board or not setup.target.model_known:
        return None
    t_s = measured.pose.t_s
    for loose in REFIT_SLACKS:
        slack = loose * setup.slack_px
        pairs = pair_spots(setup.packed, left, right, slack, overlaid=setup.overlaid)
        if len(pairs.index) < whole:
            continue
        predicted = expected(setup, measured.track, t_s)
        best = match_known(setup, left, right, pairs, prediction=predicted, slack_px=slack).best
        if best is None or len(best.names) < whole:
            continue
        index = pairs.index[best.pair]
        at_left, at_right = left.take(index[:, 0]), right.take(index[:, 1])
        uv, cov = stack_spots((at_left, at_right))
        X = model.xyz_m[[model.names.index(name) for name in best.names]]
        spots = NamedSpots(best.names, X, uv, cov, radius_m=np.zeros((len(X), 2)), normal=model.normal)
        solved = solve_pose(setup.packed, t_s, spots, limit=np.inf)
        if solved.pose.status is PoseStatus.OK:
            return replace(measured, pose=solved.pose, spots=(at_left, at_right), names=best.names)
    return None


SETTLED_VIEWS = 8
"""Views after a start whose chi-square says nothing: the state they are held against is a guess."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingCheck:
    """The verdict, and how the pose at each view (n, 6, q) follows the parameters that it is about."""

    verdict: Consistency
    slopes: Array


def check_motion(setup: Setup, views: Sequence[View], starts: Sequence[Start], jerk: Array) -> MovingCheck:
    """Return what the views' innovations under a motion of strength jerk (n,) say of rig and target."""
    evidence = Evidence.of(setup)
    n, q = len(views), evidence.size
    t, blocks = np.array([view.t_s for view in views]), BLOCKS * evidence.fine
    block = (np.arange(n) * blocks) // n
    run, judged = Filtered.of(setup.packed, setup.model.xyz_m, views, starts, jerk), rig_of(setup)
    seen_s, side, first = run.rows.views
    side = side + len(judged.k) - len(setup.packed.k)  # before the cameras of other rigs than pairs stands one more
    dp, ds = (np.zeros((n, run.Cs.shape[1], q)) for _ in range(2))
    still = [StillLights(len(setup.model.xyz_m), 1) for _ in setup.packed.k]
    weight = np.array([still[one.side].weight(one.lights, one.uv_px[:, None], one.cov_px2[:, None]) for one in views])
    for start in starts:
        weight[start.view : start.view + SETTLED_VIEWS] = 0.0
    information, score, chi2 = np.zeros((blocks, q, q)), np.zeros((blocks, q)), np.zeros(blocks)
    kernels.run_evidence(
        (seen_s, side, first),
        run.rows.spots,
        judged.arrays,
        (run.positions_m, np.ascontiguousarray(evidence.basis)),
        (weight, block),
        *run.states(ds, dp),
        (information, score, chi2),
    )
    dof = np.bincount(block, weight * [2.0 * len(view.lights) for view in views], blocks)
    for k in np.unique(block[weight > 0.0]).tolist():
        part = Block(
            float(t[block == k][0]), information[k], score[k], max(float(chi2[k]), float(dof[k])), float(dof[k])
        )
        part.frames = int((block == k).sum())
        evidence.blocks.append(part)
    run.smooth(ds, dp)
    moves, turns = ds[:, :3], ds[:, 3:6]
    evidence.shift_m2 = np.einsum("nap,naq->pq", moves, moves)
    evidence.shift_rad2 = np.einsum("nap,naq->pq", turns, turns)
    variances = np.diagonal(run.Cs, axis1=1, axis2=2)
    evidence.claimed_m2, evidence.claimed_rad2 = float(variances[:, :3].sum()), float(variances[:, 3:6].sum())
    evidence.frames = n
    return MovingCheck(verdict=judge(evidence).final, slopes=ds[:, :6])


SHOWN = {"1": (100.0, " %"), "m": (1.0 / MM, " mm"), "rad": (1.0 / DEG, "°"), "s": (1e3, " ms")}
"""How people read each unit: factor and sign."""

FLAT_BOARD = "For less, glue the board on a flat plate and measure its print with a calliper"

ONE_SIGNED = ("scale", "timing")
"""Causes of one number, whose sign means something."""


AXES = {f"about_{a}_rad": f"about its {a} axis" for a in "xyz"} | {f"{a}_m": f"along {a}" for a in "xyz"}
"""Which number of a vector is told, by its label."""


def sentence(found: Consistency) -> str:
    """Return what the check says in one or two sentences; empty where there is nothing to say."""
    if found.left_out:
        told = " ".join(one.told for one in found.left_out)
        return f"{told} {sentence(replace(found, left_out=()))}".strip()
    if found.instead:
        return f"{found.instead}."
    if not found.findings and found.verdict == "inconsistent":
        return f"{100 * found.refused:.0f} % of the frames do not fit the target, and no one cause stands out."
    if not found.findings or found.verdict == "ok":
        return _noise(found)
    first, *others = found.findings[: found.equal]
    text = f"{what(first)}: {_consequence(found, first)}"
    if others:
        text += f". The residuals agree as well with this: {'; or '.join(what(other) for other in others)}"
    if found.refused > 0.0:
        text += f". {100 * found.refused:.0f} % of the frames do not fit at all and gave no pose"
    return f"{text[0].upper()}{text[1:]}."


def advice(found: Consistency) -> str:
    """Return what to do about it; empty where there is nothing to do."""
    if found.left_out:
        told = " ".join(f"{one.cure}." for one in found.left_out)
        return f"{told} {advice(replace(found, left_out=()))}".strip()
    if found.remedy:
        return f"{found.remedy}."
    if found.as_calibrated and found.noise_scale > VERY_NOISY and not found.findings:
        return f"{FLAT_BOARD}, then {RECALIBRATE}."
    if found.verdict in ("ok", "unchecked"):
        return ""
    if not found.findings:
        noisy = "Look at the spots in the report: blur, reflections, vibration"
        return (
            f"{noisy}."
            if found.verdict == "doubtful"
            else f"{RECALIBRATE[0].upper()}{RECALIBRATE[1:]}, then {REMEASURE}."
        )
    cures = dict.fromkeys(f.cause.advice for f in found.findings[: found.equal])
    return ". Or: ".join(cures) + "."


def what(f: Finding) -> str:
    """Return the cause with its size: 'the target's scale against the baseline is off by 1.02 +- 0.03 %'."""
    moment = "" if f.since_s is None else f" (from about {f.since_s:.1f} s on)"
    if not (f.cause.unit and f.quotable):
        return f"{f.cause.words}{moment if f.cause.cameras else ''}"
    factor, sign = SHOWN[f.unit]
    if f.cause.key.startswith("distortion"):
        factor, sign = 1.0, " in k1"
    value = f.size if f.cause.key.split()[0] in ONE_SIGNED else abs(f.size)
    size = _figures(factor * value, factor * f.std, sign)
    size += f" {AXES[f.label]}" if f.label in AXES else ""
    if f.cause.key.startswith("timing "):
        later = "later" if f.size > 0.0 else "earlier"
        return f"{f.cause.words}: {_figures(factor * abs(f.size), factor * f.std, sign)} {later}"
    if f.cause.key == "timing":
        later = "later" if f.size > 0.0 else "earlier"
        return (
            f"the right camera exposes {_figures(factor * abs(f.size), factor * f.std, sign)} {later} than the left one"
        )
    return f"{f.cause.words}, by {size}{moment}" if f.cause.key != "scale" else f"{f.cause.words} by {size}"


def _figures(value: float, std: float, sign: str) -> str:
    """Return value and standard deviation with as many digits as the standard deviation has two of."""
    decimals = max(0, 1 - math.floor(math.log10(std))) if std > 0.0 else 3
    return f"{value:.{min(decimals, 6)}f} ± {std:.{min(decimals, 6)}f}{sign}"


def _consequence(found: Consistency, f: Finding) -> str:
    """Return what it does to the poses, beside what they claim."""
    times = f.effect_m / found.claimed_m
    text = f"positions are wrong by about {_plain(f.effect_m / MM)} mm"
    turns = f.effect_rad / found.claimed_rad
    if turns > max(2.0, times):
        text, times = f"{text} and rotations by {_plain(f.effect_rad / DEG)}°", turns
    return f"{text}, {_plain(times)} times the claimed standard deviation"


def _plain(value: float) -> str:
    """Return two significant digits, without powers of ten."""
    return f"{value:.{max(0, 1 - math.floor(math.log10(value)))}f}" if value > 0.0 else "0"


def _noise(found: Consistency) -> str:
    if found.verdict == "unchecked" or found.noise_scale < NOISY:
        return ""
    if found.as_calibrated:
        return (
            f"The residuals, {found.residual_px:.3f} px, are those that the rig was calibrated with "
            f"({found.calibration_px:.3f} px) and {found.noise_scale:.1f} times the noise of the points found: "
            "the board's print and flatness or the lenses, not this recording; the poses' standard deviations are "
            "widened by it."
        )
    text = f"The residuals are {found.noise_scale:.1f} times the spots' noise, without a pattern"
    much = ": more than a camera's noise explains" if found.noise_scale > VERY_NOISY else ""
    return f"{text}{much}; the poses' standard deviations are widened by it."
