"""How parallel a pair of cameras stands, with standard deviations from its calibration (Kapucu 2005, alignment)."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.fields import Doc
from armsight.optics.camera import INTRINSICS
from armsight.optics.rig import RIGHT_POSE, Rig
from armsight.records import NamedCovariance, frozen_array
from armsight.records.output import Output, output

DERIVATIVE_STEPS = (1e-3,) * 5 + (1e-6,) * 5
"""Steps of the central differences by INTRINSICS, in px and without unit."""

POSE_STEP = 1e-6
"""... and by T_rig_right, in m and rad."""


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


def parallelism(rig: Rig, depths_m: ArrayLike = (0.5, 1.0, 2.0, 4.0)) -> Parallelism:
    """Return the alignment report of a pair; standard deviations to first order from the rig's covariance."""
    depths = frozen_array("depths_m", np.atleast_1d(depths_m), (None,))
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


def moved_rig(rig: Rig, step: Array) -> Rig:
    """Return the rig with its parameters moved by step (26,); the right pose as t + dt, Exp(dw) R."""
    n = len(INTRINSICS)
    cameras = [
        replace(camera, intrinsics=camera.intrinsics + part)
        for camera, part in ((rig.left, step[:n]), (rig.right, step[n : 2 * n]))
    ]
    dt, dw = step[2 * n : 2 * n + 3], step[2 * n + 3 :]
    T = rig.T_rig_right
    turned = RigidTransform.from_components(np.asarray(T.translation) + dt, Rotation.from_rotvec(dw) * T.rotation)
    return Rig(kind=rig.kind, left=cameras[0], right=cameras[1], T_rig_left=rig.T_rig_left, T_rig_right=turned)


def _measures(rig: Rig, depths: Array) -> Array:
    """Return _SCALARS and the gaps (6 + n,)."""
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
        step = np.zeros(len(rig.parameters))
        i = rig.parameters.index(name)
        step[i] = POSE_STEP if name in RIGHT_POSE else DERIVATIVE_STEPS[i % len(INTRINSICS)]
        plus, minus = (_measures(moved_rig(rig, sign * step), depths) for sign in (1.0, -1.0))
        columns.append((plus - minus) / (2.0 * step[i]))
    J = np.column_stack(columns)  # (6 + n, p)
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", J, covariance.block(names), J)))
