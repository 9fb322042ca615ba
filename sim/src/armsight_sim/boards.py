"""Images of a checkerboard, by casting rays through the lens onto the board's plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight_sim.kernels import cast_board
from armsight_sim.lens import Lens
from armsight_sim.render import LightImage

SAMPLES = (89, 55)
"""Rays per pixel on a Fibonacci lattice (two neighbours of the series): 89 different places along either axis, so
that an edge along an axis is placed to 1/89 px where a square grid of as many rays gives 1/9."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A printed checkerboard of columns x rows inner corners, square_m apart, in the plane z = 0.

    Origin at the first inner corner, x along the columns, y along the rows; a black square lies before the
    first corner, and a white margin of one square is round the board. black, white: in grey levels under
    the light there is; room: level of what is behind the board. blur_px: Gaussian sigma of the lens.
    """

    columns: int = 9
    rows: int = 6
    square_m: float = 0.025
    black: float = 25.0
    white: float = 190.0
    room: float = 70.0
    blur_px: float = 0.6

    def __post_init__(self) -> None:
        if self.columns < 2 or self.rows < 2 or not self.square_m > 0.0:
            raise Inconsistent(f"a board of {self.columns}x{self.rows} corners {self.square_m} m apart cannot be")
        if min(self.black, self.white, self.room, self.blur_px) < 0.0:
            raise Inconsistent("a board's shades and blur are not negative")

    def corners_m(self) -> Array:
        """Return the inner corners (rows * columns, 3) in board axes, row by row."""
        r, c = np.mgrid[0 : self.rows, 0 : self.columns]
        return np.stack([c * self.square_m, r * self.square_m, 0.0 * r], axis=-1).reshape(-1, 3)


def corner_rays(lens: Lens) -> Array:
    """Return the rays (h+1, w+1, 2) through the corners of the lens's pixels, for board_light."""
    v, u = np.mgrid[0 : lens.height + 1, 0 : lens.width + 1] - 0.5
    return lens.rays(np.stack([u, v], axis=-1))


def board_light(rays: Array, board: Board, T_camera_board: RigidTransform) -> LightImage:
    """Return the light (h, w, 1) of a board in front of the camera whose corner_rays are given.

    Each pixel takes the mean of 89 rays cast onto the plane where an edge crosses it, then the image is blurred
    by the lens. Raises Inconsistent where the board is behind the camera or seen edge-on.
    """
    M = T_camera_board.as_matrix()[:3][:, [0, 1, 3]]  # (3, 3): board plane (x, y, 1) -> camera axes
    if not ((M @ np.array([[0.0], [0.0], [1.0]]))[2] > 0.0 and abs(np.linalg.det(M)) > 1e-9):
        raise Inconsistent("the simulated board is behind the camera or seen edge-on")
    H = np.diag([1.0 / board.square_m, 1.0 / board.square_m, 1.0]) @ np.linalg.inv(M)
    return _cast(rays, H, board)


def board_light_at(places_m: Array, board: Board) -> LightImage:
    """Return the light (h, w, 1) of a board of which the corners of the pixels see the places (h+1, w+1, 2), in m.

    For views whose rays do not meet in one point, as through a glass plate.
    """
    return _cast(places_m / board.square_m, np.eye(3), board)


def _cast(rays: Array, H: Array, board: Board) -> LightImage:
    """Return the blurred light (h, w, 1) of a board whose plane H (3, 3) gives in squares for each ray."""
    n, step = SAMPLES
    index = np.arange(n)
    lattice = np.stack([(index + 0.5) / n, ((index * step) % n + 0.5) / n], axis=1)  # (n, 2) in the unit square
    sharp = np.empty((rays.shape[0] - 1, rays.shape[1] - 1), np.float32)
    shades = np.array([board.black, board.white, board.room])
    cast_board(np.ascontiguousarray(rays), np.ascontiguousarray(H), board.columns, board.rows, shades, lattice, sharp)
    light: LightImage = gaussian_filter(sharp, board.blur_px, mode="nearest", truncate=5.0)
    return light[:, :, None]


BOARD_MARGIN_PX = 12.0
"""How far inside both images every corner of the outer squares must be."""

BOARD_TRIES = 200
"""Poses drawn before a board is said not to fit; about one in two fits at the default sizes."""


def random_board_pose(
    board: Board, rig: Mapping[str, tuple[Lens, RigidTransform]], rng: np.random.Generator, reach: float = 1.0
) -> RigidTransform:
    """Return a random T_world_board that both cameras see whole; reach: times the usual distance, for longer lenses.

    Raises UsageError where none is found.
    """
    corners = board.corners_m()
    size = corners.max(axis=0)
    x, y = np.meshgrid([-board.square_m, size[0] + board.square_m], [-board.square_m, size[1] + board.square_m])
    edge = np.stack([x.ravel(), y.ravel(), np.zeros(4)], axis=1)
    for _ in range(BOARD_TRIES):
        axis = rng.normal(size=2)
        lean = rng.uniform(0.0, np.deg2rad(40.0)) * axis / np.linalg.norm(axis)
        R = Rotation.from_rotvec([*lean, 0.0]) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.35, 0.35)])
        centre = rng.uniform([-0.15, -0.12, 0.40 * reach], [0.27, 0.12, 0.75 * reach])
        pose = RigidTransform.from_components(centre - R.apply(0.5 * size), R)
        if all(_holds(lens, (T.inv() * pose).apply(edge)) for lens, T in rig.values()):
            return pose
    raise UsageError(
        f"no pose was found at which both cameras see all of a board of {size[0]:.2f} x {size[1]:.2f} m",
        cure="Simulate a smaller board",
    )


def _holds(lens: Lens, points_m: Array) -> bool:
    """Tell whether points (n, 3) in camera axes land inside the image with BOARD_MARGIN_PX to spare."""
    uv = lens.project(points_m)
    high = np.array([lens.width, lens.height]) - 1.0 - BOARD_MARGIN_PX
    return bool(((uv >= BOARD_MARGIN_PX) & (uv <= high)).all())
