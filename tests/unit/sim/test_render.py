"""Light on the sensor against closed forms and brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import ndtr

from armsight.errors import Inconsistent
from armsight_sim import (
    Ghost,
    Lens,
    Light,
    PointSource,
    Rest,
    Sensor,
    SimCamera,
    SmoothTrajectory,
    ambient,
    kernels,
    render_sources,
)


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


@pytest.mark.parametrize("sigma", [0.3, 0.7, 1.5, 4.0])
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


def test_the_tabulated_integrals_are_exact_to_a_billionth():
    t = np.linspace(-9.0, 9.0, 20011)
    bell = np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    np.testing.assert_allclose([kernels._gauss_step(x) for x in t], ndtr(t), atol=1e-9)
    np.testing.assert_allclose([kernels._gauss_ramp(x) for x in t], t * ndtr(t) + bell, atol=1e-9)


def test_a_pixel_holds_the_integral_over_its_area():
    cam = camera()
    u, v, s = 20.3, 30.4, 0.6
    image = cam.light([spot(sigma_px=s)], at(u, v, cam), 0.0)[:, :, 0]
    fine = (np.arange(400) + 0.5) / 400 - 0.5
    for i, j in ((20, 30), (21, 31), (19, 30), (22, 29)):
        x, y = np.meshgrid(i + fine - u, j + fine - v)
        assert image[j, i] == pytest.approx(100 * np.exp(-(x**2 + y**2) / (2 * s * s)).mean(), abs=2e-4)


def test_a_spot_cut_by_the_border_is_the_crop_of_a_whole_one():
    large, small = camera(80, 60), camera(20, 16)
    whole = large.light([spot(sigma_px=3.0), spot(name="B")], at(30.0 + 1.3, 22.0 - 2.2, large), 0.0)
    cut = small.light([spot(sigma_px=3.0), spot(name="B")], at(1.3, -2.2, small), 0.0)
    np.testing.assert_allclose(cut, whole[22:38, 30:50], atol=1e-4)


def test_light_far_outside_behind_or_facing_away_is_not_seen():
    cam = camera(level=7.0)
    behind = Rest(T_world_target=RigidTransform.from_translation([0.0, 0.0, -1.0]))
    turned = Rest(T_world_target=RigidTransform.from_components([0.0, 0.0, 1.0], Rotation.from_rotvec([np.pi, 0, 0])))
    for path in (behind, turned, at(5000.0, 30.0, cam)):
        for light in (spot(), spot(diameter_m=0.01)):
            np.testing.assert_array_equal(cam.light([light], path, 0.0), cam.backdrop)
    assert cam.light([spot()], at(40.0, 30.0, cam), 0.0, hidden=frozenset({"A"})).max() == 7.0


@pytest.mark.parametrize("length_px", [0.5, 4.0, 16.0])
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


def test_a_streak_is_as_smooth_as_a_line_of_light():
    cam = camera(200, 40, exposure_s=0.01)
    path = SmoothTrajectory(
        centre_m=np.array([0.0, 0.0, 1.0]),
        tilt=Rotation.identity(),
        swing_m=np.array([10.0, 0.0, 0.0]),
        swing_rad=np.zeros(3),
        period_s=np.full(6, 2 * np.pi * 10.0 / (60.0 / 400.0 / 0.01)),
        phase_rad=np.zeros(6),
    )
    row = cam.light([spot(sigma_px=1.5)], path, 0.0)[:, :, 0].sum(axis=0)
    middle = row[80:120]
    assert np.ptp(middle) < 1e-3 * middle.mean()


@pytest.mark.parametrize(
    ("tilt", "distortion"), [((0, 0, 0), (0,) * 5), ((0.5, -0.6, 0.2), (0.3, -0.2, 0.01, -0.02, 0))]
)
def test_a_disc_is_the_projection_of_a_lit_disc(tilt, distortion):
    """Area and centre against rays cast back onto the disc on a grid of 1/25 px: no ellipse, no outline."""
    cam = camera(f=300.0, distortion=distortion)
    pose = RigidTransform.from_components([0.03, -0.01, 0.5], Rotation.from_rotvec(tilt))
    radius = 0.015
    image = cam.light([spot(diameter_m=2 * radius, sigma_px=0.8)], Rest(T_world_target=pose), 0.0)[:, :, 0]
    total, mean, _ = moments(image)

    u, v = np.meshgrid(np.arange(46, 70, 0.04) + 0.02, np.arange(10, 36, 0.04) + 0.02)
    rays = cam.lens.rays(np.stack([u, v], axis=-1))
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    normal, centre = pose.rotation.apply([0.0, 0.0, 1.0]), np.asarray(pose.translation)
    hits = rays * ((centre @ normal) / (rays @ normal))[..., None]
    inside = ((hits - centre) ** 2).sum(axis=-1) < radius**2
    assert total / 100.0 == pytest.approx(inside.sum() * 0.04**2, rel=2e-4)
    np.testing.assert_allclose(mean, [u[inside].mean(), v[inside].mean()], atol=1e-3)


def test_a_round_disc_has_its_area_its_plateau_and_the_lens_blur_at_its_edge():
    cam = camera(f=400.0)
    s, r = 0.9, 10.0
    image = cam.light([spot(diameter_m=2 * r / 400.0, sigma_px=s)], at(40.25, 30.5, cam), 0.0)[:, :, 0]
    total, mean, second = moments(image)
    assert total == pytest.approx(100.0 * np.pi * r**2, rel=1e-6)
    np.testing.assert_allclose(mean, [40.25, 30.5], atol=1e-5)
    np.testing.assert_allclose(second, np.array([1.0, 0.0, 1.0]) * (r**2 / 4 + s**2 + 1 / 12), atol=1e-3)
    assert image[30, 40] == pytest.approx(100.0, abs=1e-4)
    assert image.max() < 100.001
    assert abs(image[:15]).max() < 1e-4
    edge = image[30, 48:53]  # the edge lies at 50.25: an error function, slightly bent by the disc's roundness
    assert (np.diff(edge) < 0).all()
    assert np.interp(-50, -edge, np.arange(48, 53)) == pytest.approx(50.2, abs=0.1)


def test_colours_stay_in_their_channels_and_grey_cameras_take_the_mean():
    colour, grey = camera(channels=3), camera()
    light = spot(bgr=(0.0, 0.5, 1.0))
    path = at(40.0, 30.0, colour)
    image = colour.light([light], path, 0.0)
    assert image[:, :, 0].max() == 0.0
    np.testing.assert_allclose(image[:, :, 1], 0.5 * image[:, :, 2], atol=1e-5)
    np.testing.assert_allclose(grey.light([light], path, 0.0)[:, :, 0], image.mean(axis=2), atol=1e-5)


def test_a_reflection_adds_to_the_spots():
    cam = camera()
    ghost = Ghost(uv_px=(15.0, 45.0), level=60.0, sigma_px=2.0)
    total, mean, _ = moments(cam.light([], at(0, 0, cam), 0.0, ghosts=[ghost])[:, :, 0])
    assert total == pytest.approx(2 * np.pi * 4.0 * 60.0, rel=1e-5)
    np.testing.assert_allclose(mean, [15.0, 45.0], atol=1e-5)
    both = cam.light([spot()], at(40.0, 30.0, cam), 0.0, ghosts=[ghost])
    assert both.sum() == pytest.approx(total + 2 * np.pi * 1.5**2 * 100, rel=1e-5)


def test_painting_touches_only_what_the_light_reaches():
    backdrop = ambient(1000, 800, 5.0)
    source = PointSource(uv_px=np.array([[300.0, 200.0]]), flux=np.ones(1), sigma_px=1.0, bgr=np.ones(1))
    patch = render_sources(backdrop, [source])
    assert max(patch.light.shape) < 22
    assert render_sources(backdrop, []).light.size == 0
    lost = PointSource(uv_px=np.array([[np.nan, 200.0]]), flux=np.ones(1), sigma_px=1.0, bgr=np.ones(1))
    assert render_sources(backdrop, [lost]).light.size == 0


def test_what_cannot_be_is_refused():
    with pytest.raises(Inconsistent):
        spot(sigma_px=0.0)
    with pytest.raises(Inconsistent):
        spot(diameter_m=-1.0)
    with pytest.raises(Inconsistent):
        Lens(width=10, height=10, focal_px=(0.0, 1.0), centre_px=(0.0, 0.0))
    with pytest.raises(Inconsistent):
        SimCamera(
            lens=Lens(width=10, height=10, focal_px=(9.0, 9.0), centre_px=(5.0, 5.0)),
            T_world_camera=RigidTransform.identity(),
            sensor=Sensor(),
            backdrop=ambient(11, 10, 0.0),
        )
