"""Measured against expected, from streams to verdict: one call, no files."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.errors import NotEnoughData
from armsight.kinematics import Arm, fk
from armsight.verify.alignment import Align, Aligned, align, gross, realign, undetermined
from armsight.verify.cause import Cause, find_cause
from armsight.verify.deciding import deciding_poses
from armsight.verify.effects import Kind
from armsight.verify.evidence import Case
from armsight.verify.joint_errors import JointErrors, joint_errors
from armsight.verify.left_out import blocks
from armsight.verify.model import Model, Mounts, nothing_more
from armsight.verify.pairing import Paired, Reported, bare_arm, check_spread, pair
from armsight.verify.plausibility import repeated
from armsight.verify.records import Measured, Rejected

Array = NDArray[np.float64]

CAUSE_ROWS = 1200
"""Rows that a cause is looked for with, evenly chosen: more of one motion tell the same."""
CONFIGURATION_RAD = 0.1
"""Joint values further apart are of another configuration."""

FLAT = 0.01
"""Places that spread less square to a plane than this share of their spread in it do not tell left from right."""
SAME_RAD = 1e-3
"""Joint values (rad or m) rounded to this are the same command."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Configurations:
    """Commanded poses that several configurations of the arm reached: how far apart their measured places are, in m."""

    n: int
    mean_m: float
    p95_m: float
    max_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verification:
    """What came out. task (k, 6): measured minus expected in base axes, m and rad (3 columns of positions), for the
    rows of paired that kept names; before (m,): the same before aligning. mounts, std, undetermined: of base and tool.
    joints: errors per joint, None where poses do not fix them."""

    paired: Paired
    kept: NDArray[np.intp]
    aligned: Aligned
    how: Align
    mounts: Mounts
    std: dict[str, float]
    undetermined: tuple[str, ...]
    before: Array
    task: Array
    joints: JointErrors | None
    cause: Cause | None
    configurations: Configurations | None
    deciding: Array | None
    rejected: Rejected
    doubts: tuple[str, ...] = field(default=())


def verify(
    arm: Arm | None, reported: Reported, measured: Measured, how: Align, *, pose: Array | None = None
) -> Verification:
    """Return how far the measured poses are from those expected, and what that comes from.

    arm: with the base and tool that hold where they are not aligned; None with commanded poses. pose: which commanded
    pose each measured row is of, by any number. Raises DataRefused with cause, consequence and cure.
    """
    nominal = _nominal(arm, measured)
    paired = pair(arm, reported, measured, nominal, how)
    copies = repeated(paired.F, paired.measured)
    known = np.flatnonzero(~np.isin(paired.measured.rows, [row for row, _ in copies]))
    if not len(known):
        raise NotEnoughData("no row is left to compare", cure="See the rows rejected")
    use, F = paired.measured.take(known), paired.F[known]
    check_spread(use, F)
    aligned = align(F, use, nominal, how)
    cause, deciding = _cause(arm, paired, known[aligned.kept], aligned)
    restored = _restored(arm, paired, known, aligned, cause)
    if restored is not None:
        aligned = restored
        cause, deciding = _cause(arm, paired, known[aligned.kept], aligned)
    kept = known[aligned.kept]
    before, _ = Model(measured=use.take(aligned.kept), expected=nothing_more(F[aligned.kept])).linearised(
        nominal.vector
    )
    mounts = aligned.fitted.mounts(measured.labels)
    joints = _joint_errors(arm, paired, kept, aligned, mounts)
    return Verification(
        paired=paired,
        kept=kept,
        aligned=aligned,
        how=how,
        mounts=mounts,
        std={name: aligned.fitted.std(name) for name in aligned.free},
        undetermined=undetermined(aligned, use, how),
        before=before,
        task=_in_base(aligned.fitted.residual, mounts),
        joints=joints,
        cause=cause,
        configurations=_configurations(paired, kept, pose, measured),
        deciding=deciding,
        rejected=tuple(sorted((*paired.rejected, *copies, *aligned.rejected))),
        doubts=(*_doubts(paired, joints, cause, how), *_repeats(paired, kept, pose, measured)),
    )


def _nominal(arm: Arm | None, measured: Measured) -> Mounts:
    identity = RigidTransform.identity()
    base, tool = (identity, identity) if arm is None else (arm.T_world_base, arm.T_flange_tool)
    return Mounts(base=base, tools=(tool,) * len(measured.labels))


def _in_base(residual: Array, mounts: Mounts) -> Array:
    """Return residuals (m, rows) in the base's axes."""
    R = mounts.base.rotation.as_matrix()
    return np.asarray(np.concatenate([residual[:, k : k + 3] @ R for k in range(0, residual.shape[1], 3)], axis=1))


def _cause(
    arm: Arm | None, paired: Paired, kept: NDArray[np.intp], aligned: Aligned
) -> tuple[Cause | None, Array | None]:
    """Return what the errors come from, and the joint positions that would decide where nothing does."""
    if arm is None or paired.q is None:
        return None, None
    chosen = kept if len(kept) <= CAUSE_ROWS else kept[np.unique(np.linspace(0, len(kept) - 1, CAUSE_ROWS).astype(int))]
    case = Case(
        bare=bare_arm(arm),
        q=paired.q[chosen],
        measured=paired.measured.take(chosen),
        free=aligned.free,
        block=blocks(len(chosen)),
    )
    fitted = aligned.fitted if len(chosen) == len(kept) else case.fit(aligned.fitted.p, None)
    speed = None if paired.speed is None else paired.speed[chosen]
    acceleration = None if paired.acceleration is None else paired.acceleration[chosen]
    cause = find_cause(case, fitted, speed, acceleration)
    if cause.cause != "undecided":
        return cause, None
    judged = tuple(i for i, verdict in enumerate(cause.joints) if verdict.judged)
    return cause, deciding_poses(case, fitted, judged) if judged else None


def _restored(
    arm: Arm | None, paired: Paired, known: NDArray[np.intp], aligned: Aligned, cause: Cause | None
) -> Aligned | None:
    """Return the alignment with rows taken back that a joint's wrong zero explains; None where there are none.

    Where the arm is stretched a wrong zero moves the tool by far more than elsewhere.
    """
    if arm is None or cause is None or cause.kind is not Kind.ZERO or cause.joint is None or cause.fitted is None:
        return None
    if paired.q is None or not aligned.rejected:
        return None
    use, q = paired.measured.take(known), paired.q[known].copy()
    q[:, cause.joint] += cause.fitted.p[-1]
    model = Model(measured=use, expected=nothing_more(fk(bare_arm(arm), q)))
    residual, _ = model.linearised(cause.fitted.p[: model.n_mounts])
    kept = np.union1d(aligned.kept, np.flatnonzero(~gross(residual, cause.fitted.residual)))
    return None if len(kept) == len(aligned.kept) else realign(paired.F[known], use, aligned, kept)


def _joint_errors(
    arm: Arm | None, paired: Paired, kept: NDArray[np.intp], aligned: Aligned, mounts: Mounts
) -> JointErrors | None:
    if arm is None or paired.q is None:
        return None
    return joint_errors(
        bare_arm(arm), paired.q[kept], paired.measured.take(kept), mounts, aligned.fitted.noise.measurement
    )


def _configurations(
    paired: Paired, kept: NDArray[np.intp], pose: Array | None, measured: Measured
) -> Configurations | None:
    """Return how far apart the places are that neighbouring rows of one commanded pose measured with other joints."""
    if pose is None or paired.q is None:
        return None
    own = dict(zip(measured.rows.tolist(), pose.tolist(), strict=True))
    rows = paired.measured.rows[kept]
    which = np.array([own[row] for row in rows.tolist()])
    other = np.abs(np.diff(paired.q[kept], axis=0)).max(axis=1) > CONFIGURATION_RAD
    pairs = np.flatnonzero((which[1:] == which[:-1]) & other)
    if not len(pairs):
        return None
    apart = np.linalg.norm(paired.measured.xyz_m[kept[pairs + 1]] - paired.measured.xyz_m[kept[pairs]], axis=1)
    return Configurations(
        n=len(pairs), mean_m=float(apart.mean()), p95_m=float(np.quantile(apart, 0.95)), max_m=float(apart.max())
    )


def _repeats(paired: Paired, kept: NDArray[np.intp], pose: Array | None, measured: Measured) -> tuple[str, ...]:
    """Return what to say where single poses were measured and none of them twice."""
    if paired.clock is not None or paired.q is None:
        return ()
    q = paired.q[kept]
    if pose is not None:
        own = dict(zip(measured.rows.tolist(), pose.tolist(), strict=True))
        which = np.array([own[row] for row in paired.measured.rows[kept].tolist()])
        q = np.column_stack([which, np.round(q / CONFIGURATION_RAD)])
    else:
        q = np.round(q / SAME_RAD)
    if len(np.unique(q, axis=0)) < len(q):
        return ()
    return ("repeatability is withheld: no pose was visited twice with the same joints",)


def _flat(xyz: Array) -> bool:
    """Whether places (m, 3) lie in one plane but for FLAT of their spread."""
    spread = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
    return bool(spread[2] < FLAT * spread[1])


def _doubts(paired: Paired, joints: JointErrors | None, cause: Cause | None, how: Align) -> tuple[str, ...]:
    told = list(paired.notes)
    if joints is not None:
        told += joints.why
    elif paired.q is not None:
        told.append("positions alone, or several points, do not fix the joints of a pose: no error per joint is given")
    if paired.measured.std is None:
        told.append("the measurement's standard deviations are not in the file: what it explains is not known")
    for i, verdict in enumerate(() if cause is None else cause.joints, start=1):
        if not verdict.judged:
            told.append(f"joint {i} is not judged: {verdict.why}")
    if how is not Align.NONE and paired.q is not None:
        free = " and ".join(how.parts)
        told.append(f"{free} were laid where they fit best: errors that they can take up are not seen")
    if how is not Align.NONE and _flat(paired.measured.xyz_m):
        told.append("the places lie in one plane: whether the measuring frame is left-handed cannot be seen")
    return tuple(told)
