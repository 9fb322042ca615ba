"""Spots that must be refused by name, and images that are not images."""

import numpy as np
import pytest

from armsight.errors import BadImage
from armsight.measure.spots import find_spots


def test_a_hot_pixel_is_refused_by_name() -> None:
    image = np.full((60, 77), 20, np.uint8)
    image[30, 40] = 250
    spots = find_spots(image)
    assert len(spots.uv_px) == 0
    assert [why.startswith("hot pixel") for _, _, why in spots.rejected] == [True]


def test_another_type_of_pixel_is_refused() -> None:
    with pytest.raises(BadImage):
        find_spots(np.zeros((20, 20)))  # type: ignore[arg-type]  # floats on purpose
