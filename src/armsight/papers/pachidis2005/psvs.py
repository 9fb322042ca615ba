"""Places from the camera with mirrors (PSVS): eqs. (4) to (6) as printed, which are right (MATH B2, 3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, cos, pi, sin, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate

Array = NDArray[np.float64]


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

    def places(self, left_px: ArrayLike, right_px: ArrayLike) -> Array:
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
