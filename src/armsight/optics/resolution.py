"""What a rig can tell apart at a distance."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.fields import Doc
from armsight.optics.camera import SIDES
from armsight.optics.rig import Rig
from armsight.optics.triangulate import triangulate
from armsight.records.fields import Shape
from armsight.records.output import Output, output

CENTROID_SIGMA_PX = 0.1
"""Standard deviation of a spot's centre where the caller gives none: MATH 2.3 uses it for webcams."""


@output
class Resolution(Output):
    """What a rig can tell apart at a distance.

    point_m (3,): depth_m in front of the middle of the two centres of projection. sigma_px: in each coordinate of both
    views, of which the standard deviations are.
    """

    depth_m: Annotated[float, Doc("The distance along the mean optical axis, m.")]
    sigma_depth_m: Annotated[float, Doc("Standard deviation of a point along that axis, m.")]
    sigma_lateral_m: Annotated[Array, Shape((2,)), Doc("Across it: along the baseline, and square to it, m.")]
    depth_per_px_m: Annotated[float, Doc("Change of depth for one pixel of disparity, m.")]
    lateral_per_px_m: Annotated[float, Doc("Change across for one pixel, m.")]
    in_view: Annotated[bool, Doc("Whether both cameras have the point in their image.")]
    point_m: Array
    sigma_px: float


def resolution(rig: Rig, depth_m: float, sigma_px: float = CENTROID_SIGMA_PX) -> Resolution:
    """Return the resolution of a rig at a distance; for parallel axes Z^2 / (B f) and Z / f (MATH 2.3).

    Raises Inconsistent where depth or standard deviation is not positive or a camera faces away from the point,
    Degenerate where the two views cannot place it.
    """
    if not (depth_m > 0.0 and sigma_px > 0.0):
        raise Inconsistent(
            f"a depth of {depth_m} m with a standard deviation of {sigma_px} px: both must be positive",
            consequence="There is no resolution",
            cure="Give both above zero",
        )
    axes = mean_axes(rig)  # columns: along the baseline, square to it, mean optical axis
    middle = 0.5 * (np.asarray(rig.T_rig_left.translation) + np.asarray(rig.T_rig_right.translation))
    point = middle + depth_m * axes[:, 2]
    left, right = rig.project(point)
    if not (np.isfinite(left).all() and np.isfinite(right).all()):
        raise Inconsistent(
            f"a camera faces away from the point {depth_m} m in front of the rig",
            consequence="There is no resolution to give",
            cure="Check the poses of the cameras in the rig's file",
        )
    cov = sigma_px**2 * np.eye(2)
    seen = triangulate(rig, left, right, cov, cov).require_all()
    deviations = np.sqrt(np.diag(axes.T @ seen.covariance_m2[0] @ axes))
    return Resolution(
        point_m=point,
        depth_m=depth_m,
        depth_per_px_m=float(deviations[2] / (np.sqrt(2.0) * sigma_px)),
        lateral_per_px_m=float(np.sqrt(2.0) * deviations[1] / sigma_px),
        sigma_px=sigma_px,
        sigma_depth_m=float(deviations[2]),
        sigma_lateral_m=deviations[:2],
        in_view=all(
            0.0 <= u <= camera.width - 1 and 0.0 <= v <= camera.height - 1
            for camera, (u, v) in zip((rig.left, rig.right), (left[0], right[0]), strict=True)
        ),
    )


def mean_axes(rig: Rig) -> Array:
    """Return (3, 3) with columns in rig axes: baseline direction, the one square to both, mean optical axis.

    The first is made square to the mean optical axis. Raises Inconsistent for cameras that look at each other
    or along the baseline.
    """
    z = np.sum([rig.T_rig_camera(side).rotation.as_matrix()[:, 2] for side in SIDES], axis=0)
    baseline = np.asarray(rig.T_rig_right.translation) - np.asarray(rig.T_rig_left.translation)
    length = float(np.linalg.norm(z))
    z = z / length if length > 0.0 else z
    x = baseline - (baseline @ z) * z
    if not (length > 1e-6 and np.linalg.norm(x) > 1e-9 * np.linalg.norm(baseline)):
        raise Inconsistent("the cameras look at each other, along the baseline, or stand in one place")
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
