"""Tables that are no CSV: YAML and JSON (hand-eye programs, ROS messages echoed), MATLAB's .mat, a folder of poses."""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # loads its io where it is used: every command imports this

from armsight.arrays import Array
from armsight.errors import BadFile, NotEnoughData
from armsight.store.atomic import read_bytes
from armsight.store.interpret.raw import MATRIX, RawTable, table_of
from armsight.store.interpret.table_format import column_names
from armsight.store.tables import is_number

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
    """Return the rows of YAML documents: lists, mappings, one pose. Raises BadFile, with the entry, NotEnoughData."""
    entries, how = _entries(documents)
    records = []
    for k, entry in enumerate(entries, 1):
        if not isinstance(entry, Mapping | list):
            raise BadFile(f"{where}, entry {k}: {str(entry)[:40]!r} is no pose")
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
        if len(values) > 1 and all(isinstance(value, Mapping) or _matrix(value) is not None for value in values):
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


MAT_BYTES = 200_000_000
"""Of a file, and of what its variables unpack to."""
MAT_HEAD, MAT_COMPRESSED = 128, 15
"""Bytes before the first variable, and the type of a compressed one, in version 5 of the format."""
MAT_NUMBERS = ("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
POSE_SUFFIXES = (".yaml", ".yml", ".txt", ".csv", ".json")
MOST_FILES = 20_000
ROTATION = tuple(f"r{row}{column}" for row in range(3) for column in range(3))
_NUMBERS = re.compile(r"(\d+)")


def mat_table(path: Path, *, unnamed: bool = False) -> RawTable:
    """Return the variables of a MATLAB file (version 7 or older) as columns.

    (4, 4, n) are poses, (3, 3, n) rotations, (n, k) or (k, n) rows of what the variable's name says: q_deg, xyz_mm,
    quat_wxyz and the other groups of column_names, with a frame's name before them where there are two poses.
    unnamed: the file's only matrix is taken as a table without names. Raises BadFile, NotEnoughData.
    """
    content = mat_variables(path, MAT_NUMBERS)
    arrays = {
        name: np.asarray(value, float)
        for name, value in content.items()
        if not name.startswith("__") and isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size
    }
    if not arrays:
        raise NotEnoughData(f"{path}: holds no array of numbers", consequence="There is nothing to do")
    if unnamed and len(arrays) == 1 and next(iter(arrays.values())).ndim == 2:
        table = next(iter(arrays.values()))
        columns: dict[str, Array] = {str(k): column for k, column in enumerate(table.T)}
        return _of_columns(columns, str(path), "one matrix without names", ())
    return _of_variables(arrays, str(path))


def mat_variables(path: Path, kinds: Sequence[str]) -> dict[str, Any]:
    """Return a MATLAB file's (version 7 or older) variables of some of MATLAB's classes; a struct as a dict of its
    fields. Raises BadFile.
    """
    try:
        return _loaded(read_bytes(path, limit=MAT_BYTES), kinds)
    except NotImplementedError as error:
        raise BadFile(
            f"{path}: a MATLAB file of version 7.3, which is HDF5", cure="Save it in MATLAB with save(..., '-v7')"
        ) from error
    except TypeError as error:  # of scipy, where a variable is an object of a class
        raise BadFile(
            f"{path}: holds an object of a MATLAB class, such as cameraParameters",
            consequence="Only MATLAB reads it",
            cure="Save it as a struct: s = toStruct(params); save('f.mat', 's', '-v7')",
        ) from error
    except (
        scipy.io.matlab.MatReadError,
        ValueError,
        KeyError,
        IndexError,
        OSError,
        EOFError,
        MemoryError,
        zlib.error,
    ) as error:
        reason = " ".join(str(error).split())[:120]
        raise BadFile(f"{path}: no MATLAB file that can be read: {reason}") from error


def _loaded(data: bytes, kinds: Sequence[str]) -> dict[str, Any]:
    """Return the variables of some classes. Raises ValueError where they unpack to more than MAT_BYTES, and as loadmat.

    A compressed variable of a few kilobytes can hold gigabytes, which loadmat takes the memory for before it looks.
    """
    at, unpacked = MAT_HEAD, 0
    order = "<" if data[MAT_HEAD - 2 : MAT_HEAD] == b"IM" else ">"
    while data[:6] == b"MATLAB" and at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        if kind == MAT_COMPRESSED:
            packed = data[at + 8 : at + 8 + size]
            unpacked += len(zlib.decompressobj().decompress(packed, MAT_BYTES + 1))
        if unpacked > MAT_BYTES:
            raise ValueError(f"its variables unpack to more than {MAT_BYTES // 1_000_000} MB")
        at += 8 + size
    file: Any = io.BytesIO(data)  # its types know of paths only
    names = [name for name, _, kind in scipy.io.whosmat(file) if kind in kinds]
    content: dict[str, Any] = scipy.io.loadmat(file, variable_names=names, simplify_cells="struct" in kinds)
    return content


def _of_variables(arrays: dict[str, Array], where: str) -> RawTable:
    """Return those variables whose count of rows is that of most as a table."""
    stacked = {name: array for name, array in arrays.items() if array.ndim == 3}
    counts = [array.shape[2] for array in stacked.values()] or [max(array.shape) for array in arrays.values()]
    n = max(set(counts), key=counts.count)
    columns: dict[str, Array] = {}
    for name, array in arrays.items():
        columns |= _columns(name, array, n)
    if not columns:
        raise BadFile(f"{where}: no variable has {n} rows")
    return _of_columns(columns, where, f"MATLAB variables {', '.join(arrays)[:120]}", tuple(columns))


def _columns(name: str, array: Array, n: int) -> dict[str, Array]:
    """Return the columns of one variable; none where it does not have n rows."""
    if array.ndim == 3:
        if array.shape[2] != n or array.shape[:2] not in ((4, 4), (3, 3), (3, 4)):
            return {}
        rows, wide = array.shape[:2]
        cells = ROTATION if wide == 3 else MATRIX[: 4 * rows]
        return dict(zip((f"{name}_{cell}" for cell in cells), array.reshape(-1, n), strict=True))
    if array.ndim != 2 or n not in array.shape:
        return {}
    table = array if array.shape[0] == n else array.T
    if table.shape[1] == 1:
        return {name: table[:, 0]}
    return dict(zip(_names(name, table.shape[1]), table.T, strict=True))


def _names(name: str, k: int) -> list[str]:
    group = list(column_names(name))
    if len(group) == k:
        return group
    stem, _, unit = name.rpartition("_")
    if unit not in ("deg", "rad", "mm", "m"):
        stem, unit = name, ""
    if k == 3 and stem.split("_")[0].lower() in ("t", "p", "xyz", "pos", "position", "translation"):
        return [f"{stem}_{axis}{'_' if unit else ''}{unit}" for axis in "xyz"]
    return [f"{stem}{i + 1}{'_' if unit else ''}{unit}" for i in range(k)]


def _of_columns(columns: dict[str, Array], where: str, how: str, names: tuple[str, ...]) -> RawTable:
    cells = tuple([repr(float(value)) for value in column] for column in columns.values())
    return RawTable(where=where, how=how, names=names, columns=cells, lines=tuple(range(2, len(cells[0]) + 2)))


def folder_table(folder: Path, read: Callable[[Path], RawTable]) -> RawTable:
    """Return a folder's poses in the order of their numbers; read: one file's table. Raises BadFile, NotEnoughData."""
    files = pose_files(folder)
    if not files:
        raise NotEnoughData(
            f"{folder}: no file ends in {', '.join(POSE_SUFFIXES)}", consequence="There is nothing to do"
        )
    if len({path.suffix.lower() for path in files}) > 1 or len(files) > MOST_FILES:
        raise BadFile(
            f"{folder}: files of several kinds ({', '.join(sorted({p.suffix for p in files}))})",
            consequence="Nobody knows which of them are the poses",
            cure="Put the files of the poses, and only them, in a folder",
        )
    records = []
    for path in files:
        table = read(path)
        if len(table) != 1:
            raise BadFile(f"{path}: {len(table)} rows, one pose is wanted in each file of a folder")
        names = table.names or tuple(str(k) for k in range(len(table.columns)))
        cells = (column[0] for column in table.columns)
        records.append({"file": path.name, **dict(zip(names, cells, strict=True))})
    return table_of(records, str(folder), f"a folder of {len(files)} files, one pose in each")


def pose_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold poses, in the order of the numbers in their names."""
    return sorted((p for p in folder.iterdir() if p.suffix.lower() in POSE_SUFFIXES and p.is_file()), key=_natural)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = _NUMBERS.split(path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
