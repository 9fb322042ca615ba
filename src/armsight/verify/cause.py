"""What the errors come from: the measurement, one joint, several, the model; or nothing that these poses can tell.

A joint is named only where correcting it takes errors off rows left out, beyond chance, and where freeing the links'
geometry does not explain the same as well. Two joints that explain alike are two joints.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import APART
from armsight.errors import NotConverged
from armsight.fitting.groups import regions
from armsight.kinematics import Arm
from armsight.verify.evidence import Case, Evidence, Fitted, by_chance, fit_linear, gain, moved_rig, poses_of
from armsight.verify.evidence import falls as fall_by_chance
from armsight.verify.explanations import ANGLE_RAD, LENGTH_M, Account, GeometryPrior, drifting
from armsight.verify.model import Effect, JointVerdict, Kind, ModelFit, effects, shown, still
from armsight.verify.words import far_zeros, model_off, several_off

FEWEST_POSES = 12
"""With fewer, poses left out say nothing."""
CHANCE = 1e-4
"""Probability of a gain by chance from which on it is none, over all effects tried."""
LEFT_OUT = 0.01
"""... of as large a fall on the rows left out, block by block."""
BEYOND = 0.02
"""Probability by chance of what the geometry takes off beyond a joint, from which on the joint is not all."""
ODDS = 1000.0
"""Odds, times the number of effects tried, by which a joint's fault is to be likelier than a geometry within what arms
are made to: of 225 healthy arms none is then told a joint (benchmarks/verify_joints.py)."""
REGIONAL = 300
"""Poses from which on the zeros of regions left out say what is wrong beside the geometry: joint 2 of a UR10 differs by
2.0 deviations between two series then, and by 3.2 without. Of fewer the regions themselves are too uncertain."""
LEAVES = 1.25
"""A fault that is no zero is one joint's where the geometry takes no more off the variance that it leaves: gears of all
joints run out of true, and that of a UR10's second one is seen first, wherever lengths are off too."""
RIVAL_LOG = 10.0
"""Log likelihood ratio (times two) within which two joints explain alike: about 150 to 1."""
SAME_JOINT = 1.02
"""A zero whose left-out error is within this factor of that of another effect of its joint is preferred."""
EXPLAINED = 1.2
"""The measurement explains errors up to so many times its standard deviations: they are never known better."""
SCATTER = 1.8
"""... and three times how far a scale estimated by the median of n rows is off, times the root of n."""
UNTOLD_M = 5e-3
"""Errors of position (RMS) that are laid to a measurement whose standard deviations nobody says are smaller."""
NO_ERROR_M = 1e-8
"""Smaller errors are rounding."""
ROUNDED, UNSEEN = 1e-9, "nothing shows it"
"""Share of what the other joints do that is rounding; why a joint is not judged that moves nothing: its axis goes
through the point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """What explains the errors of an arm, and by how much.

    cause: none, joint N, several joints, model, measurement, drift or undecided. joint: from 0, where one is named, and
    what it has wrong: kind, and parameters by name as (value, standard deviation). gains: shares of the left-out
    squares that the best single joint, all zeros, and geometry with zeros take off. measurement_share: of the squared
    error, None where the measurement's standard deviations are not known. rival: the other joint that would do.
    fitted: base, tool and the effect. arm_off_m: how far the arm's own zeros, lengths and axes may put the tool off at
    these rows (RMS), what base and tool take up included; None where it was not looked for. sentence: in words."""

    cause: str
    joints: tuple[JointVerdict, ...]
    sentence: str
    joint: int | None = None
    kind: Kind | None = None
    parameters: dict[str, tuple[float, float]] = field(default_factory=dict)
    gains: dict[str, float] = field(default_factory=dict)
    measurement_share: float | None = None
    rival: int | None = None
    fitted: ModelFit | None = None
    arm_off_m: float | None = None

    def zeroed(self, arm: Arm) -> Arm | None:
        """Return the arm with the zeros of turning joints that are the cause taken out; None where none are."""
        if not (self.cause == "several joints" or self.kind is Kind.ZERO):
            return None
        alone = range(arm.n) if self.joint is None else (self.joint,)
        off = {i: self.joints[i].offset or 0.0 for i in alone if arm.revolute[i]}
        joints = (replace(joint, theta_rad=joint.theta_rad + off.get(i, 0.0)) for i, joint in enumerate(arm.joints))
        return replace(arm, joints=tuple(joints))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Trial:
    """The best single effect and all that it is compared with."""

    effect: Effect
    fitted: ModelFit
    before: Evidence
    after: Evidence
    plain: Fitted
    own: Fitted
    single: dict[int, tuple[Effect, Fitted]]
    n_tried: int

    @property
    def gained(self) -> bool:
        """Whether the effect takes errors off, beyond chance, on rows left out."""
        chance = self.n_tried * by_chance(self.before.linear, self.plain, self.own)
        return chance < CHANCE and fall_by_chance(self.plain, self.own) < LEFT_OUT


def find_cause(case: Case, aligned: ModelFit, speed: Array | None, acceleration: Array | None) -> Cause:
    """Return what the errors left by base and tool come from.

    speed, acceleration (m, n): of the joints, None of single poses.
    """
    judged = judge(case, aligned)
    share = _measurement_share(aligned)
    if np.linalg.norm(aligned.residual[:, :3], axis=1).max() < NO_ERROR_M:
        return Cause(cause="none", joints=judged, sentence="There is no error to explain.", measurement_share=share)
    able = np.array([v.judged for v in judged])
    why = _too_little(case, able)
    if why:
        return Cause(cause="undecided", joints=judged, sentence=why, measurement_share=share)
    # base or tool take up a joint's zero, not what changes with its reading or its direction
    offered = [
        e
        for e in effects(case.bare, case.q, speed, acceleration)
        if able[e.joint] or (e.kind is not Kind.ZERO and judged[e.joint].why != UNSEEN)
    ]
    trial = _best_effect(case, aligned, offered)
    cause = _decide(case, aligned, trial, judged, share)
    played = trial.before.backlash(offered, np.flatnonzero(able))
    return replace(cause, joints=tuple(replace(v, backlash=played.get(i)) for i, v in enumerate(cause.joints)))


def _too_little(case: Case, able: NDArray[np.bool_]) -> str:
    """Return why these rows cannot tell a cause at all; "" where they may."""
    poses = len(np.unique(poses_of(case.q)))
    if poses < FEWEST_POSES or len(np.unique(case.block)) < 5:
        return (
            f"{len(case.q)} rows at {poses} different poses are too few to tell a cause; {FEWEST_POSES} poses are the "
            "least."
        )
    return "" if able.any() else "None of the joints can be judged at these poses, so no cause can be told."


def judge(case: Case, aligned: ModelFit) -> tuple[JointVerdict, ...]:
    """Return for each joint whether these rows can tell its zero from base and tool."""
    evidence = Evidence.at(case, aligned, None, aligned.noise)
    fixed = evidence.linear.fixed.reshape(evidence.linear.residual.size, -1)
    basis = np.empty((len(fixed), 0))
    if fixed.shape[1]:
        U, s, _ = np.linalg.svd(fixed / np.maximum(np.linalg.norm(fixed, axis=0), 1e-300), full_matrices=False)
        basis = U[:, s > 1e-9 * s[0]]
    parts = {name.split(".")[0].split(":")[0] for name in case.free}
    least = ROUNDED * np.linalg.norm(evidence.joints, axis=(0, 1)).max()
    found = []
    for i in range(case.bare.n):
        column = evidence.joints[:, :, i].ravel()
        own = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(column))
        if np.ptp(case.q[:, i]) < still(case.bare)[i]:
            found.append(JointVerdict(judged=False, why="it hardly moved"))
        elif size <= least:
            found.append(JointVerdict(judged=False, why=UNSEEN))
        elif np.linalg.norm(own) < APART * size:
            why = f"what its zero does, the free {' and '.join(sorted(parts))} do as well"
            found.append(JointVerdict(judged=False, why=why))
        else:
            found.append(JointVerdict(judged=True))
    return tuple(found)


def _measurement_share(aligned: ModelFit) -> float | None:
    """Return which share of the squared errors of position the measurement's standard deviations explain."""
    known = aligned.noise.measurement[:, 0]
    if not known.any():
        return None
    return float(min(1.0, np.sum(3.0 * known**2) / max(float((aligned.residual[:, :3] ** 2).sum()), 1e-300)))


def _best_effect(case: Case, aligned: ModelFit, offered: list[Effect]) -> _Trial:
    """Return the effect with the least left-out error, fitted with base and tool."""
    noise = aligned.noise
    effect = offered[0]
    for _ in range(2):  # the second time weighed by the noise that the effect leaves
        before = Evidence.at(case, aligned, None, noise)
        single: dict[int, tuple[Effect, Fitted]] = {}
        for each in offered:
            fit = fit_linear(before.linear, before.columns(each))
            known = single.get(each.joint)
            if known is None or fit.left_out * (SAME_JOINT if known[0].kind is Kind.ZERO else 1.0) < known[1].left_out:
                single[each.joint] = each, fit
        effect = min(single.values(), key=lambda pair: pair[1].left_out)[0]
        fitted = case.fit(aligned.p, effect)
        noise = fitted.noise
    after = Evidence.at(case, fitted, effect, noise)
    return _Trial(
        effect=effect,
        fitted=fitted,
        before=Evidence.at(case, aligned, None, noise),
        after=after,
        plain=Evidence.at(case, aligned, None, noise).plain(),
        own=after.plain(),
        single=single,
        n_tried=len(offered),
    )


def _decide(
    case: Case, aligned: ModelFit, trial: _Trial, judged: tuple[JointVerdict, ...], share: float | None
) -> Cause:
    able = np.flatnonzero([v.judged for v in judged])
    before, plain = trial.before, trial.plain
    geometry, zeros = before.with_geometry(), before.with_joints(able)
    everything = before.with_geometry(before.joints[:, :, able])
    gains = {
        "joint": gain(plain, trial.own),
        "zeros": gain(plain, zeros),
        "model": gain(plain, min(everything, geometry, key=lambda fit: fit.left_out)),
    }
    cause = Cause(cause="undecided", joints=judged, sentence="", gains=gains, measurement_share=share)
    explained = min(fit.squares for fit in (trial.own, zeros, geometry, everything))
    drift = drifting(before, trial.fitted.noise, case, aligned.mounts(case.measured.labels).base)
    least = explained if drift is None else min(explained, drift[-1])
    if moved := moved_rig(before, trial.fitted.noise, case, least):
        return replace(cause, sentence=moved)
    found = _explained(case, aligned, trial, cause, able)
    if drift is None or drift[2] < float(np.median(aligned.noise.measurement[:, 0])):
        return found
    if found.cause not in ("measurement", "undecided") and drift[-1] > explained:
        return replace(found, sentence=f"{found.sentence} {drift[0]}")
    found = replace(found, cause="drift", parameters=drift[1], sentence=drift[0])
    return replace(found, joint=None, kind=None, rival=None, fitted=None)


def _explained(case: Case, aligned: ModelFit, trial: _Trial, cause: Cause, able: NDArray[np.intp]) -> Cause:
    """Return the cause by what joints, zeros and geometry explain, alike throughout the run."""
    before, plain, gains, judged = trial.before, trial.plain, cause.gains, cause.joints
    prior = GeometryPrior.of(case, aligned)
    healthy, loose = prior.account(aligned, None), prior.account(aligned, None, able.tolist())
    if len(np.unique(poses_of(case.q))) >= REGIONAL:
        loose.std[able] = np.maximum(loose.std[able], before.std(able, regions(case.q)))
    cause = replace(cause, joints=_estimates(judged, able, trial, loose), arm_off_m=healthy.off_m)
    beyond = float(np.log(ODDS * trial.n_tried))
    least = max(healthy.log_evidence + beyond, loose.log_evidence)
    everything = before.with_geometry(before.joints[:, :, able])
    links = _gained(before, plain, everything) or _gained(before, plain, before.with_geometry())
    likeliest = _likeliest(case, aligned, trial, prior) if trial.gained or links else None
    if likeliest is not None and trial.gained and (one := _one_joint(case, likeliest, cause, least)) is not None:
        return one
    if _gained(before, plain, before.with_joints(able)) and loose.log_evidence - healthy.log_evidence > beyond:
        return replace(cause, cause="several joints", sentence=several_off(cause.joints, gains))
    if likeliest is not None and _may_be_it(*likeliest[:2], healthy.log_evidence):
        return replace(cause, sentence=_joint_or_links(*likeliest[:2]))
    off = far_zeros(case.bare, cause.joints, 2.0 * np.where(case.bare.revolute, ANGLE_RAD, LENGTH_M))
    if links:
        or_zeros = off if loose.log_evidence > healthy.log_evidence else ""
        return replace(cause, cause="model", sentence=model_off(gains, trial.effect.joint, or_zeros))
    return _nothing(aligned, cause, off)


def _one_joint(case: Case, likeliest: tuple[_Trial, Account, int | None], cause: Cause, least: float) -> Cause | None:
    """Return the cause where one joint's fault is it, or one of two that explain alike; None where it is none.

    least: the log evidence that it is to have.
    """
    trial, own, rival = likeliest
    after, zero = trial.after, trial.effect.kind is Kind.ZERO
    if own.log_evidence <= least or not (zero or _leaves_little(trial)):
        return None
    if rival is not None:
        both = f"Joint {trial.effect.joint + 1} and joint {rival + 1}"
        alike = f"{both} explain the errors alike at these poses; neither is named."
        return replace(cause, rival=rival, sentence=alike)
    adds = by_chance(after.linear, trial.own, after.with_geometry()) < BEYOND
    able = np.flatnonzero([v.judged for v in cause.joints])
    cause = replace(cause, joints=_estimates(cause.joints, able, trial, own))
    return _named(case, trial, cause, own, adds)


def _leaves_little(trial: _Trial) -> bool:
    """Whether the geometry takes little off the variance that a fault leaves."""
    size = trial.after.linear.residual.size
    left, least = (fit.squares / max(size - fit.rank, 1) for fit in (trial.own, trial.after.with_geometry()))
    return left <= LEAVES * least


def _may_be_it(trial: _Trial, own: Account, healthy: float) -> bool:
    """Whether a joint's fault is likelier than links within what arms are made to (log evidence healthy)."""
    likelier = own.log_evidence - healthy
    if trial.effect.kind is Kind.ZERO and likelier > 0.5 * RIVAL_LOG:
        return True
    return likelier > 0.0 and _leaves_little(trial)


def _gained(evidence: Evidence, poorer: Fitted, richer: Fitted) -> bool:
    return by_chance(evidence.linear, poorer, richer) < CHANCE and fall_by_chance(poorer, richer) < LEFT_OUT


def _likeliest(
    case: Case, aligned: ModelFit, trial: _Trial, prior: GeometryPrior
) -> tuple[_Trial, Account, int | None]:
    """Return the trial of the joint that is likeliest beside the geometry, its account, and another joint (from 0)
    that explains the errors about as well."""
    fits = {trial.effect.joint: trial.fitted}
    for joint, (effect, _) in trial.single.items():
        if joint not in fits:
            with suppress(NotConverged):  # it runs along what the rows leave open: it is nobody's likeliest cause
                fits[joint] = case.fit(aligned.p, effect)
    accounts = {joint: prior.account(fit, trial.single[joint][0]) for joint, fit in fits.items()}
    best, *others = sorted(accounts, key=lambda joint: -accounts[joint].log_evidence)
    rival = others[0] if others else None
    if rival is not None and accounts[best].log_evidence - accounts[rival].log_evidence > 0.5 * RIVAL_LOG:
        rival = None
    if best != trial.effect.joint:
        effect = trial.single[best][0]
        after = Evidence.at(case, fits[best], effect, trial.fitted.noise)
        trial = replace(trial, effect=effect, fitted=fits[best], after=after, own=after.plain())
    return trial, accounts[best], rival


def _estimates(
    judged: tuple[JointVerdict, ...], able: NDArray[np.intp], trial: _Trial, account: Account
) -> tuple[JointVerdict, ...]:
    """Return what is known of each joint, zeros as an explanation has them."""
    out = list(judged)
    for i in able.tolist():
        effect, alone = trial.single[i]
        share = gain(trial.plain, alone)
        kind, offset = effect.kind if share > 0.0 else None, float(account.zeros[i])
        out[i] = JointVerdict(judged=True, offset=offset, std=float(account.std[i]), gain_heldout=share, kind=kind)
    return tuple(out)


def _named(case: Case, trial: _Trial, found: Cause, own: Account, adds: bool) -> Cause:
    effect, fit, parameters = trial.effect, trial.fitted, _parameters(trial, own)
    values_text = ", ".join(shown(name, *pair) for name, pair in parameters.items())
    name = case.bare.joints[effect.joint].name
    rest = " The rest is the model's: `armsight calibrate arm` corrects it." if adds else ""
    return replace(
        found,
        cause=f"joint {effect.joint + 1}",
        joint=effect.joint,
        kind=effect.kind,
        parameters=parameters,
        fitted=fit,
        sentence=f"Joint {effect.joint + 1} ({name}) is the cause: {effect.kind}, {values_text}. It takes "
        f"{100 * gain(trial.plain, trial.own):.3g} % off the squared errors of rows left out.{rest}",
    )


def _parameters(trial: _Trial, own: Account) -> dict[str, tuple[float, float]]:
    """Return the fault's parameters by name with their deviations."""
    values = trial.fitted.p[len(trial.fitted.p) - len(trial.effect.names) :]
    if trial.effect.kind is Kind.ZERO:
        values = own.zeros[[trial.effect.joint]]
    found = zip(trial.effect.names, values, own.fault_std, strict=True)
    return {name: (float(value), float(std)) for name, value, std in found}


def _joint_or_links(trial: _Trial, own: Account) -> str:
    """Return in words that a fault and links within what arms are made to explain the errors alike."""
    fault = ", ".join(shown(name, *pair) for name, pair in _parameters(trial, own).items())
    return (
        f"Joint {trial.effect.joint + 1} ({trial.effect.kind}, {fault}) explains the errors at these rows, and lengths "
        "and axes within what arms are made to do so as well: neither is named."
    )


def _nothing(aligned: ModelFit, cause: Cause, zeros: str) -> Cause:
    """Return the verdict where neither joints nor geometry take errors off; zeros: those that seem to be off."""
    if zeros:
        sentence = f"Zeros seem to be off ({zeros}), but take too little off rows left out to be told from chance."
        return replace(cause, cause="undecided", sentence=sentence)
    known = bool(aligned.noise.measurement.any())
    total = np.sqrt(np.median(aligned.noise.sigma**2, axis=0))
    own = np.sqrt(np.median(aligned.noise.measurement**2, axis=0))
    turned = aligned.residual.shape[1] == 6
    limit = EXPLAINED * (1.0 + SCATTER / np.sqrt(len(aligned.residual)))
    if known and not (total <= limit * own)[: 1 + turned].all():
        factor = float((total / np.maximum(own, 1e-300))[: 1 + turned].max())
        sentence = (
            f"Errors are {factor:.2g} times what the measurement's standard deviations say, and neither a joint nor "
            "the geometry takes them off rows left out."
        )
        return replace(cause, cause="undecided", sentence=sentence)
    off = float(np.sqrt((aligned.residual[:, :3] ** 2).sum(axis=1).mean()))
    if not known and off > UNTOLD_M:
        sentence = (
            f"Errors of {1e3 * off:.3g} mm follow neither the joints nor the geometry, and are too large to be laid to "
            "a measurement whose standard deviations are not in the file: are there rows of another arm, tool or rig?"
        )
        return replace(cause, cause="undecided", sentence=sentence)
    said = "" if known else " (its standard deviations are not in the file; the arm's own scatter counts with it)"
    sentence = f"The errors are the measurement's{said}: nothing in them follows the joints."
    return replace(cause, cause="measurement", sentence=sentence)
