"""A joint log, or the robot's poses, joined with what cameras or a tracker measured, though on another clock."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.arm_files import given_arm
from armsight.app.requests.files import JoinJob
from armsight.arrays import Array
from armsight.calibrate.handeye import PosePairs, Setup
from armsight.columns import POSITION, QUATERNION
from armsight.errors import NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records.output import Output, output
from armsight.records.result_parts import RejectedRow
from armsight.store import write_text
from armsight.store.covariances import POSITION_COVARIANCE
from armsight.store.handeye_file import write_pairs
from armsight.store.tables import cells, word
from armsight.store.verify_files import MeasuredFile, read_commanded, read_measured, read_reported_joints
from armsight.verify import Align, Measured, Paired, Reported
from armsight.verify.model import Mounts
from armsight.verify.pairing import pair, pair_at

KINDS = ("points", "observed", "pairs")
STILL_RAD_S = 2e-3
"""A joint that turns slower rests: at one metre it moves its tool by 2 mm a second."""
STILL_M_S = 2e-3
STILL_ROWS = 3
"""Rows of one rest that are worth a mean."""


@output
class JoinOutput(Output):
    """armsight join."""

    kind: Annotated[str, Doc("The table written: points, observed or pairs.")]
    by: Annotated[str, Doc("time, or order where one side has no times.")]
    offset_s: Annotated[float | None, Doc("Added to measured times it gives the robot's, s; null by order.")]
    offset_std_s: Annotated[float | None, Doc("Its standard deviation, s; null where it was stated, or by order.")]
    drift_ppm: Annotated[
        float | None,
        Doc(
            "How much faster the robot's clock runs, in parts of a million; null where no drift is proved.", unit="1e-6"
        ),
    ]
    n_measured: Annotated[int, Doc("Measured rows.")]
    n: Annotated[int, Doc("Rows written.")]
    rejected: Annotated[list[RejectedRow], Doc("Measured rows left out, with the reason.")]
    notes: Annotated[list[str], Doc("What is to be known of times and columns.")]
    file: Annotated[str | None, Doc("The file written.")] = None


def join(job: JoinJob) -> JoinOutput:
    """Find the time offset, write the rows that belong together; return what was done.

    Rows without times on one side belong together by order. Raises UsageError, DataRefused.
    """
    _check(job)
    arm = given_arm(job.arm)
    file = read_measured(job.measured, job.table.of_camera)
    if job.kind == "pairs" and file.measured.rotation is None:
        raise UsageError(f"{job.measured} has no rotations, and pairs need them", cure="Give poses, not points")
    reported = _reported(job, arm)
    inside = job.kind == "pairs" and job.setup is Setup.EYE_IN_HAND
    seen = _inverse(file.measured) if inside else file.measured  # moved with the hand: the camera seen by the target
    if job.offset_s is not None:
        paired = pair_at(arm, reported, seen, job.offset_s)
    else:
        origin = Mounts(base=RigidTransform.identity(), tools=(RigidTransform.identity(),))
        paired = pair(arm, reported, seen, origin, Align.BOTH)
    rows = _rests(paired) if job.still else [np.array([i]) for i in range(len(paired.measured))]
    if not rows:
        raise NotEnoughData(
            f"none of {len(file.measured)} measured rows has its place among the robot's",
            consequence="Nothing is written",
            cure="Check that both files are of one run" if not job.still else "Leave --still away, or let the arm rest",
        )
    table = _Joined(paired=paired, rows=rows, reported=reported, covariance=_covariances(file, paired, rows))
    _write(job, arm, table, inside)
    return _output(job, file, paired, len(rows))


def _check(job: JoinJob) -> None:
    if job.kind not in KINDS:
        raise UsageError(f"no table is called {job.kind!r}", cure=f"Give --as with one of {', '.join(KINDS)}")
    if (job.joints is None) == (job.robot_stream is None):
        raise UsageError(
            "what the robot did is not said, or twice",
            consequence="Nothing is joined",
            cure="Give --joints with --arm, or --robot-stream with the flange's poses",
        )
    if job.joints is not None and job.arm is None:
        raise UsageError("--joints needs --arm", cure="Give the arm: its nominal geometry is enough")
    if job.robot_stream is not None and job.kind != "pairs":
        raise UsageError(f"{job.kind} need joint readings", cure="Give --joints and --arm, or --as pairs")


def _reported(job: JoinJob, arm: Arm | None) -> Reported:
    """Return the joints' own values, or the flange's poses, over time."""
    if job.robot_stream is not None:
        commanded = read_commanded(job.robot_stream, job.table)
        if not commanded.turned:
            raise UsageError(f"{job.robot_stream} has no rotations", cure="Give the flange's poses")
        return commanded.reported
    if job.joints is None or arm is None:
        raise UsageError("--joints needs --arm")
    names = job.table.of_arm(arm)
    found = read_reported_joints(job.joints, names)
    if found.q is None or found.q.shape[1] != arm.n:
        count = 0 if found.q is None else found.q.shape[1]
        raise UsageError(f"{job.joints} has {count} joints, {arm.name} has {arm.n}", cure="Give the log of this arm")
    return found.values_of(arm)


def _inverse(measured: Measured) -> Measured:
    """Return the poses (m) the other way round."""
    if measured.rotation is None:
        return measured
    R = measured.rotation.transpose(0, 2, 1)
    return replace(measured, xyz_m=-np.einsum("mij,mj->mi", R, measured.xyz_m), rotation=R, std=None, covariance=None)


def _rests(paired: Paired) -> list[NDArray[np.intp]]:
    """Return the rows of each rest of the arm, in which no joint moves."""
    if paired.speed is None:
        raise UsageError("--still needs joint readings with times", cure="Give --joints, both files with t_s")
    still = np.abs(paired.speed).max(axis=1) < min(STILL_RAD_S, STILL_M_S)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    spans = [np.arange(first, last) for first, last in zip(ends[::2], ends[1::2], strict=True)]
    return [span for span in spans if len(span) >= STILL_ROWS]


def _covariances(file: MeasuredFile, paired: Paired, rows: list[NDArray[np.intp]]) -> Array | None:
    """Return the covariance (k, 6, 6) of each group's mean, in the axes measured in; None where nobody says.

    What repeats from row to row, as far as the file tells it, is not made less by a mean.
    """
    if file.measured.covariance is None:
        return None
    at = np.searchsorted(file.measured.rows, paired.measured.rows)
    own, shared = file.measured.covariance[at], np.zeros((len(at), 6, 6))
    if file.repeats.systematic is not None:
        shared = file.repeats.systematic[at]
    return np.array([(own[g] - shared[g]).mean(axis=0) / len(g) + shared[g].mean(axis=0) for g in rows])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Joined:
    """Rows that belong together, the groups of them that make one row, the log, and the covariance (k, 6, 6)."""

    paired: Paired
    rows: list[NDArray[np.intp]]
    reported: Reported
    covariance: Array | None


def _write(job: JoinJob, arm: Arm | None, table: _Joined, inside: bool) -> None:
    """Write the file asked for: one row for each group of rows, their mean."""
    paired, rows, covariance = table.paired, table.rows, table.covariance
    measured = _inverse(paired.measured) if inside else paired.measured
    xyz = np.array([measured.xyz_m[group].mean(axis=0) for group in rows])
    turned = measured.rotation
    R = None if turned is None else Rotation.concatenate([Rotation.from_matrix(turned[g]).mean() for g in rows])
    if job.kind == "pairs" and R is not None:
        F = [RigidTransform.from_matrix(paired.F[group]).mean() for group in rows]
        seen = [RigidTransform.from_components(x, r) for x, r in zip(xyz, R, strict=True)]
        known = covariance is not None and bool((np.diagonal(covariance, axis1=1, axis2=2) > 0.0).all())
        write_pairs(job.out, PosePairs.of(F, seen, camera_covariance=covariance if known else None))
        return
    if paired.q is None or arm is None:
        raise UsageError(f"{job.kind} need joint readings")
    q = arm.readings(np.array([paired.q[group].mean(axis=0) for group in rows]))
    at_s = None if paired.at_s is None else np.array([paired.at_s[group].mean() for group in rows])
    q = q if at_s is None else table.reported.in_their_turn(q, at_s)
    names, columns = [*(f"q{i + 1}" for i in range(q.shape[1])), *POSITION], [q, xyz]
    if R is not None and job.kind == "points":
        names, columns = [*names, *QUATERNION], [*columns, R.as_quat(canonical=True)]
    if at_s is not None and job.kind == "points":  # calibrate arm takes neighbours in time as what they are
        names, columns = [*names, "t_s"], [*columns, at_s[:, None]]
    if covariance is not None:
        C = covariance[:, :3, :3]
        names = [*names, *POSITION_COVARIANCE]
        columns = [*columns, np.sqrt(np.diagonal(C, axis1=1, axis2=2)), C[:, (0, 0, 1), (1, 2, 2)]]
    labels = [measured.point[group[0]] for group in rows]
    named = any(labels)
    lines = [",".join([*names, *(["point"] if named else [])])]
    values = np.concatenate(columns, axis=1)
    lines += [f"{cells(row)},{word(label)}" if named else cells(row) for row, label in zip(values, labels, strict=True)]
    write_text(job.out, "\n".join(lines) + "\n")


def _output(job: JoinJob, file: MeasuredFile, paired: Paired, n: int) -> JoinOutput:
    clock = paired.clock
    by = "order" if paired.at_s is None or (clock is None and job.offset_s is None) else "time"
    rejected = [RejectedRow(row=row, why=why) for row, why in (*file.rejected, *paired.rejected)]
    return JoinOutput(
        kind=job.kind,
        by=by,
        offset_s=job.offset_s if clock is None else clock.offset_s,
        offset_std_s=None if clock is None else clock.std_s,
        drift_ppm=None if clock is None or clock.drift_ppm == 0.0 else clock.drift_ppm,
        n_measured=file.n,
        n=n,
        rejected=rejected,
        notes=[*file.notes, *paired.notes],
        file=str(job.out),
    )
