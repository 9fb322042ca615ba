"""Pachidis et al. 2005: lit areas of a complex image in pairs, places from the mirrors' camera, the lights' frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, cos, pi, sin, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from armsight.arrays import Array
from armsight.errors import Degenerate, NotEnoughData

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


def plate_shift(thickness_m: float, index: float) -> tuple[float, float]:
    """Return m and l in m of a plate at 45 degrees, eqs. (5) and (6).

    m is right for the chief ray; l is printed, and not the optical shift (MATH B3).
    """
    omega, refracted = pi / 4.0, asin(sin(pi / 4.0) / index)
    m = thickness_m * cos(omega + refracted) / cos(refracted)
    shift = thickness_m / cos(refracted) * (1.0 - sin(omega + refracted) + cos(omega + refracted) * tan(omega))
    return m, shift


@dataclass(frozen=True, slots=True, kw_only=True)
class Psvs:
    """The rig of eq. (4): focal lengths and principal point in px (those of the one real camera), lengths in m."""

    au_px: float
    av_px: float
    u0_px: float
    v0_px: float
    baseline_m: float
    m_m: float
    l_m: float

    def positions(self, left_px: ArrayLike, right_px: ArrayLike) -> Array:
        """Return places (n, 3) in m in axes of the real camera of pixels (n, 2) of both views: eq. (4).

        The two equations for x and for y are averaged. Raises Degenerate where a disparity is not positive.
        """
        (uL, vL), (uR, vR) = (np.atleast_2d(px).astype(float).T for px in (left_px, right_px))
        uL, uR, vL, vR = uL - self.u0_px, uR - self.u0_px, vL - self.v0_px, vR - self.v0_px
        if (uL - uR <= 0.0).any():
            raise Degenerate("the disparity of a pair is not positive", consequence="Its point is not in front")
        half = 0.5 * self.baseline_m
        z = (self.au_px * (self.baseline_m + self.m_m) + self.l_m * uL) / (uL - uR) - half
        x_right = (z + half) * uR / self.au_px + half
        x_left = (z + half - self.l_m) * uL / self.au_px - half - self.m_m
        y_right, y_left = (z + half) * vR / self.av_px, (z + half - self.l_m) * vL / self.av_px
        return np.stack([0.5 * (x_right + x_left), 0.5 * (y_right + y_left), z], axis=1)


def frame_of_three(abc_m: ArrayLike) -> Array:
    """Return the pose (4, 4) of the frame of the lights A, B, C, rows of (3, 3) in m: eqs. (7) and (8).

    Origin G is their mean, u = -GA, w = GB x GA, v = w x u. Raises Degenerate for lights on one line.
    """
    points = np.asarray(abc_m, float)
    G = points.mean(axis=0)
    a, b = points[0] - G, points[1] - G
    w = np.cross(b, a)
    size = float(np.linalg.norm(w))
    if size <= 1e-9 * float(np.linalg.norm(a) * np.linalg.norm(b)):
        raise Degenerate("the three lights lie on one line", consequence="They span no frame")
    u, w = -a / np.linalg.norm(a), w / size
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([u, np.cross(w, u), w], axis=1), G
    return T


def pose_of_three(seen_m: ArrayLike, model_m: ArrayLike) -> Array:
    """Return the pose (4, 4) of a target whose lights (3, 3) are model_m in its own axes, seen at seen_m."""
    return np.asarray(frame_of_three(seen_m) @ np.linalg.inv(frame_of_three(model_m)))
