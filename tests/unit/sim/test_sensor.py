"""Noise against numpy's own generators, and everything a sensor does to light."""

import numpy as np
import pytest
from scipy import stats

from armsight_sim import Sensor, ambient

SIZE = 600  # 360,000 pixels: a variance is known to 0.24 %, a correlation to 0.0017
N = SIZE * SIZE


def developed(level, sensor, seed=0):
    return sensor.develop(ambient(SIZE, SIZE, level), np.random.default_rng(seed)).astype(float)


@pytest.mark.parametrize(
    ("level", "gain", "read"), [(8.0, 24.0, 1.5), (60.0, 5.0, 0.8), (150.0, 24.0, 0.0), (30.0, 1.0, 2.0)]
)
def test_mean_variance_and_skewness_are_those_of_poisson_electrons_and_read_noise(level, gain, read):
    image = developed(level, Sensor(electrons_per_level=gain, read_noise_level=read))
    rng = np.random.default_rng(99)
    peer = np.round(rng.poisson(level * gain, N) / gain + read * rng.normal(size=N)).clip(0, 255)
    variance = level / gain + read**2 + 1 / 12  # shot, read, rounding
    assert image.mean() == pytest.approx(level, abs=4 * np.sqrt(variance / N))
    assert image.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / N) + 1e-3)
    assert stats.skew(image, axis=None) == pytest.approx(stats.skew(peer), abs=4 * np.sqrt(2 * 6 / N))
    assert stats.kurtosis(image, axis=None) == pytest.approx(stats.kurtosis(peer), abs=4 * np.sqrt(2 * 24 / N) + 0.01)


def test_noise_of_neighbours_rows_frames_and_channels_is_uncorrelated():
    sensor = Sensor()
    image = developed(60.0, sensor) - 60.0
    other = developed(60.0, sensor, seed=1) - 60.0
    flat = image.ravel()
    shifted = {f"lag {k}": (flat[:-k], flat[k:]) for k in (1, 2, 3, SIZE - 1, SIZE, SIZE + 1, 2 * SIZE)}
    shifted |= {"frames": (flat, other.ravel()), "squares": (flat[:-1] ** 2, flat[1:] ** 2)}
    shifted |= {"squares by row": (flat[:-SIZE] ** 2, flat[SIZE:] ** 2)}
    colour = sensor.develop(ambient(SIZE, 100, 60.0, bgr=(1.0, 1.0, 1.0)), np.random.default_rng(3)).astype(float)
    shifted |= {"channels": (colour[:, :, 0].ravel(), colour[:, :, 1].ravel())}
    for name, (a, b) in shifted.items():
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(a.size), name


def test_light_beyond_saturation_clips_and_none_falls_below_zero():
    image = developed(500.0, Sensor(saturation=240))
    assert image.min() == image.max() == 240
    dark = developed(0.0, Sensor(read_noise_level=2.0))
    assert dark.min() == 0
    assert dark.mean() == pytest.approx(
        2.0 / np.sqrt(2 * np.pi), abs=0.05
    )  # half of a normal; rounding shifts a little
