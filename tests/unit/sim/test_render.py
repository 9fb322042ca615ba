"""Light on the sensor against closed forms and brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight_sim import Lens, Light, Rest, Sensor, SimCamera, SmoothTrajectory, ambient


def moments(light):
    """Sum, centre (u, v) and central second moments (uu, uv, vv) of an image."""
    v, u = np.mgrid[0 : light.shape[0], 0 : light.shape[1]].astype(float)
    w = light.astype(float)
    total = w.sum()
    mu, mv = (w * u).sum() / total, (w * v).sum() / total
    second = [(w * (a) * (b)).sum() / total for a, b in ((u - mu, u - mu), (u - mu, v - mv), (v - mv, v - mv))]
    return total, np.array([mu, mv]), np.array(second)


def camera(width=80, height=60, f=400.0, level=0.0, exposure_s=0.0, channels=1, **lens):
    return SimCamera(
        lens=Lens(width=width, height=height, focal_px=(f, f), centre_px=((width - 1) / 2, (height - 1) / 2), **lens),
        T_world_camera=RigidTransform.identity(),
        sensor=Sensor(),
        backdrop=ambient(width, height, level, bgr=(1.0,) * channels),
        exposure_s=exposure_s,
    )


def at(u, v, cam, z=1.0):
    """The place whose image in a camera without distortion is (u, v)."""
    (fx, fy), (cx, cy) = cam.lens.focal_px, cam.lens.centre_px
    return Rest(T_world_target=RigidTransform.from_translation([(u - cx) / fx * z, (v - cy) / fy * z, z]))


def spot(**changes):
    return Light(**({"name": "A", "xyz_m": (0.0, 0.0, 0.0), "level": 100.0, "sigma_px": 1.5} | changes))


def test_a_spot_at_10_5_peaks_at_row_5_column_10():
    cam = camera()
    image = cam.light([spot()], at(10.0, 5.0, cam), 0.0)[:, :, 0]
    assert np.unravel_index(image.argmax(), image.shape) == (5, 10)
    assert image[5, 9] == pytest.approx(image[5, 11], rel=1e-6)
    assert image[4, 10] == pytest.approx(image[6, 10], rel=1e-6)


@pytest.mark.parametrize("sigma", [0.3, 1.5, 4.0])
@pytest.mark.parametrize("centre", [(40.0, 30.0), (39.63, 30.21)])
def test_moments_of_a_gaussian_spot(sigma, centre):
    cam = camera()
    image = cam.light([spot(sigma_px=sigma)], at(*centre, cam), 0.0)[:, :, 0]
    total, mean, second = moments(image)
    assert total == pytest.approx(2 * np.pi * sigma**2 * 100.0, rel=1e-5)
    # sampling a Gaussian on a grid beats with it: exp(-2 pi^2 sigma^2) of a pixel, nothing from 0.9 px on
    np.testing.assert_allclose(mean, centre, atol=2e-6 + 0.4 * np.exp(-2 * np.pi**2 * sigma**2))
    # the pixel's box widens it by 1/12; below half a pixel of sigma the grid no longer carries the second moment
    if sigma >= 0.7:
        np.testing.assert_allclose(second, [sigma**2 + 1 / 12, 0.0, sigma**2 + 1 / 12], atol=2e-4)


def test_light_far_outside_behind_or_facing_away_is_not_seen():
    cam = camera(level=7.0)
    behind = Rest(T_world_target=RigidTransform.from_translation([0.0, 0.0, -1.0]))
    turned = Rest(T_world_target=RigidTransform.from_components([0.0, 0.0, 1.0], Rotation.from_rotvec([np.pi, 0, 0])))
    for path in (behind, turned, at(5000.0, 30.0, cam)):
        for light in (spot(), spot(diameter_m=0.01)):
            np.testing.assert_array_equal(cam.light([light], path, 0.0), cam.backdrop)
    assert cam.light([spot()], at(40.0, 30.0, cam), 0.0, hidden=frozenset({"A"})).max() == 7.0


@pytest.mark.parametrize("length_px", [4.0, 16.0])
def test_motion_over_the_exposure_widens_by_a_twelfth_of_its_square(length_px):
    f, s, angle = 400.0, 1.5, 0.6
    cam = camera(f=f, exposure_s=0.01)
    reach = 10.0  # so long a swing that its middle is straight and uniform to 1e-6
    speed = length_px / f / 0.01
    path = SmoothTrajectory(
        centre_m=np.array([0.0, 0.0, 1.0]),
        tilt=Rotation.identity(),
        swing_m=np.array([reach * np.cos(angle), reach * np.sin(angle), 0.0]),
        swing_rad=np.zeros(3),
        period_s=np.full(6, 2 * np.pi * reach / speed),
        phase_rad=np.zeros(6),
    )
    total, mean, second = moments(cam.light([spot(sigma_px=s)], path, 0.0)[:, :, 0])
    assert total == pytest.approx(2 * np.pi * s**2 * 100.0, rel=1e-5)
    np.testing.assert_allclose(mean, cam.lens.centre_px, atol=1e-5)
    direction = np.array([np.cos(angle), np.sin(angle)])
    want = (s**2 + 1 / 12) * np.eye(2) + length_px**2 / 12 * np.outer(direction, direction)
    np.testing.assert_allclose(second, want[[0, 0, 1], [0, 1, 1]], rtol=2e-4, atol=2e-4)
