"""Where the things of a cell are, as its files and the robot's joints tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.handeye import Setup
from armsight.errors import NotEnoughData
from armsight.kinematics import Arm, link_frames
from armsight.store import World, read_world
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.handeye_file import HandEyeFile, read_handeye


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """What a cell's files tell of where its cameras and its target are; None of what they do not."""

    world: World | None
    handeye: HandEyeFile | None

    def rig_pose(self, arm: Arm | None, q: Array | None) -> RigidTransform | None:
        """Return T_world_rig by world.yaml, or by hand-eye, arm and joints q (n,); None where it is not known.

        A carried rig is where the arm is now; without an arm, or its joints, its position is not known.
        """
        if self.world is not None:
            return self.world_parent(arm) * self.world.T_parent_rig
        if self.handeye is None or arm is None:
            return None
        if self.handeye.setup is Setup.EYE_TO_HAND:
            return arm.T_world_base * self.handeye.T_parent_camera
        return None if q is None else flange_pose(arm, q) * self.handeye.T_parent_camera

    def world_parent(self, arm: Arm | None) -> RigidTransform:
        """Return T_world_parent of the frame that world.yaml gives the rig in, and the station its poses."""
        in_base = self.world is not None and self.world.parent == "base" and arm is not None
        return arm.T_world_base if in_base and arm is not None else RigidTransform.identity()

    def on_robot(self, arm: Arm | None, consequence: str) -> tuple[Arm, RigidTransform]:
        """Return the arm with the target as its tool, and T_world_rig of standing cameras. Raises NotEnoughData."""
        T_world_rig = self.rig_pose(arm, None)
        if arm is None or self.handeye is None or T_world_rig is None:
            raise NotEnoughData(
                "where the cameras and the target are on the robot is not known",
                consequence=consequence,
                cure="Calibrate hand-eye first, on the page Calibrate",
            )
        return replace(arm, T_flange_tool=self.handeye.T_parent_target), T_world_rig


def read_placement(folder: Path, cell: CellFile, *, target: bool = True) -> Placement:
    """Return what the cell's files tell; without target no more than the cameras' position takes. Raises BadFile."""
    files = {name: cell_path(folder, getattr(cell, name), name) for name in ("world", "handeye")}
    world = None if files["world"] is None else read_world(files["world"])
    needed = files["handeye"] if target or world is None else None
    return Placement(world=world, handeye=None if needed is None else read_handeye(needed))


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
