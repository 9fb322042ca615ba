"""points.csv: the tool at joint readings; sweep.csv: a beacon while joint after joint moves; a recording's times."""

from __future__ import annotations

import csv
import difflib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm import ArmPoints
from armsight.calibrate.identify import Sweeps
from armsight.columns import POSITION, QUATERNION, STEREO_PIXELS
from armsight.errors import BadFile
from armsight.geometry import pose_from_quat
from armsight.optics import SIDES, require_camera_name
from armsight.records import PoseStatus
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.covariances import POSITION_COVARIANCE, all_covariances
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import check_joint_values, joint_readings, standard_bytes
from armsight.store.lost import without_lost, without_rare_rotations
from armsight.store.tables import Table, cells, parse_table
from armsight.store.verify_files import KNOWN

STD = "std_px"
"""Column of the pixels' standard deviation, where it is known."""
U, V = "_u_px", "_v_px"
"""Ends of the columns of a camera's pixels."""


def read_sweeps(path: Path, format_: TableFormat = OURS) -> Sweeps:
    """Return sweeps of joint (from 1), q1..qn and x_m,y_m,z_m or the pixels of cameras by name. Raises BadFile."""
    data = standard_bytes(path, "sweep", format_)
    cameras = _cameras_in(data)
    if not set(cameras) <= set(SIDES):
        return _read_sweeps_of(path, data, cameras, format_)
    table = parse_table(
        data,
        str(path),
        ["joint"],
        optional=(*POSITION, *STEREO_PIXELS, STD),
        blank=("q", *POSITION, *STEREO_PIXELS),
        series="q",
    )
    seen = [STEREO_PIXELS] if all(name in table.numbers for name in STEREO_PIXELS) else []
    table = without_lost(table, format_.notify, groups=seen)
    readings = table.series("q")
    check_joint_values(table.stacked(readings), str(path), format_)
    pixels = [name for name in STEREO_PIXELS if name in table.numbers]
    positions = [name for name in POSITION if name in table.numbers]
    if not readings or 0 < len(pixels) < 4 or 0 < len(positions) < 3 or not (pixels or positions):
        raise BadFile(
            f"{path}: has the columns {', '.join(table.numbers)}",
            cure=f"Give joint, q1 .. qn, and {', '.join(POSITION)} or {', '.join(STEREO_PIXELS)}",
        )
    joint = _joints_in(table)
    xyz = table.stacked(POSITION) if positions else np.zeros((len(table), 3))
    uv = table.stacked(STEREO_PIXELS).reshape(-1, 2, 2) if pixels else None
    std = table.numbers.get(STD)
    return Sweeps(joint=joint, q=table.stacked(readings), xyz_m=xyz, uv_px=uv, std_px=std)


def _joints_in(table: Table) -> NDArray[np.intp]:
    """Return the joints of a table, from 0. Raises BadFile."""
    joint = table.numbers["joint"]
    if not (joint == np.round(joint)).all():
        row = int(np.argmax(joint != np.round(joint)))
        raise BadFile(f"{table.location(row)}, column joint: {joint[row]:g} is not the number of a joint")
    return joint.astype(np.intp) - 1


def _cameras_in(data: bytes) -> tuple[str, ...]:
    """Return the cameras whose pixels a table has, by its columns NAME_u_px; left and right where it has none."""
    header = _cells(data.splitlines()[0]) if data else []
    return tuple(name.removesuffix(U) for name in header if name.endswith(U) and name != U) or SIDES


def _pixels_of(cameras: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{name}{end}" for name in cameras for end in (U, V))


def _read_sweeps_of(path: Path, data: bytes, cameras: tuple[str, ...], format_: TableFormat) -> Sweeps:
    """Return sweeps with the pixels of these cameras, empty where one does not show the beacon."""
    for name in cameras:
        require_camera_name(name)
    pixels = _pixels_of(cameras)
    table = parse_table(
        data, str(path), ("joint", *pixels), optional=(*POSITION, STD), blank=(*pixels, *POSITION), series="q"
    )
    readings = table.series("q")
    check_joint_values(table.stacked(readings), str(path), format_)
    placed = all(name in table.numbers for name in POSITION)
    xyz = np.nan_to_num(table.stacked(POSITION)) if placed else np.zeros((len(table), 3))
    return Sweeps(
        joint=_joints_in(table),
        q=table.stacked(readings),
        xyz_m=xyz,
        uv_px=table.stacked(pixels).reshape(len(table), -1, 2),
        std_px=table.numbers.get(STD),
        cameras=cameras,
    )


def read_sweep_joints(
    path: Path, format_: TableFormat = OURS
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return frames (m,) in sorted order, joints (m,) that move, both from 0, and q (m, n) of a sweep_joints.csv."""
    table = parse_table(standard_bytes(path, "sweep_joints", format_), str(path), ["frame", "joint"], series="q")
    q = joint_readings(table, str(path), format_)
    frame, joint = table.numbers["frame"], table.numbers["joint"]
    for name, column in (("frame", frame), ("joint", joint)):
        whole = (column == np.round(column)) & (column >= 0.0)
        if not whole.all():
            row = int(np.argmin(whole))
            raise BadFile(f"{table.location(row)}, column {name}: {column[row]:g} is not a number to count with")
    return frame.astype(np.intp), joint.astype(np.intp) - 1, q


def write_sweeps(path: Path, sweeps: Sweeps) -> None:
    """Write sweep.csv, joints from 1."""
    of = _pixels_of(sweeps.cameras)
    pixels = () if sweeps.uv_px is None else of if sweeps.std_px is None else (*of, STD)
    names = ["joint", *(f"q{i + 1}" for i in range(sweeps.n)), *POSITION, *pixels]
    rows = []
    for i in range(len(sweeps)):
        values = [*sweeps.q[i], *sweeps.xyz_m[i], *(sweeps.uv_px[i].ravel() if sweeps.uv_px is not None else ())]
        values += [sweeps.std_px[i]] if sweeps.std_px is not None and STD in pixels else []
        rows.append(f"{sweeps.joint[i] + 1},{cells(values)}")
    write_text(path, "\n".join([",".join(names), *rows]) + "\n")


SLIP = 0.8
"""Names that are so much alike (difflib's ratio) are one written wrong: `xm`, `qX`; goal_x_m and x_m are not."""


def read_arm_points(path: Path, format_: TableFormat = OURS) -> ArmPoints:
    """Return the measurements of a points.csv: q1..qn,x_m,y_m,z_m[,qx,qy,qz,qw][,point][,t_s][,sx_m .. cov_y_z], or of
    a table that can be understood as one.

    What `verify` takes is taken, as it sends its reader here: its further columns (goal_x_m, temperature_c, ...)
    are passed over, and rows whose status is not ok are left out. A column that is nearly one of this table is a slip
    of writing, and refused. Raises BadFile that names line and column, Inconsistent where units
    contradict the numbers.
    """
    content = standard_bytes(path, "points", format_)
    data = _without_lost(content)
    own = (*QUATERNION, "point", "t_s", *POSITION_COVARIANCE)
    further = _further(data, (*POSITION, *own))
    table = parse_table(
        data,
        str(path),
        POSITION,
        optional=(*own, *further),
        text=("point", *further),
        blank=("t_s", "q", *POSITION, *QUATERNION, *POSITION_COVARIANCE, *further),
        series="q",
    )
    table = without_lost(without_rare_rotations(table, format_.notify), format_.notify)
    q = joint_readings(table, str(path), format_)
    rotation = _rotation(table, path)
    t_s = table.numbers.get("t_s")
    covariance, note = all_covariances(table, path, 3, "the positions")
    lines = [i for i, line in enumerate(content.splitlines(), 1) if line.strip()]
    return ArmPoints(
        q=q,
        xyz_m=table.stacked(POSITION),
        rotation=rotation,
        point=table.text.get("point", ()),
        t_s=None if t_s is None or np.isnan(t_s).any() else t_s,
        covariance=covariance,
        unweighed=note,
        row=np.searchsorted(lines, table.lines) - 1,
    )


def _rotation(table: Table, path: Path) -> NDArray[np.float64] | None:
    turns = [name for name in QUATERNION if name in table.numbers]
    if turns and len(turns) < len(QUATERNION):
        raise BadFile(
            f"{path}: of the quaternion only {', '.join(turns)} is there",
            cure="Give qx, qy, qz and qw, or none of them",
        )
    if not turns:
        return None
    with named(str(path)):
        each = zip(table.stacked(POSITION), table.stacked(QUATERNION), strict=True)
        return np.stack([pose_from_quat(xyz, quat).rotation.as_matrix() for xyz, quat in each])


def _without_lost(data: bytes) -> bytes:
    """Return a table with empty lines in place of rows whose status says that they are no pose."""
    lines = data.splitlines(keepends=True)
    header = _cells(lines[0]) if lines else []
    if header.count("status") != 1:
        return data
    column = header.index("status")
    good = (PoseStatus.OK.value, "status", "")
    return b"".join(line if len(row := _cells(line)) != len(header) or row[column] in good else b"\n" for line in lines)


def _cells(line: bytes) -> list[str]:
    text = line.decode("utf-8-sig", errors="replace")
    return [cell.strip() for cell in next(csv.reader([text]), [])]


def _further(data: bytes, known: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a table that are none of ours, nor nearly one."""
    return tuple(
        name
        for name in dict.fromkeys(_cells(data.splitlines()[0] if data else b""))
        if name not in known
        and not name[1:].isdecimal()  # q1 .. qn, or one of them written wrong
        and (name in KNOWN or not difflib.get_close_matches(name, known, n=1, cutoff=SLIP))
    )
