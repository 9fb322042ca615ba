"""Everything round in an image: candidates for the dots of a circle grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LEAST_RADIUS_PX = 1.5
ROUNDNESS = 0.12
"""A dot's area may differ from its ellipse's by this share (pixel stairs of the smallest dots: 0.1)."""
FLATTEST = 0.2
"""Shortest half axis over longest: beyond this slant nobody measures."""
LEAST_LEVELS = 12.0
"""A dot must differ from its surroundings by this many grey levels."""
SHORTEST_CONTOUR = 8
LARGEST_SHARE = 1.0 / 16.0
"""A dot covers at most this share of the image."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dots:
    """Candidates: uv (n, 2), half axes (n, 2) in px, the long one first, and its direction (n,) in rad."""

    uv: Array
    axes: Array
    angle: Array

    @cached_property
    def area(self) -> Array:
        """Area (n,) in px^2."""
        return np.asarray(np.pi * self.axes[:, 0] * self.axes[:, 1])

    @cached_property
    def tree(self) -> cKDTree:
        """What finds the dot nearest to a pixel."""
        return cKDTree(self.uv)

    @property
    def shape(self) -> Array:
        """Matrices (n, 2, 2) whose columns are the half axes in px."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        long, short = self.axes.T
        return np.stack([c * long, -s * short, s * long, c * short], axis=1).reshape(-1, 2, 2)


def neighbourhoods(image: Image) -> tuple[int, ...]:
    """Return the sizes of neighbourhood in which a pixel is compared with its surroundings: 0 is the whole image."""
    width = image.shape[1]
    return (0, width // 12 | 1, width // 40 | 1, width // 5 | 1, width // 72 | 1)


def round_dots(image: Image, block: int, *, dark: bool) -> Dots:
    """Return everything round, dark on light or light on dark, in one thresholded image.

    However many contours there are: wood, gravel and noise give thousands, and the board may lie among them.
    """
    kind = cv2.THRESH_BINARY_INV if dark else cv2.THRESH_BINARY
    if block == 0:
        binary = cv2.threshold(image, 0, 255, kind | cv2.THRESH_OTSU)[1]
    else:
        offset = LEAST_LEVELS / 2.0 if dark else -LEAST_LEVELS / 2.0
        binary = cv2.adaptiveThreshold(image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, max(block, 5), offset)
    found, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    contours = [c.reshape(-1, 2) for c in found if SHORTEST_CONTOUR <= len(c) <= image.shape[1]]
    if not contours:
        return Dots(uv=np.empty((0, 2)), axes=np.empty((0, 2)), angle=np.empty(0))
    begin = np.cumsum([0, *(len(c) for c in contours[:-1])])
    xy = np.concatenate(contours)
    area, uv, spread = _moments(xy.astype(float), begin)
    values, vectors = np.linalg.eigh(4.0 * spread)  # squared half axes of the ellipse with the same moments
    keep = (area > np.pi * LEAST_RADIUS_PX**2) & (area < LARGEST_SHARE * image.size)
    keep &= (values[:, 0] > 0.0) & (values[:, 0] >= FLATTEST**2 * values[:, 1])
    keep &= np.abs(np.pi * np.sqrt(np.maximum(values.prod(axis=1), 0.0)) - area) <= ROUNDNESS * area
    edge = np.add.reduceat(image[xy[:, 1], xy[:, 0]].astype(float), begin) / np.diff(np.append(begin, len(xy)))
    at = np.clip(uv, 0, np.array(image.shape[::-1]) - 1).astype(int)
    middle = image[at[:, 1], at[:, 0]]
    keep &= (middle < edge) if dark else (middle > edge)
    axes = np.sqrt(np.maximum(values[keep], 0.0))
    # the contour runs through the outermost pixels' centres: the dot is half a pixel larger all round
    return Dots(
        uv=uv[keep],
        axes=axes[:, ::-1] + 0.5,
        angle=np.arctan2(vectors[keep, 1, 1], vectors[keep, 0, 1]),
    )


def _moments(xy: Array, begin: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return area (n,), centre (n, 2) and second central moments over area (n, 2, 2) of polygons.

    xy (m, 2): the vertices of all, one polygon after the other; begin (n,): where each begins. Green's theorem;
    polygons without area get zeros.
    """
    after = np.arange(1, len(xy) + 1)
    after[np.append(begin[1:], len(xy)) - 1] = begin
    origin = np.repeat(xy[begin], np.diff(np.append(begin, len(xy))), axis=0)
    p, q = xy - origin, xy[after] - origin  # near zero, or the products would lose digits
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    terms = np.column_stack(
        [
            cross / 2.0,
            (p + q) * cross[:, None] / 6.0,
            (p * p + p * q + q * q) * cross[:, None] / 12.0,
            (p[:, 0] * (2.0 * p[:, 1] + q[:, 1]) + q[:, 0] * (2.0 * q[:, 1] + p[:, 1])) * cross / 24.0,
        ]
    )
    m00, m10, m01, m20, m02, m11 = np.add.reduceat(terms, begin, axis=0).T
    some = np.where(m00 == 0.0, 1.0, m00)
    u, v = m10 / some, m01 / some
    uu, vv, uv = m20 / some - u * u, m02 / some - v * v, m11 / some - u * v
    spread = np.stack([uu, uv, uv, vv], axis=1).reshape(-1, 2, 2)
    spread[m00 == 0.0] = 0.0
    return np.abs(m00), xy[begin] + np.stack([u, v], axis=1), spread
