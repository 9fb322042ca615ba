"""Spots that are found, spots that are refused by name, and images that are not images."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.measure.spots import SpotSettings, find_spots, track_spots
from armsight.records import Spots

Image = NDArray[np.uint8]
NOISE = 2.0
NEAR_PX = 0.15
"""Five standard deviations of a light of sigma 2 px and height 150 in noise 2."""


def frame(
    *lights: tuple[float, float, float],
    size: tuple[int, int] = (160, 120),
    background: float = 20.0,
    sigma: float = 2.0,
) -> Image:
    """A noisy frame (width, height) of lights (u, v, height)."""
    y, x = np.mgrid[: size[1], : size[0]]
    image = background + np.random.default_rng(3).normal(0.0, NOISE, x.shape)
    for u, v, height in lights:
        image += height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * sigma**2))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def reasons(spots: Spots) -> list[str]:
    return [why for _, _, why in spots.rejected]


def assert_found(spots: Spots, *places: tuple[float, float]) -> None:
    assert len(spots) == len(places), reasons(spots)
    away = np.linalg.norm(spots.uv_px[:, None] - np.array(places)[None], axis=2)
    assert (away.min(axis=0) < NEAR_PX).all()


def test_a_hot_pixel_is_refused_by_name_and_does_not_disturb() -> None:
    image = frame((70.3, 50.6, 150.0))
    image[20, 30] = image[90, 140] = 250
    spots = find_spots(image)
    assert_found(spots, (70.3, 50.6))
    assert len(spots.rejected) == 2 and all(why.startswith("hot pixel") for why in reasons(spots))


@pytest.mark.parametrize("place", [(158.5, 60.0), (80.0, 0.4), (159.0, 119.0)])
def test_a_spot_cut_by_the_border_is_refused(place: tuple[float, float]) -> None:
    spots = find_spots(frame((80.0, 60.0, 150.0), (*place, 150.0)))
    assert_found(spots, (80.0, 60.0))
    assert any("border" in why for why in reasons(spots))


def test_what_is_no_spot_is_refused_by_name() -> None:
    window = frame((30.0, 30.0, 150.0), size=(640, 480))
    window[300:370, 400:480] = 230
    spots = find_spots(window)
    assert_found(spots, (30.0, 30.0))
    assert any("too large" in why for why in reasons(spots))
    few = find_spots(frame((30.0, 30.0, 150.0), (90.0, 60.0, 100.0), (60.0, 90.0, 60.0)), SpotSettings(max_spots=2))
    assert_found(few, (30.0, 30.0), (90.0, 60.0))
    assert any("too many" in why for why in reasons(few))
    small = find_spots(frame((80.0, 60.0, 30.0), sigma=1.0), SpotSettings(min_pixels=40))
    assert len(small) == 0 and any("too small" in why for why in reasons(small))


def test_dark_noisy_and_white_images_hold_no_spot() -> None:
    assert len(find_spots(np.zeros((120, 160), np.uint8))) == 0
    assert len(find_spots(frame())) == 0
    white = find_spots(np.full((120, 160), 255, np.uint8))
    assert len(white) == 0 and reasons(white)[0].startswith("bright all over")
    noise = np.random.default_rng(0).integers(0, 256, (120, 160)).astype(np.uint8)
    assert len(find_spots(noise)) == 0


def test_dark_spots_are_found_inverted_only() -> None:
    image = np.asarray(255 - frame((70.3, 50.6, 150.0)), np.uint8)
    assert_found(find_spots(image, SpotSettings(inverted=True)), (70.3, 50.6))
    assert len(find_spots(image)) == 0


def test_a_mask_hides_and_must_fit() -> None:
    image = frame((40.3, 50.6, 150.0), (110.2, 70.9, 150.0))
    mask = np.ones(image.shape, bool)
    mask[:, :80] = False
    assert_found(find_spots(image, SpotSettings(mask=mask)), (110.2, 70.9))
    tracked, of = track_spots(image, [[40.0, 50.0], [110.0, 70.0]], 12.0, SpotSettings(mask=mask))
    assert_found(tracked, (110.2, 70.9))
    assert of.tolist() == [1]
    with pytest.raises(Inconsistent, match="mask"):
        find_spots(image, SpotSettings(mask=mask[1:]))


@pytest.mark.parametrize("size", [(161, 119), (1283, 65), (65, 700)])
def test_any_size_and_slope_of_the_background(size: tuple[int, int]) -> None:
    places = [(0.3 * size[0], 0.4 * size[1]), (0.7 * size[0], 0.6 * size[1])]
    lights = [(u, v, 150.0) for u, v in places]
    assert_found(find_spots(frame(*lights, size=size)), *places)
    slope = 0.05 * np.add.outer(np.arange(size[1]), np.arange(size[0]))
    assert_found(find_spots((frame(*lights, size=size) + slope).clip(0, 255).astype(np.uint8)), *places)


def test_tracking_takes_the_nearest_spot_and_never_one_twice() -> None:
    image = frame((40.3, 50.6, 150.0), (60.2, 50.9, 150.0))
    spots, of = track_spots(image, [[42.0, 51.0], [58.0, 50.0], [120.0, 90.0]], 14.0)
    assert of.tolist() == [0, 1]
    assert np.linalg.norm(spots.uv_px - [[40.3, 50.6], [60.2, 50.9]], axis=1).max() < NEAR_PX
    shared, of = track_spots(image, [[43.0, 51.0], [41.0, 50.0]], 8.0)
    assert of.tolist() == [1]
    assert_found(shared, (40.3, 50.6))


def test_windows_may_reach_beyond_the_image_and_cut_spots_are_said() -> None:
    image = frame((10.3, 8.6, 150.0))
    assert_found(track_spots(image, [[8.0, 6.0], [-500.0, 3.0], [1e5, 1e5]], 20.0)[0], (10.3, 8.6))
    cut, of = track_spots(image, [[14.0, 8.0]], 4.0)
    assert len(cut) == len(of) == 0
    assert "window" in reasons(cut)[0]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.tuples(st.integers(1, 90), st.integers(1, 90)),
    lights=st.lists(st.tuples(st.floats(-5, 95), st.floats(-5, 95), st.floats(0, 3000)), max_size=5),
    sigma=st.floats(0.3, 12.0),
)
def test_whatever_is_found_has_a_place_and_a_covariance(
    seed: int, size: tuple[int, int], lights: list[tuple[float, float, float]], sigma: float
) -> None:
    image = frame(*lights, size=size, sigma=sigma)
    rng = np.random.default_rng(seed)
    image[rng.random(image.shape) < 0.02] = rng.integers(0, 256)
    spots = find_spots(image)
    assert np.isfinite(spots.uv_px).all()
    assert (spots.uv_px > -0.5).all() and (spots.uv_px < np.array(size) - 0.5).all()
    assert all((np.linalg.eigvalsh(C) > 0.0).all() for C in spots.covariance_px2)
