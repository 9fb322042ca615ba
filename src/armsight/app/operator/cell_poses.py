"""Where the things of a cell are, as its files and the robot's joints tell."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import Setup
from armsight.kinematics import Arm, link_frames
from armsight.store import read_world
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.handeye_file import read_handeye

Array = NDArray[np.float64]


def rig_pose(folder: Path, cell: CellFile, arm: Arm | None, q: Array | None) -> RigidTransform | None:
    """Return T_world_rig by world.yaml, or by hand-eye, arm and joints q (n,); None where it is not known.

    A carried rig is where the arm is now; without an arm, or its joints, its position is not known. Raises BadFile.
    """
    world, handeye = (cell_path(folder, getattr(cell, name), name) for name in ("world", "handeye"))
    if world is not None:
        found = read_world(world)
        base = arm.T_world_base if found.parent == "base" and arm is not None else RigidTransform.identity()
        return base * found.T_parent_rig
    if handeye is None or arm is None:
        return None
    calibrated = read_handeye(handeye)
    if calibrated.setup is Setup.EYE_TO_HAND:
        return arm.T_world_base * calibrated.T_parent_camera
    return None if q is None else flange_pose(arm, q) * calibrated.T_parent_camera


def flange_pose(arm: Arm, q: Array) -> RigidTransform:
    """Return T_world_flange at a controller's readings q (n,)."""
    return RigidTransform.from_matrix(arm.fk(arm.values(q))) * arm.T_flange_tool.inv()


def arm_points(arm: Arm, q: Array) -> Array:
    """Return (2 n + 2, 3): the corners of the line that an arm is drawn as in world, from its base to its tool.

    Each link goes along its joint's axis first, then across it, as Denavit and Hartenberg's lengths do.
    """
    frames = link_frames(arm, arm.values(q))
    points = [frames[0, :3, 3]]
    for before, after in pairwise(frames[:-1]):
        z, way = before[:3, 2], after[:3, 3] - before[:3, 3]
        points += [before[:3, 3] + (z @ way) * z, after[:3, 3]]
    return np.array([*points, frames[-1, :3, 3]])
