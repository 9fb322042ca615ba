"""The figures of ISO 9283 of a file: which command its repeats had, in the frame that was measured in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.store.verify_files import CommandedFile, MeasuredFile
from armsight.verify import Align, Measured, Reported, Verification
from armsight.verify.iso9283 import CommandedPath, evaluate
from armsight.verify.iso9283.drift import trend
from armsight.verify.iso9283.figure import IsoFigure
from armsight.verify.repeats import PATH, Command, iso9283_test, polyline

SAME_GOAL_M = 1e-6
"""Rows of one commanded pose's name that differ by more (m) contradict each other."""
WIDEST_M = 30.0
"""Measured places further apart than any arm reaches are not in m."""


def iso_figures(
    file: MeasuredFile, measured: Measured, command: Command | None, band_m: float | None = None
) -> tuple[dict[str, IsoFigure], tuple[str, ...]]:
    """Return the figures by key, and what to know of them. Raises Inconsistent where repeats contradict each other.

    band_m: the limit band of arrivals in m; without it the pose repeatability of the same pose.
    """
    test, notes = iso9283_test(measured, file.repeats, command, band_m)
    drifting = [(visits.place, found) for visits in test.poses if (found := trend(visits)) is not None]
    told = tuple(f"ISO 9283, {place}: {found.told()}" for place, found in drifting)
    return evaluate(test).results(), (*notes, *told)


def by_name(file: MeasuredFile, commanded: CommandedFile) -> bool:
    """Whether measured rows find their command by the names of poses and paths, not by order or time."""
    if not file.repeats.any:
        return False
    if any(commanded.pose) or any(commanded.path):
        return True
    timed = commanded.reported.t_s is not None and file.measured.t_s is not None
    return any(file.repeats.run) and not timed and len(commanded.reported) != file.n


def named_rows(file: MeasuredFile, commanded: CommandedFile) -> Reported:
    """Return the commanded pose of each row of the measured file, NaN where its pose has no command."""
    T = np.full((file.n, 4, 4), np.nan)
    goals = _goals(commanded)
    rows = zip(file.measured.rows, file.repeats.pose, file.repeats.at_pose, strict=True)
    for row, name, visited in rows:
        if visited and name in goals:
            T[row - 1] = goals[name]
    return Reported(T=T)


def uncommanded(file: MeasuredFile, commanded: CommandedFile) -> tuple[str, ...]:
    """Return what to say of measured poses that no command has the name of."""
    names = sorted(set(file.repeats.pose) - set(commanded.pose) - {""})
    return (f"no command has the name of pose {', '.join(names)}: its rows are not compared",) if names else ()


def _goals(commanded: CommandedFile) -> dict[str, Array]:
    goals: dict[str, Array] = {}
    T = commanded.reported.T
    for i, name in enumerate(commanded.pose):
        if not name or T is None or not np.isfinite(T[i]).all():
            continue
        first = goals.setdefault(name, T[i])
        if np.abs(first - T[i]).max() > SAME_GOAL_M:
            raise Inconsistent(
                f"the commanded pose {name} is given twice, and not alike",
                consequence="Which one its visits were commanded to is not known",
                cure="Give each pose one name",
            )
    return goals


def command_of(result: Verification, commanded: CommandedFile | None, file: MeasuredFile, turned: bool) -> Command:
    """Return what was expected of each row compared, base and tool as they were laid; paths only where commanded.

    Joint readings say where the arm went, not where a path should have led.
    """
    paired = result.paired
    tools = [T.as_matrix() for T in result.mounts.tools]
    tool = np.array([tools[k] for k in paired.measured.which])
    T = result.mounts.base.as_matrix() @ paired.F @ tool
    rows = paired.measured.rows
    in_frame = result.how is Align.NONE
    paths: dict[str, CommandedPath] = {}
    if commanded is not None:
        paths = named_paths(commanded) if by_name(file, commanded) else _first_runs(file, rows, T, turned)
    return Command(row=rows, T=T, turned=turned, in_frame=in_frame, paths=paths)


def named_paths(commanded: CommandedFile) -> dict[str, CommandedPath]:
    """Return the commanded paths by name; the whole file as one where it gives none."""
    T = commanded.reported.T
    if T is None:
        return {}
    names = np.array(commanded.path or ("",) * len(T))
    out = {}
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        found = polyline(T[rows], commanded.turned, _speed(commanded, rows))
        if found is not None:
            out[str(name) or PATH] = found
    return out


def _speed(commanded: CommandedFile, rows: NDArray[np.intp]) -> float | None:
    if commanded.speed_m_s is None:
        return None
    speeds = commanded.speed_m_s[rows]
    return float(speeds[0]) if len(np.unique(speeds)) == 1 and speeds[0] > 0.0 else None


def _first_runs(file: MeasuredFile, rows: NDArray[np.intp], T: Array, turned: bool) -> dict[str, CommandedPath]:
    """Return for each path what was commanded along its first run."""
    index_of = {int(row): i for i, row in enumerate(rows)}
    first: dict[str, tuple[str, str]] = {}
    members: dict[str, list[int]] = {}
    commanded = file.repeats
    runs = zip(commanded.robot, commanded.run, strict=True)
    for row, run, name in zip(file.measured.rows.tolist(), runs, commanded.path, strict=True):
        if run[1] and first.setdefault(name or PATH, run) == run and row in index_of:
            members.setdefault(name or PATH, []).append(index_of[row])
    found = {name: polyline(T[index], turned) for name, index in members.items()}
    return {name: path for name, path in found.items() if path is not None}


def check_unit(measured: Measured) -> None:
    """Raise Inconsistent for places further apart than any arm reaches."""
    wide = float(np.ptp(measured.xyz_m, axis=0).max())
    if wide > WIDEST_M:
        raise Inconsistent(
            f"the measured places are {wide:.4g} m apart: they are in mm",
            consequence="Nothing is computed",
            cure="Give positions in m",
        )
