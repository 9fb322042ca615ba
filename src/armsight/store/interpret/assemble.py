"""Columns of one meaning put together: positions, rotations, joints, with what the numbers contradict refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Mask
from armsight.errors import Ambiguous, BadFile, Inconsistent
from armsight.geometry.poses import QUAT_NORM_TOLERANCE
from armsight.store.interpret.names import Meaning
from armsight.store.interpret.rotations import (
    FEWEST_ROWS,
    ROTVEC,
    EulerOrder,
    degrees_cause,
    largest,
    looks_like_degrees,
    looks_like_m,
    looks_like_mm,
    looks_like_radians,
)
from armsight.store.interpret.table_format import UNITS, TableFormat
from armsight.store.tables import filled, zeros

ORTHOGONAL = 2e-3
"""Largest entry of R R^T - 1: matrices with three decimals stay below it."""
HALF_TURN_SLACK = 1.02
RIGHT_ANGLE_RAD = np.pi / 2 + 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """A column's meaning and its numbers (n,), as the file has them."""

    meaning: Meaning
    values: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """The columns of one frame by kind and key, the file, its lines, and what was told of them."""

    where: str
    lines: Sequence[int]
    kinds: Mapping[str, Mapping[str, Column]]
    format: TableFormat
    notes: list[str] = field(default_factory=list)

    def complete_columns(self, kind: str, keys: Sequence[str]) -> list[Column] | None:
        """Return the columns of a kind in the order of the keys, None where one is missing."""
        have = self.kinds.get(kind, {})
        return [have[key] for key in keys] if all(key in have for key in keys) else None


def position_m(found: Found) -> Array | None:
    """Return positions (n, 3) in m, None where the columns give none. Raises Inconsistent for the wrong unit."""
    tcp = found.complete_columns("tcp", "012")
    columns = found.complete_columns("position", "xyz") or tcp
    if columns is None:
        return None
    return lengths_m(found, columns, 1.0 if tcp is columns else found.format.length_m)


def lengths_m(found: Found, columns: Sequence[Column], unstated: float) -> Array:
    """Return columns of lengths as (n, k) in m. Raises Inconsistent where the numbers say another unit."""
    names = list(dict.fromkeys(column.meaning.name for column in columns))
    scales = [unstated if column.meaning.scale is None else column.meaning.scale for column in columns]
    xyz = np.stack([column.values for column in columns], axis=1)
    if len(columns) == 3:
        xyz = np.where(filled(xyz)[:, None], np.nan, xyz)  # a lost frame's say no unit
    out: Array = xyz * np.array(scales)
    if all(column.meaning.scale is None for column in columns):
        unit = next((name for name, (_, scale) in UNITS.items() if scale == unstated), "m")
        found.notes.append(f"{', '.join(names)}: taken as {unit}, the header states no unit")
    if found.format.as_stated:
        return out
    if looks_like_mm(out):
        stated = min(scales) < 1.0
        raise far_for_stated(found.where, names, out) if stated else mm_for_metres(found.where, names, xyz)
    if max(scales) < 0.1 and looks_like_m(xyz):
        raise Inconsistent(
            f"{found.where}: columns {', '.join(names)}: these look like metres: the largest value is "
            f"{largest(xyz):.4g}",
            consequence="Taken as mm, all would lie in one spot",
            cure=f"Name the columns {_with_unit(names[0], 'm')}, ..., or give --as-stated if they are mm",
        )
    return out


def angles_rad(found: Found, columns: Sequence[Column], unstated: float, what: str) -> Array:
    """Return columns of angles as (n, k) in rad; what: of which they are, for messages.

    Columns in a unit of length are a prismatic joint's, and stay lengths. Raises Inconsistent where the numbers say
    another unit than the header.
    """
    names = [column.meaning.name for column in columns]
    scales = [unstated if column.meaning.scale is None else column.meaning.scale for column in columns]
    raw = np.stack([column.values for column in columns], axis=1)
    out: Array = raw * np.array(scales)
    if found.format.as_stated:
        return out
    if looks_like_degrees(raw[:, [scale == 1.0 for scale in scales]]):
        raise degrees_for_radians(found.where, names, raw)
    in_degrees = raw[:, [0.01 < scale < 0.02 for scale in scales]]
    if in_degrees.size and looks_like_radians(in_degrees):
        raise Inconsistent(
            f"{found.where}: columns {', '.join(names)[:120]}: these look like radians: the largest value is "
            f"{largest(in_degrees):.4g}",
            consequence=f"Taken as degrees, {what} would hardly turn at all",
            cure=f"Name the columns {_with_unit(names[0], 'rad')}, ..., or give --as-stated if they are degrees",
        )
    return out


STATED = ("m", "mm", "cm", "rad", "deg")
"""What a column's name may state its unit by."""


def mm_for_metres(where: str, names: Sequence[str], xyz: Array) -> Inconsistent:
    """Return the refusal of positions that look like mm where metres are meant."""
    return Inconsistent(
        f"{where}: columns {', '.join(names)}: these look like mm or cm: the largest value is {largest(xyz):.4g}",
        consequence="Taken as metres they would be far from any arm",
        cure=f"Name the columns {_in_unit(names[0], 'mm')}; --as-stated if they are metres",
    )


def far_for_stated(where: str, names: Sequence[str], xyz_m: Array) -> Inconsistent:
    """Return the refusal of positions that are far from any arm in the unit that is stated, which is none of metres."""
    return Inconsistent(
        f"{where}: columns {', '.join(names)}: in the unit that is stated the largest value is {largest(xyz_m):.4g} m",
        consequence="No arm, rig or tracker's target is so far off",
        cure="Check the values, and the unit: um is 0.001 mm; give --as-stated if they are right",
    )


def degrees_for_radians(where: str, names: Sequence[str], values: Array) -> Inconsistent:
    """Return the refusal of angles that look like degrees where radians are meant."""
    return Inconsistent(
        f"{where}: columns {', '.join(names)[:120]}: {degrees_cause(values)}",
        consequence="Taken as radians they would be other angles",
        cure=f"Name the columns {_in_unit(names[0], 'deg', ' or --robot-format')}; --as-stated if they are radians",
    )


def _with_unit(name: str, unit: str) -> str:
    stem, _, tail = name.rpartition("_")
    return f"{stem if stem and tail in STATED else name}_{unit}"


def _in_unit(name: str, unit: str, other: str = "") -> str:
    """Return how to say the unit: by the columns' names, and by flags where those state none, which flags obey."""
    flags = "" if name.rpartition("_")[2] in STATED else f", or give --units {unit}{other}"
    return f"{_with_unit(name, unit)}, ...{flags}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turned:
    """Rotations (n), which of them are known (n,), the others stand at the identity, and the positions (n, 3) in m of
    matrices that have them."""

    rotation: Rotation
    known: Mask
    xyz_m: Array | None = None


def rotations(found: Found) -> Turned | None:
    """Return the rotations, None without columns of them. Raises Inconsistent, Ambiguous, BadFile."""
    if found.format.euler:
        euler = _euler(found)
        if euler is not None:
            return euler
    quaternion = found.complete_columns("quaternion", "xyzw")
    if quaternion is not None:
        return _quaternions(found, quaternion)
    if "cell" in found.kinds and len(found.kinds["cell"]) >= 9:
        return _matrices(found)
    for kind, keys in (("rotvec", "xyz"), ("tcp", "345")):
        columns = found.complete_columns(kind, keys)
        if columns is not None:
            return _rotvecs(found, columns)
    return _euler(found)


def _known(values: Array) -> Mask:
    return np.asarray(np.isfinite(values).all(axis=1))


def _quaternions(found: Found, columns: Sequence[Column]) -> Turned:
    values = np.stack([column.values for column in columns], axis=1)
    lost = (values == values[:, :1]).all(axis=1) & (np.abs(values[:, 0]) != 0.5)  # such as zeros, or -9999
    known = _known(values) & ~lost
    quat = np.where(known[:, None], values, (0.0, 0.0, 0.0, 1.0))
    norm = np.linalg.norm(quat, axis=1)
    far = np.flatnonzero(np.abs(norm - 1.0) > QUAT_NORM_TOLERANCE)
    if far.size:
        raise BadFile(
            f"{found.where}, line {found.lines[far[0]]}: the quaternion {quat[far[0]].tolist()} has length "
            f"{norm[far[0]]:.6g}, not 1",
            consequence="It does not say a rotation",
            cure="Check which columns are the quaternion, and their precision",
        )
    return Turned(rotation=Rotation.from_quat(quat), known=known)


def _rotvecs(found: Found, columns: Sequence[Column]) -> Turned:
    documented = columns[0].meaning.kind == "tcp"  # in rad by its documentation, whatever else is open
    vectors = angles_rad(found, columns, 1.0 if documented else found.format.angle_rad, "the poses")
    known = _known(vectors)
    vectors = np.where(known[:, None], vectors, 0.0)
    longest = float(np.linalg.norm(vectors, axis=1).max(initial=0.0))
    if longest > 2.0 * np.pi and not found.format.as_stated:
        raise Inconsistent(
            f"{found.where}: columns {', '.join(c.meaning.name for c in columns)}: these look like Euler angles: as "
            f"rotation vectors they turn by up to {np.degrees(longest):.0f} degrees",
            consequence="Taken as rotation vectors they would be other rotations",
            cure="Give --euler with their order, or --as-stated if they are rotation vectors",
        )
    if longest > HALF_TURN_SLACK * np.pi:
        found.notes.append(f"rotation vectors are up to {np.degrees(longest):.0f} degrees long: more than half a turn")
    return Turned(rotation=Rotation.from_rotvec(vectors), known=known)


def _euler(found: Found) -> Turned | None:
    columns = found.complete_columns("sequence", "123")
    about: Sequence[str] = ("", "", "")
    if columns is None:
        columns, about = found.complete_columns("euler", "xyz"), "xyz"
    if columns is None and found.format.euler:  # rotation_x, rotation_y, rotation_z without a w, and an order
        columns = None if found.complete_columns("quaternion", "w") else found.complete_columns("quaternion", "xyz")
        columns = columns or found.complete_columns("rotvec", "xyz")
    if columns is None:
        return None
    names = [column.meaning.name for column in columns]
    order = found.format.order or _roll_pitch_yaw(found, names)
    if order is None:
        raise Ambiguous(
            f"{found.where}: the columns {', '.join(names)} are angles of an order that nobody states",
            consequence="The same three angles are other rotations in another order",
            cure="Give --euler with the order (xyz-fixed, zyx, zyz ...), --robot-format with the maker, or name the "
            "columns rotvec_x, ... for a rotation vector",
        )
    angles = angles_rad(found, columns, found.format.angle_rad, "the poses")[:, list(order.sequence(about))]
    known = _known(angles)
    angles = np.where(known[:, None], angles, 0.0)
    _check_middle(found, angles, order, names)
    found.notes.append(
        f"{', '.join(names)}: {'a rotation vector' if order.axes == ROTVEC else f'Euler angles {order}'}"
    )
    return Turned(rotation=order.rotation(angles), known=known)


def _roll_pitch_yaw(found: Found, names: Sequence[str]) -> EulerOrder | None:
    """Return ROS's order (REP 103) for columns called roll, pitch and yaw, None for others."""
    if not all(word in name.lower() for word, name in zip(("roll", "pitch", "yaw"), names, strict=True)):
        return None
    found.notes.append("roll, pitch, yaw: taken as ROS means them, --euler says another order")
    return EulerOrder(axes="xyz", fixed=True)


def _check_middle(found: Found, angles: Array, order: EulerOrder, names: Sequence[str]) -> None:
    """Raise Inconsistent where the middle angle leaves the range that controllers keep to, and another one does not."""
    if found.format.as_stated or len(angles) < FEWEST_ROWS or order.axes == ROTVEC:
        return
    proper = order.axes[0] == order.axes[2]
    middle = angles[:, 1]
    inside = (middle >= -1e-3).all() if proper else (np.abs(middle) <= RIGHT_ANGLE_RAD).all()
    others = [np.abs(angles[:, k]).max() <= RIGHT_ANGLE_RAD for k in (0, 2)]
    if not inside and not proper and any(others):
        raise Inconsistent(
            f"{found.where}: columns {', '.join(names)}: these look like angles of another order: that in the middle "
            f"of {order} goes to {np.degrees(np.abs(middle).max()):.0f} degrees, where controllers stay within 90",
            consequence="The same three angles are other rotations in another order",
            cure="Check --euler or --robot-format and the columns, or give --as-stated if the order is right",
        )


def _matrices(found: Found) -> Turned:
    cells = {key.replace("_", ""): column for key, column in found.kinds["cell"].items()}
    M, translated = _grid(found, cells)  # (n, 4, 4)
    turns = M[:, :3, :3].reshape(-1, 9)
    known = _known(M.reshape(-1, 16)) & ~zeros(turns)  # a lost frame may be all zeros
    R = np.where(known[:, None, None], M[:, :3, :3], np.eye(3))
    skewed = np.asarray(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > ORTHOGONAL)
    far = skewed | np.asarray(np.linalg.det(R) < 0.0)
    if far.any():
        row = int(np.argmax(far))
        raise BadFile(
            f"{found.where}, line {found.lines[row]}: the nine cells of the rotation are no rotation matrix",
            cure="Check the order of the columns: row by row, or column by column",
        )
    xyz = None
    if translated:
        scales = [column.meaning.scale for column in cells.values() if column.meaning.scale is not None]
        named = Meaning(name="T", kind="position", key="", scale=scales[0] if scales else None)
        columns = [Column(meaning=named, values=M[:, k, 3]) for k in range(3)]
        xyz = lengths_m(found, columns, found.format.length_m)
    return Turned(rotation=Rotation.from_matrix(R), known=known, xyz_m=xyz)


def _grid(found: Found, cells: Mapping[str, Column]) -> tuple[Array, bool]:
    n = len(found.lines)
    for first in ("0", "1"):
        for count in (16, 12):
            keys = [str(int(first) + k) for k in range(count)]
            if set(cells) == set(keys):
                return _flat(found, np.stack([cells[key].values for key in keys], axis=1)), True
    base = 0 if "00" in cells else 1
    M = np.tile(np.eye(4), (n, 1, 1))
    for key, column in cells.items():
        row, column_index = int(key[0]) - base, int(key[-1]) - base
        if len(key) != 2 or not (0 <= row <= 3 and 0 <= column_index <= 3):
            raise BadFile(
                f"{found.where}: the column {column.meaning.name!r} is no cell of a matrix of 4 x 4",
                cure="Name cells by row and column, r11, r12, ... r33: nine in a row may be rows or columns",
            )
        M[:, row, column_index] = column.values
    finite = M[np.isfinite(M).all(axis=(1, 2))]
    if np.abs(finite[:, 3] - (0.0, 0.0, 0.0, 1.0)).max(initial=0.0) > 1e-9:
        raise Inconsistent(
            f"{found.where}: the last rows of the matrices are not 0, 0, 0, 1",
            consequence="They are no poses as the header names them",
            cure="Check whether rows and columns are swapped",
        )
    return M, len(cells) >= 12


def _flat(found: Found, values: Array) -> Array:
    """Return matrices (n, 4, 4) of 12 or 16 numbers: row by row, or column by column where the numbers say so."""
    n, count = values.shape
    if count == 12:
        return np.concatenate([values.reshape(n, 3, 4), np.tile([[[0.0, 0.0, 0.0, 1.0]]], (n, 1, 1))], axis=1)
    finite = values[np.isfinite(values).all(axis=1)].reshape(-1, 4, 4)
    last = np.array([0.0, 0.0, 0.0, 1.0])
    by_rows, by_columns = (np.abs(part - last).max(initial=0.0) <= 1e-9 for part in (finite[:, 3, :], finite[:, :, 3]))
    if by_rows and by_columns:
        raise Ambiguous(
            f"{found.where}: matrices without any translation may be written row by row or column by column",
            consequence="A rotation and its inverse look alike",
            cure="Give --columns with the cells' names, m00, m01, ...",
        )
    if not by_rows and not by_columns:
        raise Inconsistent(f"{found.where}: sixteen numbers without 0, 0, 0, 1 in them are no poses")
    if by_columns:
        found.notes.append("matrices are written column by column")
    M = values.reshape(n, 4, 4)
    return M if by_rows else M.transpose(0, 2, 1)


def pose_of(found: Found, inverse: bool) -> tuple[Array | None, Array | None]:
    """Return positions (n, 3), m, and quaternions (n, 4), inverted where asked; None without columns, else NaN."""
    turned = rotations(found)
    xyz = turned.xyz_m if turned is not None and turned.xyz_m is not None else position_m(found)
    if turned is None:
        return xyz, None
    rotation, known = turned.rotation, turned.known
    if inverse and xyz is not None:
        there = known & _known(xyz) & ~(zeros(xyz) & (rotation.magnitude() == 0.0))  # zeros say nothing, as they stood
        T = RigidTransform.from_components(np.where(there[:, None], xyz, 0.0), rotation).inv()
        xyz, rotation, known = np.where(there[:, None], T.translation, np.nan), T.rotation, there
    return xyz, np.where(known[:, None], rotation.as_quat(canonical=True), np.nan)
