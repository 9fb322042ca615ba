"""Compiled maps from a board's grid to the image: a homography and, on top, the lens as a cubic polynomial.

Grid coordinates are centred and scaled to [-1, 1] before anything is solved: normal equations are then safe in double
precision, and a map of fifty corners costs some ten microseconds.
"""

from __future__ import annotations

from math import erf, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import solve_damped
from armsight.geometry.kernels import copy_1

N_H = 8
"""Entries of a homography whose last one is 1: the grid's middle is never at infinity."""
N_CUBIC = 10
POINTS_FOR_CUBIC = 24
"""A cubic has ten coefficients a coordinate; with fewer points than this it would follow single corners."""
FAR = 4.0
"""Points further from the map than this many robust standard deviations do not shape it,"""
LEAST_SPREAD_PX = 0.05
"""... which are never taken for smaller than this."""
ROUNDS = 3
"""Of leaving out what lies far from the map."""
STEPS = 8
"""Gauss-Newton steps from the linear homography to that with the smallest distances in the image: two or three do."""
STILL = 1e-8
RIDGE = 1e-11
"""Added to the diagonal, a point: three rows of points cannot tell y^3 from y; the smaller coefficients are taken."""


@inner_kernel
def _monomials(x, y, m):
    """Fill m (10,) with all monomials up to the third degree."""
    m[0], m[1], m[2] = 1.0, x, y
    m[3], m[4], m[5] = x * x, x * y, y * y
    m[6], m[7], m[8], m[9] = x * x * x, x * x * y, x * y * y, y * y * y


@inner_kernel
def _normal(g, uv, use, h, linear, A, b):
    """Fill A (8, 8), its lower half, and b (8,) with J'J and J'r of the distances at h (8,).

    linear: of the distances times the depths, at h = 0. The rows of u and v share all but the last two columns.
    """
    A[:] = 0.0
    b[:] = 0.0
    f, at, r = np.empty(3), np.empty(2), np.empty(2)
    for i in range(len(g)):
        if not use[i]:
            continue
        x, y = g[i, 0], g[i, 1]
        by = 1.0 / (h[6] * x + h[7] * y + 1.0)
        f[0], f[1], f[2] = x * by, y * by, by
        for k in range(2):
            model = h[3 * k] * f[0] + h[3 * k + 1] * f[1] + h[3 * k + 2] * by
            at[k] = uv[i, k] if linear else model
            r[k] = model - uv[i, k]
        both = at[0] * at[0] + at[1] * at[1]
        for j in range(3):
            for k in range(j + 1):
                A[j, k] += f[j] * f[k]
            b[j] += f[j] * r[0]
            b[3 + j] += f[j] * r[1]
        for j in range(2):
            for k in range(3):
                A[6 + j, k] -= at[0] * f[j] * f[k]
                A[6 + j, 3 + k] -= at[1] * f[j] * f[k]
            for k in range(j + 1):
                A[6 + j, 6 + k] += both * f[j] * f[k]
            b[6 + j] -= f[j] * (at[0] * r[0] + at[1] * r[1])
    A[3:6, 3:6] = A[:3, :3]


@inner_kernel
def _homography(g, uv, use, h):
    """Fill h (8,) with the homography of g (n, 2) to uv (n, 2) among those of use (n,); False where there is none.

    First the linear solution; then Gauss-Newton on the distances themselves.
    """
    A, b, step = np.empty((N_H, N_H)), np.empty(N_H), np.empty(N_H)
    h[:] = 0.0
    for turn in range(STEPS):
        _normal(g, uv, use, h, turn == 0, A, b)
        if not solve_damped(A, b, 0.0, step):
            return turn > 0
        moved = 0.0
        for a in range(N_H):
            h[a] += step[a]
            moved = max(moved, abs(step[a]))
        if turn > 0 and moved < STILL:
            break
    return True


@inner_kernel
def _cubic(g, rest, use, c):
    """Fill c (10, 2) with the cubic through the rests (n, 2) at g (n, 2) among those of use (n,)."""
    A, b, m = np.zeros((N_CUBIC, N_CUBIC)), np.zeros((2, N_CUBIC)), np.empty(N_CUBIC)
    for i in range(len(g)):
        if use[i]:
            _monomials(g[i, 0], g[i, 1], m)
            for j in range(N_CUBIC):
                b[0, j] -= m[j] * rest[i, 0]
                b[1, j] -= m[j] * rest[i, 1]
                for k in range(j + 1):
                    A[j, k] += m[j] * m[k]
    for j in range(N_CUBIC):
        A[j, j] += RIDGE * len(g)
    for k in range(2):
        if solve_damped(A, b[k], 0.0, m):
            copy_1(m, c[:, k])


@kernel
def fit_grid_map(grid, uv):
    """Return H (3, 3), cubic (10, 2), centre (2,), half and the distance (n,) of each point from the map, in px.

    grid (n, 2), uv (n, 2) px. Gross outliers do not pull it: they are left out, judged by the median distance.
    """
    n = len(grid)
    centre, middle = np.empty(2), np.empty(2)
    half = spread = 0.0
    for k in range(2):
        low, high = grid[:, k].min(), grid[:, k].max()
        centre[k] = 0.5 * (low + high)
        half = max(half, 0.5 * (high - low))
        middle[k] = uv[:, k].mean()
        spread = max(spread, uv[:, k].max() - uv[:, k].min())
    half, spread = max(1.0, half), max(1.0, 0.5 * spread)
    # both sides in [-1, 1]
    g, at = (grid - centre) / half, (uv - middle) / spread
    use, keep = np.ones(n, np.bool_), np.empty(n, np.bool_)
    H, cubic, distance = np.eye(3), np.zeros((N_CUBIC, 2)), np.full(n, np.inf)
    h, rest, m = np.empty(N_H), np.empty((n, 2)), np.empty(N_CUBIC)
    n_used = n
    for _ in range(ROUNDS):
        if not _homography(g, at, use, h):  # what is left lies on one line
            break
        for k in range(3):
            w = h[6 + k] if k < 2 else 1.0
            H[0, k], H[1, k], H[2, k] = spread * h[k] + middle[0] * w, spread * h[3 + k] + middle[1] * w, w
        for i in range(n):
            w = H[2, 0] * g[i, 0] + H[2, 1] * g[i, 1] + 1.0
            for k in range(2):
                rest[i, k] = uv[i, k] - (H[k, 0] * g[i, 0] + H[k, 1] * g[i, 1] + H[k, 2]) / w
        cubic[:] = 0.0
        if n_used >= POINTS_FOR_CUBIC:
            _cubic(g, rest, use, cubic)
        for i in range(n):
            _monomials(g[i, 0], g[i, 1], m)
            du, dv = rest[i, 0], rest[i, 1]
            for j in range(N_CUBIC):
                du -= m[j] * cubic[j, 0]
                dv -= m[j] * cubic[j, 1]
            distance[i] = sqrt(du * du + dv * dv)
        limit = FAR * max(1.5 * np.median(distance), LEAST_SPREAD_PX)
        n_used = same = 0
        for i in range(n):
            keep[i] = distance[i] <= limit
            n_used += keep[i]
            same += keep[i] == use[i]
        # too few to go by, or nothing changes any more
        if n_used < 0.6 * n or same == n:
            break
        use[:] = keep
    return H, cubic, centre, half, distance


@kernel
def median(x):
    """Return the median of x (n,); numpy's own takes ten times as long for so few."""
    return np.median(x)


@kernel
def map_points(H, cubic, centre, half, grid):
    """Return the pixels (n, 2) of grid coordinates (n, 2)."""
    out, m = np.empty((len(grid), 2)), np.empty(N_CUBIC)
    for i in range(len(grid)):
        x, y = (grid[i, 0] - centre[0]) / half, (grid[i, 1] - centre[1]) / half
        _monomials(x, y, m)
        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        for k in range(2):
            out[i, k] = (H[k, 0] * x + H[k, 1] * y + H[k, 2]) / w
            for j in range(N_CUBIC):
                out[i, k] += m[j] * cubic[j, k]
    return out


@kernel
def map_derivatives(H, cubic, centre, half, grid):
    """Return the image steps of one square (n, 2, 2; columns: along x, y) and second derivatives (n, 2, 3)."""
    first, second = np.empty((len(grid), 2, 2)), np.empty((len(grid), 2, 3))
    for i in range(len(grid)):
        x, y = (grid[i, 0] - centre[0]) / half, (grid[i, 1] - centre[1]) / half
        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        for k in range(2):
            c = cubic[:, k]
            u = (H[k, 0] * x + H[k, 1] * y + H[k, 2]) / w
            by_x, by_y = (H[k, 0] - u * H[2, 0]) / w, (H[k, 1] - u * H[2, 1]) / w
            # of the homography, then of the monomials
            second[i, k, 0] = -2.0 * by_x * H[2, 0] / w + 2.0 * c[3] + 6.0 * c[6] * x + 2.0 * c[7] * y
            second[i, k, 1] = -(by_x * H[2, 1] + by_y * H[2, 0]) / w + c[4] + 2.0 * c[7] * x + 2.0 * c[8] * y
            second[i, k, 2] = -2.0 * by_y * H[2, 1] / w + 2.0 * c[5] + 2.0 * c[8] * x + 6.0 * c[9] * y
            by_x += c[1] + 2.0 * c[3] * x + c[4] * y + 3.0 * c[6] * x * x + 2.0 * c[7] * x * y + c[8] * y * y
            by_y += c[2] + c[4] * x + 2.0 * c[5] * y + c[7] * x * x + 2.0 * c[8] * x * y + 3.0 * c[9] * y * y
            first[i, k, 0], first[i, k, 1] = by_x / half, by_y / half
            for j in range(3):
                second[i, k, j] /= half * half
    return first, second


@kernel
def nearest_levels(image, uv):
    """Return the grey levels (n,) of image (h, w) at the pixels nearest to uv (n, 2); beyond its edge those at it."""
    h, w = image.shape
    out = np.empty(len(uv))
    for i in range(len(uv)):
        row, column = int(np.rint(uv[i, 1])), int(np.rint(uv[i, 0]))
        out[i] = image[min(max(row, 0), h - 1), min(max(column, 0), w - 1)]
    return out


@kernel
def off_line(grid, uv, axis, at):
    """Return how far the points of a line of a grid (n, 2), those whose coordinate along an axis is place, are in the
    image (n, 2) from where the map of the others has them: the median, in squares.
    """
    line = np.abs(grid[:, axis] - at) < 0.5
    there, rest = grid[line], ~line
    smooth = fit_grid_map(grid[rest], uv[rest])[:4]
    off, first, seen = map_points(*smooth, there) - uv[line], map_derivatives(*smooth, there)[0], np.empty(len(there))
    for i in range(len(there)):
        size = min(np.hypot(first[i, 0, 0], first[i, 1, 0]), np.hypot(first[i, 0, 1], first[i, 1, 1]))
        seen[i] = np.hypot(off[i, 0], off[i, 1]) / size
    return np.median(seen)


# Drawing of a checkerboard's dark pattern into an image of grey levels, for taking it off again.

SQRT_HALF = 0.7071067811865476
INVERSE_STEPS = 3
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
            for _ in range(1 if warm else INVERSE_STEPS):
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
