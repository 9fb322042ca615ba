"""The lit areas of a complex image and their pairs (section 4): threshold, seeds, propagation, mean of the pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from armsight.errors import NotEnoughData

Array = NDArray[np.float64]

CROSS_PX = 5
"""Side of the cross that must fit into an area for a seed. The paper takes 9 or, where areas are small, 5 pixels."""

LIGHTS = 3


def lit_areas(image: NDArray[np.uint8], threshold: float, mask: NDArray[np.bool_]) -> Array:
    """Return the centres (n, 2) in px, u then v, of the areas above a grey level in which a cross fits.

    mask (rows, columns): where areas are looked for. A centre is the mean of the area's pixels, without weights.
    """
    lit = (image > threshold) & mask
    cross = np.zeros((CROSS_PX, CROSS_PX), bool)
    cross[CROSS_PX // 2], cross[:, CROSS_PX // 2] = True, True
    seeds = ndimage.binary_erosion(lit, cross)
    labels, _ = ndimage.label(lit, structure=np.ones((3, 3)))
    numbers = np.unique(labels[seeds])
    if not len(numbers):
        return np.empty((0, 2))
    return np.array(ndimage.center_of_mass(lit, labels, numbers))[:, ::-1]


def light_pairs(centres_px: Array) -> tuple[Array, Array]:
    """Return the pixels (3, 2) of the lights A, B, C in the left and in the right view, of six areas (6, 2).

    The two views of a light lie on one scan line, the left one further right. A is left, B lower right, C upper right
    (MATH 3.1, 3.2). Raises NotEnoughData for another number of areas.
    """
    if len(centres_px) != 2 * LIGHTS:
        raise NotEnoughData(
            f"the image has {len(centres_px)} lit areas", consequence="Three lights are six areas; there is no pose"
        )
    pairs = centres_px[np.argsort(centres_px[:, 1])].reshape(LIGHTS, 2, 2)
    pairs = np.array([pair[np.argsort(pair[:, 0])] for pair in pairs])  # (3, right then left view, 2)
    upper, a, lower = _with_a_first(pairs)
    named = np.stack([a, lower, upper])
    return named[:, 1], named[:, 0]


def _with_a_first(pairs: Array) -> tuple[Array, Array, Array]:
    """Return the pairs (2, 2) of C, A and B: A is the leftmost, the others go by height."""
    first = int(pairs[:, 1, 0].argmin())
    others = np.delete(pairs, first, axis=0)
    return others[0], pairs[first], others[1]
