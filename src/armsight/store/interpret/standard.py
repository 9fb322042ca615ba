"""A table as people have it, brought to the columns of ours."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSITION, QUATERNION
from armsight.errors import Ambiguous, BadFile
from armsight.store.interpret.assemble import Column, Found, angles_rad, pose_of
from armsight.store.interpret.names import PAIR_FRAMES, PREFIXES, Meaning, Role, meaning, split_unit
from armsight.store.interpret.raw import RawTable
from armsight.store.interpret.table_format import SKIPPED, UNITS, TableFormat
from armsight.store.tables import bare, known, number, number_column, word

EPOCHS = ((1e17, 1e-9, "ns"), (1e14, 1e-6, "us"), (1e11, 1e-3, "ms"))
"""Stamps beyond the first number are counts since 1970 in this unit: 1e11 s is the year 5138."""

UNUSED = "columns not used: "
_NAME_CELL = re.compile(r"(.*?)name(\[?\d+\]?)")
_OURS_Q = re.compile(r"q[1-9]\d*")
_ROT = re.compile(r"(?P<lead>(?:.*[^a-z])?)(?P<stem>rot_?|r_?)(?P<axis>[xyzw])", re.IGNORECASE)


@dataclass(slots=True, kw_only=True, eq=False)
class Standard:
    """Columns of ours by name, numbers (n,) with NaN for an empty cell or words; lines (n,) of the file; what was
    understood, in words; foreign: whether any column came by another name than ours."""

    where: str
    how: str
    columns: dict[str, Array | Sequence[str]] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    notes: list[str] = field(default_factory=list)
    foreign: bool = False

    def csv(self) -> bytes:
        """Return it as CSV whose rows stand in the lines that they came from."""
        texts = [
            [number(value) for value in column] if isinstance(column, np.ndarray) else list(column)
            for column in self.columns.values()
        ]
        out = [",".join(self.columns)]
        for line, row in zip(self.lines, zip(*texts, strict=True), strict=True):
            out += [""] * (line - 1 - len(out))
            out.append(",".join(word(bare(cell)) for cell in row))
        return ("\n".join(out) + "\n").encode()


def standard_table(raw: RawTable, role: Role, format_: TableFormat) -> Standard:
    """Return a table in the columns of a role. Raises DataRefused with what is missing or contradicts itself."""
    names = _names(raw, role, format_)
    out = Standard(where=raw.where, how=raw.how, lines=raw.lines)
    meanings = _meanings(raw, names, role, format_)
    words = _words(names, role)
    for ours, k in words.items():
        out.columns[ours] = list(raw.columns[k])
        out.foreign |= names[k] != ours
    kept = [k for k, name in enumerate(names) if name in role.extras and k not in words.values()]
    chosen = _without_doubles(raw.where, meanings)
    numbers = {k: _numbers(raw, names[k], k, found.kind) for k, found in chosen.items()}
    found = {
        frame: Found(
            where=raw.where,
            lines=raw.lines,
            kinds=_kinds(chosen, numbers, frame),
            format=format_.of_camera if frame == "camera_target" else format_,
            notes=out.notes,
        )
        for frame in {*(m.frame for m in chosen.values()), *role.frames, ""}
    }
    _joints(out, found[""], role, format_)
    for frame in role.frames:
        _pose(out, found, frame, role, chosen)
    moved = out.columns
    _time(out, found[""], role)
    out.columns = {name: out.columns[name] for name in ("t_s", *moved) if name in out.columns}
    for k in kept:
        out.columns[names[k]] = list(raw.columns[k])
    unused = [names[k] for k in range(len(names)) if k not in chosen and k not in words.values() and k not in kept]
    unused = [name for name in unused if name and name != SKIPPED]
    if unused and role.keeps_unknown:
        out.columns |= {name: list(raw.columns[names.index(name)]) for name in unused if name not in out.columns}
    elif unused:
        out.notes.append(f"{UNUSED}{', '.join(unused)[:200]}")
    out.foreign |= any(m.name not in role.known and not _OURS_Q.fullmatch(m.name) for m in chosen.values())
    return out


def _names(raw: RawTable, role: Role, format_: TableFormat) -> tuple[str, ...]:
    """Return the columns' names: those stated, those of the file, or those that its count of columns can only mean."""
    stated, count = format_.names, len(raw.columns)
    if stated:
        if len(stated) != count:
            raise BadFile(
                f"{raw.where}: {count} columns, --columns names {len(stated)}",
                consequence="Nobody knows which column is which",
                cure="Name every column; write - for one that is not used",
            )
        return stated
    if raw.names:
        return _joint_state_names(raw)
    maker = format_.maker
    timed = role.time != "no"
    if role.frames == ("",) and role.joints != "wanted":
        if timed and count == 8:
            return ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
        if count in (12, 16):
            return tuple(f"m{k}" for k in range(count))
        if maker is not None and count == len(maker.columns):
            return maker.columns
    wanted = ", ".join(sorted(role.required))
    raise BadFile(
        f"{raw.where}: {count} columns without names",
        consequence="Nobody knows which column is which",
        cure=f"The first line must name the columns ({wanted}, ...), or name them with --columns, for instance "
        "--columns q1..q6_deg,xyz_mm",
    )


def _joint_state_names(raw: RawTable) -> tuple[str, ...]:
    """Return the names, those of a ROS joint state's positions replaced by the joints' own, which stand in a cell."""
    names = list(raw.names)
    for k, name in enumerate(raw.names):
        match = _NAME_CELL.fullmatch(name)
        position = f"{match[1]}position{match[2]}" if match else ""
        if match and position in names and raw.columns[k]:
            joint = raw.columns[k][0]
            if any(cell != joint for cell in raw.columns[k]):
                raise BadFile(f"{raw.where}: the column {name} names several joints")
            names[names.index(position)] = joint
    return tuple(names)


def _meanings(raw: RawTable, names: Sequence[str], role: Role, format_: TableFormat) -> dict[int, Meaning]:
    """Return what the columns mean, by their number; those that mean nothing known are left out."""
    pairs, joints = len(role.frames) > 1, role.joints != "no"
    out = {}
    for k, name in enumerate(names):
        if name == SKIPPED or name in role.extras or name in role.words:
            continue
        found = meaning(_as_quaternion(name, names), format_, frames=pairs, joints=joints)
        if found is not None and _belongs(found, role):
            out[k] = replace(found, name=name)
    return out


def _as_quaternion(name: str, names: Sequence[str]) -> str:
    """Return a name, that of a quaternion's entry where rot_x, rot_y, rot_z are no angles: rot_w is beside them."""
    match = _ROT.fullmatch(name)
    if match is None or not all(f"{match['lead']}{match['stem']}{axis}" in names for axis in _axes_like(match["axis"])):
        return name
    return f"{match['lead']}q{match['axis'].lower()}"


def _axes_like(axis: str) -> str:
    return "XYZW" if axis.isupper() else "xyzw"


def _belongs(found: Meaning, role: Role) -> bool:
    if found.kind == "t":
        return role.time != "no"
    if found.kind == "joint":
        return role.joints != "no"
    return bool(role.frames) and (len(role.frames) > 1) == bool(found.frame)


def _words(names: Sequence[str], role: Role) -> dict[str, int]:
    """Return the place of each column of text, by its name in our tables."""
    out: dict[str, int] = {}
    for ours in role.words:
        known = (ours, *role.words[ours])
        columns = [k for k, name in enumerate(names) if name == ours or split_unit(name)[0] in known]
        if columns:
            out[ours] = columns[0]
    return out


def _without_doubles(where: str, meanings: Mapping[int, Meaning]) -> dict[int, Meaning]:
    """Return one column for each coordinate, measured before commanded, and one time. Raises Ambiguous for several."""
    out: dict[tuple[str, str, str], int] = {}
    for k, found in meanings.items():
        key = (found.frame, found.kind, found.key)
        before = out.get(key)
        if before is None:
            out[key] = k
            continue
        other = meanings[before]
        asked, was = (_asked(one, beside) for one, beside in ((found, other), (other, found)))
        if asked != was:
            out[key] = k if was else before
        elif found.kind == "t":  # the stamp of the measurement, not that of the recording
            out[key] = k if "stamp" in found.name else before
        else:
            raise Ambiguous(
                f"{where}: the columns {other.name!r} and {found.name!r} may be the same coordinate",
                consequence="Nobody knows which is meant",
                cure="Give --columns with - for those that are not used",
            )
    return {k: meanings[k] for k in sorted(out.values())}


MEASURED = frozenset(("actual", "current", "measured"))


def _asked(one: Meaning, beside: Meaning) -> bool:
    """Whether a column is what was asked for; `target_` says so unless the other one is named after a body too."""
    words = [set(split_unit(meaning.name)[0].split("_")) for meaning in (one, beside)]
    others = words[1] & PREFIXES
    return one.commanded or ("target" in words[0] and (not others or not MEASURED.isdisjoint(others)))


def _numbers(raw: RawTable, name: str, k: int, kind: str) -> Array:
    """Return a column's numbers, NaN where a cell says that there is none; a time is always needed."""
    values = number_column(raw.columns[k], name, raw.lines, raw.where, kind != "t")
    return np.where(known(values), values, np.nan)


def _kinds(chosen: Mapping[int, Meaning], numbers: Mapping[int, Array], frame: str) -> dict[str, dict[str, Column]]:
    out: dict[str, dict[str, Column]] = {}
    for k, found in chosen.items():
        if found.frame == frame:
            out.setdefault(found.kind, {})[found.key] = Column(meaning=found, values=numbers[k])
    return out


def _time(out: Standard, found: Found, role: Role) -> None:
    """Add t_s: in the stated unit, in s, or as a count since 1970 that can be nothing else."""
    if role.time == "no":
        return
    columns = found.complete_columns("t", [next(iter(found.kinds.get("t", {"": None})))])
    if columns is None:
        if role.counts_rows:
            out.columns["t_s"] = np.arange(float(len(out.lines)))
            out.notes.append("no column of time: rows are counted 0, 1, 2 ...")
            out.foreign = True
        return
    scale, values = columns[0].meaning.scale, columns[0].values
    if scale is None and found.format.time_s is not None:
        scale = found.format.time_s
    elif scale is None and (counted := _counted_ms(out, values)):
        scale = 1e-3
        out.notes.append(f"{columns[0].meaning.name}: taken as ms: {counted}; --units s says seconds")
    elif scale is None:
        scale = 1.0
        for least, unit, name in EPOCHS:
            if values.size and np.nanmin(np.abs(values)) > least:
                scale = unit
                out.notes.append(f"{columns[0].meaning.name}: {name} since 1970")
                break
        else:
            out.notes.append(f"{columns[0].meaning.name}: taken as seconds, no unit is stated")
    out.columns["t_s"] = values if scale == 1.0 else values * scale


FASTEST, SLOWEST = 12.0, 0.1
"""rad/s or m/s: what moves between these at its fastest in ms would hardly move at all in s."""
SMOOTH = 10.0
"""A motion goes further than this many of its usual steps; noise does not."""


def _counted_ms(out: Standard, t: Array) -> str:
    """Return why whole numbers without a unit are ms: the columns that move would not in s; '' where they are not."""
    step = np.diff(t)
    if len(t) < 20 or not np.isfinite(t).all() or (t != np.round(t)).any() or not (step >= 1.0).all():
        return ""
    for names, unit in ((POSITION, "m/s"), ([n for n in out.columns if _OURS_Q.fullmatch(n)], "rad/s")):
        moved = [column for n in names if isinstance(column := out.columns.get(n), np.ndarray)]
        if not moved:
            continue
        values = np.stack(moved, axis=1)
        moves = np.abs(np.diff(values, axis=0)).max(axis=1)
        fastest = float(np.nanmax(moves / step, initial=0.0))
        far = float(np.nanmax(np.ptp(values[np.isfinite(values).all(axis=1)], axis=0), initial=0.0))
        if SLOWEST < 1e3 * fastest < FASTEST and far > SMOOTH * float(np.nanmedian(moves)):
            return f"whole numbers, and in seconds nothing would move faster than {fastest:.2g} {unit}"
    return ""


def _joints(out: Standard, found: Found, role: Role, format_: TableFormat) -> None:
    """Add q1..qn in rad or m, in the order of the arm's joints where the columns carry their names."""
    if role.joints == "no":
        return
    columns = found.kinds.get("joint", {})
    named = {int(key[1:]): column for key, column in columns.items() if key.startswith("=")}
    counted = {int(key): column for key, column in columns.items() if not key.startswith("=")}
    follow = [k for k in format_.following if k not in named]
    if named and len(named) + len(follow) == len(format_.joints):
        ordered = [named[k] for k in sorted(named)]
        out.notes.append(f"joints by name: {', '.join(column.meaning.name for column in ordered)[:200]}")
    elif counted:
        first = min(counted)
        follow = [k for k in format_.following if k + first not in counted]
        numbers = sorted([*counted, *(k + first for k in follow)])
        if first not in (0, 1) or numbers != list(range(first, first + len(numbers))):
            raise BadFile(
                f"{out.where}: the columns {', '.join(c.meaning.name for c in counted.values())[:120]} are not counted "
                "from 1 without a gap",
                cure="Number the joints q1, q2, ..., or give --columns",
            )
        ordered = [counted[k] for k in sorted(counted)]
        if first == 0:
            out.notes.append(f"joints are counted from 0: {ordered[0].meaning.name} is q1")
    else:
        return
    q = angles_rad(found, ordered, format_.joint_rad, "the arm")
    if follow:  # 0 is what a joint without a drive reads: the arm knows its value
        q = np.insert(q, [k - i for i, k in enumerate(follow)], 0.0, axis=1)
        out.foreign = True
        out.notes.append(f"joints that follow others, without a column: {', '.join(format_.joints[k] for k in follow)}")
    out.columns |= {f"q{k + 1}": q[:, k] for k in range(q.shape[1])}
    in_degrees = [c for c in ordered if (c.meaning.scale or format_.joint_rad) == UNITS["deg"][1]]
    if in_degrees:
        out.notes.append(f"{len(in_degrees)} joints in degrees")


def _by_easy_handeye(names: Iterable[str]) -> bool:
    """Whether the columns are those of easy_handeye's samples: robot and tracking, or robot and optical."""
    leads = {name.split("_")[0] for name in names}
    return leads in ({"robot", "tracking"}, {"robot", "optical"})


EASY_HANDEYE: Mapping[bool | None, str] = {
    True: "samples of easy_handeye, taken with eye_in_hand: robot is the flange in the base",
    False: "samples of easy_handeye, taken with eye_on_base: robot is the base in the flange, and was inverted",
    None: "samples of easy_handeye: taken as those of eye_in_hand; those of eye_on_base hold the inverse of the "
    "robot's pose, which calibrate handeye --setup eye-to-hand reads so",
}
"""easy_handeye looks up the robot's transform the other way round for a camera beside the robot (its sampler)."""


def _pose(out: Standard, found: Mapping[str, Found], frame: str, role: Role, chosen: Mapping[int, Meaning]) -> None:
    mine = found[frame]
    inverse = {m.inverse for m in chosen.values() if m.frame == frame}
    if frame == PAIR_FRAMES[0] and _by_easy_handeye(m.name for m in chosen.values()):
        out.notes.append(EASY_HANDEYE[mine.format.on_hand])
        inverse = {mine.format.on_hand is False}
    if len(inverse) > 1:
        raise Ambiguous(f"{out.where}: of {frame} some columns are named the other way round")
    xyz, quat = pose_of(mine, inverse == {True})
    lead = f"{frame}_" if frame else ""
    if inverse == {True}:
        out.notes.append(f"the columns of {frame} are of the inverse pose, and were inverted")
    if xyz is not None:
        out.columns |= {f"{lead}{name}": xyz[:, k] for k, name in enumerate(POSITION)}
    if quat is not None:
        out.columns |= {f"{lead}{name}": quat[:, k] for k, name in enumerate(QUATERNION)}
