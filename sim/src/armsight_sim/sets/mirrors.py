"""Complex images of a board and of a lit target, seen by one camera through four mirrors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.records import Frame
from armsight_sim.boards import Board, board_light_at
from armsight_sim.camera import SimCamera
from armsight_sim.lens import Lens
from armsight_sim.pipeline import IDEAL
from armsight_sim.render import LightImage
from armsight_sim.rigs import MirrorLens, Mirrors, mirror_rig, mirror_views
from armsight_sim.scene import Light
from armsight_sim.sensor import Sensor, ambient
from armsight_sim.sets.dataset import Dataset, checked_size

USUAL, LEAST, LIT, COVERED = 20, 8, 12, 8
"""Images of the board, the least of them, images of the lit target, and places seen with one path covered."""
BOARD = Board(columns=7, rows=5, square_m=0.015)
LENS = Lens(
    width=768,
    height=576,
    focal_px=(1002.0, 1001.0),
    centre_px=(386.1, 285.3),
    distortion=(-0.11, 0.08, 0.0004, -0.0003, 0.0),
)
MIRRORS = Mirrors(baseline_m=0.12, tilts_rad=((0.0, 0.0), (2e-4, -1e-4), (0.0, 0.0), (-1e-4, 2e-4)))
SPOTS_M = {"A": (-0.034, 0.0, 0.0), "B": (0.026, 0.027, 0.0), "C": (0.026, -0.027, 0.0)}
EDGE_PX = 12.0
"""How far inside the image every view of the board ends."""
TRIES = 400
BOARD_STREAM, LIGHTS_STREAM, COVERED_STREAMS = 1, 2, {"left": 3, "right": 4}


def mirror_set(seed: int, size: int | None = None) -> Dataset:
    """Return a set for `calibrate mirrors`: complex images of a board at `size` places, and of a lit target.

    Of the first places there are images with one path covered as well. The mirrors stand some tenths of a milliradian
    off. Raises UsageError for too few images.
    """
    n = checked_size(size, USUAL, LEAST, "images of the board")
    views = mirror_views(LENS, MIRRORS)
    boards = _board_poses(views, n, np.random.default_rng([seed, BOARD_STREAM]))
    lights = _target_poses(np.random.default_rng([seed, LIGHTS_STREAM]))

    def images() -> Iterator[tuple[str, Frame]]:
        places = {side: _outgoing(view) for side, view in views.items()}
        for index, pose in enumerate(boards):
            yield f"complex/{index:06d}", _board_image(places, pose, (seed, BOARD_STREAM, index))
        for index, pose in enumerate(boards[:COVERED]):
            for side, stream in COVERED_STREAMS.items():
                yield f"{side}/{index:06d}", _board_image({side: places[side]}, pose, (seed, stream, index))
        cameras = {side: _camera(view) for side, view in views.items()}
        for index, pose in enumerate(lights):
            yield f"lights/{index:06d}", _lit_image(cameras, pose, seed, index)

    board = f"checkerboard:{BOARD.columns}x{BOARD.rows}:{BOARD.square_m:g}"
    return Dataset(
        name="mirrors",
        seed=seed,
        n_images=n + len(COVERED_STREAMS) * COVERED + len(lights),
        images=images,
        rigs={"rig_true.yaml": mirror_rig(views)},
        cameras={"camera.yaml": LENS.mapping()},
        targets={"target.yaml": {"kind": "spots", "spots_m": {key: list(xyz) for key, xyz in SPOTS_M.items()}}},
        commands=(
            f"armsight calibrate mirrors --image complex --board {board} -o rig.yaml",
            f"armsight calibrate mirrors --left-only left --right-only right --board {board} -o rig-of-halves.yaml",
            "armsight calibrate mirrors --image lights --target target.yaml --camera camera.yaml --baseline-mm 120 "
            "-o rig-of-lights.yaml",
            "armsight measure --rig rig.yaml --target target.yaml --image lights --stills -o run",
        ),
        assumptions=_assumptions(board),
    )


def _assumptions(board: str) -> tuple[str, ...]:
    return (
        f"lens: {LENS.width}x{LENS.height}, focal lengths {LENS.focal_px} px, distortion {LENS.distortion}",
        f"mirrors: baseline {MIRRORS.baseline_m} m, plate {MIRRORS.plate_m} m of index {MIRRORS.index}, turned by "
        f"{MIRRORS.tilts_rad} rad",
        f"board: {board}, random places 0.42 to 0.75 m away, tilted up to 35 deg, whole in both views",
        "lit target: an isosceles triangle of 60 mm, 0.5 to 0.7 m away, tilted up to 20 deg",
    )


def _outgoing(view: MirrorLens) -> tuple[Array, Array]:
    """Return where the rays through the pixels' corners leave the mirrors (h+1, w+1, 3), and their directions."""
    v, u = np.mgrid[0 : view.height + 1, 0 : view.width + 1] - 0.5
    rays = view.rays(np.stack([u, v], axis=-1))
    origin, ray = view.mirrors.trace(view.side, rays.reshape(-1, 2))
    return origin.reshape(*rays.shape[:2], 3), ray.reshape(*rays.shape[:2], 3)


def _board_image(places: dict[str, tuple[Array, Array]], pose: RigidTransform, noise: tuple[int, int, int]) -> Frame:
    """Return the views of a board at a pose in rig axes, upon one another: the plate gives each half the light.

    noise: seed, stream and the image's number.
    """
    light: LightImage = ambient(LENS.width, LENS.height, 0.0)
    for origin, ray in places.values():
        R, t = pose.rotation.inv().as_matrix(), np.asarray(pose.translation)
        start, way = (origin - t) @ R.T, ray @ R.T
        along = -start[..., 2] / way[..., 2]
        light = light + 0.5 * board_light_at((start + along[..., None] * way)[..., :2], BOARD)
    index, rng = noise[-1], np.random.default_rng(noise)
    image = IDEAL.develop(np.ascontiguousarray(light, np.float32), Sensor(), rng)
    return Frame(image=image, t_s=float(index), sequence=index, source="mirrors/complex")


def _camera(view: MirrorLens) -> SimCamera:
    return SimCamera(
        lens=view,
        T_world_camera=RigidTransform.identity(),
        sensor=Sensor(),
        backdrop=ambient(view.width, view.height, 6.0),
    )


def _lit_image(cameras: dict[str, SimCamera], pose: RigidTransform, seed: int, index: int) -> Frame:
    """Return both views of the lit target."""
    lights = [Light(name=key, xyz_m=xyz, level=100.0, sigma_px=1.8) for key, xyz in SPOTS_M.items()]
    poses = RigidTransform.concatenate([pose])
    sources = [
        source
        for camera in cameras.values()
        for source in camera.sources(
            lights, lambda t_s: RigidTransform.concatenate([poses[0]] * len(t_s)), 0.0, frozenset(), ()
        )
    ]
    image = cameras["left"].develop(sources, np.random.default_rng([seed, LIGHTS_STREAM, index]))
    return Frame(image=image, t_s=float(index), sequence=index, source="mirrors/lights")


def _board_poses(views: dict[str, MirrorLens], n: int, rng: np.random.Generator) -> list[RigidTransform]:
    """Return random T_rig_board that both views hold whole, upright in the image."""
    size = BOARD.corners_m().max(axis=0)
    margin = np.array([-BOARD.square_m, size[0] + BOARD.square_m, -BOARD.square_m, size[1] + BOARD.square_m])
    edge = np.array([(x, y, 0.0) for x, y in product(margin[:2], margin[2:])])
    poses: list[RigidTransform] = []
    for _ in range(TRIES * n):
        lean = rng.uniform(-0.6, 0.6, 2)
        turn = Rotation.from_rotvec([*lean, 0.0]) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.3, 0.3)])
        centre = rng.uniform([-0.12, -0.12, 0.42], [0.12, 0.12, 0.75])
        pose = RigidTransform.from_components(centre - turn.apply(0.5 * size), turn)
        if np.linalg.norm(lean) < 0.6 and all(_complete(view.project(pose.apply(edge))) for view in views.values()):
            poses.append(pose)
        if len(poses) == n:
            return poses
    raise UsageError(f"only {len(poses)} places of the board lie whole in both views", cure="Ask for fewer images")


def _complete(uv_px: Array) -> bool:
    high = np.array([LENS.width, LENS.height]) - 1.0 - EDGE_PX
    return bool(((uv_px >= EDGE_PX) & (uv_px <= high)).all())


def _target_poses(rng: np.random.Generator) -> Sequence[RigidTransform]:
    """Return random T_rig_target before the mirrors."""
    turns = [Rotation.from_rotvec([*rng.uniform(-0.35, 0.35, 2), rng.uniform(-0.5, 0.5)]) for _ in range(LIT)]
    return [RigidTransform.from_components(rng.uniform([-0.08, -0.07, 0.5], [0.08, 0.07, 0.7]), turn) for turn in turns]
