"""Measured against expected, from streams to verdict: one call, no files; errors of the task and of the joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.plausibility import MOST_SHARE, exceeded, spread_m
from armsight.errors import DataRefused, Inconsistent, NotEnoughData
from armsight.fields import Doc
from armsight.kinematics import Arm, fk, fk_jacobian, solve_numeric_many
from armsight.records.output import Output, output
from armsight.units import MM
from armsight.verify.alignment import Align, Aligned, align, check_tool, gross, realign, undetermined
from armsight.verify.cause import Cause, find_cause
from armsight.verify.evidence import Case, blocks, poses_of
from armsight.verify.explanations import deciding_poses
from armsight.verify.model import Kind, Model, Mounts, nothing_more
from armsight.verify.pairing import (
    CLOCK_ROUNDS,
    CLOCK_SETTLED,
    Clocked,
    Paired,
    Reported,
    bare_arm,
    check_senses,
    check_spread,
    pair,
    repeated,
    without_computed,
)
from armsight.verify.records import Measured, Rejected

CAUSE_ROWS = 1200
"""Rows that a cause is looked for with, evenly chosen: more of one motion tell the same."""
CONFIGURATION_RAD = 0.1
"""Joint values further apart are of another configuration."""

FLAT = 0.01
"""Positions that spread less square to a plane than this share of their spread in it do not tell left from right."""
SAME_RAD = 1e-3
"""Joint values (rad or m) rounded to this are the same command."""


@output
class Configurations(Output):
    """Commanded poses that several configurations of the arm reached: how far apart their measured places are, in m."""

    n: Annotated[int, Doc("Pairs of rows.")]
    mean_m: Annotated[float, Doc("Mean distance, m.")]
    p95_m: Annotated[float, Doc("95 % are closer, m.")]
    max_m: Annotated[float, Doc("Largest distance, m.")]


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

    Clocks that are laid by an arm whose zeros are off take up a part of that: they are laid anew by what is found.
    """
    result = _verified(arm, reported, measured, how, pose)
    for _ in range(CLOCK_ROUNDS):
        clock, clocked = result.paired.clock, None if arm is None or result.cause is None else result.cause.zeroed(arm)
        if clock is None or clocked is None:
            break
        try:
            result = _verified(arm, reported, measured, how, pose, (clocked, clock.offset_s))
        except DataRefused:
            break  # what was found first stands
        again = result.paired.clock
        if again is None or abs(again.offset_s - clock.offset_s) < CLOCK_SETTLED * again.std_s:
            break
    return result


def _verified(
    arm: Arm | None,
    reported: Reported,
    measured: Measured,
    how: Align,
    pose: Array | None,
    clocked: Clocked | None = None,
) -> Verification:
    nominal = _nominal(arm, measured)
    paired = without_computed(pair(arm, reported, measured, nominal, how, clocked=clocked))
    copies = repeated(paired.F, paired.measured)
    known = np.flatnonzero(~np.isin(paired.measured.rows, [row for row, _ in copies]))
    if not len(known):
        raise NotEnoughData("no row is left to compare", cure="See the rows rejected")
    use, F = paired.measured.take(known), paired.F[known]
    check_spread(use, F)
    aligned, cause, deciding = _explained(arm, paired, known, nominal, how)
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
        doubts=(*_caveats(paired, joints, cause, how), *_repeats(paired, kept, pose, measured)),
    )


def _explained(
    arm: Arm | None, paired: Paired, known: NDArray[np.intp], nominal: Mounts, how: Align
) -> tuple[Aligned, Cause | None, Array | None]:
    """Return the alignment of known rows, what their errors come from, and the joint positions that would decide."""
    aligned = _aligned(arm, paired, known, nominal, how)
    cause, deciding = _cause(arm, paired, known[aligned.kept], aligned)
    if cause is not None and cause.cause not in ("none", "measurement", "several joints"):
        left = aligned.fitted if cause.fitted is None else cause.fitted
        check_tool(paired.F[known], paired.measured.take(known), nominal, how, left)
    restored = _restored(arm, paired, known, aligned, cause)
    if restored is None:
        return aligned, cause, deciding
    return restored, *_cause(arm, paired, known[restored.kept], restored)


def _aligned(arm: Arm | None, paired: Paired, known: NDArray[np.intp], nominal: Mounts, how: Align) -> Aligned:
    """Return the alignment of known rows. Raises Inconsistent where they are not of this arm, with what would fit."""
    measured = paired.measured.take(known)
    try:
        aligned = align(paired.F[known], measured, nominal, how)
    except Inconsistent:
        check_senses(arm, paired.q, paired.measured, known)
        raise
    if exceeded(np.linalg.norm(aligned.fitted.residual[:, :3], axis=1)) > MOST_SHARE * spread_m(measured.xyz_m):
        check_senses(arm, paired.q, paired.measured, known)
    return aligned


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
        block=blocks(len(chosen), poses_of(paired.q[chosen])),
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
    """Whether positions (m, 3) lie in one plane but for FLAT of their spread."""
    spread = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
    return bool(spread[2] < FLAT * spread[1])


def _caveats(paired: Paired, joints: JointErrors | None, cause: Cause | None, how: Align) -> tuple[str, ...]:
    notes = list(paired.notes)
    if joints is not None:
        notes += joints.why
    elif paired.q is not None:
        notes.append("positions alone, or several points, do not fix the joints of a pose: no error per joint is given")
    if paired.measured.std is None:
        notes.append("the measurement's standard deviations are not in the file: what it explains is not known")
    for i, verdict in enumerate(() if cause is None else cause.joints, start=1):
        if not verdict.judged:
            notes.append(f"joint {i} is not judged: {verdict.why}")
    if how is not Align.NONE and paired.q is not None:
        free = " and ".join(how.parts)
        off = None if cause is None else cause.arm_off_m
        may = (
            ""
            if off is None
            else f"; an arm as arms are made that fits these rows may be off by {off / MM:.2g} mm (RMS) here, of which "
            "only what is left over shows: with --world all of it does"
        )
        notes.append(f"{free} were laid where they fit best: errors that they can take up are not seen{may}")
    if how is not Align.NONE and _flat(paired.measured.xyz_m):
        notes.append("the places lie in one plane: whether the measuring frame is left-handed cannot be seen")
    return tuple(notes)


# Errors of the task carried into the joints: the readings that would explain each measured pose, near the reported.

NEAREST_SINGULAR = 0.02
"""Least singular value of the Jacobian (lengths by the arm's own) below which a joint error is a multiple of noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointErrors:
    """Errors dq (m, n) of the joints, measured minus reported, in rad or m, and their standard deviations std (m, n),
    as far as the measurement's are known; NaN in rows where `why` says so. why: in words, how many rows have none."""

    dq: Array
    std: Array
    why: tuple[str, ...]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which rows (m,) have joint errors."""
        return np.asarray(np.isfinite(self.dq).all(axis=1))


def joint_errors(arm: Arm, q: Array, measured: Measured, mounts: Mounts, sigma: Array) -> JointErrors | None:
    """Return the joint errors by inverse kinematics from the reported joints q (m, n); None where poses leave it open.

    sigma (m, 2): standard deviations of a coordinate in m and a turn in rad. Positions alone do for arms of three
    joints or fewer. Rows close to a singularity and rows without a solution have none.
    """
    turned = measured.rotation is not None
    if arm.n > (6 if turned else 3) or len(mounts.tools) > 1:
        return None
    flange = measured_flange(measured, mounts)
    bare_T = np.tile(np.eye(4), (len(q), 1, 1))
    bare_T[:, :3, :] = flange[:, :3, :]
    if not turned:
        bare_T[:, :3, :3] = fk(arm, q)[:, :3, :3]
    found, solved, _ = solve_numeric_many(arm, bare_T, q, task="pose" if turned and arm.n == 6 else "position")
    _, J = fk_jacobian(arm, q)
    J = J[:, : 6 if turned and arm.n == 6 else 3]
    singular = _least_singular(J, arm) < NEAREST_SINGULAR
    bad = singular | ~solved
    dq, std = found - q, np.full(q.shape, np.nan)
    weights = np.repeat(sigma, 3, axis=1)[:, : J.shape[1]] ** 2
    inverse = np.linalg.pinv(J[~bad])
    std[~bad] = np.sqrt(np.einsum("mij,mj,mij->mi", inverse, weights[~bad], inverse))
    dq[bad] = np.nan
    return JointErrors(dq=dq, std=std, why=_why(int(singular.sum()), int((~solved & ~singular).sum()), len(q)))


def measured_flange(measured: Measured, mounts: Mounts) -> Array:
    """Return T_base_flange (m, 4, 4) as measured; of positions only the position of the tool's point, in base axes."""
    R, t = mounts.base.rotation.as_matrix(), mounts.base.translation
    T = np.tile(np.eye(4), (len(measured), 1, 1))
    T[:, :3, 3] = (measured.xyz_m - t) @ R
    if measured.rotation is not None:
        T[:, :3, :3] = R.T @ measured.rotation
    tool = mounts.tools[0].inv().as_matrix() if measured.rotation is not None else np.eye(4)
    return np.asarray(T @ tool)


def _least_singular(J: Array, arm: Arm) -> Array:
    scaled = J.copy()
    scaled[:, :3] /= arm.length_m
    columns = np.where(arm.revolute, 1.0, arm.length_m)
    return np.asarray(np.linalg.svd(scaled * columns, compute_uv=False)[:, -1])


def _why(singular: int, unsolved: int, m: int) -> tuple[str, ...]:
    notes = []
    if singular:
        notes.append(
            f"{singular} of {m} rows are close to a singularity, where joint errors are a multiple of the noise"
        )
    if unsolved:
        notes.append(f"{unsolved} of {m} rows have no joint values near the reported ones that reach the measured pose")
    return tuple(notes)


# Rows that cannot be what they claim: a measurement repeated while the arm moved.
