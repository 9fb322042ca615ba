"""How parallel a pair of cameras stands (Kapucu 2005, alignment), and what it can tell apart at a distance.

With standard deviations from the calibration.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.defaults import SPOT_STD_PX
from armsight.errors import Degenerate, Inconsistent, UsageError
from armsight.fields import Doc
from armsight.optics.camera import INTRINSICS
from armsight.optics.rig import Rig, moved_rig
from armsight.optics.triangulate import triangulate
from armsight.records import NamedCovariance, frozen_array
from armsight.records.checks import Shape
from armsight.records.output import Output, output

PX_STEP, OWN_STEP = 1e-3, 1e-6
"""Steps of the central differences by intrinsics in px, and by all else: in m, rad and without unit."""


def difference_step(name: str) -> float:
    """Return the step of the central difference by a parameter of a rig, as Rig.parameters names it."""
    return PX_STEP if name.split(".")[-1] in INTRINSICS[:5] else OWN_STEP


@output
class Parallelism(Output):
    """Alignment of the right camera against the left one.

    convergence_rad: how far the optical axes turn towards each other. vertical_rad: how far the right axis points
    below the left one; vertical_px the same as rows at infinity (row of the right image minus row of the left one,
    both from their principal points). roll_rad: turn of the right image about its axis. height_m, advance_m: how
    far the right centre of projection lies below and before the left one. gap_depths_m, gap_px (n,): two lines lie
    where the optical axes meet the plane at the first depth, each in the middle of its image; the distance of
    their images with the plane at each depth, 0 throughout where the axes are parallel. std: by name, and
    gap_px_std (n,); None where the rig brings no covariance.
    """

    convergence_rad: Annotated[float, Doc("How far the optical axes turn towards each other, rad.")]
    vertical_rad: Annotated[float, Doc("How far the right axis points below the left one, rad.")]
    vertical_px: Annotated[float, Doc("The same as rows at infinity, right minus left, px.")]
    roll_rad: Annotated[float, Doc("Turn of the right image about its axis, rad.")]
    height_m: Annotated[float, Doc("How far the right centre of projection is below the left one, m.")]
    advance_m: Annotated[float, Doc("How far the right centre of projection is before the left one, m.")]
    gap_depths_m: Array
    gap_px: Array
    std: dict[str, float] | None
    gap_px_std: Array | None


_SCALARS = ("convergence_rad", "vertical_rad", "vertical_px", "roll_rad", "height_m", "advance_m")
_MATTERS = ("right.fx", "right.fy", "right.t", "right.r")  # how names begin that _measures changes with at all


def parallelism(rig: Rig, depths_m: ArrayLike = (0.5, 1.0, 2.0, 4.0)) -> Parallelism:
    """Return the alignment report of a pair; standard deviations to first order from the rig's covariance."""
    rig, depths = rig.pair(), frozen_array("depths_m", np.atleast_1d(depths_m), (None,))
    values = _measures(rig, depths)
    std = None if rig.covariance is None else _deviations(rig, rig.covariance, depths)
    n = len(_SCALARS)
    return Parallelism(
        **dict(zip(_SCALARS, values[:n].tolist(), strict=True)),
        gap_depths_m=depths,
        gap_px=values[n:],
        std=None if std is None else dict(zip(_SCALARS, std[:n].tolist(), strict=True)),
        gap_px_std=None if std is None else std[n:],
    )


def _measures(rig: Rig, depths: Array) -> Array:
    T_left_right = rig.T_rig_left.inv() * rig.T_rig_right
    R, t = T_left_right.rotation.as_matrix(), np.asarray(T_left_right.translation)
    axis = R[:, 2]
    vertical = np.arctan2(axis[1], np.hypot(axis[0], axis[2]))
    far = R.T @ np.array([0.0, 0.0, 1.0])  # the left axis at infinity, in right camera axes
    fy = rig.right.intrinsics[1]
    scalars = [np.arctan2(-axis[0], axis[2]), vertical, fy * far[1] / far[2], np.arctan2(R[1, 0], R[0, 0]), t[1], t[2]]
    return np.concatenate([scalars, _gaps(rig, R, t, depths)])


def _gaps(rig: Rig, R: Array, t: Array, depths: Array) -> Array:
    """Return the distance in px (n,) of the two lines' images for each depth along the left axis."""
    reach = (depths[0] - t[2]) / R[2, 2]
    hit = t + reach * R[:, 2]  # where the right axis meets the first plane
    gaps = []
    for depth in depths:
        p = R.T @ (np.array([hit[0], hit[1], depth]) - t)
        gaps.append(-rig.right.intrinsics[0] * p[0] / p[2])  # the left line stays at its principal point
    return np.array(gaps)


def _deviations(rig: Rig, covariance: NamedCovariance, depths: Array) -> Array:
    """Return the standard deviations of _measures from the rig's covariance by central differences."""
    names = tuple(name for name in rig.parameters if name in covariance.names)
    columns = []
    for name in names:
        if not name.startswith(_MATTERS):
            columns.append(np.zeros(len(_SCALARS) + len(depths)))
            continue
        step = np.zeros(len(rig.parameters))
        i = rig.parameters.index(name)
        step[i] = difference_step(name)
        plus, minus = (_measures(moved_rig(rig, sign * step), depths) for sign in (1.0, -1.0))
        columns.append((plus - minus) / (2.0 * step[i]))
    J = np.column_stack(columns)  # (6 + n, p)
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", J, covariance.block(names), J)))


# What a rig can tell apart at a distance.


@output
class Resolution(Output):
    """What a rig can tell apart at a distance.

    point_m (3,): depth_m in front of the middle of the two centres of projection; of other rigs than pairs before the
    first camera. sigma_px: in each coordinate of all views, of which the standard deviations are.
    """

    depth_m: Annotated[float, Doc("The distance along the mean optical axis, m; of no pair along the first camera's.")]
    sigma_depth_m: Annotated[float, Doc("Standard deviation of a point along that axis, m.")]
    sigma_lateral_m: Annotated[Array, Shape((2,)), Doc("Across it: along the baseline, and square to it, m.")]
    depth_per_px_m: Annotated[float | None, Doc("Change of depth for one pixel of a pair's disparity, m.")]
    lateral_per_px_m: Annotated[float | None, Doc("Change across for one pixel of a pair, m.")]
    in_view: Annotated[bool, Doc("Whether two cameras have the point in their image.")]
    point_m: Array
    sigma_px: float


def resolution(rig: Rig, depth_m: float, sigma_px: float = SPOT_STD_PX) -> Resolution:
    """Return the resolution of a rig at a distance; for parallel axes Z^2 / (B f) and Z / f (MATH 2.3).

    Of other rigs than pairs the distance is from the first camera along its axis, and those count that have the point
    in their image. Raises UsageError for one camera, which places no point; Inconsistent where depth or standard
    deviation is not positive or a camera faces away from the point, Degenerate where the views cannot place it.
    """
    if not (depth_m > 0.0 and sigma_px > 0.0):
        raise Inconsistent(
            f"a depth of {depth_m} m with a standard deviation of {sigma_px} px: both must be positive",
            consequence="There is no resolution",
            cure="Give both above zero",
        )
    if not rig.is_pair:
        return _by_views(rig, depth_m, sigma_px)
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


def _by_views(rig: Rig, depth_m: float, sigma_px: float) -> Resolution:
    """Return the resolution of other rigs than pairs, see resolution."""
    if len(rig.cameras) < 2:
        raise UsageError(
            "one camera does not place a point: it may be anywhere along its ray",
            consequence="There is no resolution to give",
            cure="Give a rig of two cameras and more",
        )
    T = rig.cameras[0].T_rig_camera
    axes = T.rotation.as_matrix()
    point = np.asarray(T.apply([0.0, 0.0, depth_m]))
    inside, J = [], []
    steps = OWN_STEP * np.vstack([np.eye(3), -np.eye(3)])
    for one, uv, moved in zip(rig.cameras, rig.project(point), rig.project(point + steps), strict=True):
        there = bool(((uv[0] >= 0.0) & (uv[0] <= [one.camera.width - 1, one.camera.height - 1])).all())
        inside.append(there)
        J.append((moved[:3] - moved[3:]).T / (2.0 * OWN_STEP))  # (2, 3)
    count = inside if sum(inside) > 1 else [bool(np.isfinite(one).all()) for one in J]
    A = np.array([one for one, counts in zip(J, count, strict=True) if counts]).reshape(-1, 3)
    if np.linalg.matrix_rank(A) < 3:
        raise Degenerate(
            f"the point {depth_m} m before the camera {rig.names[0]} is before no other one",
            consequence="There is no resolution to give",
            cure="Give a distance at which two cameras look at the same place",
        )
    covariance = sigma_px**2 * np.linalg.inv(A.T @ A)
    deviations = np.sqrt(np.diag(axes.T @ covariance @ axes))
    return Resolution(
        point_m=point,
        depth_m=depth_m,
        depth_per_px_m=None,
        lateral_per_px_m=None,
        sigma_px=sigma_px,
        sigma_depth_m=float(deviations[2]),
        sigma_lateral_m=deviations[:2],
        in_view=sum(inside) > 1,
    )


def shared_point(rig: Rig) -> Array:
    """Return the point (3,) nearest to all lines of sight through the pictures' middles, in rig axes, m."""
    across = []
    for one in rig.cameras:
        z = np.asarray(one.T_rig_camera.rotation.as_matrix())[:, 2]
        across.append(np.eye(3) - np.outer(z, z))
    beside = [A @ np.asarray(one.T_rig_camera.translation) for A, one in zip(across, rig.cameras, strict=True)]
    return np.asarray(np.linalg.lstsq(np.vstack(across), np.concatenate(beside), rcond=None)[0])


def mean_axes(rig: Rig) -> Array:
    """Return (3, 3) with columns in rig axes: baseline direction, the one square to both, mean optical axis.

    Of other rigs than pairs the direction is from the first camera to the last, of one camera its x axis. The first is
    made square to the mean optical axis. Raises Inconsistent for cameras that look at each other or along the baseline.
    """
    poses = [one.T_rig_camera for one in rig.cameras]
    z = np.sum([T.rotation.as_matrix()[:, 2] for T in poses], axis=0)
    baseline = np.asarray(poses[-1].translation) - np.asarray(poses[0].translation)
    if len(poses) == 1:
        baseline = poses[0].rotation.as_matrix()[:, 0]
    length = float(np.linalg.norm(z))
    z = z / length if length > 0.0 else z
    x = baseline - (baseline @ z) * z
    if not (length > 1e-6 and np.linalg.norm(x) > 1e-9 * np.linalg.norm(baseline)):
        raise Inconsistent("the cameras look at each other, along the baseline, or stand in one place")
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
