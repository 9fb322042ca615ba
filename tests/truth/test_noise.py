"""Noise found in frames drawn here, pixel by pixel: shot noise, read noise, transfer curve, mosaic, lamps, movement."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.ndimage import convolve, shift

from armsight.calibrate.camera_noise.photon_transfer import NoiseCalibration, calibrate_noise
from armsight.errors import BadImage, Degenerate, Inconsistent, NotEnoughData
from refusals import refuses

H, W = 240, 320
GAIN, READ = 0.1, 1.2
DEVIATIONS = 4.5
"""One of 1.5e5 normal errors is beyond; the standard deviations from 20 groups are themselves known to 16 %."""

Array = np.ndarray


def room(rng: np.random.Generator, low: float = 8.0, high: float = 235.0, shape: tuple[int, int] = (H, W)) -> Array:
    """Return the light of a room of soft-edged patches on a slope, in grey levels."""
    patches = rng.random((shape[0] // 24 + 1, shape[1] // 24 + 1)).astype(np.float32)
    light = cv2.resize(patches, shape[::-1], interpolation=cv2.INTER_NEAREST)
    light = cv2.GaussianBlur(light, (0, 0), 1.5) + 0.15 * np.linspace(0.0, 1.0, shape[1])
    light = (light - light.min()) / np.ptp(light)
    return low + (high - low) * light**1.5


def rounded(levels: Array) -> Array:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def exposed(light: Array, rng: np.random.Generator, gain: float = GAIN, read: float = READ) -> Array:
    """Return light (grey levels) with the noise of its electrons and of reading them, before rounding."""
    return rng.poisson(light / gain) * gain + rng.normal(0.0, read, light.shape)


def shots(light: Array, n: int, seed: int, change: Callable[[Array, int], Array] | None = None) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [rounded(exposed(light if change is None else change(light, i), rng)) for i in range(n)]


def line(levels: Array) -> Array:
    return READ**2 + 1.0 / 12.0 + GAIN * levels


def assert_is_the_line(found: NoiseCalibration, model: float = 0.0) -> None:
    """The knots are the true variances within their standard deviations, and within model of them."""
    noise = found.noise
    true = line(noise.levels)
    assert (np.abs(noise.variance_levels2 - true) < DEVIATIONS * noise.std_levels2 + model * true).all()
    assert (noise.std_levels2 < 0.1 * true).all()


@pytest.mark.parametrize("n", [4, 12])
def test_a_linear_camera_is_found(n: int) -> None:
    found = calibrate_noise(shots(room(np.random.default_rng(1)), n, seed=n))
    noise = found.noise
    assert_is_the_line(found)
    assert len(noise.levels) >= 7
    assert noise.linear is not None
    assert noise.linear.gain_levels == pytest.approx(GAIN, rel=0.03)  # 5 times the 0.6 % of four frames
    assert noise.linear.read_noise_levels == pytest.approx(READ, abs=0.08)
    near = noise.correlation
    assert (np.abs([near.x, near.y]) < DEVIATIONS * np.array([near.std_x, near.std_y])).all()
    assert noise.widening() == pytest.approx(1.0, abs=0.05)
    assert (found.moving, found.frozen, found.n_copies) == (0.0, 0.0, 0)
    assert found.frame_ratio == pytest.approx(1.0, abs=0.03)
    assert found.advice == ()


def test_the_deviations_are_true() -> None:
    errors, correlations = [], []
    for seed in range(12):
        noise = calibrate_noise(shots(room(np.random.default_rng(seed), shape=(160, 240)), 5, seed)).noise
        errors.append((noise.variance_levels2 - line(noise.levels)) / noise.std_levels2)
        near = noise.correlation
        correlations.append([near.x / near.std_x, near.y / near.std_y])
    # about 100 and 48 errors of rms 1; the 16 % of their standard deviations and neighbours' overlap are in the limits
    assert 0.75 < np.sqrt(np.mean(np.square(np.concatenate(errors)))) < 1.35
    assert 0.65 < np.sqrt(np.mean(np.square(correlations))) < 1.45


def test_a_transfer_curve_is_a_table_and_no_line() -> None:
    def srgb(x: Array) -> Array:
        x = np.maximum(x, 0.0) / 255.0
        return 255.0 * np.where(x < 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1.0 / 2.4) - 0.055)

    rng = np.random.default_rng(3)
    light = room(rng, 6.0, 200.0)
    found = calibrate_noise([rounded(srgb(exposed(light, rng, read=0.5))) for _ in range(12)])
    noise = found.noise
    assert noise.linear is None
    assert found.line_deviation is not None
    assert found.line_deviation > 0.2
    x = np.linspace(7.0, 195.0, 40)
    slope = (srgb(x + 0.01) - srgb(x - 0.01)) / 0.02
    true = slope**2 * (0.5**2 + GAIN * x) + 1.0 / 12.0
    # 4 %: the curve's second derivative, and chords between the knots
    assert noise.variance_at(srgb(x)) == pytest.approx(true, rel=0.04)


def test_a_demosaiced_image_has_correlated_noise() -> None:
    """Each colour is filled in by the mean of its neighbours: the correlations of white noise sent through that."""
    rng = np.random.default_rng(4)
    masks = {"r": np.zeros((H, W)), "g": np.zeros((H, W)), "b": np.zeros((H, W))}
    masks["r"][::2, ::2] = masks["g"][::2, 1::2] = masks["g"][1::2, ::2] = masks["b"][1::2, 1::2] = 1.0
    corners = np.array([[0.25, 0.5, 0.25], [0.5, 1.0, 0.5], [0.25, 0.5, 0.25]])
    cross = np.array([[0.0, 0.25, 0.0], [0.25, 1.0, 0.25], [0.0, 0.25, 0.0]])
    share = {"r": 0.299, "g": 0.587, "b": 0.114}

    def grey(raw: Array) -> Array:
        kernels = {"r": corners, "g": cross, "b": corners}
        return sum(share[c] * convolve(raw * masks[c], kernels[c], mode="mirror") for c in masks)

    light = room(np.random.default_rng(5))
    noise = calibrate_noise([rounded(grey(exposed(light, rng, read=6.0))) for _ in range(10)]).noise
    large = np.array([grey(rng.normal(size=(H, W)))[4:-4, 4:-4] for _ in range(20)])
    square = (large**2).mean()
    true = [[(large[..., :-k] * large[..., k:]).mean() / square for k in (1, 2)],
            [(large[:, :-k] * large[:, k:]).mean() / square for k in (1, 2)]]  # fmt: skip
    # 0.015: rounding, which is independent and 1 % of the variance, and shot noise that differs from place to place
    near = noise.correlation
    assert np.array([near.x, near.y]) == pytest.approx(np.array(true), abs=0.015)
    assert near.x[0] > 0.2
    assert near.diagonal == pytest.approx((large[:, :-1, :-1] * large[:, 1:, 1:]).mean() / square, abs=0.015)
    v, u = np.mgrid[-10:11, -10:11]
    for sigma_px in (1.5, 2.0, 3.0):  # the centres of lights: 10 % for what is beyond the lags that are kept
        weight = u * np.exp(-(u**2 + v**2) / (2.0 * sigma_px**2))
        shifts = np.array([convolve(one, weight)[11:-11, 11:-11] for one in large[:4]])
        widening = (shifts**2).mean() / (square * (weight**2).sum())
        assert noise.widening(sigma_px) == pytest.approx(widening, rel=0.1)


def test_lamps_at_mains_frequency_are_taken_off() -> None:
    rows = np.arange(H)[:, None]

    def bands(light: Array, i: int) -> Array:
        return light * (1.0 + 0.04 * np.sin(2.0 * np.pi * rows / 120.0 + 2.4 * i)) * (1.0 + 0.03 * np.sin(1.9 * i))

    found = calibrate_noise(shots(room(np.random.default_rng(6), high=215.0), 10, seed=6, change=bands))
    assert_is_the_line(found, model=0.02)  # the light itself changes by 5 %, and its noise with it
    assert found.brightness_rms == pytest.approx(0.06, abs=0.02)  # steps of both sines: 0.054 and 0.034, over sqrt 2
    assert any("brightness" in text for text in found.advice)


def test_what_moves_is_left_out() -> None:
    def walks(light: Array, i: int) -> Array:
        light = light.copy()
        light[60:130, 20 * i : 20 * i + 50] = 180.0
        return light

    found = calibrate_noise(shots(room(np.random.default_rng(8)), 10, seed=8, change=walks))
    assert_is_the_line(found, model=0.01)
    assert 0.02 < found.moving < 0.4
    assert any("moves" in text for text in found.advice)


def test_a_trembling_camera_is_told_and_a_moved_one_refused() -> None:
    wide = room(np.random.default_rng(9))
    rng = np.random.default_rng(10)

    def shifted(step_px: float) -> Callable[[Array, int], Array]:
        def change(light: Array, i: int) -> Array:
            return np.maximum(shift(light, (0.0, step_px * (i % 2 if step_px < 0.2 else i)), mode="reflect"), 0.0)

        return change

    found = calibrate_noise(shots(wide, 8, seed=9, change=shifted(0.1)))
    assert_is_the_line(found, model=0.04)
    assert found.shift_px_rms == pytest.approx(0.1, rel=0.1)
    assert any("shifts" in text for text in found.advice)
    with refuses(Degenerate, "image moves"):
        calibrate_noise(shots(wide, 8, seed=9, change=shifted(0.3)))
    with pytest.raises(Degenerate, match="moves"):
        calibrate_noise([rounded(room(rng)) for _ in range(5)])


def test_black_and_clipped_pixels_say_nothing() -> None:
    light = room(np.random.default_rng(11), -60.0, 340.0)
    rng = np.random.default_rng(12)
    frames = [np.clip(rounded(exposed(np.maximum(light, 0.0), rng)), 3, 240) for _ in range(8)]
    found = calibrate_noise(frames)
    assert_is_the_line(found, model=0.01)
    assert found.noise.levels[0] > 3.0
    assert found.noise.levels[-1] < 240.0
    assert found.unusable > 0.2
    seen = (np.arange(H) < 6)[:, None]
    with refuses(NotEnoughData, "black or clipped"):
        calibrate_noise([np.where(seen, frame, np.where(light > 100.0, 255, 0)).astype(np.uint8) for frame in frames])


def test_frames_without_noise_are_refused() -> None:
    frames = shots(room(np.random.default_rng(13)), 6, seed=13)
    with pytest.raises(Degenerate, match="copies"):
        calibrate_noise([frames[0]] * 6)
    spots = [frames[0].copy() for _ in range(6)]
    for i, frame in enumerate(spots):
        frame[10 * i : 10 * i + 10, 40:60] += 5
    with refuses(Degenerate, "pixels change"):
        calibrate_noise(spots)
    partly = [np.where(np.arange(W) < 0.7 * W, frames[0], frame) for frame in frames]
    with pytest.raises(Degenerate, match="unchanged"):
        calibrate_noise(partly)
    found = calibrate_noise([frame for frame in frames for _ in range(2)])
    assert (found.n_given, found.n_copies, found.n_frames) == (12, 6, 6)
    assert any("copies" in text for text in found.advice)
    assert_is_the_line(found)


def test_frames_averaged_over_time_are_told_or_refused() -> None:
    def smoothed(share: float, every: int = 1) -> list[Array]:
        rng = np.random.default_rng(14)
        light = room(rng)
        shown, frames = exposed(light, rng), []
        for _ in range(8 * every):
            shown = (1.0 - share) * shown + share * exposed(light, rng)
            frames.append(rounded(shown))
        return frames[::every]

    with refuses(Degenerate, "averaged"):
        calibrate_noise(smoothed(0.4))
    told = calibrate_noise(smoothed(0.8))
    assert told.frame_ratio == pytest.approx(1.2, abs=0.03)
    assert any("alike" in text for text in told.advice)
    assert calibrate_noise(smoothed(0.4, every=6)).frame_ratio == pytest.approx(1.047, abs=0.03)  # 0.6^6


def test_too_little_is_refused() -> None:
    frames = shots(room(np.random.default_rng(15)), 4, seed=15)
    with refuses(NotEnoughData, "3 frames"):
        calibrate_noise(frames[:3])
    with pytest.raises(NotEnoughData, match="0 frames"):
        calibrate_noise([])
    with refuses(NotEnoughData, "small"):
        calibrate_noise([frame[:60, :60] for frame in frames])
    with pytest.raises(Inconsistent, match="frame 2"):
        calibrate_noise([frames[0], frames[1][:-8], *frames])
    with refuses(BadImage, "8-bit"):
        calibrate_noise([frame[..., None].repeat(3, axis=2) for frame in frames])


def test_compression_is_measured_as_it_is() -> None:
    """JPEG changes noise; what is found is the variance about each pixel's own mean over many frames."""
    rng = np.random.default_rng(16)
    light = room(rng)

    def stored(levels: Array) -> Array:
        return cv2.imdecode(cv2.imencode(".jpg", rounded(levels), [cv2.IMWRITE_JPEG_QUALITY, 90])[1], 0)

    many = np.array([stored(exposed(light, rng)) for _ in range(40)])
    found = calibrate_noise(list(many[:12]))
    assert found.moving < 0.02
    variance, mean = many.var(axis=0, ddof=1), many.mean(axis=0)
    for level in (20, 40, 60, 90, 130, 180):
        near = np.abs(mean - level) < 5.0
        assert found.noise.variance_at(level) == pytest.approx(variance[near].mean(), rel=0.1)
