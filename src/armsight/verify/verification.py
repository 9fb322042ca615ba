"""Measured against expected, from streams to verdict: one call, no files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.arm.points import check_scale
from armsight.errors import DataRefused, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm, fk
from armsight.verify.alignment import Align, Aligned, align, left_handed, undetermined
from armsight.verify.cause import Cause, find_cause
from armsight.verify.clocks import SamplingTimes, sampling_times
from armsight.verify.deciding import deciding_poses
from armsight.verify.evidence import Case
from armsight.verify.joint_errors import JointErrors, joint_errors
from armsight.verify.left_out import blocks
from armsight.verify.model import Model, Mounts, nothing_more
from armsight.verify.paths import JointStream, PoseStream, Stream, covered, gap_s
from armsight.verify.plausibility import repeated
from armsight.verify.records import Measured, Rejected
from armsight.verify.synchronise import Clock, synchronise

Array = NDArray[np.float64]

CAUSE_ROWS = 1200
"""Rows that a cause is looked for with, evenly chosen: more of one motion tell the same."""
CONFIGURATION_RAD = 0.1
"""Joint values further apart are of another configuration."""

SAME_RAD = 1e-3
"""Joint values (rad or m) rounded to this are the same command."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reported:
    """What the controller says: joint values q (n, joints), or commanded poses T (n, 4, 4); t_s (n,) where stamped.
    Rows that could not be read are NaN."""

    q: Array | None = None
    T: Array | None = None
    t_s: Array | None = None

    def __len__(self) -> int:
        return len(self.q) if self.q is not None else len(self.T) if self.T is not None else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Paired:
    """Rows that belong together: measured (m rows) and the flange expected there F (m, 4, 4), with joints q, speed and
    acceleration (m, n) where there are; at_s (m,): on the arm's clock."""

    measured: Measured
    F: Array
    q: Array | None = None
    speed: Array | None = None
    acceleration: Array | None = None
    at_s: Array | None = None
    clock: Clock | None = None
    times: SamplingTimes | None = None
    rejected: Rejected = ()
    notes: tuple[str, ...] = ()


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
    _check_units(use, F)
    aligned = align(F, use, nominal, how)
    kept = known[aligned.kept]
    before, _ = Model(measured=use.take(aligned.kept), expected=nothing_more(F[aligned.kept])).linearised(
        nominal.vector
    )
    mounts = aligned.fitted.mounts(measured.labels)
    cause, deciding = _cause(arm, paired, kept, aligned)
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


def _bare(arm: Arm) -> Arm:
    identity = RigidTransform.identity()
    return replace(arm, T_world_base=identity, T_flange_tool=identity, couplings=(), covariance=None)


def pair(arm: Arm | None, reported: Reported, measured: Measured, nominal: Mounts, how: Align) -> Paired:
    """Return the rows that belong together: by order where one side has no stamps, else by time.

    Raises as sampling_times and synchronise; Inconsistent where rows without stamps are not as many.
    """
    if measured.t_s is None or reported.t_s is None:
        return _by_order(arm, reported, measured)
    return _by_time(arm, reported, measured, nominal, how)


def _by_order(arm: Arm | None, reported: Reported, measured: Measured) -> Paired:
    last = int(measured.rows.max())
    if last > len(reported):
        raise Inconsistent(
            f"{last} measured rows and {len(reported)} of the arm, at least one side without t_s",
            consequence="Which rows belong together is not known; nothing is verified",
            cure="Give one row of the arm for each measured row, in the same order, or t_s in both files",
        )
    notes = (
        () if last == len(reported) else (f"the arm's file has {len(reported) - last} rows more; they are not used",)
    )
    index = measured.rows - 1
    values = reported.q if reported.q is not None else reported.T
    if values is None:
        raise UsageError("neither joints nor commanded poses")
    good = np.isfinite(values[index].reshape(len(index), -1)).all(axis=1)
    lost = tuple((int(row), "the arm's row cannot be read") for row in measured.rows[~good])
    chosen, values = np.flatnonzero(good), values[index[good]]
    at_s = None if reported.t_s is None else reported.t_s[index[good]]
    part = measured.take(chosen)
    if arm is None or reported.q is None:
        return Paired(measured=part, F=values, at_s=at_s, rejected=lost, notes=notes)
    return Paired(measured=part, F=fk(_bare(arm), values), q=values, at_s=at_s, rejected=lost, notes=notes)


def _by_time(arm: Arm | None, reported: Reported, measured: Measured, nominal: Mounts, how: Align) -> Paired:
    if measured.t_s is None:
        raise UsageError("the measured rows have no stamps")
    stream, told = _stream(arm, reported)
    times = sampling_times(measured.t_s, "the measured rows")
    _check_units(measured, stream.at(stream.t_s[:: max(1, len(stream.t_s) // 2000)])[0])
    sure = np.flatnonzero(times.sure)
    clock = _clock(stream, measured.take(sure), times.t_s[sure], nominal, how)
    clock = replace(clock, std_s=float(np.hypot(clock.std_s, times.std_s)))
    at = clock.on_arm(times.t_s)
    there = covered(stream.t_s, at)
    doubtful = (
        "a row of its burst was lost, and its sampling time is open" if times.bursts else "repeats the stamp before"
    )
    rejected = [(int(row), doubtful) for row in measured.rows[~times.sure]]
    rejected += [(int(measured.rows[i]), _uncovered(stream, float(at[i]))) for i in np.flatnonzero(times.sure & ~there)]
    chosen = np.flatnonzero(times.sure & there)
    F, _ = stream.at(at[chosen])
    notes = (*told, *((times.note,) if times.note else ()), *clock.notes)
    return Paired(
        measured=measured.take(chosen),
        F=F,
        q=stream.q_at(at[chosen]) if isinstance(stream, JointStream) else None,
        speed=stream.speed_at(at[chosen]) if isinstance(stream, JointStream) else None,
        acceleration=stream.acceleration_at(at[chosen]) if isinstance(stream, JointStream) else None,
        at_s=at[chosen],
        clock=clock,
        times=times,
        rejected=tuple(rejected),
        notes=notes,
    )


def _clock(stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, how: Align) -> Clock:
    """Return the clock; Inconsistent for left-handed positions where these agree once they are mirrored."""
    try:
        return synchronise(stream, measured, t_s, nominal, how)
    except Inconsistent as error:
        flipped = Measured(xyz_m=measured.xyz_m * [1.0, 1.0, -1.0], point=measured.point)
        try:
            synchronise(stream, flipped, t_s, nominal, Align.BOTH)
        except DataRefused:
            raise error from None
        raise left_handed("no time offset makes the path the arm's, and one does when it is mirrored") from error


def _uncovered(stream: Stream, at_s: float) -> str:
    if not stream.t_s[0] <= at_s <= stream.t_s[-1]:
        return "before the arm's first row or after its last one"
    i = int(np.searchsorted(stream.t_s, at_s))
    gap = stream.t_s[i] - stream.t_s[i - 1]
    return f"in a gap of {gap:.3g} s in the arm's rows, which are {np.median(np.diff(stream.t_s)):.3g} s apart"


def _stream(arm: Arm | None, reported: Reported) -> tuple[Stream, tuple[str, ...]]:
    """Return what the arm says over time, and what is to be known of its stamps."""
    values = reported.q if reported.q is not None else reported.T
    if values is None or reported.t_s is None:
        raise UsageError("neither joints nor commanded poses with stamps")
    good = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    times = sampling_times(reported.t_s[good], "the arm's rows")
    use = times.sure & np.append(True, np.diff(times.t_s) > 0.0)
    t, values = times.t_s[use], values[good][use]
    if len(t) < 4:
        raise NotEnoughData(f"{len(t)} rows of the arm with stamps", consequence="No time offset can be told")
    notes = [times.note] if times.note else []
    gaps = int((np.diff(t) > gap_s(t)).sum())
    if gaps:
        notes.append(f"the arm's rows have {gaps} gap{'s' * (gaps > 1)} of more than {gap_s(t):.3g} s")
    if (~good).any():
        notes.append(f"{int((~good).sum())} of the arm's rows cannot be read and are left out")
    if arm is not None and reported.q is not None:
        return JointStream(_bare(arm), t, values), tuple(notes)
    return PoseStream(t, values), tuple(notes)


def _check_units(measured: Measured, F: Array) -> None:
    """Raise Inconsistent for positions in another unit than m."""
    place = F[:, :3, 3]
    expected = float(np.linalg.norm(place - place.mean(axis=0), axis=1).mean())
    seen = float(np.linalg.norm(measured.xyz_m - np.median(measured.xyz_m, axis=0), axis=1).mean())
    if expected > 1e-3:
        check_scale(expected, seen, "the arm moves its flange")


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
        bare=_bare(arm),
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


def _joint_errors(
    arm: Arm | None, paired: Paired, kept: NDArray[np.intp], aligned: Aligned, mounts: Mounts
) -> JointErrors | None:
    if arm is None or paired.q is None:
        return None
    return joint_errors(
        _bare(arm), paired.q[kept], paired.measured.take(kept), mounts, aligned.fitted.noise.measurement
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
    return tuple(told)
