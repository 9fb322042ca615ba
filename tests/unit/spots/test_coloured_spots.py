"""Beacons found by their colour among lights of other colours."""

import numpy as np
import pytest
from numpy.typing import NDArray

from armsight.measure.spots import SpotSettings, find_spots, track_spots
from armsight.measure.spots.grey import grey_of
from armsight.records import Colour
from armsight.records.target import BLUE, GREEN, RED

BGR = {"red": (0.1, 0.15, 1.0), "green": (0.15, 1.0, 0.1), "blue": (1.0, 0.2, 0.1), "white": (1.0, 1.0, 1.0)}
PLACES = {"red": (60.3, 50.6), "green": (150.2, 70.9), "blue": (100.7, 120.4), "white": (200.1, 130.0)}


def scene(sigma: float = 3.0, only: str = "") -> NDArray[np.uint8]:
    """One light of each colour on grey, with noise of 2 grey levels in each channel."""
    y, x = np.mgrid[:180, :250]
    image = 30.0 + np.random.default_rng(5).normal(0.0, 2.0, (180, 250, 3))
    for name, (u, v) in PLACES.items():
        if only in ("", name):
            light = 170.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * sigma**2))
            image += light[:, :, None] * np.array(BGR[name])
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("name", "colour"), [("red", RED), ("green", GREEN), ("blue", BLUE)])
def test_the_beacon_of_a_colour_is_found_and_the_others_are_not(name: str, colour: Colour) -> None:
    spots = find_spots(scene(), SpotSettings(colour=colour))
    assert len(spots) == 1
    error = spots.uv_px[0] - PLACES[name]
    assert np.linalg.norm(error) < 0.2
    assert error @ np.linalg.solve(spots.covariance_px2[0], error) < 20.0  # chi-square of 2: once in 20,000
    tracked, of = track_spots(scene(), [[5.0, 5.0], np.add(PLACES[name], 4.0)], 15.0, SpotSettings(colour=colour))
    np.testing.assert_allclose(tracked.uv_px, spots.uv_px, atol=0.1)
    assert of.tolist() == [1]


def test_hues_wrap_through_zero() -> None:
    across, below = Colour(hue_deg=(350.0, 10.0)), Colour(hue_deg=(300.0, 340.0))
    assert len(find_spots(scene(only="red"), SpotSettings(colour=across))) == 1
    assert len(find_spots(scene(only="red"), SpotSettings(colour=below))) == 0


def test_a_channel_that_is_clipped_is_not_measured_through_grey() -> None:
    image = np.zeros((2, 3, 3), np.uint8)
    image[0, 1], image[1, 2] = (255, 10, 10), (254, 10, 10)  # blue: little of a grey level
    grey = grey_of(image, 255).astype(int)
    assert grey[0, 1] == 255 and 20 < grey[1, 2] < 60 and grey.sum() == grey[0, 1] + grey[1, 2]
