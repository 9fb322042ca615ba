"""A LED's place in an image as thresholding and moments give it, without weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import NotEnoughData

Array = NDArray[np.float64]

THRESHOLD = 100.0
"""Grey level above which a pixel is a LED's; the paper names none."""

HALF_PX = 14
"""Half of the window about the LED."""


def led_centroid(image: NDArray[np.uint8], near_px: ArrayLike) -> Array:
    """Return the mean place (2,) in px, u then v, of the bright pixels about near_px (2,) in a grey image.

    Raises NotEnoughData where none is bright.
    """
    u, v = np.rint(np.asarray(near_px, float)).astype(int)
    top, left = max(v - HALF_PX, 0), max(u - HALF_PX, 0)
    window = image[top : v + HALF_PX + 1, left : u + HALF_PX + 1]
    rows, columns = np.nonzero(window > THRESHOLD)
    if not len(rows):
        raise NotEnoughData(
            f"no pixel about ({u}, {v}) is brighter than {THRESHOLD:g}", consequence="The LED has no place"
        )
    return np.array([left + columns.mean(), top + rows.mean()])
