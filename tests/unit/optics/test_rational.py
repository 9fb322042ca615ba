"""A rational lens: against OpenCV's own and the simulated one, by finite differences, and where it ends."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent
from armsight.optics import Camera, LensKind, Plate, Rig, moved_rig, triangulate
from armsight.optics.camera import RATIONAL_INTRINSICS, with_step
from armsight.optics.kernels.camera import intrinsics_jacobian, project_point, undistort_point
from armsight_sim.lens import Lens
from refusals import refuses

COEFFICIENTS = {
    "an OAK's": (9.0, -5.2, 3e-4, -2e-4, 0.9, 9.3, -2.6, -0.4),
    "a Kinect's": (0.45, -2.6, 7e-4, -3e-4, 1.5, 0.33, -2.4, 1.45),
    "with a pole": (0.2, 0.1, 1e-4, 0.0, 0.0, 0.1, -0.2, 0.0),
    "a pinhole's": (-0.1, 0.02, 7e-4, -3e-4, 0.0, 0.0, 0.0, 0.0),
}
SIZE = (1280, 800)


def camera(of: str, focal_px: float = 606.0) -> Camera:
    return Camera.rational(*SIZE, focal_px, focal_px + 0.5, 640.3, 398.2, distortion=COEFFICIENTS[of])


def picture() -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0.0, SIZE[0] - 1.0, 65), np.linspace(0.0, SIZE[1] - 1.0, 41))
    return np.stack([u.ravel(), v.ravel()], axis=1)


@pytest.mark.parametrize("of", COEFFICIENTS)
def test_opencv_and_the_simulated_lens_agree_up_to_the_corners(of: str) -> None:
    lens = camera(of)
    uv, rays = picture(), lens.rays(picture())
    assert np.isfinite(rays).all()
    X = np.column_stack([rays, np.ones(len(rays))])
    theirs = cv2.projectPoints(X, np.zeros(3), np.zeros(3), lens.matrix, np.array(COEFFICIENTS[of]))[0].reshape(-1, 2)
    np.testing.assert_allclose(lens.project(X), theirs, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(lens.project(X), uv, rtol=0.0, atol=1e-9)
    other = Lens(
        width=SIZE[0],
        height=SIZE[1],
        focal_px=(606.0, 606.5),
        centre_px=(640.3, 398.2),
        distortion=COEFFICIENTS[of],
    )
    np.testing.assert_allclose(other.project(X), uv, rtol=0.0, atol=1e-9)


def test_without_a_denominator_it_is_the_pinhole() -> None:
    plain = Camera.pinhole(*SIZE, 606.0, 606.5, 640.3, 398.2, distortion=COEFFICIENTS["a pinhole's"][:5])
    np.testing.assert_allclose(camera("a pinhole's").rays(picture()), plain.rays(picture()), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("of", ["an OAK's", "a Kinect's"])
def test_derivatives_are_finite_differences(of: str) -> None:
    lens, h = camera(of), 1e-6
    for x, y in lens.rays(picture())[::97]:
        X = np.array([0.7 * x, 0.7 * y, 0.7])
        uv, J, K = np.empty(2), np.empty((2, 3)), np.empty((2, 13))
        assert project_point(lens.packed, *X, uv, J)
        intrinsics_jacobian(lens.packed, *X, K)
        by_point = [(lens.project(X + e)[0] - lens.project(X - e)[0]) / (2 * h) for e in h * np.eye(3)]
        np.testing.assert_allclose(J, np.stack(by_point, axis=1), rtol=1e-5, atol=2e-3)
        for i in range(13):
            there, back = (with_step(lens, s * h * np.eye(13)[i]).project(X)[0] for s in (1.0, -1.0))
            np.testing.assert_allclose(K[:, i], (there - back) / (2 * h), rtol=1e-5, atol=2e-3)
        ray, by_pixel = np.empty(2), np.empty((2, 2))
        assert undistort_point(lens.packed, *uv, ray, by_pixel)
        differences = [(lens.rays(uv + e)[0] - lens.rays(uv - e)[0]) / 2e-4 for e in 1e-4 * np.eye(2)]
        np.testing.assert_allclose(by_pixel, np.stack(differences, axis=1), rtol=1e-4, atol=1e-8)


def test_it_ends_where_it_folds_or_has_a_pole_and_nowhere_before() -> None:
    rng, folding = np.random.default_rng(3), 0
    r = np.tan(np.linspace(1e-4, np.radians(85.0), 20_001))
    for _ in range(300):
        k1, k2, k3, k4, k5, k6 = rng.normal(0.0, 1.0, 6) * 10.0 ** rng.uniform(-2.0, 0.7)
        lens = Camera.rational(*SIZE, 600.0, 600.0, 640.0, 400.0, distortion=(k1, k2, 0.0, 0.0, k3, k4, k5, k6))
        q = r**2
        bottom = 1.0 + q * (k4 + q * (k5 + q * k6))
        image = r * (1.0 + q * (k1 + q * (k2 + q * k3))) / bottom
        ends = np.flatnonzero((np.diff(image) <= 0.0) | (bottom[1:] <= 0.0))
        first = np.arctan(r[ends[0]]) if len(ends) else np.radians(85.0)
        assert lens.widest_rad == pytest.approx(first, abs=2e-4)
        if len(ends):
            folding += 1
            inside, beyond = np.tan(lens.widest_rad * 0.99), np.tan(lens.widest_rad) * 1.001
            uv = lens.project([[0.6 * inside, 0.8 * inside, 1.0], [beyond, 0.0, 1.0]])
            assert np.isfinite(uv[0]).all()
            assert np.isnan(uv[1]).all()
            np.testing.assert_allclose(lens.rays(uv[:1])[0], [0.6 * inside, 0.8 * inside], rtol=1e-6)
            past = (
                lens.rays([[640.0 + 600.0 * image[ends[0]] * 1.01, 400.0]])
                if image[ends[0]] < 1e3
                else np.array(np.nan)
            )
            assert np.isnan(past).all()
    assert folding > 100


def test_a_rig_of_a_rational_and_a_plain_lens() -> None:
    plain = Camera.pinhole(*SIZE, 606.0, 606.5, 640.3, 398.2)
    rig = Rig(
        left=plain,
        right=camera("an OAK's"),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.1, 0.0, 0.0]),
    )
    assert len(rig.parameters) == 2 * len(RATIONAL_INTRINSICS) + 6
    assert {"left.k3", "right.k6"} < set(rig.parameters)
    assert "left.k4" not in rig.parameters
    X = np.random.default_rng(0).uniform([-0.5, -0.3, 0.7], [0.5, 0.3, 1.5], (50, 3))
    left, right = rig.project(X)
    cov = np.tile(0.01 * np.eye(2), (len(X), 1, 1))
    np.testing.assert_allclose(triangulate(rig, left, right, cov, cov).xyz_m, X, rtol=0.0, atol=1e-9)
    step = np.zeros(32)
    step[[0, 25, 26]] = 1.0, 0.1, 0.01
    moved = moved_rig(rig, step)
    assert moved.left.intrinsics[0] == 607.0
    assert moved.right.intrinsics[12] == pytest.approx(-0.3)
    assert moved.T_rig_right.translation[0] == pytest.approx(0.11)


def test_what_it_cannot_be() -> None:
    lens = camera("an OAK's")
    assert lens.lens is LensKind.RATIONAL
    with refuses(Inconsistent, "rational", "plate"):
        Camera(width=1280, height=800, intrinsics=lens.intrinsics, lens=lens.lens, plate=Plate(thickness_m=0.003))
    with refuses(Inconsistent, "distortion", "8"):
        Camera.rational(*SIZE, 600.0, 600.0, 640.0, 400.0, distortion=[0.1] * 5)
