"""sweep.csv: a beacon's places, and pixels where a rig saw it, while one joint after the other moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armsight.calibrate.identify import Sweeps
from armsight.errors import BadFile
from armsight.store.tables import read_table
from armsight.store.tracks import POSITION

PIXELS = ("left_u_px", "left_v_px", "right_u_px", "right_v_px")


def read_sweeps(path: Path) -> Sweeps:
    """Return the sweeps of joint,q1..qn and x_m,y_m,z_m, or the four pixel columns, or both; joints count from 1.

    Raises BadFile that names line and column.
    """
    table = read_table(path, ["joint"], optional=(*POSITION, *PIXELS), series="q")
    readings = table.series("q")
    pixels = [name for name in PIXELS if name in table.numbers]
    places = [name for name in POSITION if name in table.numbers]
    if not readings or 0 < len(pixels) < 4 or 0 < len(places) < 3 or not (pixels or places):
        raise BadFile(
            f"{path}: has the columns {', '.join(table.numbers)}",
            consequence="The file is not used",
            cure=f"Give joint, q1 .. qn, and {', '.join(POSITION)} or {', '.join(PIXELS)}",
        )
    joint = table.numbers["joint"]
    if not (joint == np.round(joint)).all():
        row = int(np.argmax(joint != np.round(joint)))
        raise BadFile(f"{table.place(row)}, column joint: {joint[row]:g} is not the number of a joint")
    xyz = table.stacked(POSITION) if places else np.zeros((len(table), 3))
    uv = table.stacked(PIXELS).reshape(-1, 2, 2) if pixels else None
    return Sweeps(joint=joint.astype(np.intp) - 1, q=table.stacked(readings), xyz_m=xyz, uv_px=uv)
