"""Tables in YAML and JSON: samples of hand-eye programs, ROS messages as they are echoed, one pose per file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from armsight.errors import BadFile
from armsight.store.interpret.raw import MATRIX, RawTable, is_number, table_of

VECTORS = frozenset(("position", "translation", "xyz", "xyz_m", "xyz_mm", "t", "trans", "pos", "p"))
"""Keys whose three numbers are x, y, z."""
QUATERNIONS: Mapping[str, str] = {"quat_xyzw": "xyzw", "quaternion_xyzw": "xyzw", "quat_wxyz": "wxyz"}
"""Keys whose four numbers are a quaternion, in the order that they say."""
ROTVECS = frozenset(("rotvec", "rvec", "rotation_vector", "rotvec_rad"))
UNORDERED = frozenset(("quat", "quaternion", "orientation", "rotation", "q"))
LISTS = ("samples", "poses", "data", "frames", "measurements", "points", "transforms")
"""Keys under which a file holds its rows."""
NUMBERED_PAIRS: Mapping[str, str] = {"T1": "base_flange", "T2": "camera_target"}
"""Keys T1_0, T2_0, T1_1, ... of handeye_calib_camodocal: base to tip, and camera to marker."""


def records_table(documents: Sequence[Any], where: str) -> RawTable:
    """Return the rows of YAML documents: a list, a list under a key, one mapping for each document, or one pose.

    Raises BadFile that names the entry, NotEnoughData.
    """
    entries, how = _entries(documents)
    records = []
    for k, entry in enumerate(entries, 1):
        if not isinstance(entry, Mapping | list):
            raise BadFile(f"{where}, entry {k}: {str(entry)[:40]!r} is no pose", consequence="The file is not used")
        records.append(dict(_flat("", entry, f"{where}, entry {k}")))
    return table_of(records, where, f"{how} of {len(records)} entries")


def _entries(documents: Sequence[Any]) -> tuple[list[Any], str]:
    if len(documents) > 1:
        return list(documents), "YAML documents (as ROS echoes messages)"
    content = documents[0] if documents else []
    if isinstance(content, Mapping):
        for key in LISTS:
            if isinstance(content.get(key), list) and content[key] and isinstance(content[key][0], Mapping | list):
                return content[key], f"the list '{key}'"
        pairs = _numbered_pairs(content)
        if pairs:
            return pairs, "numbered pairs of matrices"
        values = list(content.values())
        if len(values) > 1 and all(_is_pose(value) for value in values):
            return [{"file": key, "": value} for key, value in content.items()], "a mapping by name"
        return [content], "a mapping"
    if isinstance(content, list) and content and all(isinstance(item, int | float) for item in content):
        return [content], "a list of numbers"
    return (content, "a list") if isinstance(content, list) else ([content], "a value")


def _numbered_pairs(content: Mapping[Any, Any]) -> list[dict[str, Any]]:
    """Return a row for each number of NUMBERED_PAIRS; none where the file is another."""
    rows: dict[int, dict[str, Any]] = {}
    for key, value in content.items():
        named = re.fullmatch(r"(T[12])_([0-9]+)", str(key))
        if named is not None:
            rows.setdefault(int(named[2]), {})[NUMBERED_PAIRS[named[1]]] = value
    return [rows[number] for number in sorted(rows)] if len(rows) > 1 else []


def _is_pose(value: Any) -> bool:
    return isinstance(value, Mapping) or _matrix(value) is not None


def _matrix(value: Any) -> list[Any] | None:
    """Return the 16 numbers of a 4 x 4 matrix, flat, nested or as OpenCV writes it; None where it is none."""
    if isinstance(value, Mapping) and {"rows", "cols", "data"} <= set(value):
        value = value["data"] if value["rows"] == 4 and value["cols"] == 4 else None
    if isinstance(value, list) and len(value) == 4 and all(isinstance(row, list) and len(row) == 4 for row in value):
        value = [cell for row in value for cell in row]
    return value if isinstance(value, list) and len(value) == 16 and all(map(_is_real, value)) else None


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _flat(key: str, value: Any, where: str) -> Iterator[tuple[str, str]]:
    """Yield the columns of one value: names joined by '_', lists under the names of what they hold."""
    lead = f"{key}_" if key else ""
    matrix = _matrix(value)
    if matrix is not None:
        yield from ((f"{lead}{cell}", repr(number)) for cell, number in zip(MATRIX, matrix, strict=True))
    elif isinstance(value, Mapping):
        if set(value) >= {"name", "position"} and isinstance(value["name"], list):
            yield from _joint_state(value, where)
            return
        stamp = _stamp(value)
        for part, inner in value.items():
            if stamp is not None and part == "stamp":
                yield f"{lead}stamp_s", stamp
            else:
                yield from _flat(f"{lead}{part}" if part else key, inner, where)
    elif isinstance(value, list) and value and all(map(_is_real, value)):
        yield from ((name, repr(number)) for name, number in zip(_listed(key, len(value), where), value, strict=True))
    elif _is_real(value):
        yield key, repr(value)
    elif isinstance(value, str) and value:
        yield key, value


def _listed(key: str, count: int, where: str) -> list[str]:
    """Return names for the numbers of a list. Raises BadFile for four numbers whose order nobody says."""
    last = key.rpartition("_")[2] if key not in VECTORS else key
    for name, order in QUATERNIONS.items():
        if count == 4 and key.endswith(name):
            return [f"{key[: -len(name)]}quat_{part}" for part in order]
    if count == 4 and last in UNORDERED:
        raise BadFile(
            f"{where}: {key!r} holds four numbers, and nobody can tell whether w is the first or the last",
            consequence="The file is not used",
            cure="Call it quat_xyzw or quat_wxyz",
        )
    if count == 3 and (last in ROTVECS or key in ROTVECS):
        return [f"{key.removesuffix('_rad')}_{axis}" for axis in "xyz"]
    if count == 3 and (last in VECTORS or key in VECTORS):
        unit = next((end for end in ("_mm", "_m") if key.endswith(end)), "")
        return [f"{key.removesuffix(unit)}_{axis}{unit}" for axis in "xyz"]
    return [f"{key}_{k + 1}" if key else f"{k + 1}" for k in range(count)]


def _stamp(value: Mapping[str, Any]) -> str | None:
    """Return a ROS time stamp in s, exact to its nanoseconds."""
    stamp = value.get("stamp")
    if not isinstance(stamp, Mapping):
        return None
    seconds = stamp.get("secs", stamp.get("sec"))
    parts = stamp.get("nsecs", stamp.get("nanosec", 0))
    if not (_is_real(seconds) and _is_real(parts)):
        return None
    return f"{int(seconds)}.{int(parts):09d}"


def _joint_state(value: Mapping[str, Any], where: str) -> Iterator[tuple[str, str]]:
    """Yield the time and the joints by name of a sensor_msgs/JointState."""
    header = value.get("header")
    stamp = _stamp(header) if isinstance(header, Mapping) else None
    if stamp is not None:
        yield "stamp_s", stamp
    if len(value["name"]) != len(value["position"]):
        raise BadFile(f"{where}: {len(value['name'])} names for {len(value['position'])} positions")
    yield from ((str(name), str(cell)) for name, cell in zip(value["name"], value["position"], strict=True))


def looks_like_records(text: str) -> bool:
    """Whether text is YAML or JSON rather than a table: its first line that says something is a key or a list item."""
    for line in text.splitlines():
        stripped = line.strip()
        if not stripped or stripped.startswith(("#", "%YAML")):
            continue
        if stripped.startswith(("{", "[", "- ", "---")) or stripped == "-":
            return not is_number(stripped.split()[-1]) or stripped[0] != "-" or stripped.startswith("- ")
        key, colon, _ = stripped.partition(":")
        return bool(colon) and "," not in key and not is_number(key)
    return False
