"""The one way into every table: a file or folder in, the bytes of a CSV of ours out."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Ambiguous, BadFile, DataRefused, Inconsistent, UsageError
from armsight.store.atomic import read_bytes
from armsight.store.interpret.assemble import degrees_for_radians, mm_for_metres
from armsight.store.interpret.names import ROLES, Role, meaning
from armsight.store.interpret.other_files import folder_table, looks_like_records, mat_table, pose_files, records_table
from armsight.store.interpret.raw import RawTable, parse_text
from armsight.store.interpret.rotations import looks_like_degrees, looks_like_mm
from armsight.store.interpret.standard import UNUSED, Standard, standard_table
from armsight.store.interpret.table_format import OURS, TableFormat
from armsight.store.interpret.trackers.formats import no_bodies, tracker_of, tracker_table
from armsight.store.programs.kinds import kind_of, program_table, pulse_table
from armsight.store.tables import MAX_BYTES, Table
from armsight.store.yamls import parse_yaml_documents

_OURS_Q = re.compile(r"q[1-9]\d*")
HEAD_BYTES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Interpreted:
    """A table in the columns of ours (CSV), how it was found to be written, and what was understood, in words."""

    data: bytes
    how: str
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    n: int | None = None


def standard_bytes(path: Path, role: str, format_: TableFormat = OURS) -> bytes:
    """Return a table as CSV of ours; see interpret. What was understood is told through format_.tell."""
    found = interpret(path, role, format_)
    for note in found.notes:
        format_.notify(f"{path.name}: {note}")
    return found.data


def interpret(path: Path, role: str, format_: TableFormat = OURS) -> Interpreted:
    """Return a table in the columns that a role of ROLES has.

    path: a table in text, YAML, JSON, a .mat, or a folder with one file per pose or with the table. A table of ours
    comes back as it is, and one of which nothing is understood too: its reader names what is missing. Raises BadFile,
    NotEnoughData, Inconsistent, Ambiguous, UsageError.
    """
    wanted = ROLES[role]
    format_.check()
    if not path.exists():
        raise BadFile(f"{path}: there is no such file", cure="Check its name")
    if path.is_dir() and len(files := pose_files(path)) == 1:
        path = files[0]  # robot_poses.csv beside its images
    if path.is_dir():
        return _interpreted(folder_table(path, lambda file: _raw(file, format_)), wanted, format_)
    if path.suffix.lower() == ".mat":
        return _interpreted(mat_table(path, unnamed=bool(format_.columns)), wanted, format_)
    data = read_bytes(path, limit=MAX_BYTES)
    program = kind_of(data[:HEAD_BYTES].decode("utf-8", errors="replace").lstrip("\ufeff"))
    if not format_.columns and program is None and (kind := tracker_of(data)) is not None:
        return _interpreted(tracker_table(kind, data, str(path), format_), wanted, format_)
    if format_.body and format_.measured is None:
        raise no_bodies(str(path), format_.body)
    plain = not (format_.stated or format_.following)
    if plain and (is_ours(data, wanted) or b"\x00" in data):
        return Interpreted(data=data, how="a table of ours")
    listed = program_table(data, str(path), wanted.joints == "wanted", format_)
    if listed is not None:
        found = _interpreted(listed.raw, wanted, listed.format)
        return replace(found, notes=(*found.notes, *listed.notes))
    return _interpreted(_raw_of(data, path, format_), wanted, format_, original=data)


def _raw(path: Path, format_: TableFormat) -> RawTable:
    if path.suffix.lower() == ".mat":
        return mat_table(path, unnamed=bool(format_.columns))
    data = read_bytes(path, limit=MAX_BYTES)
    program = program_table(data, str(path), None, format_)
    return _raw_of(data, path, format_) if program is None else program.raw


def _raw_of(data: bytes, path: Path, format_: TableFormat) -> RawTable:
    """Return a table that neither a tracker nor a robot wrote."""
    head = data[:HEAD_BYTES].decode("utf-8", errors="replace").lstrip("\ufeff")
    if path.suffix.lower() in (".yaml", ".yml", ".json") or looks_like_records(head):
        return records_table(parse_yaml_documents(data, str(path)), str(path))
    return pulse_table(parse_text(data, str(path)), format_)


def is_ours(data: bytes, role: Role) -> bool:
    """Whether the first line names exactly columns of ours, and all that are required."""
    for line in data[:HEAD_BYTES].decode("utf-8-sig", errors="replace").splitlines():
        if line.strip():
            try:
                names = [name.strip() for name in next(csv.reader([line]))]
            except csv.Error:
                return False
            known = role.known
            joints = role.joints != "no"
            ours = all(
                name in known
                or (joints and _OURS_Q.fullmatch(name) is not None)
                or (role.keeps_unknown and meaning(name, OURS, joints=joints) is None)
                for name in names
            )
            counted = role.counts_rows and "t_s" not in names  # the times are made here
            return ours and role.required <= set(names) and not counted
    return False


def _interpreted(raw: RawTable, role: Role, format_: TableFormat, *, original: bytes | None = None) -> Interpreted:
    found = standard_table(raw, role, format_)
    missing = sorted(role.required - set(found.columns))
    ours = original is not None and raw.csv and not found.foreign and not format_.stated and raw.names
    if original is not None and ours and missing != ["t_s"]:
        return Interpreted(data=original, how="a table of ours", missing=tuple(missing))
    if missing:
        raise _missing(raw, role, found, missing, format_.joints)
    notes = (f"read as {raw.how}: {', '.join(found.columns)}", *raw.notes, *dict.fromkeys(found.notes))
    return Interpreted(data=found.csv(), how=raw.how, notes=notes, n=len(found.lines))


def _missing(raw: RawTable, role: Role, found: Standard, missing: list[str], of_arm: Sequence[str] = ()) -> BadFile:
    several = len(missing) > 1
    there = ", ".join(raw.names)[:200] or f"{len(raw.columns)} columns without names"
    understood = f"; understood are {', '.join(found.columns)}" if found.columns else ""
    cure = "Name them in the first line, or give --columns"
    if raw.tracked and role.joints == "wanted":
        cure = "A tracker knows no joints: armsight join --joints LOG --arm ARM --measured FILE -o points.csv, "
        cure += "for robot-world with --as observed"
    elif raw.tracked and len(role.frames) > 1:
        cure = "A tracker's file is one of the two: give it as --camera-stream, and the robot's as --robot-stream"
    elif raw.listed and missing == ["t_s"]:
        cure = (
            "A program's points have no times: armsight join --robot-stream PROGRAM --measured FILE --as pairs joins "
        )
        cure += (
            "poses in their order, --joints PROGRAM --arm ARM joint values; --still makes rows of a recording's rests"
        )
    elif role.time == "wanted" and missing == ["t_s"]:
        cure = "Times are needed here: add a column t_s in seconds"
    elif any(name.startswith("q") and name[1:].isdecimal() for name in missing):
        cure = "Name the joints q1, q2, ... or q1_deg, ..."
        cure += f", or as the arm does: {', '.join(of_arm)}" if of_arm else "; by their own names they need --arm"
    elif len(role.frames) > 1:
        cure = "Say whose poses they are: base_flange_x_m, ..., camera_target_x_m, ..."
    return BadFile(
        f"{raw.where}: the column{'s' * several} {', '.join(missing)} {'are' if several else 'is'} missing; "
        f"found {there}{understood}",
        cure=cure,
    )


def check_joint_values(q: NDArray[np.float64], where: str, format_: TableFormat) -> None:
    """Raise Inconsistent where joint values (n, k) of columns q1, q2, ... in rad or m are degrees."""
    if not format_.as_stated and looks_like_degrees(q):
        raise degrees_for_radians(where, ["q1", "..."] if q.shape[1] > 1 else ["q1"], q)


def joint_readings(table: Table, where: str, format_: TableFormat) -> NDArray[np.float64]:
    """Return the joint readings (m, n) of columns q1 .. qn. Raises BadFile without any, Inconsistent for degrees."""
    names = table.series("q")
    if not names:
        raise BadFile(f"{where}: no column q1", cure="Give q1 .. qn in every row")
    q = table.stacked(names)
    check_joint_values(q, where, format_)
    return q


def check_positions(xyz_m: NDArray[np.float64], names: Sequence[str], where: str, format_: TableFormat) -> None:
    """Raise Inconsistent where positions (n, 3) of columns in m are mm."""
    if not format_.as_stated and looks_like_mm(xyz_m):
        raise mm_for_metres(where, names, xyz_m)


def kind_of_table(path: Path, format_: TableFormat, among: Sequence[str]) -> str:
    """Return which kind of table leaves fewest columns unused. Raises UsageError for none, Inconsistent, Ambiguous."""
    best, fewest, why = "", 10**9, None
    if path.is_file() and tracker_of(read_bytes(path, limit=MAX_BYTES)) is None:
        _raw(path, format_)  # what can be no table at all says why
    for name in among:
        try:
            found = interpret(path, f"untimed-{name}" if f"untimed-{name}" in ROLES else name, format_)
        except DataRefused as error:
            # what the numbers contradict says more than what is missing for a kind that may not be meant
            why = error if why is None or isinstance(error, Inconsistent | Ambiguous) else why
            continue
        left = sum(note.count(",") + 1 for note in found.notes if note.startswith(UNUSED)) + len(found.missing)
        if not found.missing and left < fewest:
            best, fewest = name, left
    if not best and isinstance(why, Inconsistent | Ambiguous):
        raise why
    if not best:
        raise UsageError(
            f"{path}: which kind of table it is cannot be told; {why.cause if why else 'it can be several'}",
            cure=f"Say it with --as {', '.join(among)}, and see what is missing",
        )
    return best
