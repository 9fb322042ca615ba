"""The runs of a cell as courses of figures: which figures there are, by group or name, and what was found of each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from sqlalchemy import Connection

from armsight.arrays import Array
from armsight.columns import POSE6, POSITION
from armsight.errors import Inconsistent
from armsight_lab.history import queries
from armsight_lab.history.entry import InputFile, Quantity, StoredPose, other_arm
from armsight_lab.history.figures import UNITS
from armsight_lab.history.looking import one_of, pose_change, wrapped
from armsight_lab.history.queries import Run

POSES = "".join(rf"|{axis}" for axis in POSE6)[1:]
GROUPS: Mapping[str, str] = {
    "joint-zeros": r"joint\d+\.(theta_rad|d_m|offset_rad)",
    "hand-eye": rf"handeye\.({POSES})",
    "rig": r"baseline_m|camera\.[^.]+\.[xyz]_m",
    "tool-tip": r"tip\.[xyz]_m",
    "world": rf"world\.({POSES})",
}
ALL = "all"
YEAR_DAYS = 365.25
ENTRY = re.compile(r"joint(\d+)\.(theta_rad|d_m)$")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """A figure over the runs that tell it: numbers of the runs, moments in days, values and deviations (n,) of them.

    std: NaN where none is told. silent: runs of the command that hold the figure as it was given, not as measured.
    """

    name: str
    command: str
    unit: str
    runs: tuple[int, ...]
    created: tuple[str, ...]
    values: Array
    std: Array
    silent: int = 0

    @property
    def group(self) -> str:
        """Which of GROUPS it is of, '' for none."""
        return next((group for group, pattern in GROUPS.items() if re.fullmatch(pattern, self.name)), "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What the history holds of a cell: runs in the order of their dates, and numbers by run."""

    runs: Sequence[Run]
    parameters: Mapping[int, Sequence[Quantity]]
    poses: Mapping[int, Sequence[StoredPose]]
    figures: Mapping[int, Sequence[Quantity]]
    inputs: Mapping[int, Sequence[InputFile]]


def found_in(connection: Connection, wanted: queries.Filter, *, figures: bool) -> Found:
    """Return what there is; figures: with all numbers of the results."""
    runs = queries.newest(connection, wanted)[::-1]
    numbers = [run.id for run in runs]
    return Found(
        runs=runs,
        parameters=queries.parameters_of(connection, numbers),
        poses=queries.poses_of(connection, numbers),
        figures=queries.figures_of(connection, numbers) if figures else {},
        inputs=queries.inputs_of(connection, numbers),
    )


def courses(found: Found, asked: Sequence[str] | None) -> list[Course]:
    """Return the courses of the figures asked for. Raises UsageError for one that is none, with the nearest."""
    trusted = [run for run in found.runs if run.trusted]
    calibrated = list(_courses(trusted, {run.id: list(_all_of(found, run.id)) for run in trusted}, measured=True))
    calibrated += _pose_courses(trusted, found.poses)
    if not asked:
        return [one for one in calibrated if one.group]
    numbers = list(_courses(trusted, found.figures, measured=False))
    every = [*calibrated, *(one for one in numbers if one.name not in {other.name for other in calibrated})]
    chosen: dict[tuple[str, str], Course] = {}
    choices = [*GROUPS, ALL, *dict.fromkeys(one.name for one in every)]
    for name in (_in_full(given, choices) for given in asked):
        pattern = GROUPS.get(name)
        for one in calibrated if pattern or name == ALL else every:
            if name in (ALL, one.name) or (pattern and re.fullmatch(pattern, one.name)):
                chosen[one.command, one.name] = one
    return list(chosen.values())


def _in_full(given: str, choices: Sequence[str]) -> str:
    """Return the choice that is given, also where its unit, `.value` or the words before its last are left out."""
    if given in choices:
        return given
    alike = [name for name in choices if f".{_stem(name)}".endswith(f".{_stem(given)}")]
    return alike[0] if len(alike) == 1 else one_of(given, alike or choices, "figure", "Give --figure with one of")


def _stem(name: str) -> str:
    return UNITS.sub("", name.removesuffix(".value"))


def _all_of(found: Found, run: int) -> Iterator[Quantity]:
    """Yield the parameters of a run that can be a zero: of a turning joint theta, of a sliding one d; all others."""
    kinds = next(one.joints for one in found.runs if one.id == run)
    for one in found.parameters.get(run, ()):
        entry = ENTRY.match(one.name)
        kind = kinds[int(entry[1]) - 1 : int(entry[1])] if entry else ""
        if not (entry and (kind, entry[2]) in (("R", "d_m"), ("P", "theta_rad"))):
            yield one


def _courses(runs: Sequence[Run], of: Mapping[int, Sequence[Quantity]], *, measured: bool) -> Iterator[Course]:
    """Yield the courses of numbers by command; measured: of what was measured alone, which tells a deviation."""
    rows: dict[tuple[str, str, str], list[tuple[Run, float, float]]] = {}
    silent: dict[tuple[str, str, str], int] = {}
    for run in runs:
        for one in of.get(run.id, ()):
            key = (run.command, one.name, one.unit)
            if one.value is None or (measured and one.std is None):
                silent[key] = silent.get(key, 0) + 1
                continue
            rows.setdefault(key, []).append((run, one.value, np.nan if one.std is None else one.std))
    for (command, name, unit), held in rows.items():
        yield _course(command, name, unit, held, silent.get((command, name, unit), 0))


def _course(command: str, name: str, unit: str, held: Sequence[tuple[Run, float, float]], silent: int = 0) -> Course:
    values = np.array([value for _, value, _ in held])
    std = np.array([std for _, _, std in held])
    if unit == "rad":  # an angle of nearly half a turn may be written with either sign
        values = values[0] + np.array([wrapped(value - values[0]) for value in values])
    if np.isfinite(std).any() and not np.isfinite(std).all():  # some tell none: as large as those that do
        std = np.where(np.isfinite(std), std, np.nanmedian(std))
    return Course(
        name=name,
        command=command,
        unit=unit,
        runs=tuple(run.id for run, _, _ in held),
        created=tuple(run.created for run, _, _ in held),
        values=values,
        std=std,
        silent=silent,
    )


def _pose_courses(runs: Sequence[Run], of: Mapping[int, Sequence[StoredPose]]) -> Iterator[Course]:
    """Yield the six numbers of each pose, against that of the first run: turns as rotation vectors from it."""
    rows: dict[tuple[str, str], list[tuple[Run, StoredPose]]] = {}
    for run in runs:
        for pose in of.get(run.id, ()):
            rows.setdefault((run.command, pose.name), []).append((run, pose))
    for (command, name), held in rows.items():
        first = held[0][1]
        moved = np.array([pose_change(first, pose) for _, pose in held])
        std = np.array([[np.nan if one is None else one for one in pose.std] for _, pose in held])
        for k, axis in enumerate(POSE6):
            column = [(run, float(moved[i, k]), float(std[i, k])) for i, (run, _) in enumerate(held)]
            yield _course(command, f"{name}.{axis}", "m" if axis in POSITION else "rad", column)


def never_measured(found: Found) -> list[str]:
    """Return the zeros of joints that the runs hold, and of which no run tells a deviation."""
    zeros = [
        (one.name, one.std is not None)
        for run in found.runs
        for one in _all_of(found, run.id)
        if re.fullmatch(GROUPS["joint-zeros"], one.name)
    ]
    measured = {name for name, known in zeros if known}
    return list(dict.fromkeys(name for name, _ in zeros if name not in measured))


def require_one_arm(found: Found, wanted: Sequence[Course]) -> None:
    """Raise Inconsistent where the joints of two arms would be held against each other."""
    if not any(one.name.startswith("joint") for one in wanted):
        return
    of_arms = [run for run in found.runs if run.joints]
    for before, after in pairwise(of_arms):
        if other_arm(before.joints, after.joints):
            raise Inconsistent(
                f"run {before.id} is of an arm with the joints {before.joints}, run {after.id} of one with "
                f"{after.joints}: one cell holds two arms",
                consequence="Their joints are not held against each other",
                cure=f"Give each arm a cell of its own; or judge the runs since: --since {after.created[:19]}",
            )


def changed_inputs(found: Found) -> list[str]:
    """Return where runs of a command have other files of the kinds that results hang on than those before."""
    notes = []
    last: dict[tuple[str, str], tuple[Run, str]] = {}
    for run in found.runs:
        for one in found.inputs.get(run.id, ()):
            if one.flag not in HELD or one.sha256 is None:
                continue
            before = last.get((run.command, one.flag))
            if before is not None and before[1] != one.sha256:
                notes.append(
                    f"From run {run.id} on ({run.created[:10]}) {run.command} was given another --{one.flag} than "
                    f"before: a change there may be the file's. Judge the runs since: --since {run.created[:10]}."
                )
            last[run.command, one.flag] = (run, one.sha256)
    return notes if len(notes) <= MOST_NOTES else [*notes[:MOST_NOTES], f"... and {len(notes) - MOST_NOTES} more."]


HELD = ("model", "arm", "rig", "camera", "target", "world")
"""Flags of inputs that stay the same from run to run."""
MOST_NOTES = 6


def clock_notes(found: Found) -> list[str]:
    """Return where a run that was filed later is dated earlier, though both were filed as they were made."""
    from armsight_lab.history.entry import day_of

    at_once = [run for run in found.runs if abs(day_of(run.filed) - day_of(run.created)) < AT_ONCE_DAYS]
    at_once.sort(key=lambda run: run.id)
    notes = [
        f"Run {after.id} was filed after run {before.id} and is dated before it: the clock was set back. They are "
        "judged in the order of their dates."
        for before, after in pairwise(at_once)
        if after.created < before.created
    ]
    return notes[:MOST_NOTES]


AT_ONCE_DAYS = 0.01
