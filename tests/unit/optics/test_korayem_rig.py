"""Korayem's closed forms against the general triangulation; its printed errors (MATH A12-A18) shown to be errors."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.errors import Degenerate, Inconsistent
from armsight.optics import Camera, converged_rig, parallel_rig, triangulate
from armsight.papers.korayem2018.converged_rig import (
    SensorView,
    converged_pinholes,
    triangulate_converged,
    triangulate_parallel,
)

PIXEL_M = 3e-6
CAMERA = Camera.pinhole(1296, 810, 1.0, 1.0, 648.0, 405.0)


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


def test_toe_in_counts_the_second_angle_in_the_other_sense() -> None:
    """A16: the printed m2 belongs with n2 = u2 c2 + F2 s2, which is this rig with -beta2."""
    rng, F = np.random.default_rng(2), 3.4e-3
    for _ in range(50):
        b1, b2 = rng.uniform(0.0, 0.3, 2)
        views = [SensorView(sensor_m=[x, 0.0, 0.0], beta_rad=b, focal_m=F) for x, b in ((-0.05, b1), (0.05, -b2))]
        p = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.7])
        (u1, v1), (u2, v2) = (on_sensor(view, p) for view in views)
        m1, n1 = F * np.cos(b1) + u1 * np.sin(b1), u1 * np.cos(b1) - F * np.sin(b1)
        m2, n2 = F * np.cos(b2) - u2 * np.sin(b2), u2 * np.cos(b2) + F * np.sin(b2)
        printed_repaired = (m1 * m2 * 0.1 + m1 * F * u2 - m2 * F * u1) / (m1 * n2 - m2 * n1)
        ours = triangulate_converged(views[0], views[1], (u1, v1), (u2, v2))[0]
        assert ours[2] == pytest.approx(printed_repaired, abs=1e-12)
        wrong = u2 * np.cos(b2) - F * np.sin(b2)  # printed n2 beside printed m2
        assert abs((m1 * m2 * 0.1 + m1 * F * u2 - m2 * F * u1) / (m1 * wrong - m2 * n1) - p[2]) > 1e-3


def test_parallel_rays_are_refused() -> None:
    view = [SensorView(sensor_m=[x, 0.0, 0.0], beta_rad=0.0, focal_m=3e-3) for x in (-0.05, 0.05)]
    with pytest.raises(Degenerate):
        triangulate_converged(view[0], view[1], (1e-3, 0.0), (1e-3, 0.0))
    with pytest.raises(Degenerate):
        triangulate_parallel(3e-3, 0.1, (1e-3, 0.0), (1e-3, 0.0))


def test_named_rigs_see_what_they_should() -> None:
    camera = Camera.pinhole(1280, 720, 1131.0, 1131.0, 640.0, 360.0)
    left, right = parallel_rig(camera, 0.1).project([0.0, 0.0, 0.5])
    assert left[0, 0] - right[0, 0] == pytest.approx(1131.0 * 0.1 / 0.5)
    beta = np.arctan(0.05 / 0.6)
    left, right = converged_rig(camera, camera, 0.1, beta, -beta).project([0.0, 0.0, 0.6])
    np.testing.assert_allclose([left[0], right[0]], 2 * [[640.0, 360.0]], atol=1e-9)
    with pytest.raises(Inconsistent, match="baseline"):
        parallel_rig(camera, -0.1)
