"""A joint log, or the robot's poses, joined with what cameras or a tracker measured, though on another clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye import PosePairs
from armsight.columns import POSITION, QUATERNION
from armsight.errors import Ambiguous, Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.ops.rests import STILL_RAD_S, STILL_ROWS, rests_of_measured, rests_of_robot, spans
from armsight.records.output import output
from armsight.records.result_parts import RejectedRow
from armsight.shown import REJECTED_SHOWN, Shown, digits
from armsight.store.atomic import TextOutput
from armsight.store.covariances import POSITION_COVARIANCE
from armsight.store.handeye_file import pairs_text
from armsight.store.interpret import TableFormat
from armsight.store.tables import Columns, cells, read_columns, word
from armsight.store.verify_files import MeasuredFile, read_commanded, read_reported_joints
from armsight.units import MS
from armsight.verify import Align, Measured, Paired, Reported
from armsight.verify.model import Mounts
from armsight.verify.pairing import pair, pair_at

KINDS = ("points", "observed", "pairs", "visits")
SAME_POSE = 5e-3
"""Rests whose joints read no more apart (rad or m) are visits of one pose."""


@output
class JoinResult(TextOutput):
    """armsight join."""

    kind: Annotated[str, Doc("The table written: points, observed, pairs or visits.")]
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

    @property
    def table(self) -> Columns:
        """The columns, by name, of the rows that belong together."""
        return read_columns(self.content.encode())

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        if self.offset_s is not None:
            std = "as stated" if self.offset_std_s is None else f"+- {digits(self.offset_std_s / MS, 2)} ms"
            yield f"Measured times {self.offset_s:+.6f} s are the robot's ({std})"
        for text in self.notes:
            yield f"- {text}"
        for item in self.rejected[:REJECTED_SHOWN]:
            yield f"  left out: row {item.row}: {item.why}"
        yield f"{self.n} rows of {self.kind} from {self.n_measured} measured, by {self.by}: {self.file}"


def require_sources(kind: str, joints: Path | None, arm: Arm | None, robot_stream: Path | None) -> None:
    """Raise UsageError for what cannot be joined to a table of this kind."""
    if kind not in KINDS:
        raise UsageError(f"no table is called {kind!r}", cure=f"Give --as with one of {', '.join(KINDS)}")
    if (joints is None) == (robot_stream is None):
        raise UsageError(
            "what the robot did is not said, or twice",
            consequence="Nothing is joined",
            cure="Give --joints with --arm, or --robot-stream with the flange's poses",
        )
    if joints is not None and arm is None:
        raise UsageError("--joints needs --arm", cure="Give the arm: its nominal geometry is enough")
    if robot_stream is not None and kind != "pairs":
        raise UsageError(f"{kind} need joint readings", cure="Give --joints and --arm, or --as pairs")


def flange_poses(path: Path, table: TableFormat) -> Reported:
    """Return the flange's poses over time. Raises UsageError for positions alone."""
    commanded = read_commanded(path, table)
    if not commanded.turned:
        raise UsageError(f"{path} has no rotations", cure="Give the flange's poses")
    return commanded.reported


def joint_log(path: Path, arm: Arm, table: TableFormat) -> Reported:
    """Return the joints' own values over time. Raises UsageError for the log of another arm."""
    found = read_reported_joints(path, table.of_arm(arm))
    if found.q is None or found.q.shape[1] != arm.n:
        count = 0 if found.q is None else found.q.shape[1]
        raise UsageError(f"{path} has {count} joints, {arm.name} has {arm.n}", cure="Give the log of this arm")
    return found.values_of(arm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Join:
    """What is joined: measured rows, what the robot told over time, and its arm, where joints are told.

    kind: of KINDS; inside: of pairs, the camera is on the hand; offset_s: stated; still: a row for each rest.
    """

    kind: str
    file: MeasuredFile
    reported: Reported
    arm: Arm | None
    inside: bool
    offset_s: float | None
    still: bool

    def result(self, out: Path | None) -> JoinResult:
        """Find the time offset and the rows that belong together, by order where one side has no times."""
        if self.still and self.reported.t_s is None and self.file.measured.t_s is not None:
            return self._by_rests(out)
        try:
            paired = self._paired()
        except Ambiguous:  # poses visited in turn: any of their visits may be the first
            if self.still and self.reported.q is not None:
                return self._by_rests(out)
            raise
        rows = _rests(paired) if self.still else [np.array([i]) for i in range(len(paired.measured))]
        if not rows:
            raise NotEnoughData(
                f"none of {len(self.file.measured)} measured rows has its place among the robot's",
                consequence="Nothing is written",
                cure="Leave --still away, or let the arm rest"
                if self.still
                else "Check that both files are of one run",
            )
        clock = paired.clock
        by = "order" if paired.at_s is None or (clock is None and self.offset_s is None) else "time"
        rejected = [RejectedRow(row=row, why=why) for row, why in (*self.file.rejected, *paired.rejected)]
        return JoinResult(
            kind=self.kind,
            by=by,
            offset_s=self.offset_s if clock is None else clock.offset_s,
            offset_std_s=None if clock is None else clock.std_s,
            drift_ppm=None if clock is None or clock.drift_ppm == 0.0 else clock.drift_ppm,
            n_measured=self.file.n,
            n=len(rows),
            rejected=rejected,
            notes=[*self.file.notes, *paired.notes],
            file=None if out is None else str(out),
            content=self._table(paired, rows),
        )

    def _paired(self) -> Paired:
        seen = _inverse(self.file.measured) if self.inside else self.file.measured  # the camera seen by the target
        if self.offset_s is not None:
            return pair_at(self.arm, self.reported, seen, self.offset_s)
        origin = Mounts(base=RigidTransform.identity(), tools=(RigidTransform.identity(),))
        return pair(self.arm, self.reported, seen, origin, Align.BOTH)

    def _by_rests(self, out: Path | None) -> JoinResult:
        """Join the rests of what was measured, in their order, with those of the robot or a program's points."""
        reported, file = rests_of_robot(self.reported), rests_of_measured(self.file)
        n, wanted = len(file.measured), len(reported)
        if n != wanted or not n:
            raise Inconsistent(
                f"what was measured rests {n} times, and the robot's file has {wanted} "
                + ("points" if self.reported.t_s is None else "rests"),
                consequence="Which of them belong together is not known; nothing is written",
                cure="Leave the same out of both, such as a rest at home before and after; rest for a second at each",
            )
        return replace(self, file=file, reported=reported, still=False).result(out)

    def _table(self, paired: Paired, rows: list[NDArray[np.intp]]) -> str:
        """Return the table asked for: one row for each group of rows, their mean."""
        covariance = _covariances(self.file, paired, rows)
        measured = _inverse(paired.measured) if self.inside else paired.measured
        xyz = np.array([measured.xyz_m[group].mean(axis=0) for group in rows])
        turned = measured.rotation
        R = None if turned is None else Rotation.concatenate([Rotation.from_matrix(turned[g]).mean() for g in rows])
        if self.kind == "pairs" and R is not None:
            F = [RigidTransform.from_matrix(paired.F[group]).mean() for group in rows]
            seen = [RigidTransform.from_components(x, r) for x, r in zip(xyz, R, strict=True)]
            known = covariance is not None and bool((np.diagonal(covariance, axis1=1, axis2=2) > 0.0).all())
            return pairs_text(PosePairs.of(F, seen, camera_covariance=covariance if known else None))
        if paired.q is None or self.arm is None:
            raise UsageError(f"{self.kind} need joint readings")
        q = self.arm.readings(np.array([paired.q[group].mean(axis=0) for group in rows]))
        at_s = None if paired.at_s is None else np.array([paired.at_s[group].mean() for group in rows])
        q = q if at_s is None else self.reported.in_their_turn(q, at_s)
        names, columns = [*(f"q{i + 1}" for i in range(q.shape[1])), *POSITION], [q, xyz]
        if R is not None and self.kind != "observed":
            names, columns = [*names, *QUATERNION], [*columns, R.as_quat(canonical=True)]
        if at_s is not None and self.kind != "observed":  # calibrate arm takes neighbours in time as what they are
            names, columns = [*names, "t_s"], [*columns, at_s[:, None]]
        if covariance is not None:
            C = covariance[:, :3, :3]
            names = [*names, *POSITION_COVARIANCE]
            columns = [*columns, np.sqrt(np.diagonal(C, axis1=1, axis2=2)), C[:, (0, 0, 1), (1, 2, 2)]]
        words = _visits(q) if self.kind == "visits" else {}
        labels = [measured.point[group[0]] for group in rows]
        words |= {"point": labels} if any(labels) else {}
        lines = [",".join([*names, *words])]
        values = np.concatenate(columns, axis=1)
        told = zip(*words.values(), strict=True) if words else [()] * len(rows)
        lines += [",".join([cells(row), *map(word, more)]) for row, more in zip(values, told, strict=True)]
        return "\n".join(lines) + "\n"


def _inverse(measured: Measured) -> Measured:
    if measured.rotation is None:
        return measured
    R = measured.rotation.transpose(0, 2, 1)
    return replace(measured, xyz_m=-np.einsum("mij,mj->mi", R, measured.xyz_m), rotation=R, std=None, covariance=None)


def _rests(paired: Paired) -> list[NDArray[np.intp]]:
    """Return the rows of each rest of the arm, in which no joint moves."""
    if paired.speed is None:
        raise UsageError("--still needs joint readings with times", cure="Give --joints, both files with t_s")
    return spans(np.abs(paired.speed).max(axis=1) < STILL_RAD_S, STILL_ROWS)


def _visits(q: Array) -> dict[str, list[str]]:
    """Return of which pose each rest (n, joints) is a visit, rest1 the first, and which visit of it."""
    first: list[Array] = []
    pose, visit = [], []
    for row in q:
        same = next((k for k, other in enumerate(first) if np.abs(row - other).max() < SAME_POSE), len(first))
        first += [row] if same == len(first) else []
        pose.append(f"rest{same + 1}")
        visit.append(str(pose.count(pose[-1])))
    return {"pose": pose, "visit": visit}


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
