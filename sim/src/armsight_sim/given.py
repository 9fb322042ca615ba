"""Cells of a rig, a target and poses that are given: what cameras that are planned will see, by the simulation's own
projection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.geometry import pose_from_quat
from armsight_sim.boards import Board
from armsight_sim.camera import SimCamera
from armsight_sim.cell import BoardCell, Cell
from armsight_sim.lens import Lens
from armsight_sim.pipeline import IDEAL
from armsight_sim.rigs import SIDES, Mirrors, Pair, mirror_views
from armsight_sim.scene import Light
from armsight_sim.sensor import Sensor, ambient

GROUND = 10.0
"""Grey levels behind the lights."""
OUT_OF_LINE_M = 1e-5
"""How far a mirror rig's virtual centres, and a metre before them, may be from those of mirrors at 45 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """A path that is at the pose k (of n) in frame k."""

    poses: RigidTransform
    fps: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses at the times t_s (n,), those of the nearest frames."""
        index = np.clip(np.rint(np.asarray(t_s) * self.fps).astype(int), 0, len(self.poses) - 1)
        return self.poses[index]


def pair_of(rig: Mapping[str, Any]) -> Pair:
    """Return the lenses and places of a rig as rig.yaml has it. Raises UsageError for mirrors out of line."""
    cameras = rig["cameras"]
    places = {
        side: pose_from_quat(cameras[side]["T_rig_camera"]["xyz_m"], cameras[side]["T_rig_camera"]["quat_xyzw"])
        for side in SIDES
    }
    lenses = {side: _lens(cameras[side]) for side in SIDES}
    if rig["kind"] != "mirror":
        return {side: (lenses[side], places[side]) for side in SIDES}
    plate = cameras["left"].get("plate") or {"thickness_m": 0.0, "index": 1.5}
    # the virtual right camera stands at (b/2, 0, -b/2) of the real one: mirrors bring no other shift there
    baseline_m = 2.0 * float(places["right"].translation[0])
    mirrors = Mirrors(baseline_m=baseline_m, plate_m=plate["thickness_m"], index=plate["index"])
    ahead = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    for side in SIDES:
        off = np.abs(mirrors.pose(side).apply(ahead) - places[side].apply(ahead)).max()
        if off > OUT_OF_LINE_M:
            raise UsageError(
                f"the {side} view of the mirror rig is {1e3 * off:.2g} mm off that of mirrors at 45 degrees",
                consequence="Only mirrors that stand in line are simulated",
                cure="Plan with mirrors in line, or leave the simulation away",
            )
    # points and rays of a lens behind mirrors are in the axes of the real camera
    return {side: (lens, RigidTransform.identity()) for side, lens in mirror_views(lenses["right"], mirrors).items()}


def _lens(camera: Mapping[str, Any]) -> Lens:
    k = [float(value) for value in camera.get("distortion") or ()]
    n = 8 if camera.get("lens") == "rational" else 5
    return Lens(
        width=int(camera["width"]),
        height=int(camera["height"]),
        focal_px=(float(camera["fx"]), float(camera["fy"])),
        centre_px=(float(camera["cx"]), float(camera["cy"])),
        skew_px=float(camera.get("skew") or 0.0),
        distortion=tuple([*k, *[0.0] * n][:n]),
        fisheye=camera.get("lens") == "fisheye",
    )


def given_cell(
    seed: int, rig: Mapping[str, Any], target: Mapping[str, Any], poses: Sequence[Sequence[float]], light: Light
) -> Cell:
    """Return a cell of lights as target.yaml has them, at poses (n, 7): x, y, z in m and the quaternion, scalar last.

    light: what all are like; target's diameter_m makes them discs. The cameras are ideal, before dim light.
    """
    places = [pose_from_quat(row[:3], row[3:]) for row in poses]
    lights = tuple(
        Light(
            name=name,
            xyz_m=(float(xyz[0]), float(xyz[1]), float(xyz[2])),
            level=light.level,
            sigma_px=light.sigma_px,
            diameter_m=target.get("diameter_m"),
            facing=light.facing,
        )
        for name, xyz in target["spots_m"].items()
    )
    return Cell(
        name="given",
        seed=seed,
        n_frames=len(places),
        fps=1.0,
        cameras=_cameras(rig, GROUND),
        lights=lights,
        path=Steps(poses=RigidTransform.concatenate(places), fps=1.0),
        target=dict(target),
        events=(),
        assumptions=("rig, target and poses are given", "cameras: ideal, before 10 grey levels"),
    )


def given_board_cell(seed: int, rig: Mapping[str, Any], printed: Board, poses: Sequence[Sequence[float]]) -> BoardCell:
    """Return a cell of a checkerboard at poses (n, 7) before a rig of two cameras."""
    return BoardCell(
        name="given-board",
        seed=seed,
        fps=1.0,
        cameras=_cameras(rig, 1.0),
        printed=printed,
        poses=tuple(pose_from_quat(row[:3], row[3:]) for row in poses),
        assumptions=("rig, board and poses are given",),
    )


def _cameras(rig: Mapping[str, Any], level: float) -> dict[str, SimCamera]:
    return {
        side: SimCamera(
            lens=lens,
            T_world_camera=pose,
            sensor=Sensor(),
            backdrop=ambient(lens.width, lens.height, level),
            pipeline=IDEAL,
        )
        for side, (lens, pose) in pair_of(rig).items()
    }
