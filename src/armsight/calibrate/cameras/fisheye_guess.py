"""A start for the bundle adjustment of a fisheye lens: the focal length that makes the boards flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.cameras.bundle_adjustment import Bundle
from armsight.calibrate.cameras.initial_guess import board_poses, homographies, start_intrinsics
from armsight.calibrate.cameras.kernels import matrices_of
from armsight.calibrate.cameras.observations import Observations
from armsight.errors import Degenerate
from armsight.optics import Camera, LensKind

Array = NDArray[np.float64]

TRIED_OVER_WIDTH = np.geomspace(0.18, 2.5, 40)
"""Focal lengths over the image's width: 318 to 23 degrees of view, 7 % apart."""


def start_of_fisheye(observations: Observations) -> Bundle:
    """Return the start of one camera: of equidistant lenses (theta_d = theta) the one that reprojects best.

    For each focal length the points are made rays, the boards' poses come from homographies of these, and the median
    distance of the points from where they should be, px, is compared. Raises Degenerate where none makes sense.
    """
    size = observations.sizes[0]
    best: tuple[float, Bundle] | None = None
    for focal in size[0] * TRIED_OVER_WIDTH:
        k = start_intrinsics(np.full(2, focal), size)
        camera = Camera(width=size[0], height=size[1], intrinsics=k, lens=LensKind.FISHEYE)
        poses = poses_by_rays(observations, camera)
        if poses is None:
            continue
        distance = _median_distance(observations, camera, poses)
        if best is None or distance < best[0]:
            best = distance, Bundle(k=k[None], side_pose=np.zeros(6), poses=poses)
    if best is None:
        raise Degenerate(
            "no fisheye lens of any focal length could have seen the board like this",
            consequence="Nothing was calibrated",
            cure="Check the board's size and that the images are of one camera, or leave --lens fisheye away",
        )
    return best[1]


def poses_by_rays(observations: Observations, camera: Camera) -> Array | None:
    """Return T_camera_board (G, 6) from homographies of the points' rays; None where a point has no ray."""
    width, height = observations.sizes[0]
    seen = observations.weight[:, 0] > 0.0
    rays = camera.rays(observations.uv[:, 0].reshape(-1, 2)).reshape(observations.n_views, -1, 2)
    if not np.isfinite(rays[seen]).all():
        return None
    rays = np.where(seen[..., None], rays, 0.0)
    ideal = rays * width + 0.5 * np.array([width - 1.0, height - 1.0])
    try:
        poses = board_poses(homographies(replace(observations, uv=ideal[:, None])), np.full(2, float(width)), width)
    except Degenerate:
        return None
    return poses if np.isfinite(poses).all() else None


def _median_distance(observations: Observations, camera: Camera, poses: Array) -> float:
    R = np.empty((len(poses), 3, 3))
    matrices_of(np.ascontiguousarray(poses[:, 3:]), R)
    points = observations.X @ R.transpose(0, 2, 1) + poses[:, None, :3]  # (G, n, 3)
    uv = camera.project(points.reshape(-1, 3)).reshape((*points.shape[:2], 2))
    distance = np.linalg.norm(uv - observations.uv[:, 0], axis=2)[observations.weight[:, 0] > 0.0]
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))
