"""After a crash: which joint's zero has moved, from ten measured poses; or the tool; or that these poses cannot tell.

The explanations are few and said beforehand: nothing, one joint's zero, the tool bent. One of them is named only where
it takes off more than chance, where nothing else adds to it, and where no other does as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm, fk
from armsight.units import DEG, MM, displayed
from armsight.verify.alignment import Align, align, free_names, gross
from armsight.verify.cause import CHANCE, RIVAL_LOG, judge
from armsight.verify.evidence import Case, Evidence, Fitted, by_chance
from armsight.verify.explanations import GeometryPrior, best_poses
from armsight.verify.model import Effect, JointVerdict, Kind, ModelFit, Mounts, mount_names
from armsight.verify.pairing import bare_arm
from armsight.verify.records import Measured, Rejected

POSES = 10
FEWEST = 8
"""Poses; with fewer, freeing everything leaves too little to know the noise by."""
ADDS = 1e-3
"""Probability by chance of what all zeros and the tool take off beyond one explanation, from which on it is not all."""
CANDIDATES = 400
SPAN_RAD, SPAN_M = np.deg2rad(30.0), 0.1
"""How far joints go from the middle pose, to either side."""
LEFT_M, LEFT_RAD = 0.02, np.deg2rad(2.0)
"""RMS of what an explanation may leave: ten times what nominal lengths and any measurement leave."""
WEIGHTY = 0.6
"""A pose is said to decide a joint where leaving it out costs that joint this share of what it costs the most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """Joint values q (k, n) to measure at, which joints (from 0) each decides, and the standard deviation to expect of
    each zero (n,), inf where it is not judged."""

    q: Array
    decides: tuple[tuple[int, ...], ...]
    expected: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mastering:
    """What a crash did. cause: none, joint N, tool, several or undecided. joint: from 0, with offset and std of
    its zero (rad or m, to be added to readings). T_tool: where the tool is now in its old axes, where it is the cause.
    before, after (m, 6): errors of position in m and rotation in rad without and with the cause. joints: the zeros
    that are believed. kept (m,): positions of the rows used."""

    cause: str
    sentence: str
    joints: tuple[JointVerdict, ...]
    before: Array
    after: Array
    kept: NDArray[np.intp]
    rejected: Rejected
    doubts: tuple[str, ...]
    joint: int | None = None
    offset: float | None = None
    std: float | None = None
    T_tool: RigidTransform | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Explanation:
    """A fit of one explanation: joint (from 0), or the tool (-1), or nothing (None). own: as it stands; all: with every
    zero and the tool free beside it; evidence: with its columns."""

    joint: int | None
    fitted: ModelFit
    evidence: Evidence
    own: Fitted
    everything: Fitted

    @property
    def enough(self) -> bool:
        """Whether zeros and tool together take no more off than chance."""
        return by_chance(self.evidence.linear, self.own, self.everything) > ADDS


def propose(arm: Arm, q: Array, how: Align, sigma: Array) -> Proposal:
    """Return which joint positions, of candidates q (c, n), tell the zeros best from each other, base and tool.

    sigma (2,): noise of a coordinate in m and of a turn in rad. Raises NotEnoughData for too few candidates.
    """
    if len(q) < 2 * POSES:
        raise NotEnoughData(
            f"{len(q)} joint positions are possible, {2 * POSES} is the least to choose {POSES} from",
            consequence="No poses are proposed",
            cure="Allow more: a wider span, or a middle pose in the middle of both views",
        )
    bare, m = bare_arm(arm), len(q)
    measured = Measured(xyz_m=np.zeros((m, 3)), rotation=np.tile(np.eye(3), (m, 1, 1)))  # anywhere
    mounts = Mounts(base=arm.T_world_base, tools=(arm.T_flange_tool,)).vector
    free = free_names(measured, Align.BOTH if "base" in how.parts else Align.TOOL)  # a bent tool is to be told as well
    case = Case(bare=bare, q=np.empty((0, arm.n)), measured=measured, free=free, block=np.empty(0, np.intp))
    joints = tuple(range(1 if "base" in how.parts else 0, arm.n - 1))
    chosen, covariance = best_poses(case, mounts, sigma, joints, q, POSES)
    variance = np.diagonal(covariance, axis1=1, axis2=2)  # (k + 1, j): all poses, then one left out each
    cost = np.sqrt(variance[1:] / variance[0]) - 1.0
    most = np.maximum(cost.max(axis=1, keepdims=True), 1e-12)
    decides = tuple(tuple(joints[i] for i in np.flatnonzero(row)) for row in cost >= WEIGHTY * most)
    expected = np.full(arm.n, np.inf)
    expected[list(joints)] = np.sqrt(variance[0])
    return Proposal(q=q[chosen], decides=decides, expected=expected)


def check_mastering(arm: Arm, q: Array, measured: Measured, how: Align) -> Mastering:
    """Return what poses measured after a crash say. q (m, n): the joints' values there. how: what of base and tool is
    not known from before.

    Raises UsageError for positions without rotations, NotEnoughData, Inconsistent where the poses are not those of this
    arm at these joint values, and as `align`.
    """
    if measured.rotation is None:
        raise UsageError("positions without rotations do not tell a joint from the tool", cure="Measure whole poses")
    if len(q) < FEWEST:
        raise NotEnoughData(f"{len(q)} poses; {FEWEST} is the least", cure=f"Measure the {POSES} poses proposed")
    nominal = Mounts(base=arm.T_world_base, tools=(arm.T_flange_tool,))
    bare = bare_arm(arm)
    start = align(fk(bare, q), measured, nominal, how).fitted.p if how.parts else nominal.vector
    kept = np.arange(len(q))
    rejected: Rejected = ()
    while True:
        case = Case(
            bare=bare,
            q=q[kept],
            measured=measured.take(kept),
            free=free_names(measured, how),
            block=np.arange(len(kept)),
        )
        found = _explained(case, start, arm, how)
        off = gross(found.after, found.after)
        if not off.any() or len(kept) - off.sum() < FEWEST or rejected:
            _require_fit(found)
            return replace(found, kept=kept, rejected=rejected)
        rejected = tuple((int(measured.rows[kept[i]]), _missed(found.after[i])) for i in np.flatnonzero(off))
        kept = kept[~off]


def _require_fit(found: Mastering) -> None:
    """Raise Inconsistent where the cause that is named leaves errors that are no noise: then it is none."""
    position, turn = (float(np.sqrt(np.square(part).sum(axis=1).mean())) for part in np.split(found.after, 2, axis=1))
    if found.cause != "several" and (position > LEFT_M or turn > LEFT_RAD):
        raise Inconsistent(
            f"no joint's zero and no bent tool explains the poses: {position / MM:.3g} mm and {turn / DEG:.3g} deg "
            "(RMS) are left",
            consequence="Nothing is said about the crash",
            cure="Check that the rows are in the order of the joint values, that the arm's file is this arm's, and the "
            "frame: with world.yaml, poses are in the rig's axes",
        )


def _missed(error: Array) -> str:
    position, turn = np.linalg.norm(error[:3]) / MM, np.linalg.norm(error[3:]) / DEG
    return f"misses what the other poses agree on by {position:.3g} mm and {turn:.3g} deg"


def _explained(case: Case, start: Array, arm: Arm, how: Align) -> Mastering:
    """Return the explanation of the rows of a case."""
    plain = case.fit(start, None)
    judged = judge(case, plain)
    able = np.flatnonzero([verdict.judged for verdict in judged])
    nothing = _explanation(case, plain, None, able)
    single = [_explanation(case, case.fit(plain.p, _zero(case, i)), i, able) for i in able.tolist()]
    bent = (
        []
        if "tool" in how.parts
        else [_explanation(case, replace(case, free=_tool_free(case)).fit(plain.p, None), -1, able)]
    )
    mastering = Mastering(
        cause="none",
        sentence="No joint's zero has moved, and the tool has not, as far as these poses tell.",
        joints=_believed(case, judged, plain),
        before=plain.residual,
        after=plain.residual,
        kept=np.arange(len(case.q)),
        rejected=(),
        doubts=_caveats(judged, how),
    )
    return _decided(mastering, case, arm, nothing, single, bent)


def _believed(
    case: Case,
    judged: tuple[JointVerdict, ...],
    plain: ModelFit,
    fault: tuple[ModelFit, Effect | None] | None = None,
    *,
    any_: bool = False,
) -> tuple[JointVerdict, ...]:
    """Return the verdicts with the joints' zeros as one explanation has them, links as they may be made counted with;
    any_: any joint may be off by as much as a fault."""
    able = [i for i, verdict in enumerate(judged) if verdict.judged]
    account = GeometryPrior.of(case, plain).account(*(fault or (plain, None)), able if any_ else ())
    return tuple(
        replace(verdict, offset=float(zero), std=float(std)) if verdict.judged else verdict
        for verdict, zero, std in zip(judged, account.zeros, account.std, strict=True)
    )


def _zero(case: Case, joint: int) -> Effect:
    unit = "rad" if case.bare.revolute[joint] else "m"
    return Effect(joint=joint, kind=Kind.ZERO, names=(f"zero_{unit}",), basis=np.ones((len(case.q), 1)))


def _tool_free(case: Case) -> tuple[str, ...]:
    tools = (name for name in mount_names(case.measured.labels) if name.startswith("tool"))
    return tuple(dict.fromkeys((*case.free, *tools)))


def _explanation(case: Case, fitted: ModelFit, joint: int | None, able: NDArray[np.intp]) -> _Explanation:
    effect = None if joint is None or joint < 0 else _zero(case, joint)
    own = replace(case, free=_tool_free(case)) if joint == -1 else case
    evidence = _evidence(own, fitted, effect)
    wide = _evidence(replace(case, free=_tool_free(case)), fitted, effect)
    return _Explanation(
        joint=joint, fitted=fitted, evidence=evidence, own=evidence.plain(), everything=wide.with_joints(able)
    )


def _evidence(case: Case, fitted: ModelFit, effect: Effect | None) -> Evidence:
    """Return the evidence at a fit, whitened by the measurement alone: what a fault adds is no noise."""
    known = fitted.noise.measurement
    noise = replace(fitted.noise, extra=np.zeros(2)) if known.any() else replace(fitted.noise, extra=np.ones(2))
    evidence = Evidence.at(case, fitted, effect, noise)
    return replace(evidence, linear=replace(evidence.linear, inflation=1.0))  # single poses do not hang together


def _decided(
    mastering: Mastering,
    case: Case,
    arm: Arm,
    nothing: _Explanation,
    single: list[_Explanation],
    bent: list[_Explanation],
) -> Mastering:
    linear, n = nothing.evidence.linear, max(len(single), 1)
    moved = min(
        by_chance(linear, nothing.own, nothing.everything),
        *(n * by_chance(linear, nothing.own, one.own) for one in (*single, *bent)),
    )
    if not moved < CHANCE or not single:
        return mastering
    best = min(single, key=lambda one: one.own.squares)
    if best.enough:
        return _one_joint(mastering, case, nothing.fitted, best, single, bent)
    if bent and bent[0].enough:
        T = arm.T_flange_tool.inv() * bent[0].fitted.mounts(case.measured.labels).tools[0]
        far, turn = np.linalg.norm(T.translation) / MM, T.rotation.magnitude() / DEG
        sentence = f"Not a joint: the tool sits {far:.3g} mm and {turn:.3g} deg from where it sat before."
        joints = _believed(replace(case, free=_tool_free(case)), mastering.joints, bent[0].fitted)
        return replace(
            mastering, cause="tool", sentence=sentence, joints=joints, after=bent[0].fitted.residual, T_tool=T
        )
    sentence = (
        "Something has moved, but neither one joint's zero nor the tool alone explains it: several joints, the base, "
        "or the arm's model. Measure more poses and run `armsight verify`, or `armsight calibrate arm` (`armsight join "
        "--as points` makes its table of measurements and joints in two files)."
    )
    joints = _believed(case, mastering.joints, nothing.fitted, any_=True)
    return replace(mastering, cause="several", sentence=sentence, joints=joints)


def _one_joint(
    mastering: Mastering,
    case: Case,
    plain: ModelFit,
    best: _Explanation,
    single: list[_Explanation],
    bent: list[_Explanation],
) -> Mastering:
    """Return the verdict for one joint; undecided where another explanation does about as well."""
    worth = best.evidence.linear.residual.size
    last, joint = case.bare.n - 1, best.joint or 0
    rivals = [*single, *(bent if joint != last else [])]  # a tool turned about the last axis is the last joint's zero
    for other in (one for one in rivals if one is not best):
        ratio = worth * np.log(max(other.own.squares, 1e-300) / max(best.own.squares, 1e-300))
        if ratio < RIVAL_LOG and other.enough:
            name = "the tool" if other.joint == -1 else f"joint {(other.joint or 0) + 1}"
            sentence = f"Joint {joint + 1} and {name} explain the errors alike at these poses; neither is named."
            joints = _believed(case, mastering.joints, plain, any_=True)
            return replace(mastering, cause="undecided", sentence=sentence, joints=joints)
    joints = _believed(case, mastering.joints, plain, (best.fitted, _zero(case, joint)))
    offset, std = joints[joint].offset or 0.0, joints[joint].std or 0.0
    unit, factor = displayed("rad" if case.bare.revolute[joint] else "m")
    doubts = list(mastering.doubts)
    if joint == last:
        doubts.append("a target that has turned on the flange about the last joint's axis would look the same")
    if joint == 0:
        doubts.append("a rig that has turned about the first joint's axis would look the same")
    name = case.bare.joints[joint].name
    return replace(
        mastering,
        cause=f"joint {joint + 1}",
        sentence=f"Joint {joint + 1} ({name}): its zero has moved, {offset / factor:.4f} +- {std / factor:.2g} {unit} "
        "is to be added to its readings.",
        joints=joints,
        joint=joint,
        offset=offset,
        std=std,
        after=best.fitted.residual,
        doubts=tuple(doubts),
    )


def _caveats(joints: tuple[JointVerdict, ...], how: Align) -> tuple[str, ...]:
    notes = [f"joint {i} is not judged: {verdict.why}" for i, verdict in enumerate(joints, 1) if not verdict.judged]
    notes.append("this holds for an arm that agreed with its file before: errors of its geometry pass for moved zeros")
    if how.parts:
        notes.append(f"{' and '.join(how.parts)} were laid where they fit best: what they can take up is not seen")
    return tuple(notes)
