"""What lens and processing do to light: linearity, the mosaic, the curve, and what they leave alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight_sim import Lens, Light, Patch, Rest, Sensor, SimCamera, ambient
from armsight_sim.pipeline import PIPELINES, LensLosses, Pipeline

QUIET = Sensor(electrons_per_level=np.inf, read_noise_level=0.0)
WIDTH, HEIGHT = 96, 64


def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def random_light(channels: int, seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).uniform(0.0, 90.0, (HEIGHT, WIDTH, channels))
    return drawn.astype(np.float32)


@pytest.mark.parametrize("glare", [0.0, 0.05])
def test_a_patch_through_the_lens_is_the_whole_image_through_the_lens(glare: float) -> None:
    """Tolerance: halo below a twentieth of a level is left out."""
    losses = LensLosses(pipeline=Pipeline(vignetting=0.3, glare=glare), height=HEIGHT, width=WIDTH)
    before, lit = random_light(1, 1), random_light(1, 1)
    lit[21:30, 43:55] += 2000.0
    patch = losses.patched(before, losses.through(before), Patch(row=21, column=43, light=lit[21:30, 43:55]))
    found = losses.through(before).copy()
    height, width = patch.light.shape[:2]
    found[patch.row : patch.row + height, patch.column : patch.column + width] = patch.light
    np.testing.assert_allclose(found, losses.through(lit), atol=0.06)


def test_vignetting_takes_its_share_in_the_corners_and_glare_keeps_the_light_together() -> None:
    plain = ambient(WIDTH, HEIGHT, 100.0)
    dark = LensLosses(pipeline=Pipeline(vignetting=0.25), height=HEIGHT, width=WIDTH).through(plain)
    assert dark[0, 0, 0] == pytest.approx(75.0, abs=1.0)
    assert dark[HEIGHT // 2, WIDTH // 2, 0] == pytest.approx(100.0, abs=0.1)
    spot = np.zeros((HEIGHT, WIDTH, 1), np.float32)
    spot[30:33, 46:49] = 1000.0
    hazy = LensLosses(pipeline=Pipeline(glare=0.1), height=HEIGHT, width=WIDTH).through(spot)
    assert hazy.sum() == pytest.approx(spot.sum(), rel=0.01)
    assert hazy[31, 47, 0] == pytest.approx(900.0, rel=0.03)
    assert 0.0 < hazy[31, 60, 0] < 10.0


def test_each_filter_of_the_mosaic_lets_its_own_colour_through() -> None:
    """RGGB: even rows red and green, odd rows green and blue; a flat colour comes back as it was."""
    colour = ambient(WIDTH, HEIGHT, 1.0, bgr=(30.0, 80.0, 160.0))
    raw = QUIET.raw(colour, rng(), bayer=True) / 16.0
    assert (raw[0, 0], raw[0, 1], raw[1, 0], raw[1, 1]) == (160.0, 80.0, 80.0, 30.0)
    over = Patch(row=3, column=5, light=np.full((4, 6, 3), (1.0, 2.0, 3.0), np.float32))
    patched = QUIET.raw(colour, rng(), over, bayer=True) / 16.0
    assert (patched[4, 6], patched[4, 7], patched[3, 6], patched[3, 7]) == (3.0, 2.0, 2.0, 1.0)
    picture = Pipeline(bayer=True).develop(colour, QUIET, rng())
    np.testing.assert_array_equal(picture[10, 10], [30, 80, 160])


def test_noise_falls_on_the_raw_signal_before_the_curve() -> None:
    """Equal light twice: where the curve is steep (dark) the same noise becomes larger than where it is flat."""
    sensor = Sensor(electrons_per_level=np.inf, read_noise_level=1.0)
    curve = Pipeline(curve="srgb")
    for level in (8.0, 120.0):
        image = curve.develop(ambient(300, 300, level), sensor, rng()).astype(float)
        slope = float(curve.encode(level + 0.5) - curve.encode(level - 0.5))
        assert image.std() == pytest.approx(np.hypot(slope, 12**-0.5), rel=0.06)
        assert image.mean() == pytest.approx(float(curve.encode(level)), abs=0.15 * slope)


def test_a_light_behind_a_machine_camera_is_where_the_pinhole_says() -> None:
    """Own arithmetic: u = f x / z + c; vignetting pulls the centroid by less than a hundredth of a pixel."""
    lens = Lens(width=WIDTH, height=HEIGHT, focal_px=(90.0, 90.0), centre_px=(47.0, 31.5))
    camera = SimCamera(
        lens=lens,
        T_world_camera=RigidTransform.identity(),
        sensor=QUIET,
        backdrop=ambient(WIDTH, HEIGHT, 40.0, across=20.0),
        pipeline=PIPELINES["machine"],
    )
    light = Light(name="A", xyz_m=(0.0, 0.0, 0.0), level=150.0, sigma_px=1.5)
    path = Rest(T_world_target=RigidTransform.from_translation([0.21, -0.13, 1.1]))
    extra = (camera.light([light], path, 0.0) - camera.light([], path, 0.0))[:, :, 0]
    want = np.array([90.0 * 0.21 / 1.1 + 47.0, 90.0 * -0.13 / 1.1 + 31.5])
    i, j = np.round(want).astype(int)
    window = extra[j - 8 : j + 9, i - 8 : i + 9]
    v, u = np.mgrid[j - 8 : j + 9, i - 8 : i + 9]
    found = np.array([(window * u).sum(), (window * v).sum()]) / window.sum()
    np.testing.assert_allclose(found, want, atol=0.01)
