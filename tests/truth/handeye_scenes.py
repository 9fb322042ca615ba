"""Pictures of a board for hand-eye calibration, by a pinhole projection of this file's own; errors against truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye.image_model import poses_of_views
from armsight.optics import Camera
from armsight.records import BoardView, TargetKind, board_target

DEG, MM = np.pi / 180, 1e-3
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
CAMERA = Camera.pinhole(1280, 960, 1100, 1100, 640, 480)
FRESH = 20


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Noise of a corner in px, of the robot in m and rad; focal, pitch: true over given; bend_m: between the board's
    middle and its ends; part: 5 x 4 corners are seen only."""

    px: float
    robot_m: float
    robot_rad: float
    focal: float = 1.0
    pitch: float = 1.0
    bend_m: float = 0.0
    part: bool = False


CELLS = {
    "good robot, noisy corners": Cell(px=0.5, robot_m=0.05 * MM, robot_rad=0.005 * DEG),
    "noisy robot": Cell(px=0.1, robot_m=0.3 * MM, robot_rad=0.05 * DEG),
    "parts of the board": Cell(px=0.3, robot_m=0.1 * MM, robot_rad=0.02 * DEG, part=True),
    "focal length off by 0.5 %": Cell(px=0.2, robot_m=0.1 * MM, robot_rad=0.02 * DEG, focal=1.005),
    "robot 0.5 mm and 0.1 degrees": Cell(px=0.2, robot_m=0.5 * MM, robot_rad=0.1 * DEG),
    "and pitch off by 0.3 %": Cell(px=0.2, robot_m=0.5 * MM, robot_rad=0.1 * DEG, pitch=1.003),
    "and board bent by 1 mm": Cell(px=0.2, robot_m=0.5 * MM, robot_rad=0.1 * DEG, bend_m=1.0 * MM),
    "good robot, board bent by 1 mm": Cell(px=0.2, robot_m=0.05 * MM, robot_rad=0.01 * DEG, bend_m=1.0 * MM),
}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Noisy views and T_base_flange (n); fresh views without noise, the true T_base_flange of these, T_base_target; and
    the camera on the flange."""

    views: list[BoardView]
    robot: RigidTransform
    fresh: list[BoardView]
    fresh_robot: RigidTransform
    T_base_target: RigidTransform
    T_flange_camera: RigidTransform


def scene(cell: Cell, n: int, seed: int) -> Scene:
    """Draw a hand-eye pose, a board's place and n images, and fresh ones."""
    rng = np.random.default_rng([n, seed])
    X = RigidTransform.from_components(
        np.array([0.03, -0.06, 0.09]) + rng.normal(0, 0.02, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    Z = RigidTransform.from_components(
        np.array([0.6, 0.1, 0.0]) + rng.normal(0, 0.1, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    k = n + FRESH
    turn = Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (k, 3)))
    t = np.stack([rng.uniform(-0.12, 0.12, k), rng.uniform(-0.08, 0.08, k), rng.uniform(0.45, 0.8, k)], axis=1)
    B = RigidTransform.from_components(t, turn) * RigidTransform.from_translation(-BOARD.xyz_m.mean(axis=0))
    A = Z * B.inv() * X.inv()
    views = [picture(rng, B[i], cell, cell.px if i < n else 0.0, part=cell.part and i < n) for i in range(k)]
    off = rng.normal(size=(2, n, 3))
    robot = RigidTransform.from_components(
        A[:n].translation + cell.robot_m * off[0], Rotation.from_rotvec(cell.robot_rad * off[1]) * A[:n].rotation
    )
    return Scene(views=views[:n], robot=robot, fresh=views[n:], fresh_robot=A[n:], T_base_target=Z, T_flange_camera=X)


def picture(rng: np.random.Generator, B: RigidTransform, cell: Cell, px: float, *, part: bool) -> BoardView:
    """Return the corners of the board at T_camera_target B; part: of a block of 5 x 4 of them."""
    along = (BOARD.xyz_m[:, 0] - BOARD.xyz_m[:, 0].mean()) / np.ptp(BOARD.xyz_m[:, 0])  # -0.5 to 0.5
    bent = np.outer(cell.bend_m * (4.0 * along**2 - 0.5), [0.0, 0.0, 1.0])
    p = B.apply(cell.pitch * BOARD.xyz_m + bent)
    uv = 1100.0 * cell.focal * p[:, :2] / p[:, 2:] + [640.0, 480.0] + px * rng.normal(size=(len(p), 2))
    index = np.arange(len(p))
    if part:
        column, row = rng.integers(0, 5), rng.integers(0, 3)
        x, y = index % 9 - column, index // 9 - row
        index = index[(x >= 0) & (x < 5) & (y >= 0) & (y < 4)]
    return BoardView(uv_px=uv[index], index=index, sigma_px=0.05, width=1280, height=960, source=f"{rng.random()}.png")


def error_mm(T_flange_camera: RigidTransform, camera: Camera, s: Scene) -> float:
    """Return where the board's points in the fresh images are put in base axes, against truth, RMS in mm."""
    seen = s.fresh_robot * T_flange_camera * poses_of_views(s.fresh, camera, BOARD).T_camera_target
    true = s.T_base_target.apply(BOARD.xyz_m)
    off = np.stack([seen[i].apply(BOARD.xyz_m) - true for i in range(len(s.fresh))])
    return float(np.sqrt((off**2).sum(axis=2).mean())) / MM
