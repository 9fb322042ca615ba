"""Visits and runs out of measured rows that say which repeat they are of: what the figures of ISO 9283 rest on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.timing.sampling import SHARED
from armsight.columns import POSITION
from armsight.errors import Inconsistent
from armsight.verify.body import FEWEST, Bodies, bodies_of
from armsight.verify.iso9283 import ArrivalTest, CommandedPath, Iso9283Test, PathRun, PathTest, PoseVisits, Stamps
from armsight.verify.iso9283.observations import random_part
from armsight.verify.iso9283.pose import pose_figures
from armsight.verify.records import Columns, Measured, Repeats

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


def iso9283_test(
    measured: Measured, repeats: Repeats, command: Command | None, band_m: float | None = None
) -> tuple[Iso9283Test, tuple[str, ...]]:
    """Return the visits, arrivals and runs of measured rows, and what to know of them.

    band_m: the limit band of arrivals in m; without it the pose repeatability of the visits of the same pose.

    Rows of one visit are its samples at rest: their mean counts. No row is left out: a repeat that went wrong is part
    of the repeatability.
    """
    notes: list[str] = []
    use, body = np.arange(len(measured)), _bodies(measured, repeats, command, notes)
    if len(measured.labels) > 1 and body is None:
        notes.append(f"ISO 9283: of {len(measured.labels)} points only {measured.labels[0]!r} is judged")
    if len(measured.labels) > 1:
        use = np.flatnonzero(measured.which == 0)
    _check_arrivals(measured, repeats)
    visited, run, moving = (np.array(words)[use] for words in (repeats.at_pose, repeats.run, repeats.arrival))
    at_pose, on_path, on_way = use[visited != ""], use[run != ""], use[moving != ""]
    if body is None:
        poses = _all_visits(at_pose, measured, repeats, command, notes)
    else:
        poses = _all_visits(
            np.arange(len(body.measured)), body.measured, body.repeats, _commanded_where_known(body, command), notes
        )
    path_of = [(repeats.robot[i], repeats.path[i] or PATH) for i in on_path]
    paths = tuple(
        _path(key, on_path[[of == key for of in path_of]], measured, repeats, command, notes)
        for key in dict.fromkeys(path_of)
    )
    way_of = [(repeats.robot[i], repeats.pose[i]) for i in on_way]
    bands = {visits.place: band_m or repeatability_m(visits) for visits in poses}
    arrivals = tuple(
        _arrivals(place, on_way[[of == key for of in way_of]], measured, repeats, bands.get(place, band_m), notes)
        for key in dict.fromkeys(way_of)
        for place in (" ".join(key).strip(),)
    )
    return Iso9283Test(poses=poses, paths=paths, arrivals=arrivals), tuple(notes)


def _all_visits(
    at_pose: Index, measured: Measured, repeats: Repeats, command: Command | None, notes: list[str]
) -> tuple[PoseVisits, ...]:
    """Return the visits of every pose that rows (k,) are at rest at."""
    visits = _visit_numbers(repeats, at_pose, notes)
    pose_of = np.array(repeats.at_pose)[at_pose]
    return tuple(
        _visits(at_pose[pose_of == name], visits[pose_of == name], measured, repeats, command, notes)
        for name in sorted(set(pose_of.tolist()))
    )


def _bodies(measured: Measured, repeats: Repeats, command: Command | None, notes: list[str]) -> Bodies | None:
    """Return the body that three or more points are of, at each visit; None where they make none."""
    at_rest = np.flatnonzero(np.array(repeats.at_pose) != "")
    if len(measured.labels) < FEWEST or not len(at_rest):
        return None
    wanted = None
    if command is not None and len(command.row):
        wanted = np.full((len(measured), 3), np.nan)
        _, mine, theirs = np.intersect1d(measured.rows, command.row, return_indices=True)
        wanted[mine] = command.T[theirs, :3, 3]
    found = bodies_of(measured, repeats, at_rest, _visit_numbers(repeats, at_rest, notes), wanted)
    if found is not None:
        notes += [note for note in found.notes if wanted is not None or "commanded" not in note]
    return found


def _commanded_where_known(body: Bodies, command: Command | None) -> Command | None:
    """Return where the body was told to be, at the visits for which that is known."""
    known = np.isfinite(body.commanded[:, 0, 0])
    if command is None or not known.any():
        return None
    return replace(command, row=body.measured.rows[known], T=body.commanded[known], turned=True)


def repeatability_m(visits: PoseVisits) -> float | None:
    """Return RP in m of a pose's visits; None where it is withheld or nothing scatters."""
    found = next(figure for figure in pose_figures(visits) if figure.symbol == "RP")
    return found.value or None


def _check_arrivals(measured: Measured, repeats: Repeats) -> None:
    """Raise Inconsistent for rows of an arrival that do not say at which pose, or that are of a run too."""
    rows = zip(measured.rows.tolist(), repeats.arrival, repeats.pose, repeats.run, strict=True)
    for row, arrival, pose, run in rows:
        if arrival and (run or not pose):
            raise Inconsistent(
                f"row {row} is of arrival {arrival}, and " + ("of a run too" if run else "has no pose"),
                consequence="At which pose the arm arrives is not known",
                cure="Fill the columns pose and arrival in each row of an arrival, and leave run empty there",
            )


def _arrivals(
    place: str, index: Index, measured: Measured, repeats: Repeats, band_m: float | None, notes: list[str]
) -> ArrivalTest:
    """Return the traces of the arrivals at one pose, in the order in which they begin."""
    arrival_of = np.array([repeats.arrival[i] for i in index])
    members = [index[arrival_of == name] for name in dict.fromkeys(arrival_of)]
    covariance, systematic = _sample_covariance(measured, repeats, index)
    return ArrivalTest(
        pose=place,
        traces=tuple(_trace(measured, rows) for rows in members),
        band_m=band_m,
        stamps=_stamps(measured, members, f"arrivals at {place}", notes),
        covariance_m2=covariance,
        systematic_m2=systematic,
    )


def _trace(measured: Measured, rows: Index) -> PathRun:
    """Return measured rows as one run or arrival."""
    return PathRun(
        xyz_m=measured.xyz_m[rows],
        t_s=None if measured.t_s is None else measured.t_s[rows],
        quat_xyzw=None if measured.rotation is None else Rotation.from_matrix(measured.rotation[rows]).as_quat(),
    )


def _stamps(measured: Measured, members: list[Index], name: str, notes: list[str]) -> Stamps:
    """Return what the stamps of runs or arrivals are; rows that share them were stamped when they were delivered."""
    if measured.t_s is None:
        return Stamps.ABSENT
    stamps = (measured.t_s[rows] for rows in members)
    if any(len(t) > 1 and float(np.mean(np.diff(t) == 0.0)) >= SHARED for t in stamps):
        notes.append(f"ISO 9283: rows of {name} share stamps: these are those of deliveries, and speed is withheld")
        return Stamps.ARRIVAL
    return Stamps.SAMPLING


def _sample_covariance(measured: Measured, repeats: Repeats, index: Index) -> tuple[Array | None, Array | None]:
    """Return the covariance (3, 3) of one sample and the part that all share; None where they are not parted."""
    covariance, systematic = _covariance(measured, repeats, [index], turned=False)
    if covariance is None or systematic is None:
        return None, None
    return (covariance[0] - systematic) * len(index) + systematic, systematic  # of one sample, not of the mean of all


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
        name = repeats.at_pose[i]
        count[name] = count.get(name, 0) + (name != last)
        last = name
        out.append(count[name])
    return np.array(out, dtype=np.intp)


def _visits(
    index: Index, visit: Index, measured: Measured, repeats: Repeats, command: Command | None, notes: list[str]
) -> PoseVisits:
    """Return the visits of one robot at one pose: the mean of each visit's rows."""
    name, robot = repeats.pose[index[0]], repeats.robot[index[0]]
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
        robot=robot,
    )


def _covariance(
    measured: Measured, repeats: Repeats, members: list[Index], turned: bool
) -> tuple[Array | None, Array | None]:
    """Return the covariance of each visit's mean and the part that all share; None where the file does not part them.

    Where the shared part is not told, none of the deviation can be taken out of the scatter of repeats.
    """
    if measured.covariance is None or repeats.systematic is None:
        return None, None
    size = 6 if turned else 3
    own = np.concatenate(members)
    shared = repeats.systematic[own, :size, :size].mean(axis=0)
    total = measured.covariance[:, :size, :size]
    each = [random_part(total[rows].mean(axis=0), shared) / len(rows) + shared for rows in members]
    return np.array(each), shared


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
    key: tuple[str, str], index: Index, measured: Measured, repeats: Repeats, command: Command | None, notes: list[str]
) -> PathTest:
    """Return the runs of one robot along one path, key being both names, in the order in which they begin."""
    name = " ".join(key).strip()
    run_of = np.array([repeats.run[i] for i in index])
    members = [index[run_of == run] for run in dict.fromkeys(run_of)]
    covariance, systematic = _sample_covariance(measured, repeats, index)
    return PathTest(
        name=name,
        runs=tuple(_trace(measured, rows) for rows in members),
        commanded=None if command is None else command.paths.get(key[1], command.paths.get(PATH)),
        in_measuring_frame=command is not None and command.in_frame,
        stamps=_stamps(measured, members, name, notes),
        covariance_m2=covariance,
        systematic_m2=systematic,
    )


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


def about_mean(measured: Measured, repeats: Repeats) -> Columns:
    """Return the measured places row by row with their repeat, and how far each is from the mean of its pose, m."""
    pose = np.array(repeats.at_pose)
    apart = np.full(len(measured), np.nan)
    for name in sorted(set(pose) - {""}):
        own = measured.xyz_m[pose == name]
        apart[pose == name] = np.linalg.norm(own - own.mean(axis=0), axis=1)
    return {
        "row": measured.rows,
        "pose": list(repeats.pose),
        "visit": list(repeats.visit),
        "run": list(repeats.run),
        **dict(zip(POSITION, measured.xyz_m.T, strict=True)),
        "from_mean_m": apart,
    }
