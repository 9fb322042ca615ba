"""The target's pose in every image, with the covariance that its corners give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust
from armsight.calibrate.cameras.initial_guess import board_poses, homographies
from armsight.calibrate.cameras.observations import Observations, pack
from armsight.calibrate.handeye.pairs import Array
from armsight.errors import Inconsistent, NotEnoughData
from armsight.optics import Camera
from armsight.records import BoardView, Target

ITERATIONS = 50


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewPoses:
    """T_camera_target of every view (a stack of n), covariance (n, 6, 6) in camera axes, rms_px over all corners.

    sightings: the views as the bundle adjustment takes them, weights scaled to the noise that the corners show.
    centred (n, 6): poses of the board's middle as (t, rotation vector).
    """

    T_camera_target: RigidTransform
    covariance: Array
    rms_px: float
    sightings: Observations
    centred: Array


def poses_of_views(views: Sequence[BoardView], camera: Camera, board: Target) -> ViewPoses:
    """Return the target's pose in each view by least squares of the reprojection, camera fixed.

    Raises NotEnoughData without views, Inconsistent where the images are not of the camera's size.
    """
    if not views:
        raise NotEnoughData(
            "no view of the target", consequence="No pose can be given", cure="Check the board and the images"
        )
    for view in views:
        if (view.width, view.height) != (camera.width, camera.height):
            raise Inconsistent(
                f"{view.source} is {view.width}x{view.height} px, the camera file says {camera.width}x{camera.height}",
                consequence="Pixels and rays do not belong together",
                cure="Give the calibration of this camera at this resolution",
            )
    sightings = pack([views], board, (camera.lens,))
    start = Bundle(k=camera.intrinsics[None], side_pose=np.zeros(6), poses=_start(sightings, camera))
    fit = adjust(sightings, start, frozenset(camera.names), max_iterations=ITERATIONS)
    R = Rotation.from_rotvec(fit.local[:, 3:])
    lever = R.apply(sightings.middle)  # (n, 3), from the board's origin to its middle
    J = np.tile(np.eye(6), (len(views), 1, 1))
    J[:, :3, 3:] = cross(lever)  # d t_origin = dt - dw x lever
    weight = sightings.weight
    squares = (fit.residuals.reshape(len(views), -1, 2) ** 2).sum(axis=2)  # (n, points) in units of 1 / weight
    sigma = np.divide(1.0, weight[:, 0], out=np.zeros_like(weight[:, 0]), where=weight[:, 0] > 0.0)
    return ViewPoses(
        T_camera_target=RigidTransform.from_components(fit.local[:, :3] - lever, R),
        covariance=J @ fit.local_covariance @ J.transpose(0, 2, 1),
        rms_px=float(np.sqrt((squares * sigma**2).sum() / np.count_nonzero(weight))),
        sightings=replace(sightings, weight=weight / fit.scale),
        centred=np.asarray(fit.local),
    )


def cross(v: Array) -> Array:
    """Return (n, 3, 3): the cross product with v (n, 3) from the left."""
    x, y, z = v.T
    o = np.zeros_like(x)
    return np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)


def _start(sightings: Observations, camera: Camera) -> Array:
    """Return poses (n, 6) from homographies of the undistorted corners."""
    width, height = sightings.sizes[0]
    rays = camera.rays(sightings.uv[:, 0].reshape(-1, 2)).reshape(sightings.n_views, -1, 2)
    seen = sightings.weight[:, 0] > 0.0
    rays = np.where(seen[..., None], rays, 0.0)
    ideal = rays * width + 0.5 * np.array([width - 1.0, height - 1.0])
    H = homographies(replace(sightings, uv=ideal[:, None]))
    return board_poses(H, np.full(2, float(width)), width)
