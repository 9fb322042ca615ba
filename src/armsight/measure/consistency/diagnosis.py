"""Do the residuals of a run agree with noise, rig and target? If not: what is wrong, how much, and what it does.

Every cause is a direction of the parameters (causes.py) with a Gaussian prior of a fault's usual size; rig and target
are uncertain by their own covariances. What the residuals say of a cause is a generalised least-squares estimate with
these as nuisance, and the gain in chi-square; causes are ranked by the evidence ln p(residuals | cause), in which a
cause pays for what it leaves free (MacKay 1992, Bayesian interpolation). The noise itself is estimated from what no
parameter explains, so that cameras noisier than they say are no fault of the setup.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import log, sqrt

import numpy as np
from scipy.special import fdtri

from armsight.arrays import Array
from armsight.measure.consistency import cameras
from armsight.measure.consistency.causes import TURNS, Cause, causes_of, parameter_widths
from armsight.measure.consistency.evidence import Block, Evidence
from armsight.measure.poses.setup import Setup
from armsight.optics import RIG_PARAMETERS

FALSE_ALARM = 1e-5
"""Chance at which the gain of one cause passes without a fault, the noise being known from the residuals alone."""

QUOTABLE = 3.0
"""Standard deviations from zero below which no number is told, nor a cause that has no other."""

PLAIN = 5.0
"""... and from which the length of a vector is told, else the number of it that stands out most."""

LEAST_ODDS = log(100.0)
"""Evidence against a setup without fault below which nothing is said."""

EQUAL_ODDS = log(20.0)
"""Causes whose evidence is within this of the best explain the residuals as well."""

PRIOR_DOF = 20.0
PRIOR_SCALE2 = 1.5
"""The noise's variance over the claimed one before any frame, as if from so many degrees of freedom: of real cameras it
is 0.5 to 2."""

DOUBTFUL = 0.5
INCONSISTENT = 5.0
"""Effect on the poses, in claimed standard deviations, from which a run is doubtful, or inconsistent."""

FELT = 0.2
"""... and from which a camera that is proven wrong is left out: the poses are better without it."""

INCONSISTENT_M = 2e-4
INCONSISTENT_RAD = 2e-3
"""... if it is also larger than this."""

NOISY = 1.5
"""Noise over the claimed one (standard deviations) from which it is mentioned."""

UNMISTAKABLE = 9.0
"""Chi-square per degree of freedom from which a proven cause is told, however small its effect is beside what poses
claim in their worst direction."""
VERY_NOISY = 3.0
"""... and from which it is no noise model's slip."""

AS_CALIBRATED = 1.25
"""Residuals of a board over those of the rig's calibration up to which they are the same: 1.00 on a calibration's own
pictures (opencv_stereo), 1.07 and 1.14 where one half of them was calibrated with and the other measured."""

SUSPECT = 12.0
"""Gain of a camera's own causes, of up to six numbers, from which it may have moved beside another."""

MOSTLY = 0.5
"""Share of refused frames from which the run as a whole is inconsistent."""

LIKELY_ODDS = log(10.0)
"""... and the evidence from which a cause is then named."""

CURVED = 0.05
"""What first order leaves of a large fault, over the fault: its residuals bend, more so under the poses it spoils."""

BENT = 0.02
"""Share of its gain by which a cause made of several must beat a single one: others explain what a large fault's bend
leaves (measured with single lights 0.5 to 3 mm off: 0.05 to 1 %)."""

CLEAR = 1e-9
"""Information of a direction, over the largest, below which it is none."""


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise's variance over the claimed one, and the degrees of freedom that it is known by.

    Causes are held against the claims where residuals are smaller: spots that claim too much make the mean small, and
    say nothing of those that claim too little.
    """

    scale2: float
    dof: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finding:
    """A cause with the estimate (k,) of its numbers, their covariance (k, k), and what it does to the poses (RMS).

    gain: fall of chi-square. evidence: ln odds against a setup without fault. since_s: of a change. second_moment
    (q, q): of the parameters' error under this cause.
    """

    cause: Cause
    estimate: Array
    covariance: Array
    gain: float
    evidence: float
    effect_m: float
    effect_rad: float
    significant: bool
    second_moment: Array
    since_s: float | None = None

    @property
    def size(self) -> float:
        """The number that the finding rests on: itself, the length of a vector, or that of it which stands out most."""
        return self._quoted[0]

    @property
    def std(self) -> float:
        """Standard deviation of size."""
        return self._quoted[1]

    @property
    def label(self) -> str:
        """Which of the cause's numbers size is; empty for the only one, and for a vector's length."""
        return self._quoted[2]

    @property
    def unit(self) -> str:
        """SI unit of size."""
        return self.cause.unit if not self.cause.of_two_kinds or self._quoted[3] < TURNS else "m"

    @property
    def quotable(self) -> bool:
        """Whether size is told from zero."""
        return abs(self.size) >= QUOTABLE * self.std

    @property
    def _quoted(self) -> tuple[float, float, str, int]:
        """Return size, standard deviation, label and the first number's place."""
        if len(self.estimate) == 1:
            return float(self.estimate[0]), float(np.sqrt(self.covariance[0, 0])), "", 0
        starts = (0, TURNS) if self.cause.of_two_kinds else (0,)
        lengths = [self._length(slice(a, b)) for a, b in zip(starts, (*starts[1:], None), strict=True)]
        i = int(np.argmax([length / std for length, std in lengths]))
        if lengths[i][0] >= PLAIN * lengths[i][1]:
            return *lengths[i], "", starts[i]
        deviations = np.sqrt(np.diag(self.covariance))
        j = int(np.argmax(np.abs(self.estimate) / deviations))
        return float(self.estimate[j]), float(deviations[j]), self.cause.labels[j], j

    def _length(self, part: slice) -> tuple[float, float]:
        along = self.estimate[part]
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.0 else np.ones(len(along)) / sqrt(len(along))
        return length, float(np.sqrt(along @ self.covariance[part, part] @ along))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOut:
    """Cameras whose sights do not count, what is wrong with them, and what to do."""

    names: tuple[str, ...]
    words: str
    cure: str

    @property
    def told(self) -> str:
        """What is wrong, and what is done about it."""
        return f"{self.words}: the run goes on without {'it' if len(self.names) == 1 else 'them'}."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Consistency:
    """The verdict over a run: 'ok', 'doubtful', 'inconsistent', or 'unchecked' where there was nothing to judge by.

    findings: significant causes, likeliest first; equal: how many of them explain the residuals equally well.
    noise_scale: the residuals' noise over the claimed one (standard deviations). chi2_per_dof: of all residuals against
    the claimed noise. claimed_m: RMS of the claimed standard deviation of a position (3-D). undetected: by cause, the
    largest
    effect (m, 3-D RMS) on the poses that the run could not have told. refused: share of the frames with enough lights
    whose residuals cannot be noise, so that they gave no pose. residual_px: RMS of a board's points (2-D), beside that
    which its rig was calibrated with; NaN of lights and where not known. instead, remedy: of a run that does not fit,
    what is wrong with rig or target by the setup that does fit (other_setups.py), and what to change. left_out: cameras
    that the others have left behind: all else is of these others.
    """

    verdict: str
    frames: int
    refused: float = 0.0
    chi2_per_dof: float = float("nan")
    noise_scale: float = 1.0
    noise_dof: float = 0.0
    claimed_m: float = float("nan")
    claimed_rad: float = float("nan")
    findings: tuple[Finding, ...] = ()
    equal: int = 0
    undetected: dict[str, float] = field(default_factory=dict)
    residual_px: float = float("nan")
    calibration_px: float = float("nan")
    instead: str = ""
    remedy: str = ""
    left_out: tuple[LeftOut, ...] = ()

    @property
    def accused(self) -> tuple[str, ...]:
        """The cameras that each of the likeliest causes names; none where these do not agree, or poses stay as good."""
        equal = self.findings[: self.equal]
        felt = [max(f.effect_m / self.claimed_m, f.effect_rad / self.claimed_rad) for f in equal]
        if not equal or max(felt) < FELT:
            return ()
        named = [f.cause.cameras for f in equal]
        return tuple(name for name in named[0] if all(name in other for other in named))

    @property
    def second_moment(self) -> Array | None:
        """Expected square (q, q) of the parameters' error, over the significant causes by their odds; None if none."""
        if not self.findings or self.verdict == "ok":
            return None
        odds = np.exp(np.array([f.evidence for f in self.findings]) - self.findings[0].evidence)
        return np.asarray(sum(p * f.second_moment for p, f in zip(odds / odds.sum(), self.findings, strict=True)))

    @property
    def as_calibrated(self) -> bool:
        """Whether a board fits no worse than in the rig's calibration: what is left is print, flatness or lens."""
        return self.residual_px <= AS_CALIBRATED * self.calibration_px

    @property
    def noise_factor(self) -> float:
        """Factor on the spots' variance: above 1 only where the residuals prove it."""
        surely = 1.0 + 4.0 * sqrt(2.0 / max(self.noise_dof, 1.0))
        return self.noise_scale**2 if self.noise_scale**2 > surely else 1.0


def judge(
    evidence: Evidence, causes: tuple[Cause, ...] | None = None, refused: float = 0.0, *, changes: bool = True
) -> Consistency:
    """Return what the sums say; refused: share of the frames that were refused for their residuals.

    changes: whether causes that began during the run are looked for, which takes ten times as long.

    Where most were, that something is wrong needs no proof any more, and the likeliest cause is named.
    """
    if not evidence.blocks or not evidence.setup.target.model_known:
        return Consistency(verdict="unchecked", frames=evidence.frames, refused=refused)
    causes = possible(evidence) if causes is None else causes
    whole = _total(evidence.blocks, evidence.size)
    blocks = evidence.blocks if changes else [whole]
    width = _widths(evidence)
    scale2, noise_dof = noise_scale2(blocks, width)
    structured = max(whole.chi2 - scale2 * whole.dof, 0.0) / whole.dof
    scale2 += CURVED**2 * structured
    prior, noise = prior_root(evidence.setup, evidence.size), Noise(max(scale2, 1.0), noise_dof + PRIOR_DOF)
    static = [cause for cause in causes if not cause.from_change]
    found = [_explain(evidence, cause, whole, whole, prior, noise, None) for cause in static if len(cause.cameras) < 2]
    suspects = {f.cause.cameras[0] for f in found if f.cause.cameras and f.gain > SUSPECT}
    both = [cause for cause in static if len(cause.cameras) > 1 and suspects.issuperset(cause.cameras)]
    found += [_explain(evidence, cause, whole, whole, prior, noise, None) for cause in both]
    if len(blocks) > 1:
        found += [_changed(evidence, cause, whole, prior, noise) for cause in causes if cause.from_change]
    ranked = sorted(found, key=lambda f: -f.evidence)
    significant = [f for f in ranked if f.significant]
    if refused > MOSTLY and not significant:
        significant = [f for f in ranked if f.evidence > LIKELY_ODDS][:1]
    significant = [f for f in significant if f.cause.unit or f is significant[0]]  # "several" may be what others are
    residual_px, calibration_px = _of_board(evidence)
    out = Consistency(
        verdict="ok",
        refused=refused,
        frames=evidence.frames,
        chi2_per_dof=whole.chi2 / whole.dof,
        noise_scale=sqrt(scale2),
        noise_dof=noise_dof,
        claimed_m=sqrt(evidence.claimed_m2 / evidence.frames),
        claimed_rad=sqrt(evidence.claimed_rad2 / evidence.frames),
        findings=tuple(significant),
        equal=sum(f.evidence >= significant[0].evidence - EQUAL_ODDS for f in significant),
        undetected=_undetected(evidence, found),
        residual_px=residual_px,
        calibration_px=calibration_px,
    )
    return replace(out, verdict="inconsistent" if refused > MOSTLY else _verdict(out))


def possible(evidence: Evidence) -> tuple[Cause, ...]:
    """Return all causes that may be told of a setup."""
    of_these = causes_of if evidence.setup.rig.is_pair else cameras.causes_of_cameras
    return of_these(evidence.setup, evidence.basis)


def _widths(evidence: Evidence) -> Array:
    scale_only, setup = evidence.basis.shape[2] == 1, evidence.setup
    if setup.rig.is_pair:
        return parameter_widths(evidence.size, scale_only=scale_only)
    return cameras.widths(len(setup.rig.cameras), evidence.size, scale_only=scale_only)


def _of_board(evidence: Evidence) -> tuple[float, float]:
    """Return the residuals of a board and of its rig's calibration, px; NaN where not both are known."""
    known = evidence.setup.rig.rms_px
    if known is None or not evidence.setup.target.is_board:
        return float("nan"), float("nan")
    return sqrt(evidence.residual_px2 / evidence.residuals), known


def noise_scale2(blocks: list[Block], width: Array) -> tuple[float, float]:
    """Return the noise's variance over the claimed one, and the degrees of freedom it rests on.

    From what is left when every parameter is free; and, so that a change in the run does not pass for noise, free
    anew from some moment on, where less is left so.
    """
    size = len(width)
    whole = _total(blocks, size)
    rest = [_unexplained([whole], width)]
    rest += [_unexplained([_total(blocks[:i], size), _total(blocks[i:], size)], width) for i in range(1, len(blocks))]
    scaled = [((chi2 + PRIOR_DOF * PRIOR_SCALE2) / (dof + PRIOR_DOF), dof) for chi2, dof in rest]
    return min(scaled)


def prior_root(setup: Setup, size: int) -> Array:
    """Return L (q, p) with L L' the covariance of the parameters that rig and target bring; p may be 0."""
    n, C = len(RIG_PARAMETERS), setup.covariance
    covariance = np.zeros((size, size))
    if not setup.rig.is_pair:
        v = len(setup.rig.cameras)
        at, target = cameras.places(v), np.arange(cameras.pose_at(v, v), size - v)
        at = np.append(at, target) if len(C) == len(at) + len(target) else at
        C = C[: len(at), : len(at)]
        covariance[np.ix_(at, at)] = C if len(C) else 0.0
    elif len(C) == size - 1:
        covariance[:-1, :-1] = C
    elif len(C):
        covariance[:n, :n] = C[:n, :n]
    scale = np.sqrt(np.diag(covariance))
    known = scale > 0.0
    unit = covariance[np.ix_(known, known)] / np.outer(scale[known], scale[known])
    values, vectors = np.linalg.eigh(unit)
    root = np.zeros((size, int(known.sum())))
    root[known] = scale[known, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _total(blocks: list[Block], size: int) -> Block:
    out = Block(blocks[0].start_s, np.zeros((size, size)), np.zeros(size))
    for block in blocks:
        out.add(block)
    return out


def _unexplained(blocks: list[Block], width: Array) -> tuple[float, float]:
    """Return chi-square and degrees of freedom that are left when all parameters are free in each block."""
    chi2 = dof = 0.0
    for block in blocks:
        values, vectors = np.linalg.eigh(block.information * np.outer(width, width))
        clear = values > CLEAR * values[-1]
        part = vectors[:, clear].T @ (block.score * width)
        chi2 += block.chi2 - float((part**2 / values[clear]).sum())
        dof += block.dof - float(clear.sum())
    return max(chi2, 0.0), max(dof, 0.0)


def _explain(
    evidence: Evidence, cause: Cause, whole: Block, part: Block, prior: Array, noise: Noise, since_s: float | None
) -> Finding:
    """Return the estimate of a cause that holds in part of the run; rig and target uncertain throughout.

    With u the unit normal numbers behind rig and target, a those of the cause (units of width, prior of 1), the cost
    (chi2 + 2 b'x + x'N x) / scale2 + u'u + a'a with x = L u + V a is minimised; u is eliminated.
    """
    V, k, scale2 = cause.scaled(), cause.V.shape[1], noise.scale2
    NV = part.information @ V / scale2  # (q, k)
    Huu = np.eye(prior.shape[1]) + prior.T @ whole.information @ prior / scale2
    Hau = NV.T @ prior
    solved = np.linalg.solve(Huu, np.column_stack([Hau.T, prior.T @ whole.score / scale2]))
    K = np.eye(k) + V.T @ NV - Hau @ solved[:, :k]
    g = V.T @ part.score / scale2 - Hau @ solved[:, k]
    K = 0.5 * (K + K.T)
    values, vectors = np.linalg.eigh(K)
    C = vectors / np.maximum(values, 1.0) @ vectors.T  # information cannot be negative
    a = -C @ g
    gain = float(g @ C @ g)
    odds = 0.5 * gain - 0.5 * float(np.log(np.maximum(values, 1.0)).sum())
    odds -= 0.0 if cause.unit else 0.5 * BENT * gain
    shapes = [V, *(W * cause.width for W in cause.same)]
    free = max(int((values > 2.0).sum()), 1)
    least = free * fdtri(free, noise.dof, 1.0 - FALSE_ALARM)
    out = Finding(
        cause=cause,
        estimate=cause.width * a,
        covariance=cause.width[:, None] * C * cause.width,
        gain=gain,
        evidence=odds,
        effect_m=max(_effect(evidence.shift_m2, W @ a, evidence.frames) for W in shapes),
        effect_rad=max(_effect(evidence.shift_rad2, W @ a, evidence.frames) for W in shapes),
        significant=bool(gain > least and odds > LEAST_ODDS),
        second_moment=np.mean([W @ (np.outer(a, a) + C) @ W.T for W in shapes], axis=0),
        since_s=since_s,
    )
    return out if out.quotable or not cause.unit else replace(out, significant=False)


def _changed(evidence: Evidence, cause: Cause, whole: Block, prior: Array, noise: Noise) -> Finding:
    """Return the cause from the moment at which it explains most; the choice of the moment is paid for."""
    blocks = evidence.blocks
    found = [
        _explain(evidence, cause, whole, _total(blocks[i:], evidence.size), prior, noise, blocks[i].start_s)
        for i in range(1, len(blocks))
    ]
    best = max(found, key=lambda f: f.evidence)
    return replace(best, evidence=best.evidence - log(len(found)))


def _effect(shift: Array, x: Array, frames: int) -> float:
    return sqrt(max(float(x @ shift @ x), 0.0) / frames)


def _verdict(found: Consistency) -> str:
    """Return the verdict; chi-square shows a fault that acts where the poses are sharp."""
    noisy = found.noise_scale > VERY_NOISY and not found.as_calibrated
    worst = "doubtful" if noisy or (found.findings and found.chi2_per_dof > UNMISTAKABLE) else "ok"
    for f in found.findings[: found.equal]:
        by_m, by_rad = f.effect_m / found.claimed_m, f.effect_rad / found.claimed_rad
        if (by_m > INCONSISTENT and f.effect_m > INCONSISTENT_M) or (
            by_rad > INCONSISTENT and f.effect_rad > INCONSISTENT_RAD
        ):
            return "inconsistent"
        if max(by_m, by_rad) > DOUBTFUL:
            worst = "doubtful"
    return worst


def _undetected(evidence: Evidence, found: list[Finding]) -> dict[str, float]:
    """Return by cause the largest effect in m on the poses that stays within five standard deviations of its
    estimate."""
    out = {}
    for f in found:
        if not f.cause.unit or f.cause.from_change:
            continue
        values, vectors = np.linalg.eigh(f.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        largest = max(
            float(np.linalg.eigvalsh(root.T @ W.T @ evidence.shift_m2 @ W @ root)[-1])
            for W in (f.cause.V, *f.cause.same)
        )
        out[f.cause.key] = 5.0 * sqrt(max(largest, 0.0) / evidence.frames)
    return out
