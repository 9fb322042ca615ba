"""Files of a verification: measured poses or points from here or from a tracker, joint readings, commanded poses.

Read as a recording leaves them: further columns are passed over and named, rows torn by NUL bytes are left out and
named; all others keep their number.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.columns import POSE6_STD, POSITION, QUATERNION
from armsight.errors import BadFile, NotEnoughData
from armsight.geometry.poses import QUAT_NORM_TOLERANCE
from armsight.records import PoseStatus
from armsight.store import covariances
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import check_joint_values, standard_bytes
from armsight.store.lost import NOTHING_LEFT, lost_rows, lost_words, without_rare_rotations
from armsight.store.tables import Table, no_rows, parse_table
from armsight.verify import Measured, Repeats, Reported

WORDS = ("status", "spots", "spot", "point", "pose", "visit", "run", "tag", "approach", "arrival", "robot")
GOAL = tuple(f"goal_{name}" for name in (*POSITION, *QUATERNION))
NUMBERS = (
    *(
        "t_s",
        *POSITION,
        *QUATERNION,
        *POSE6_STD,
        *covariances.SYSTEMATIC,
        *covariances.LIGHTS,
        *covariances.LIGHTS_STD,
        *covariances.VELOCITY,
        *covariances.VELOCITY_STD,
    ),
    *(*covariances.COVARIANCE, *covariances.SYSTEMATIC_COVARIANCE, *GOAL, "speed_m_s"),
)
KNOWN = frozenset((*NUMBERS, *WORDS))
"""Columns that mean something here, beside q1 .. qn; others are passed over."""
SAME_GOAL = 1e-3
"""Commanded poses that differ by less (m, or in a quaternion's entries) are one."""
NUL = b"\x00"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredFile:
    """What a file of measurements says: the rows that can be used, the joints they were taken at where those are
    columns of it, which commanded pose each is of (m,), which repeat, those left out, and notes."""

    measured: Measured
    reported: Reported | None
    pose: Array | None
    repeats: Repeats
    rejected: tuple[tuple[int, str], ...]
    notes: tuple[str, ...]
    n: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """A table read, the numbers of its rows (m,) from 1 in the file, the rows torn, and by their place those lost."""

    table: Table
    row: Index
    torn: tuple[tuple[int, str], ...]
    lost: Mapping[int, str]
    unused: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """How many rows the file has, torn ones included."""
        return len(self.row) + len(self.torn)

    def columns(self, names: tuple[str, ...]) -> Array:
        """Return columns of all rows (n, k) of the file, NaN where one is torn or lost."""
        out = np.full((self.n, len(names)), np.nan)
        out[self.row - 1] = self.table.stacked(names)
        out[self.row[list(self.lost)] - 1] = np.nan
        return out

    def words(self, name: str) -> tuple[str, ...]:
        """Return a column of words of all rows (n,) of the file, "" where one is torn or the column is not there."""
        out = [""] * self.n
        for row, word in zip(self.row, self.table.text.get(name, ()), strict=False):
            out[row - 1] = word.strip()
        return tuple(out)

    def has(self, names: tuple[str, ...]) -> bool:
        """Whether all of these are columns; BadFile where only some are."""
        there = [name for name in names if name in self.table.numbers]
        if there and len(there) < len(names):
            raise BadFile(
                f"{self.table.where}: of {', '.join(names)} only {', '.join(there)} "
                f"{'is' if len(there) == 1 else 'are'} there",
                cure="Give all of them, or none",
            )
        return bool(there)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommandedFile:
    """Commanded poses row by row, whether they have rotations, and where the file says so the pose's name, the path's
    name (tag) and the commanded speed (n,) in m/s."""

    reported: Reported
    turned: bool
    pose: tuple[str, ...] = ()
    path: tuple[str, ...] = ()
    speed_m_s: Array | None = None


def read_measured(path: Path, format_: TableFormat = OURS) -> MeasuredFile:
    """Return the measurements of a poses.csv, a points.csv, a tracker's table (t_s,x_m,y_m,z_m[,qx,qy,qz,qw]) or TUM.

    Raises BadFile that names line and column, NotEnoughData without a row.
    """
    return _measured(_parse(standard_bytes(path, "measured", format_), str(path), POSITION, rotations=False))


def _parse(
    data: bytes, where: str, required: tuple[str, ...], *, measured: bool = True, rotations: bool = True
) -> _Rows:
    """Return a file's table, torn rows counted, lost ones named; rotations: rows are of no use without them."""
    lines = data.splitlines(keepends=True)
    torn = [i for i, line in enumerate(lines, start=1) if NUL in line]
    if 1 in torn:
        raise BadFile(f"{where}: NUL bytes in the first line", cure="Save it as text")
    clean = b"".join(b"\n" if NUL in line else line for line in lines)
    header = _header(clean)
    unused = tuple(
        name for name in header if name and name not in KNOWN and not (name[0] == "q" and name[1:].isdecimal())
    )
    table = parse_table(
        clean,
        where,
        required,
        optional=(*NUMBERS, *WORDS, *unused),
        text=(*WORDS, *unused),
        blank=("q", *(name for name in NUMBERS if name != "t_s")),
        series="q",
        need_rows=False,
    )
    if not len(table):
        raise no_rows(where)
    row_of_line = {line: k + 1 for k, line in enumerate(sorted({*table.lines, *torn}))}
    row = np.array([row_of_line[line] for line in table.lines], dtype=np.intp)
    notes: list[str] = []
    table = table if rotations else without_rare_rotations(table, notes.append)
    return _Rows(
        table=table,
        row=row,
        torn=tuple((row_of_line[line], f"line {line} holds NUL bytes") for line in torn),
        lost=lost_rows(table, measured=measured),
        unused=unused,
        notes=tuple(notes),
    )


def _header(data: bytes) -> list[str]:
    for line in data.decode("utf-8-sig", errors="replace").splitlines():
        if line.strip():
            return [name.strip() for name in next(csv.reader([line]))]
    return []


def _measured(rows: _Rows) -> MeasuredFile:
    table = rows.table
    turned = rows.has(QUATERNION) and not np.isnan(table.stacked(QUATERNION)).all()
    quat = table.stacked(QUATERNION) if turned else None
    index, rejected, lost = _usable(rows, quat)
    if not len(index):
        raise NotEnoughData(
            f"{table.where}: no row has a position that can be used: {[*lost.values(), *dict(rejected).values()][0]}",
            consequence="There is nothing to do",
            cure=NOTHING_LEFT,
        )
    measured = Measured(
        xyz_m=table.stacked(POSITION)[index],
        rotation=None if quat is None else Rotation.from_quat(quat[index]).as_matrix(),
        t_s=table.numbers["t_s"][index] if "t_s" in table.numbers else None,
        covariance=_covariance(table, index, turned),
        row=rows.row[index],
        point=_labels(table, index),
    )
    notes = [*rows.notes, *([lost_words(lost, table)] if lost else [])]
    if measured.covariance is not None and not covariances.has_correlations(table.numbers):
        notes.append(f"the file {covariances.UNCORRELATED}")
    notes += [f"columns not used: {', '.join(rows.unused)[:200]}"] if rows.unused else []
    return MeasuredFile(
        measured=measured,
        reported=_own_joints(rows),
        pose=_poses(table, index),
        repeats=_repeats(table, index),
        rejected=(*rows.torn, *rejected),
        notes=tuple(notes),
        n=rows.n,
    )


def _usable(rows: _Rows, quat: Array | None) -> tuple[Index, list[tuple[int, str]], dict[int, str]]:
    """Return the places of the rows that can be used, those left out with the reason, and those lost."""
    table = rows.table
    status = table.text.get("status", (PoseStatus.OK.value,) * len(table))
    good, rejected, lost = [], [], dict[int, str]()
    for i in range(len(table)):
        row = int(rows.row[i])
        if status[i] == PoseStatus.DOUBTFUL.value:
            rejected.append((row, "doubtful: it, or its run, does not fit what its measurement claims"))
        elif status[i] == PoseStatus.POSITION_ONLY.value:
            rejected.append((row, "a position only: that of the mean of the lights seen, another point"))
        elif status[i] == PoseStatus.LOST.value or i in rows.lost:
            lost[i] = rows.lost.get(i, "of status lost")
        elif quat is not None and abs(np.linalg.norm(quat[i]) - 1.0) > QUAT_NORM_TOLERANCE:
            rejected.append((row, f"its quaternion has length {np.linalg.norm(quat[i]):.4g}, not 1"))
        else:
            good.append(i)
    return np.array(good, dtype=np.intp), rejected, lost


def _covariance(table: Table, index: Index, turned: bool) -> Array | None:
    """Return covariances (m, 6, 6), of positions with zeros beyond; None where a row of those used has no standard
    deviations."""
    names = POSE6_STD if turned else POSE6_STD[:3]
    if any(name not in table.numbers for name in names):
        return None
    std = table.stacked(names)[index]
    if np.isnan(std).any() or not std[:, :3].any():
        return None
    return _in_six(covariances.covariances(table, std, index.tolist()))


def _in_six(covariance: Array) -> Array:
    """Return covariances (m, k, k) as (m, 6, 6), with zeros beyond."""
    out = np.zeros((len(covariance), 6, 6))
    k = covariance.shape[1]
    out[:, :k, :k] = covariance
    return out


def _labels(table: Table, index: Index) -> tuple[str, ...]:
    words = table.text.get("point", table.text.get("spot"))
    return () if words is None else tuple(words[i] for i in index)


def _own_joints(rows: _Rows) -> Reported | None:
    names = rows.table.series("q")
    return Reported(q=rows.columns(names)) if names else None


def _poses(table: Table, index: Index) -> Array | None:
    """Return which commanded pose each row (m,) is of, by number; None where the file does not say."""
    if "pose" in table.text:
        none = ("",) * len(table)
        robot, moving = table.text.get("robot", none), table.text.get("arrival", none)
        # rows of an arrival are on their way; another robot's pose is another pose
        words = [f"{robot[i]} {table.text['pose'][i]}".strip() if not moving[i].strip() else "" for i in index]
        which = np.unique(words, return_inverse=True)[1].astype(float)
        return np.where([bool(word) for word in words], which, np.nan)
    if any(name not in table.numbers for name in GOAL):
        return None
    goal = table.stacked(GOAL)[index]
    goal[:, 3:] *= np.where(goal[:, 6:] < 0.0, -1.0, 1.0)
    if np.isnan(goal).any():
        return None
    step = np.abs(np.diff(goal, axis=0)).max(axis=1) > SAME_GOAL  # rows of one command follow each other
    return np.concatenate([[0.0], np.cumsum(step)])


def _repeats(table: Table, index: Index) -> Repeats:
    none = ("",) * len(table)
    words = {
        name: tuple(table.text.get(name, none)[i].strip() for i in index)
        for name in ("pose", "visit", "run", "tag", "approach", "arrival", "robot")
    }
    systematic = None
    if all(name in table.numbers for name in covariances.SYSTEMATIC[:3]):
        there = tuple(name for name in covariances.SYSTEMATIC if name in table.numbers)
        std = np.nan_to_num(table.stacked(there)[index])
        systematic = _in_six(
            covariances.covariances(table, std[:, : 6 if len(there) == 6 else 3], index.tolist(), "sys_")
        )
    return Repeats(path=words.pop("tag"), systematic=systematic, **words)


def read_reported_joints(path: Path, format_: TableFormat = OURS) -> Reported:
    """Return joint readings q1..qn, with t_s or without; rows torn by NUL bytes are NaN. Raises BadFile."""
    rows = _parse(standard_bytes(path, "reported", format_), str(path), ("q1",))
    if rows.lost:
        format_.notify(f"{path.name}: {lost_words(rows.lost, rows.table)}")
    q = rows.columns(rows.table.series("q"))
    check_joint_values(q, str(path), format_)
    return Reported(q=q, t_s=_stamps(rows))


def read_commanded(path: Path, format_: TableFormat = OURS) -> CommandedFile:
    """Return commanded poses of a path.csv, plan.csv, poses.csv or TUM. Raises BadFile that names line and column."""
    rows = _parse(standard_bytes(path, "measured", format_), str(path), POSITION, measured=False)
    turned = rows.has(QUATERNION)
    T = np.tile(np.eye(4), (rows.n, 1, 1))
    T[:, :3, 3] = rows.columns(POSITION)
    if turned:
        quat = rows.columns(QUATERNION)
        good = np.isfinite(quat).all(axis=1) & (np.abs(np.linalg.norm(quat, axis=1) - 1.0) <= QUAT_NORM_TOLERANCE)
        T[~good] = np.nan
        T[good, :3, :3] = Rotation.from_quat(quat[good]).as_matrix()
    speed = rows.columns(("speed_m_s",))[:, 0] if "speed_m_s" in rows.table.numbers else None
    return CommandedFile(
        reported=Reported(T=T, t_s=_stamps(rows)),
        turned=turned,
        pose=rows.words("pose"),
        path=rows.words("tag"),
        speed_m_s=speed,
    )


def _stamps(rows: _Rows) -> Array | None:
    """Return the stamps (n,) of all rows; those of torn ones lie between their neighbours'."""
    if "t_s" not in rows.table.numbers:
        return None
    t = rows.columns(("t_s",))[:, 0]
    known = np.isfinite(t)
    return np.asarray(np.interp(np.arange(len(t)), np.flatnonzero(known), t[known]))
