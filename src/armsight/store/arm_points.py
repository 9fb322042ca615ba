"""points.csv: the tool's positions, and maybe rotations, at joint readings; times of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armsight.calibrate.arm import ArmPoints
from armsight.errors import BadFile
from armsight.geometry import pose_from_quat
from armsight.store.interpret import OURS, TableFormat, check_joint_values, standard_bytes
from armsight.store.schema import named
from armsight.store.tables import parse_table
from armsight.store.tracks import POSITION, QUATERNION


def read_arm_points(path: Path, format_: TableFormat = OURS) -> ArmPoints:
    """Return the measurements of a points.csv: q1..qn,x_m,y_m,z_m[,qx,qy,qz,qw][,point][,t_s], or of a table that can
    be understood as one.

    Raises BadFile that names line and column, Inconsistent where units contradict the numbers.
    """
    data = standard_bytes(path, "points", format_)
    optional = (*QUATERNION, "point", "t_s")
    table = parse_table(data, str(path), POSITION, optional=optional, text=("point",), blank=("t_s",), series="q")
    readings = table.series("q")
    if not readings:
        raise BadFile(f"{path}: no column q1", consequence="The file is not used", cure="Give q1 .. qn in every row")
    check_joint_values(table.stacked(readings), str(path), format_)
    turns = [name for name in QUATERNION if name in table.numbers]
    if turns and len(turns) < len(QUATERNION):
        raise BadFile(
            f"{path}: of the quaternion only {', '.join(turns)} is there",
            consequence="The file is not used",
            cure="Give qx, qy, qz and qw, or none of them",
        )
    rotation = None
    if turns:
        with named(str(path)):
            poses = [
                pose_from_quat(xyz, quat)
                for xyz, quat in zip(table.stacked(POSITION), table.stacked(QUATERNION), strict=True)
            ]
        rotation = np.stack([pose.rotation.as_matrix() for pose in poses])
    t_s = table.numbers.get("t_s")
    return ArmPoints(
        q=table.stacked(readings),
        xyz_m=table.stacked(POSITION),
        rotation=rotation,
        point=table.text.get("point", ()),
        t_s=None if t_s is None or np.isnan(t_s).any() else t_s,
    )
