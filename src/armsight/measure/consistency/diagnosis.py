"""Do the residuals of a run agree with noise, rig and target? If not: what is wrong, how much, and what it does.

Every cause is a direction of the parameters (causes.py) with a Gaussian prior of a fault's usual size; rig and target
are uncertain by their own covariances. What the residuals say of a cause is a generalised least-squares estimate with
these as nuisance, and the gain in chi-square; causes are ranked by the evidence ln p(residuals | cause), in which a
cause pays for what it leaves free (MacKay 1992, Bayesian interpolation). The noise itself is estimated from what no
parameter explains, so that cameras noisier than they say are no fault of the setup.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import TypeVar

import numpy as np
import scipy  # loads its special functions where they are used

from armsight.arrays import Array
from armsight.measure.consistency import cameras
from armsight.measure.consistency.causes import Cause, causes_of, parameter_widths
from armsight.measure.consistency.evidence import Block, Evidence
from armsight.measure.consistency.findings import Consistency, Finding
from armsight.measure.poses.setup import Setup, n_parameters

T = TypeVar("T")

FALSE_ALARM = 1e-5
"""Chance at which the gain of one cause passes without a fault, the noise being known from the residuals alone."""


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

WITHIN = (0.75, 0.5, 0.25)
"""Shares of a block of several frames behind a change within it that are tried."""

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
    scale2, noise_dof = noise_scale2(blocks, width, evidence.fine)
    structured = max(whole.chi2 - scale2 * whole.dof, 0.0) / whole.dof
    scale2 += CURVED**2 * structured
    prior, noise = prior_root(evidence.setup, evidence.size), Noise(max(scale2, 1.0), noise_dof + PRIOR_DOF)
    found = _explained(Sums.of(evidence, whole, prior, noise), causes, changes=len(blocks) > 1)
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


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """What causes are held against: a run's sums over all of it, with what rig and target leave open, prior (q, p).

    Huu (p, p), bu (p,): information and score of the p unit normal numbers behind these.
    """

    evidence: Evidence
    whole: Block
    prior: Array
    noise: Noise
    Huu: Array
    bu: Array

    @classmethod
    def of(cls, evidence: Evidence, whole: Block, prior: Array, noise: Noise) -> Sums:
        """Return them."""
        Huu = np.eye(prior.shape[1]) + prior.T @ whole.information @ prior / noise.scale2
        return cls(evidence, whole, prior, noise, Huu, prior.T @ whole.score / noise.scale2)


def _explained(sums: Sums, causes: tuple[Cause, ...], *, changes: bool) -> list[Finding]:
    """Return what the sums say of each cause; of two cameras at once only where each alone may have moved."""
    static = [cause for cause in causes if not cause.from_change]
    found = [_explain(sums, cause, sums.whole) for cause in static if len(cause.cameras) < 2]
    suspects = {f.cause.cameras[0] for f in found if f.cause.cameras and f.gain > SUSPECT}
    both = [cause for cause in static if len(cause.cameras) > 1 and suspects.issuperset(cause.cameras)]
    found += [_explain(sums, cause, sums.whole) for cause in both]
    since = [_changed(sums, cause) for cause in causes if changes and cause.from_change]
    wholes, parts = [f for f, _ in since], [f for _, some in since for f in some]
    likely = [max(some, key=lambda f: f.evidence).cause.cameras for some in (wholes, parts) if some]
    return found + wholes + parts * (len(set(likely)) == 1)  # else a camera that turned stands for one that did more


def possible(evidence: Evidence) -> tuple[Cause, ...]:
    """Return all causes that may be told of a setup."""
    of_these = causes_of if evidence.setup.rig.is_pair else cameras.causes_of_cameras
    return of_these(evidence.setup, evidence.basis)


def _widths(evidence: Evidence) -> Array:
    scale_only, setup = evidence.basis.shape[2] == 1, evidence.setup
    if setup.rig.is_pair:
        return parameter_widths(setup, evidence.size, scale_only=scale_only)
    return cameras.widths(setup, evidence.size, scale_only=scale_only)


def _of_board(evidence: Evidence) -> tuple[float, float]:
    """Return the residuals of a board and of its rig's calibration, px; NaN where not both are known."""
    known = evidence.setup.rig.rms_px
    if known is None or not evidence.setup.target.is_board:
        return float("nan"), float("nan")
    return sqrt(evidence.residual_px2 / evidence.residuals), known


def noise_scale2(blocks: list[Block], width: Array, fine: int = 1) -> tuple[float, float]:
    """Return the noise's variance over the claimed one, and the degrees of freedom it rests on.

    From what is left when every parameter is free; and, so that a change in the run does not pass for noise, free
    anew from some moment on, where less is left so. fine: as searched.
    """

    def left(*parts: list[Block]) -> tuple[float, float]:
        chi2, dof = _unexplained([_total(part, len(width)) for part in parts if part], width)
        return (chi2 + PRIOR_DOF * PRIOR_SCALE2) / (dof + PRIOR_DOF), dof

    split = _searched(len(blocks), fine, lambda i: left(blocks[:i], blocks[i:]), lambda one: -one[0])
    rest = [left(blocks), *split.values()]
    if fine > 1 and split and blocks[0].frames > 1:  # a block that the change is within is of neither part
        i = min(split, key=lambda i: split[i])
        rest += [left(blocks[:j], blocks[j + 1 :]) for j in (i - 1, i)]
    return min(rest)


def prior_root(setup: Setup, size: int) -> Array:
    """Return L (q, p) with L L' the covariance of the parameters that rig and target bring; p may be 0."""
    n, C = n_parameters(setup.packed), setup.covariance
    covariance = np.zeros((size, size))
    if not setup.rig.is_pair:
        v = len(setup.rig.cameras)
        at, target = cameras.places(setup), np.arange(cameras.pose_at(setup, v), size - v)
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
    sums: Sums, cause: Cause, part: Block, since_s: float | None = None, mixed: Array | None = None
) -> Finding:
    """Return the estimate of a cause that holds in part of the run; rig and target uncertain throughout.

    mixed (q, q): information of part on how its frames differ, which its sums do not have.

    With u the unit normal numbers behind rig and target, a those of the cause (units of width, prior of 1), the cost
    (chi2 + 2 b'x + x'N x) / scale2 + u'u + a'a with x = L u + V a is minimised; u is eliminated.
    """
    V, k, scale2, evidence, prior = cause.scaled(), cause.V.shape[1], sums.noise.scale2, sums.evidence, sums.prior
    NV = part.information @ V / scale2  # (q, k)
    Hau = NV.T @ prior
    solved = np.linalg.solve(sums.Huu, np.column_stack([Hau.T, sums.bu]))
    K = np.eye(k) + V.T @ NV - Hau @ solved[:, :k]
    if mixed is not None:
        K -= V.T @ mixed @ V / scale2
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
    # the quantile last: few runs need it, and to load it takes as long as 50 pairs
    significant = odds > LEAST_ODDS and gain > free * scipy.special.fdtri(free, sums.noise.dof, 1.0 - FALSE_ALARM)
    out = Finding(
        cause=cause,
        estimate=cause.width * a,
        covariance=cause.width[:, None] * C * cause.width,
        gain=gain,
        evidence=odds,
        effect_m=max(_effect(evidence.shift_m2, W @ a, evidence.frames) for W in shapes),
        effect_rad=max(_effect(evidence.shift_rad2, W @ a, evidence.frames) for W in shapes),
        significant=bool(significant),
        second_moment=np.mean([W @ (np.outer(a, a) + C) @ W.T for W in shapes], axis=0),
        since_s=since_s,
    )
    proven = out.quotable or not cause.unit or (k > 1 and cause.cameras)  # of six numbers none may stand out
    return out if proven else replace(out, significant=False)


def _changed(sums: Sums, cause: Cause) -> tuple[Finding, list[Finding]]:
    """Return the cause from the moment at which it explains most, and its parts from there; the choice is paid for.

    Of a change within a block only sums over both of its parts are known. Its frames being alike, a cause that held in
    a share s of it has moved these as s of its size would have all along: score and rig's part by s, its own
    information by s^2.
    """
    blocks, fine, start_s = sums.evidence.blocks, sums.evidence.fine, [block.start_s for block in sums.evidence.blocks]

    def since(i: int, share: float = 1.0, cause: Cause = cause) -> Finding:
        part = Block(start_s[i], share * blocks[i].information, share * blocks[i].score)
        for block in blocks[i + 1 :]:
            part.add(block)
        mixed = None if share == 1.0 else share * (1.0 - share) * blocks[i].information
        return _explain(sums, cause, part, float(np.interp(i + 1.0 - share, range(len(blocks)), start_s)), mixed)

    found = _searched(len(blocks), fine, since, lambda f: f.evidence)
    best = max(found, key=lambda i: found[i].evidence)
    within = WITHIN if fine > 1 and blocks[0].frames > 1 else ()
    every = {(i, 1.0): f for i, f in found.items()}
    every |= {(i, share): since(i, share) for i in (best - 1, best) for share in within}
    at, moments = max(every, key=lambda at: every[at].evidence), (len(blocks) - 1) * (1 + len(within))
    chosen = [every[at], *(since(*at, part) for part in cause.parts)]
    whole, *parts = [replace(f, evidence=f.evidence - log(moments)) for f in chosen]
    return whole, parts


def _searched(n: int, fine: int, of: Callable[[int], T], worth: Callable[[T], float]) -> dict[int, T]:
    """Return of(i) of moments i of 1 .. n - 1: of each multiple of fine, and of all about the one of most worth."""
    found = {i: of(i) for i in range(fine, n, fine)}
    best = max(found, key=lambda i: worth(found[i]), default=fine)
    near = range(max(best - fine + 1, 1), min(best + fine, n))
    return found | {i: of(i) for i in near if i not in found}


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
