"""Starts for the bundle adjustment: homographies, focal lengths and poses in closed form (Zhang 2000); of a fisheye the
focal length that makes the boards flat."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle
from armsight.calibrate.cameras.kernels import matrices_of, poses_of
from armsight.calibrate.cameras.observations import Observations
from armsight.errors import Degenerate
from armsight.optics import Camera, LensKind

GUESS_OVER_WIDTH = 1.0
"""Focal length over image width (53 degrees of view) where the views do not tell it."""
RANGE_OVER_WIDTH = (0.2, 20.0)
"""Focal lengths outside this range come from noise: 136 degrees and 3 degrees of view."""
SINGULAR = 1e12
"""Condition from which on a view's points lie on a line: boards all over images give 2e4 at most, lines 7e16."""


def homographies(observations: Observations, c: int = 0) -> Array:
    """Return H (G, 3, 3) from board coordinates (m, centred) to pixels from the image's middle, in image widths.

    Linear least squares with H[2, 2] = 1, which the centred board allows: its middle is in front of the camera.
    Raises Degenerate where a view's points lie on one line.
    """
    width, height = observations.sizes[c]
    seen = (observations.weight[:, c] > 0.0).astype(float)  # (G, n)
    xy = (observations.uv[:, c] - 0.5 * np.array([width - 1.0, height - 1.0])) / width  # (G, n, 2)
    extent = float(np.abs(observations.X).max())
    X, Y = (observations.X[:, :2] / extent).T  # (n,)
    one, zero = np.ones_like(X), np.zeros_like(X)
    design = np.empty((observations.n_views, 2, len(X), 8))
    design[:, 0] = np.stack([X, Y, one, zero, zero, zero, zero, zero], axis=1)
    design[:, 1] = np.stack([zero, zero, zero, X, Y, one, zero, zero], axis=1)
    for h in range(2):
        design[:, h, :, 6] = -xy[:, :, h] * X
        design[:, h, :, 7] = -xy[:, :, h] * Y
    design *= seen[:, None, :, None]
    flat = design.reshape(observations.n_views, -1, 8)
    target = (xy * seen[:, :, None]).transpose(0, 2, 1).reshape(observations.n_views, -1, 1)
    transposed = flat.transpose(0, 2, 1)
    normal = transposed @ flat
    if not np.linalg.cond(normal).max() < SINGULAR:
        raise Degenerate(
            "in one view the points seen of the board lie on one line",
            consequence="That view says nothing about the camera",
            cure="Leave the view out",
        )
    rows = np.linalg.solve(normal, transposed @ target)[:, :, 0]
    H = np.concatenate([rows, np.ones((len(rows), 1))], axis=1).reshape(-1, 3, 3)
    H[:, :, :2] /= extent
    return np.asarray(H)


def focal_lengths(H: Array, width: int) -> Array:
    """Return fx, fy (2,) in px from homographies (G, 3, 3) with the principal point in the image's middle.

    Zhang's two constraints a view, linear in 1/fx^2 and 1/fy^2. Falls back to one focal length for both, then to
    GUESS_OVER_WIDTH, where the views leave them open (no tilt).
    """
    h1, h2 = H[:, :, 0], H[:, :, 1]
    size = np.sqrt(np.linalg.norm(h1[:, :2], axis=1) * np.linalg.norm(h2[:, :2], axis=1))[:, None]
    h1, h2 = h1 / size, h2 / size
    design = np.concatenate([h1[:, :2] * h2[:, :2], h1[:, :2] ** 2 - h2[:, :2] ** 2])  # (2G, 2)
    target = -np.concatenate([h1[:, 2] * h2[:, 2], h1[:, 2] ** 2 - h2[:, 2] ** 2])  # (2G,)
    inverse = np.linalg.lstsq(design, target, rcond=None)[0]
    low, high = RANGE_OVER_WIDTH
    if (inverse > 0.0).all() and ((low < inverse**-0.5) & (inverse**-0.5 < high)).all():
        return np.asarray(width * inverse**-0.5)
    one = design.sum(axis=1)
    both = float(one @ target) / max(float(one @ one), 1e-300)
    f = both**-0.5 if both > 0.0 else 0.0
    return np.full(2, width * (f if low < f < high else GUESS_OVER_WIDTH))


def board_poses(H: Array, focal: Array, width: int) -> Array:
    """Return T_camera_board (G, 6) as (t m, rotation vector rad) from homographies and focal lengths (2,)."""
    poses = np.empty((len(H), 6))
    poses_of(np.ascontiguousarray(H), focal[0] / width, focal[1] / width, poses)
    return poses


def start_intrinsics(focal: Array, size: tuple[int, int]) -> Array:
    """Return intrinsics (10,): the focal lengths, the principal point in the middle, no skew or distortion."""
    k = np.zeros(10)
    k[:2] = focal
    k[2], k[3] = 0.5 * (size[0] - 1.0), 0.5 * (size[1] - 1.0)
    return k


# A start for the bundle adjustment of a fisheye lens: the focal length that makes the boards flat.

TRIED_OVER_LARGEST = np.geomspace(0.18, 2.5, 40)
"""Focal lengths over the image's larger side: 318 to 23 degrees of view, 7 % apart; by the longest every pixel has a
ray."""


def start_of_fisheye(observations: Observations) -> Bundle:
    """Return the start of one camera: of equidistant lenses (theta_d = theta) the one that reprojects best.

    For each focal length the points are made rays, the boards' poses come from homographies of these, and the median
    distance of the points from where they should be, px, is compared. Raises Degenerate as homographies.
    """
    size = observations.sizes[0]
    found = []
    for focal in max(size) * TRIED_OVER_LARGEST:
        k = start_intrinsics(np.full(2, focal), size)
        camera = Camera(width=size[0], height=size[1], intrinsics=k, lens=LensKind.FISHEYE)
        poses = poses_by_rays(observations, camera)
        if poses is not None:
            bundle = Bundle(k=k[None], poses=poses)
            found.append((_median_distance(observations, camera, poses), bundle))
    return min(found, key=lambda one: one[0])[1]


def poses_by_rays(observations: Observations, camera: Camera) -> Array | None:
    """Return T_camera_board (G, 6) from homographies of the points' rays; None where a point has no ray."""
    width, height = observations.sizes[0]
    seen = observations.weight[:, 0] > 0.0
    rays = camera.rays(observations.uv[:, 0].reshape(-1, 2)).reshape(observations.n_views, -1, 2)
    if not np.isfinite(rays[seen]).all():
        return None
    rays = np.where(seen[..., None], rays, 0.0)
    ideal = rays * width + 0.5 * np.array([width - 1.0, height - 1.0])
    poses = board_poses(homographies(replace(observations, uv=ideal[:, None])), np.full(2, float(width)), width)
    return poses if np.isfinite(poses).all() else None


def poses_of_lights(observations: Observations, camera: Camera) -> Array | None:
    """Return T_camera_target (G, 6) of points anywhere, from their rays (Terzakis, Lourakis 2020); None as above."""
    poses = np.empty((observations.n_views, 6))
    for g, (uv, weight) in enumerate(zip(observations.uv[:, 0], observations.weight[:, 0], strict=True)):
        rays, X = camera.rays(uv[weight > 0.0]), observations.X[weight > 0.0]
        if not np.isfinite(rays).all():
            return None
        _, turn, place = cv2.solvePnP(X, rays[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        poses[g] = np.concatenate([place.ravel(), turn.ravel()])
    return poses


def _median_distance(observations: Observations, camera: Camera, poses: Array) -> float:
    R = np.empty((len(poses), 3, 3))
    matrices_of(np.ascontiguousarray(poses[:, 3:]), R)
    points = observations.X @ R.transpose(0, 2, 1) + poses[:, None, :3]  # (G, n, 3)
    uv = camera.project(points.reshape(-1, 3)).reshape((*points.shape[:2], 2))
    distance = np.linalg.norm(uv - observations.uv[:, 0], axis=2)[observations.weight[:, 0] > 0.0]
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))
