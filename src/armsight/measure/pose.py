"""The target's pose from its named spots in both views, with covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.measure.kernels import pose as kernels
from armsight.measure.match import SLACK_PX
from armsight.optics import PackedRig
from armsight.records import Points, PoseStatus, TargetPose

Array = NDArray[np.float64]

PARENT = "rig"

MAX_ROTATION_SIGMA = 0.3
"""A rotation less certain than this (rad; 17 degrees) is none: its covariance, taken to first order, means nothing."""

_WHY = {
    kernels.NO_WEIGHT: "the covariance of a spot is not positive",
    kernels.NO_POINT: "the rays of a named spot do not meet in front of both cameras",
    kernels.BEHIND_CAMERA: "the fit put the target behind a camera",
    kernels.OPEN: "the spots leave some direction of the pose open",
    kernels.ENDLESS: "the fit did not settle",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A pose with the points it came from; its matrix T (4, 4), None where it is not whole.

    fits: whether the residuals agree with the target, slack allowed.
    """

    pose: TargetPose
    points: Points
    T: Array | None = None
    fits: bool = True


def solve_pose(
    packed: PackedRig,
    t_s: float,
    names: tuple[str, ...],
    xyz_m: Array,
    uv_px: Array,
    cov_px2: Array,
    radius_m: Array,
    normal: Array,
    *,
    limit: float,
    slack_px: float = SLACK_PX,
) -> Solved:
    """Return the pose of greatest likelihood on both images from n >= 3 named spots, started by Kabsch.

    xyz_m: (n, 3) in target axes. uv_px: (n, 2, 2), cov_px2: (n, 2, 2, 2) as [spot, side]. radius_m: (n, 2) of the
    flat light where the spot is the outline of one, else 0; normal: (3,) of the lights' plane in target axes.
    limit: largest chi-square, slack included, that is believed (fit_limit).
    Status LOST, with the reason, where the spots do not fit the target; POSITION_ONLY where they fit but leave
    the rotation open.
    """
    n = len(names)
    P, S, T, C, residual = (
        np.empty((n, 3)),
        np.empty((n, 3, 3)),
        np.empty((4, 4)),
        np.empty((6, 6)),
        np.zeros((n, 2, 2)),
    )
    state, wide = kernels.solve_named(
        packed.k, packed.R, packed.t, uv_px, cov_px2, slack_px**2, xyz_m, radius_m, normal, P, S, T, C, residual
    )
    if state in (kernels.NO_WEIGHT, kernels.NO_POINT):
        return Solved(pose=lost(t_s, _WHY[state]), points=no_points(), fits=False)
    points = Points(names=names, xyz_m=P, covariance_m2=S)
    if state != kernels.SOLVED:
        return Solved(pose=position_only(t_s, points, residual, _WHY[state]), points=points, fits=state == kernels.OPEN)
    if not wide <= limit:
        rms = float(np.sqrt(np.mean(residual**2)))
        why = (
            f"the spots do not fit the target: residuals of {rms:.2f} px; "
            "the target's measures, the calibration or the moment of the two exposures is off"
        )
        return Solved(pose=lost(t_s, why), points=points, fits=False)
    return _whole(t_s, points, T, C, residual)


def solve_frame(packed: PackedRig, t_s: float, names: tuple[str, ...], uv_px: Array, cov_px2: Array) -> Solved:
    """Return the frame of three lights A, B, C nobody has measured (Pachidis 2005, eqs. 7-8), with its covariance.

    Arguments as solve_pose. The lights' own triangle is not assumed to keep its shape.
    """
    points, residual, why = solve_points(packed, names, uv_px, cov_px2)
    if why:
        return Solved(pose=lost(t_s, why), points=points, fits=False)
    T, C = np.eye(4), np.empty((6, 6))
    if not kernels.pachidis_frame(points.xyz_m, points.covariance_m2, T, C):
        return Solved(pose=position_only(t_s, points, residual, "the three lights lie on one line"), points=points)
    return _whole(t_s, points, T, C, residual)


def _whole(t_s: float, points: Points, T: Array, C: Array, residual: Array) -> Solved:
    """Return the pose T (4, 4) with its covariance, or the position alone where the rotation is too uncertain."""
    if not max(C[3, 3], C[4, 4], C[5, 5]) <= MAX_ROTATION_SIGMA**2:
        return Solved(pose=position_only(t_s, points, residual, _WHY[kernels.OPEN]), points=points)
    pose = TargetPose(
        t_s=t_s,
        status=PoseStatus.OK,
        parent=PARENT,
        spots=points.names,
        # orthonormal to rounding: testing and mending it would cost 0.1 ms
        pose=RigidTransform(T, normalize=False, copy=True),
        covariance=C,
        residual_px=residual.ravel(),
    )
    return Solved(pose=pose, points=points, T=T)


def solve_points(packed: PackedRig, names: tuple[str, ...], uv_px: Array, cov_px2: Array) -> tuple[Points, Array, str]:
    """Return the points by themselves, their residuals (n, 2, 2) in px, and why there are none ('' where there are)."""
    n = len(names)
    P, S, residual = np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 2, 2))
    if not kernels.triangulate_all(packed.k, packed.R, packed.t, uv_px, cov_px2, P, S):
        return no_points(), residual[:0], _WHY[kernels.NO_POINT]
    if not kernels.point_residuals(packed.k, packed.R, packed.t, uv_px, P, residual):
        return no_points(), residual[:0], _WHY[kernels.NO_POINT]
    return Points(names=names, xyz_m=P, covariance_m2=S), residual, ""


def position_only(t_s: float, points: Points, residual_px: Array, why: str) -> TargetPose:
    """Return the position of the mean of the points, with its covariance (3, 3)."""
    n = len(points)
    return TargetPose(
        t_s=t_s,
        status=PoseStatus.POSITION_ONLY,
        parent=PARENT,
        spots=points.names,
        pose=RigidTransform.from_translation(points.xyz_m.mean(axis=0)),
        covariance=points.covariance_m2.sum(axis=0) / n**2,
        residual_px=residual_px.ravel(),
        why=why,
    )


def lost(t_s: float, why: str) -> TargetPose:
    """Return the record of a moment without any pose."""
    return TargetPose(t_s=t_s, status=PoseStatus.LOST, parent=PARENT, why=why)


def no_points() -> Points:
    """Return the record of no points."""
    return Points(names=(), xyz_m=np.empty((0, 3)), covariance_m2=np.empty((0, 3, 3)))
