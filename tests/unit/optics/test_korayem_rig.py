"""Korayem's closed forms against the general triangulation; its printed errors (MATH A12-A18) shown to be errors.

The form for converged cameras stands here: camera i has its sensor's centre at (X0i, Y0i, Z0i), its optical axis along
(sin b_i, 0, cos b_i) and its lens F_i in front of the sensor: x / u = (F - z) / F (the image is inverted). Lengths in
m; MATH 2.3 and A11-A18.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate, Inconsistent
from armsight.geometry import pose_from_rotvec
from armsight.optics import Camera, converged_rig, parallel_rig, triangulate
from armsight.optics.rig import Rig, RigKind
from armsight.records import frozen_array
from armsight_sim.papers.korayem2018 import triangulate_parallel

Array = NDArray[np.float64]

PIXEL_M = 3e-6
CAMERA = Camera.pinhole(1296, 810, 1.0, 1.0, 648.0, 405.0)


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


def _mn(view: SensorView, u: Array) -> tuple[Array, Array]:
    c, s = np.cos(view.beta_rad), np.sin(view.beta_rad)
    return view.focal_m * c + u * s, u * c - view.focal_m * s


def _height(view: SensorView, v: Array, X: Array, Z: Array) -> Array:
    X0, Y0, Z0 = view.sensor_m
    depth = (X - X0) * np.sin(view.beta_rad) + (Z - Z0) * np.cos(view.beta_rad)
    return np.asarray(Y0 + v - v / view.focal_m * depth)


def on_sensor(view: SensorView, p: np.ndarray) -> tuple[float, float]:
    """Image of a point by the lens equation x / u = (F - z) / F in the camera's own axes (A11, A12)."""
    c, s = np.cos(view.beta_rad), np.sin(view.beta_rad)
    x, y, z = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) @ (p - view.sensor_m)
    return view.focal_m * x / (view.focal_m - z), view.focal_m * y / (view.focal_m - z)


def random_rig(rng: np.random.Generator) -> tuple[SensorView, SensorView]:
    half = 0.5 * rng.uniform(0.04, 0.2)
    return tuple(  # type: ignore[return-value]
        SensorView(
            sensor_m=np.array([x, rng.uniform(-0.005, 0.005), rng.uniform(-0.005, 0.005)]),
            beta_rad=rng.uniform(-0.3, 0.3),
            focal_m=rng.uniform(0.002, 0.008),
        )
        for x in (-half, half)
    )


def test_converged_closed_form_is_exact_and_agrees_with_the_pinholes() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        views = random_rig(rng)
        p = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.7])
        uv = [np.array(on_sensor(view, p)) for view in views]
        np.testing.assert_allclose(triangulate_converged(*views, *uv)[0], p, atol=1e-9)
        rig = converged_pinholes(*views, CAMERA, PIXEL_M)
        px = [np.array([648.0, 405.0]) - q / PIXEL_M for q in uv]
        general = triangulate(rig, px[0], px[1], np.eye(2), np.eye(2)).require_all()
        np.testing.assert_allclose(general.xyz_m[0], p, atol=1e-9)


def test_parallel_closed_form_needs_camera_one_at_minus_half_the_baseline() -> None:
    """A17, A18: with the places exchanged the same formula puts the point behind the cameras."""
    F, B, p = 3.4e-3, 0.1, np.array([0.03, -0.04, 0.55])
    first, second = (SensorView(sensor_m=[x, 0.0, 0.0], beta_rad=0.0, focal_m=F) for x in (-0.5 * B, 0.5 * B))
    uv1, uv2 = on_sensor(first, p), on_sensor(second, p)
    assert uv1[0] - uv2[0] < 0.0
    np.testing.assert_allclose(triangulate_parallel(F, B, uv1, uv2)[0], p, atol=1e-12)
    assert triangulate_parallel(F, B, uv2, uv1)[0, 2] < 0.0


def test_named_rigs_see_what_they_should() -> None:
    camera = Camera.pinhole(1280, 720, 1131.0, 1131.0, 640.0, 360.0)
    left, right = parallel_rig(camera, 0.1).project([0.0, 0.0, 0.5])
    assert left[0, 0] - right[0, 0] == pytest.approx(1131.0 * 0.1 / 0.5)
    beta = np.arctan(0.05 / 0.6)
    left, right = converged_rig(camera, camera, 0.1, beta, -beta).project([0.0, 0.0, 0.6])
    np.testing.assert_allclose([left[0], right[0]], 2 * [[640.0, 360.0]], atol=1e-9)
    with pytest.raises(Inconsistent, match="baseline"):
        parallel_rig(camera, -0.1)
