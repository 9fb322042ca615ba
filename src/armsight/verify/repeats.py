"""Visits and runs out of measured rows that say which repeat they are of: what the figures of ISO 9283 rest on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.errors import Inconsistent
from armsight.verify.clocks import SHARED
from armsight.verify.iso9283 import CommandedPath, Iso9283Test, PathRun, PathTest, PoseVisits, Stamps
from armsight.verify.records import Measured, Repeats

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SAME_COMMAND_M = 1e-3
"""Commands of one pose's visits that lie further apart are not of one pose."""
LEAST_STEP_M = 1e-5
"""Commanded points that are closer to the one before give a path no direction."""
PATH = "path"
"""What a path is called that the file gives no name."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Command:
    """Where what was measured should be: T (k, 4, 4) for the rows (k,) of the measured file, in the frame that was
    measured in. turned: whether it has rotations. in_frame: False where base or tool were fitted to the same rows.
    paths: the commanded paths by name, {PATH: ...} for one without a name."""

    row: Index
    T: Array
    turned: bool
    in_frame: bool
    paths: Mapping[str, CommandedPath] = field(default_factory=dict)


def iso9283_test(measured: Measured, repeats: Repeats, command: Command | None) -> tuple[Iso9283Test, tuple[str, ...]]:
    """Return the visits and runs of measured rows, and what to know of them.

    Rows of one visit are its samples at rest: their mean counts. No row is left out: a repeat that went wrong is part
    of the repeatability.
    """
    notes: list[str] = []
    use = np.arange(len(measured))
    if len(measured.labels) > 1:
        use = np.flatnonzero(measured.which == 0)
        notes.append(f"ISO 9283: of {len(measured.labels)} points only {measured.labels[0]!r} is judged")
    pose, run = (np.array(words)[use] for words in (repeats.pose, repeats.run))
    at_pose, on_path = use[(pose != "") & (run == "")], use[run != ""]
    names = sorted({repeats.pose[i] for i in at_pose})
    visits = _visit_numbers(repeats, at_pose, notes)
    poses = [
        _visits(name, at_pose[pose_of == name], visits[pose_of == name], measured, repeats, command, notes)
        for pose_of in [np.array(repeats.pose)[at_pose]]
        for name in names
    ]
    path_of = np.array([repeats.path[i] or PATH for i in on_path])
    paths = [
        _path(name, on_path[path_of == name], measured, repeats, command, notes) for name in dict.fromkeys(path_of)
    ]
    return Iso9283Test(poses=tuple(poses), paths=tuple(paths)), tuple(notes)


def _visit_numbers(repeats: Repeats, index: Index, notes: list[str]) -> Index:
    """Return the visit (k,) of the rows; without that column rows of one pose that follow each other are one visit.

    A camera at rest gives many rows of one visit: counted as visits they would show its noise as the arm's
    repeatability.
    """
    words = [repeats.visit[i] for i in index]
    if not len(index):
        return np.empty(0, dtype=np.intp)
    if all(words):
        numbers = all(word.isdecimal() for word in words)
        return np.array([int(w) for w in words]) if numbers else np.unique(words, return_inverse=True)[1]
    if any(words):
        raise Inconsistent(
            f"{sum(not word for word in words)} of {len(words)} rows of commanded poses have no visit",
            consequence="Repeats cannot be counted",
            cure="Fill the column visit for all of them, or leave it out",
        )
    notes.append("ISO 9283: without a column visit, rows of one pose that follow each other are one visit")
    count: dict[str, int] = {}
    out, last = [], None
    for i in index:
        name = repeats.pose[i]
        count[name] = count.get(name, 0) + (name != last)
        last = name
        out.append(count[name])
    return np.array(out, dtype=np.intp)


def _visits(
    name: str,
    index: Index,
    visit: Index,
    measured: Measured,
    repeats: Repeats,
    command: Command | None,
    notes: list[str],
) -> PoseVisits:
    """Return the visits of one pose: the mean of each visit's rows."""
    numbers = np.unique(visit)
    members = [index[visit == number] for number in numbers]
    quat = None
    if measured.rotation is not None:
        quat = np.array([Rotation.from_matrix(measured.rotation[rows]).mean().as_quat() for rows in members])
    covariance, systematic = _covariance(measured, repeats, members, quat is not None)
    came = [{repeats.approach[i] for i in rows} for rows in members]
    wanted = _commanded(name, index, measured, command, notes)
    return PoseVisits(
        pose=name,
        visit=numbers.astype(np.int64),
        xyz_m=np.array([measured.xyz_m[rows].mean(axis=0) for rows in members]),
        quat_xyzw=quat,
        covariance=covariance,
        systematic=systematic,
        approach=tuple(" and ".join(sorted(words)) for words in came) if all(all(words) for words in came) else None,
        commanded_xyz_m=None if wanted is None else wanted[0],
        commanded_quat_xyzw=None if wanted is None else wanted[1],
        in_measuring_frame=command is not None and command.in_frame,
    )


def _covariance(
    measured: Measured, repeats: Repeats, members: list[Index], turned: bool
) -> tuple[Array | None, Array | None]:
    """Return the covariance of each visit's mean and the part that all share; None where the file does not part them.

    Where the shared part is not told, none of the deviation can be taken out of the scatter of repeats.
    """
    if measured.std is None or repeats.systematic is None:
        return None, None
    size = 6 if turned else 3
    own = np.concatenate(members)
    shared = np.mean(repeats.systematic[own, :size] ** 2, axis=0)
    total = measured.std[:, :size] ** 2
    each = [np.diag(np.maximum(total[rows].mean(axis=0) - shared, 0.0) / len(rows) + shared) for rows in members]
    return np.array(each), np.diag(shared)


def _commanded(
    name: str, index: Index, measured: Measured, command: Command | None, notes: list[str]
) -> tuple[Array, Array | None] | None:
    """Return the position (3,) and quaternion (4,) that a pose's rows were commanded to; None where that is not one."""
    if command is None:
        return None
    T = command.T[np.isin(command.row, measured.rows[index])]
    if not len(T):
        return None
    apart = float(np.linalg.norm(T[:, :3, 3] - T[:, :3, 3].mean(axis=0), axis=1).max())
    if apart > SAME_COMMAND_M:
        notes.append(
            f"ISO 9283: what was commanded at pose {name} differs by {1e3 * apart:.3g} mm between its rows: "
            "it is not taken for one pose, and AP is withheld"
        )
        return None
    quat = Rotation.from_matrix(T[:, :3, :3]).mean().as_quat() if command.turned else None
    return T[:, :3, 3].mean(axis=0), quat


def _path(
    name: str, index: Index, measured: Measured, repeats: Repeats, command: Command | None, notes: list[str]
) -> PathTest:
    """Return the runs along one path, in the order in which they begin."""
    run_of = np.array([repeats.run[i] for i in index])
    members = [index[run_of == run] for run in dict.fromkeys(run_of)]
    runs = tuple(
        PathRun(
            xyz_m=measured.xyz_m[rows],
            t_s=None if measured.t_s is None else measured.t_s[rows],
            quat_xyzw=None if measured.rotation is None else Rotation.from_matrix(measured.rotation[rows]).as_quat(),
        )
        for rows in members
    )
    covariance, systematic = _covariance(measured, repeats, [index], turned=False)
    stamps = Stamps.ABSENT if measured.t_s is None else Stamps.SAMPLING
    if measured.t_s is not None and any(_bursts(measured.t_s[rows]) for rows in members):
        stamps = Stamps.ARRIVAL
        notes.append(f"ISO 9283: rows of {name} share stamps: these are those of deliveries, and speed is withheld")
    if covariance is not None and systematic is not None:  # of one sample, not of the mean of all
        covariance = (covariance[0] - systematic) * len(index) + systematic
    return PathTest(
        name=name,
        runs=runs,
        commanded=None if command is None else command.paths.get(name, command.paths.get(PATH)),
        in_measuring_frame=command is not None and command.in_frame,
        stamps=stamps,
        covariance_m2=covariance,
        systematic_m2=systematic,
    )


def _bursts(t_s: Array) -> bool:
    return len(t_s) > 1 and float(np.mean(np.diff(t_s) == 0.0)) >= SHARED


def polyline(T: Array, turned: bool, speed_m_s: float | None = None) -> CommandedPath | None:
    """Return commanded poses (k, 4, 4) as a path, repeated points left out; None where fewer than two remain."""
    kept: list[int] = []
    for i in range(len(T)):
        if np.isfinite(T[i]).all() and (not kept or np.linalg.norm(T[i, :3, 3] - T[kept[-1], :3, 3]) > LEAST_STEP_M):
            kept.append(i)
    if len(kept) < 2:
        return None
    quat = Rotation.from_matrix(T[kept, :3, :3]).as_quat() if turned else None
    return CommandedPath(xyz_m=T[kept, :3, 3], quat_xyzw=quat, speed_m_s=speed_m_s)
