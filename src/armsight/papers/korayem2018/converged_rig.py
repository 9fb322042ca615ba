"""The converged rig in the paper's own terms, sensor coordinates and a lens in front (Korayem 2018, corrected).

Camera i has its sensor's centre at (X0i, Y0i, Z0i), its optical axis along (sin b_i, 0, cos b_i) and its lens
F_i in front of the sensor: x / u = (F - z) / F (the image is inverted). Lengths in m; MATH 2.3 and A11-A18.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate
from armsight.geometry import pose_from_rotvec
from armsight.optics.camera import Camera
from armsight.optics.rig import Rig, RigKind
from armsight.records import frozen_array

Array = NDArray[np.float64]

PARALLEL = 1e-12
"""m1 n2 - m2 n1 relative to its terms; below it the rays are parallel to rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorView:
    """One camera of the paper: sensor centre (3,) in m, beta in rad, focal length in m."""

    sensor_m: Array
    beta_rad: float
    focal_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensor_m", frozen_array("sensor_m", self.sensor_m, (3,)))

    @property
    def axis(self) -> Array:
        """Unit vector (3,) of the optical axis."""
        return np.array([np.sin(self.beta_rad), 0.0, np.cos(self.beta_rad)])

    @property
    def lens_m(self) -> Array:
        """Centre of projection (3,)."""
        return np.asarray(self.sensor_m + self.focal_m * self.axis)


def converged_pinholes(first: SensorView, second: SensorView, camera: Camera, pixel_m: float) -> Rig:
    """Return the same rig as two pinholes (first = left); camera gives size, principal point and distortion.

    The focal length in px is F / pixel_m. A pixel (col, row) is the sensor point u = -(col - cx) pixel_m,
    v = -(row - cy) pixel_m with the rig's y down (MATH 2.3).
    """
    cameras = []
    for view in (first, second):
        k = camera.intrinsics.copy()
        k[:2] = view.focal_m / pixel_m
        cameras.append(Camera(width=camera.width, height=camera.height, intrinsics=k))
    T = [pose_from_rotvec(view.lens_m, [0.0, view.beta_rad, 0.0]) for view in (first, second)]
    return Rig(kind=RigKind.STEREO, left=cameras[0], right=cameras[1], T_rig_left=T[0], T_rig_right=T[1])


def triangulate_converged(first: SensorView, second: SensorView, uv1_m: ArrayLike, uv2_m: ArrayLike) -> Array:
    """Return the points (n, 3) of sensor coordinates (n, 2) in m: eq. (7) as corrected by MATH 2.3.

    The two equations for Y are averaged. Raises Degenerate where two rays are parallel.
    """
    (u1, v1), (u2, v2) = np.atleast_2d(uv1_m).astype(float).T, np.atleast_2d(uv2_m).astype(float).T
    (X1, _, Z1), (X2, _, Z2) = first.sensor_m, second.sensor_m
    m1, n1 = _mn(first, u1)
    m2, n2 = _mn(second, u2)
    denominator = m1 * n2 - m2 * n1
    if (np.abs(denominator) <= PARALLEL * (np.abs(m1 * n2) + np.abs(m2 * n1))).any():
        raise Degenerate("the rays of a pair are parallel", consequence="Their point is at infinity")
    F1, F2 = first.focal_m, second.focal_m
    Z = (m1 * m2 * (X2 - X1) + m1 * F2 * u2 - m2 * F1 * u1 + m1 * n2 * Z2 - m2 * n1 * Z1) / denominator
    X = X1 + (u1 * F1 - n1 * (Z - Z1)) / m1
    Y = 0.5 * (_height(first, v1, X, Z) + _height(second, v2, X, Z))
    return np.stack([X, Y, Z], axis=-1)


def triangulate_parallel(focal_m: float, baseline_m: float, uv1_m: ArrayLike, uv2_m: ArrayLike) -> Array:
    """Return the points (n, 3) for parallel axes, sensors at x = -B/2 (first) and +B/2: eq. (10) with MATH A17.

    Z counts from the sensor plane, so that Z - F = B F / (u2 - u1) (the sensor is inverted, u1 - u2 < 0).
    Raises Degenerate where the disparity is zero.
    """
    (u1, v1), (u2, v2) = np.atleast_2d(uv1_m).astype(float).T, np.atleast_2d(uv2_m).astype(float).T
    disparity = u1 - u2
    if (disparity == 0.0).any():
        raise Degenerate("the rays of a pair are parallel", consequence="Their point is at infinity")
    Z = focal_m - baseline_m * focal_m / disparity
    scale = (focal_m - Z) / focal_m
    return np.stack([scale * u1 - 0.5 * baseline_m, scale * 0.5 * (v1 + v2), Z], axis=-1)


def _mn(view: SensorView, u: Array) -> tuple[Array, Array]:
    c, s = np.cos(view.beta_rad), np.sin(view.beta_rad)
    return view.focal_m * c + u * s, u * c - view.focal_m * s


def _height(view: SensorView, v: Array, X: Array, Z: Array) -> Array:
    X0, Y0, Z0 = view.sensor_m
    depth = (X - X0) * np.sin(view.beta_rad) + (Z - Z0) * np.cos(view.beta_rad)
    return np.asarray(Y0 + v - v / view.focal_m * depth)
