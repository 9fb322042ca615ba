"""sweep.csv: a beacon's positions, and pixels where a rig saw it, while one joint after the other moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify import Sweeps
from armsight.columns import POSITION, STEREO_PIXELS
from armsight.errors import BadFile
from armsight.store.atomic import write_text
from armsight.store.interpret import OURS, TableFormat, check_joint_values, standard_bytes
from armsight.store.lost import without_lost
from armsight.store.tables import cells, parse_table

STD = "std_px"
"""Column of the pixels' standard deviation, where it is known."""


def read_sweeps(path: Path, format_: TableFormat = OURS) -> Sweeps:
    """Return the sweeps of joint,q1..qn and x_m,y_m,z_m, or the four pixel columns, or both; joints count from 1.

    Raises BadFile that names line and column.
    """
    data = standard_bytes(path, "sweep", format_)
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
            consequence="The file is not used",
            cure=f"Give joint, q1 .. qn, and {', '.join(POSITION)} or {', '.join(STEREO_PIXELS)}",
        )
    joint = table.numbers["joint"]
    if not (joint == np.round(joint)).all():
        row = int(np.argmax(joint != np.round(joint)))
        raise BadFile(f"{table.location(row)}, column joint: {joint[row]:g} is not the number of a joint")
    xyz = table.stacked(POSITION) if positions else np.zeros((len(table), 3))
    uv = table.stacked(STEREO_PIXELS).reshape(-1, 2, 2) if pixels else None
    std = table.numbers.get(STD)
    return Sweeps(joint=joint.astype(np.intp) - 1, q=table.stacked(readings), xyz_m=xyz, uv_px=uv, std_px=std)


def read_sweep_joints(
    path: Path, format_: TableFormat = OURS
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return frames (m,) in sorted order, joints (m,) that move, both from 0, and q (m, n) of a sweep_joints.csv."""
    table = parse_table(standard_bytes(path, "sweep_joints", format_), str(path), ["frame", "joint"], series="q")
    readings = table.series("q")
    check_joint_values(table.stacked(readings), str(path), format_)
    if not readings:
        raise BadFile(f"{path}: no column q1", consequence="The file is not used", cure="Give q1 .. qn in every row")
    frame, joint = table.numbers["frame"], table.numbers["joint"]
    for name, column in (("frame", frame), ("joint", joint)):
        whole = (column == np.round(column)) & (column >= 0.0)
        if not whole.all():
            row = int(np.argmin(whole))
            raise BadFile(f"{table.location(row)}, column {name}: {column[row]:g} is not a number to count with")
    return frame.astype(np.intp), joint.astype(np.intp) - 1, table.stacked(readings)


def write_sweeps(path: Path, sweeps: Sweeps) -> None:
    """Write sweep.csv, joints from 1."""
    pixels = () if sweeps.uv_px is None else STEREO_PIXELS if sweeps.std_px is None else (*STEREO_PIXELS, STD)
    names = ["joint", *(f"q{i + 1}" for i in range(sweeps.n)), *POSITION, *pixels]
    rows = []
    for i in range(len(sweeps)):
        values = [*sweeps.q[i], *sweeps.xyz_m[i], *(sweeps.uv_px[i].ravel() if sweeps.uv_px is not None else ())]
        values += [sweeps.std_px[i]] if sweeps.std_px is not None and STD in pixels else []
        rows.append(f"{sweeps.joint[i] + 1},{cells(values)}")
    write_text(path, "\n".join([",".join(names), *rows]) + "\n")
