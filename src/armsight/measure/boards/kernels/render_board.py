"""Compiled drawing of a checkerboard's dark pattern into an image of grey levels, for taking it off again."""

from __future__ import annotations

from math import erf, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel

SQRT_HALF = 0.7071067811865476
STEPS = 3
"""Newton steps from the homography's inverse to that of the whole map: the lens moves points by a tenth of a square.
From the pixel before, one does."""
REACH = 1.6
"""Squares round the corners that are drawn: the board ends one square beyond them, and its blur a little later."""


class GridMapK(NamedTuple):
    """A GridMap as kernels take it: the homography H (3, 3), and on top the cubic (10, 2) px in x, y.

    Both are of (x, y) = ((s, t) - centre) / half, where s, t count squares.
    """

    H: Any
    cubic: Any
    centre: Any
    half: Any


@inner_kernel
def map_point(grid, s, t, uv, slope):
    """Fill uv (2,) and slope (2, 2), px and px per square, of a GridMap at grid coordinates (s, t)."""
    H, cubic, centre, half = grid
    x, y = (s - centre[0]) / half, (t - centre[1]) / half
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    for a in range(2):
        top = H[a, 0] * x + H[a, 1] * y + H[a, 2]
        c = cubic[:, a]
        uv[a] = (
            top / w
            + (c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y)
            + (c[6] * x**3 + c[7] * x * x * y + c[8] * x * y * y + c[9] * y**3)
        )
        dx = (H[a, 0] - top / w * H[2, 0]) / w
        dy = (H[a, 1] - top / w * H[2, 1]) / w
        dx += c[1] + 2.0 * c[3] * x + c[4] * y + 3.0 * c[6] * x * x + 2.0 * c[7] * x * y + c[8] * y * y
        dy += c[2] + c[4] * x + 2.0 * c[5] * y + c[7] * x * x + 2.0 * c[8] * x * y + 3.0 * c[9] * y * y
        slope[a, 0] = dx / half
        slope[a, 1] = dy / half


@inner_kernel
def _stripes(s, px, n, low, high, blur):
    """Return how far inside the board (0..1) and on which stripe (-1..1) a point lies along one axis.

    px: pixels per square across the stripes; the lines are at 0 .. n - 1, the board ends at low and high.
    """
    z = SQRT_HALF * px / blur
    k = min(max(int(np.rint(s)), 0), n - 1)
    side = erf((s - k) * z)
    inside = 0.25 * (1.0 + erf((s - low) * z)) * (1.0 - erf((s - high) * z))
    return inside, side if k % 2 == 0 else -side


@kernel
def render_pattern(grid, columns, rows, edge, first, contrast, blur, out):
    """Add a board's dark pattern to out (h, w) float64.

    grid: as a GridMapK. edge (2, 2): where the pattern
    begins and ends along columns and rows, in squares. first: +1 where the square beyond the first corner is
    white, -1 where it is black. contrast (3,): half the levels between black and white, and its slope along
    columns and rows, per square. blur: of the edges, px.
    """
    grid = GridMapK(*grid)
    H, _, centre, half = grid
    h, w = out.shape
    back = np.linalg.inv(H)
    uv = np.empty(2)
    E = np.empty((2, 2))
    low = np.array([1e9, 1e9])
    high = np.array([-1e9, -1e9])
    for s in (-REACH, columns - 1.0 + REACH):
        for t in (-REACH, rows - 1.0 + REACH):
            map_point(grid, s, t, uv, E)
            low = np.minimum(low, uv)
            high = np.maximum(high, uv)
    for row in range(max(0, int(low[1]) - 4), min(h, int(high[1]) + 5)):
        warm = False
        s = t = det = 0.0
        for col in range(max(0, int(low[0]) - 4), min(w, int(high[0]) + 5)):
            if warm:  # one pixel on from the one before
                s += E[1, 1] / det
                t -= E[1, 0] / det
            else:
                q = back[2, 0] * col + back[2, 1] * row + back[2, 2]
                s = (back[0, 0] * col + back[0, 1] * row + back[0, 2]) / q * half + centre[0]
                t = (back[1, 0] * col + back[1, 1] * row + back[1, 2]) / q * half + centre[1]
            if abs(s - centre[0]) > centre[0] + REACH or abs(t - centre[1]) > centre[1] + REACH:
                warm = False
                continue
            for _ in range(1 if warm else STEPS):
                map_point(grid, s, t, uv, E)
                det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
                du, dv = col - uv[0], row - uv[1]
                s += (E[1, 1] * du - E[0, 1] * dv) / det
                t += (E[0, 0] * dv - E[1, 0] * du) / det
            warm = True
            # gradients of s and t have lengths |E's other column| / det
            in_s, on_s = _stripes(
                s, abs(det) / sqrt(E[0, 1] ** 2 + E[1, 1] ** 2), columns, edge[0, 0], edge[1, 0], blur
            )
            in_t, on_t = _stripes(t, abs(det) / sqrt(E[0, 0] ** 2 + E[1, 0] ** 2), rows, edge[0, 1], edge[1, 1], blur)
            dark = in_s * in_t * 0.5 * (1.0 - first * on_s * on_t)
            out[row, col] -= 2.0 * (contrast[0] + contrast[1] * s + contrast[2] * t) * dark
