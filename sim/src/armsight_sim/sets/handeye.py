"""Photographs of a board from a robot's hand, with the robot's poses; the same as pairs of poses, and as streams."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.records import Frame
from armsight_sim.arms import pose_mapping
from armsight_sim.boards import Board, board_light, corner_rays
from armsight_sim.cell import SEED_NOISE
from armsight_sim.pipeline import IDEAL
from armsight_sim.rigs import converging_webcams
from armsight_sim.sensor import Sensor, ambient
from armsight_sim.sets.dataset import QUATERNION, Dataset, Table, checked_size, row_of, with_noise

USUAL, LEAST = 20, 6
BOARD = Board(columns=9, rows=6, square_m=0.02)
WIDTH, HEIGHT = 960, 720
LENS = converging_webcams(WIDTH, HEIGHT)["left"][0]
T_FLANGE_CAMERA = RigidTransform.from_components(
    [0.031, -0.058, 0.087], Rotation.from_euler("xyz", [1.5, -2.0, 88.0], degrees=True)
)
T_BASE_TARGET = RigidTransform.from_components(
    [0.62, 0.11, 0.02], Rotation.from_euler("xyz", [1.0, -0.5, 93.0], degrees=True)
)
ROBOT_M, ROBOT_RAD = 0.00008, 0.0002
"""Normal errors of the robot's readings."""
SEEN_M, SEEN_RAD = 0.0003, 0.0008
"""Normal errors of the board's poses in the tables of poses."""
STREAM_HZ, STREAM_S, LATE_S = 30.0, 20.0, 0.12
"""Rate and length of the streams, and by how much the camera's clock is behind the robot's."""
EDGE_PX = 15.0
TRIES = 400
POSES, NOISE = 1, 2


def handeye_set(seed: int, size: int | None = None) -> Dataset:
    """Return a set for `calibrate handeye`: photographs from the hand, pairs.csv, and two streams of poses.

    size: how many photographs. Raises UsageError for too few.
    """
    n = checked_size(size, USUAL, LEAST, "photographs")
    views = _views(n, np.random.default_rng([seed, POSES]))
    names = [f"{index:03d}" for index in range(n)]

    def images() -> Iterator[tuple[str, Frame]]:
        rays = corner_rays(LENS)
        lamps = ambient(WIDTH, HEIGHT, 1.0, across=0.12, down=-0.08)
        for index, (name, view) in enumerate(zip(names, views, strict=True)):
            light = np.ascontiguousarray(board_light(rays, BOARD, view) * lamps, np.float32)
            image = IDEAL.develop(light, Sensor(), np.random.default_rng([seed, SEED_NOISE, index]))
            yield f"photos/{name}", Frame(image=image, t_s=float(index), sequence=index, source="handeye")

    board = f"checkerboard:{BOARD.columns}x{BOARD.rows}:{BOARD.square_m:g}"
    return Dataset(
        name="handeye",
        seed=seed,
        n_images=n,
        images=images,
        cameras={"camera.yaml": LENS.mapping()},
        truths={
            "handeye_true.yaml": {
                "T_flange_camera": pose_mapping(T_FLANGE_CAMERA),
                "T_base_target": pose_mapping(T_BASE_TARGET),
                "camera_clock_behind_s": LATE_S,
            }
        },
        tables=_tables(names, views, seed),
        commands=(
            f"armsight calibrate handeye --images photos --camera camera.yaml --board {board} --robot robot_poses.csv "
            "-o handeye.yaml",
            "armsight calibrate handeye --pairs pairs.csv -o from-pairs.yaml",
            "armsight calibrate handeye --robot-stream robot.csv --camera-stream poses.csv -o from-streams.yaml",
        ),
        assumptions=_assumptions(board),
    )


def _assumptions(board: str) -> tuple[str, ...]:
    """Return what was chosen, a line each."""
    return (
        f"camera: {WIDTH}x{HEIGHT}, focal lengths {LENS.focal_px} px, on the flange",
        f"board: {board}, 0.35 to 0.55 m away, seen up to 30 deg off its normal",
        f"robot reads its flange with normal errors of {ROBOT_M} m and {ROBOT_RAD} rad an axis",
        f"poses in the tables: {SEEN_M} m and {SEEN_RAD} rad an axis",
        f"streams: {STREAM_HZ:g} Hz, {STREAM_S:g} s, the camera's clock {LATE_S} s behind the robot's",
    )


def _tables(names: list[str], views: list[RigidTransform], seed: int) -> dict[str, Table]:
    """Return the robot's poses by photograph, the pairs of poses, and the streams."""
    rng = np.random.default_rng([seed, NOISE])
    read = [with_noise(_flange(view), rng, length_m=ROBOT_M, angle_rad=ROBOT_RAD) for view in views]
    seen = [with_noise(view, rng, length_m=SEEN_M, angle_rad=SEEN_RAD) for view in views]
    both = [f"{pose}_{name}" for pose in ("base_flange", "camera_target") for name in QUATERNION]
    poses: list[list[float | str]] = [[f"{name}.png", *row_of(pose)] for name, pose in zip(names, read, strict=True)]
    robot, camera = _streams(np.random.default_rng([seed, POSES, NOISE]))
    return {
        "robot_poses.csv": (("file", *QUATERNION), poses),
        "pairs.csv": (both, [[*row_of(a), *row_of(b)] for a, b in zip(read, seen, strict=True)]),
        "robot.csv": robot,
        "poses.csv": camera,
    }


def _flange(view: RigidTransform) -> RigidTransform:
    """Return T_base_flange at which the camera sees the board at T_camera_target."""
    return T_BASE_TARGET * view.inv() * T_FLANGE_CAMERA.inv()


def _views(n: int, rng: np.random.Generator) -> list[RigidTransform]:
    """Return random T_camera_target of a board that is whole in the picture."""
    size = BOARD.corners_m().max(axis=0)
    square = BOARD.square_m
    edge = np.array([[-square, -square, 0.0], [size[0] + square, -square, 0.0], [-square, size[1] + square, 0.0]])
    edge = np.vstack([edge, size + np.array([square, square, 0.0])])
    views: list[RigidTransform] = []
    for _ in range(TRIES * n):
        lean = rng.uniform(-0.5, 0.5, 2)
        turn = Rotation.from_rotvec([*lean, 0.0]) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.6, 0.6)])
        centre = rng.uniform([-0.08, -0.06, 0.35], [0.08, 0.06, 0.55])
        view = RigidTransform.from_components(centre - turn.apply(0.5 * size), turn)
        uv = LENS.project(view.apply(edge))
        if ((uv >= EDGE_PX) & (uv <= np.array([WIDTH, HEIGHT]) - 1.0 - EDGE_PX)).all():
            views.append(view)
        if len(views) == n:
            return views
    raise UsageError(f"only {len(views)} views hold the board whole", cure="Ask for fewer photographs")


def _streams(rng: np.random.Generator) -> tuple[Table, Table]:
    """Return the robot's and the camera's table of one smooth motion, each by its own clock."""
    t_s = np.arange(0.0, STREAM_S, 1.0 / STREAM_HZ)
    period, phase = rng.uniform(3.0, 6.0, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    swing = np.sin(2.0 * np.pi * t_s[:, None] / period + phase) * [0.05, 0.04, 0.06, 0.35, 0.35, 0.5]
    size = BOARD.corners_m().max(axis=0)
    robot: list[list[float | str]] = []
    camera: list[list[float | str]] = []
    for at_s, (x, y, z, *turn) in zip(t_s.tolist(), swing.tolist(), strict=True):
        R = Rotation.from_rotvec(turn)
        view = RigidTransform.from_components(np.array([x, y, 0.45 + z]) - R.apply(0.5 * size), R)
        flange = with_noise(_flange(view), rng, length_m=ROBOT_M, angle_rad=ROBOT_RAD)
        robot.append([at_s, *row_of(flange)])
        camera.append([at_s - LATE_S, *row_of(with_noise(view, rng, length_m=SEEN_M, angle_rad=SEEN_RAD))])
    columns = ("t_s", *QUATERNION)
    return (columns, robot), (columns, camera)
