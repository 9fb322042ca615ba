"""A LED's place in an image as thresholding and moments give it, without weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from armsight.errors import NotEnoughData

Array = NDArray[np.float64]

HALF_PX = 14
"""Half of the window about the LED."""

FAINTEST = 30.0
"""Levels by which the window's brightest pixel must exceed its median to be a LED's; the paper names none."""


def led_centroid(image: NDArray[np.uint8], near_px: ArrayLike) -> Array:
    """Return the mean place (2,) in px, u then v, of the bright area about near_px (2,) in a grey image.

    The area holds the window's brightest pixel, and its pixels are above the middle between that and the median. Raises
    NotEnoughData where nothing is bright.
    """
    u, v = np.rint(np.asarray(near_px, float)).astype(int)
    top, left = max(v - HALF_PX, 0), max(u - HALF_PX, 0)
    window = image[top : v + HALF_PX + 1, left : u + HALF_PX + 1].astype(float)
    ground = float(np.median(window)) if window.size else 0.0
    peak = float(window.max(initial=0.0))
    if peak - ground < FAINTEST:
        raise NotEnoughData(
            f"no pixel about ({u}, {v}) is {FAINTEST:g} levels above its surroundings",
            consequence="The LED has no place",
        )
    labels, _ = ndimage.label(window > 0.5 * (peak + ground), structure=np.ones((3, 3)))
    rows, columns = np.nonzero(labels == labels[np.unravel_index(int(window.argmax()), window.shape)])
    return np.array([left + columns.mean(), top + rows.mean()])
