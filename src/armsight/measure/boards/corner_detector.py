"""Grids of checkerboard corners in an image where several boards may lie over each other.

Where two images are added, the edges of one run through the squares of the other. A corner's mixed derivative along the
board's two edge directions is untouched by that: any edge along either of them, f(x) + g(y), has none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # loads its ndimage where it is used

from armsight.arrays import Array, Index, Mask
from armsight.measure.boards.gridmap import GridMap, fit_map

Cell = tuple[int, int]

SCALE_PX = 2.0
"""Of the Gaussian whose derivatives are taken: above the blur of a sharp lens, far below a square."""
APART_PX = 4
"""Two corners nearer to each other than this show as one."""
WEAK = 0.12
"""Share of the strong corners' response below which a maximum is no corner."""
LOUD = 6.0
"""... and so many standard deviations of the noise: among half a million pixels of noise the largest has five."""
STRONG = 40
"""How many of the strongest maxima set what is usual."""
MANY_CORNERS = 800
"""More maxima than this are not looked at, the weakest first."""
BINS = 180
SMOOTH_BINS = 4.0
OFF_AXIS_DEG = 30.0
"""The two edge directions are at least this far apart: a board more slanted is not found."""
AIM = 0.95
"""Cosine between a step along the grid and its edge direction: perspective turns it by some degrees."""
LEAST_STEP_PX = 8.0
SLENDER = 4.0
FLAT_RESPONSE = 0.3
"""Sine of the angle between a square's sides below which it is no square."""
NEIGHBOURS = 6
"""Along each direction so many maxima are tried as the next corner: those of the other board lie between."""
NEAR = 0.08
NEAR_PX = (2.0, 5.0)
"""A corner is this near to where the grid predicts it: in squares, but in px not less than and no more than that."""
SETTLED_CORNERS = 16
"""A grid of so many corners predicts the next ones twice as well."""
SEEDS = 80
"""Corners tried as the first of a grid, the strongest first."""
BEYOND = 0.75
"""Response of a corner outside the board's size, to the median one, that means that the board goes on."""
MISSING = 0.1
EDGE_WORTH = 0.75
CLIP = 1.3
"""What a cell of a board is worth: its response by the usual one (at most CLIP) less EDGE_WORTH; a corner at the
board's edge has 0.5 and is worth less than nothing, and a cell without a corner costs MISSING."""
PAIR_SHARE = 0.4
"""Windows worth less than this share of the best are no board."""
GAIN = 0.3
"""Two boards hold more than one by this share of a board."""
DOUBLED = 1.4
"""Response where two boards' corners fall on one another, to the others': less means one board that is bigger."""
ENOUGH = 0.9
"""A grid with this share of the board's corners is not improved upon."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Saddles:
    """Maxima of the mixed derivative: uv (n, 2) px, strongest first; response (n,), signed.

    axes (2, 2): rows are the unit edge directions. The response is positive where the sector between them is bright.
    """

    uv: Array
    response: Array
    axes: Array

    @property
    def usual(self) -> float:
        """The response of a strong one."""
        return float(np.median(np.abs(self.response[:STRONG]))) if len(self.response) else 0.0

    def stronger(self, response: float) -> Saddles:
        """Return those of a larger response."""
        keep = np.abs(self.response) > response
        return Saddles(uv=self.uv[keep], response=self.response[keep], axes=self.axes)

    def without(self, points_px: Array, radius_px: float) -> Saddles:
        """Return those that are further than the radius from all the points (m, 2)."""
        gap = np.linalg.norm(self.uv[:, None] - points_px[None], axis=2).min(axis=1, initial=np.inf)
        keep = gap > radius_px
        return Saddles(uv=self.uv[keep], response=self.response[keep], axes=self.axes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Corners by their cell.

    cells (n, 2) from 0 to the board's size, right-handed in the image; uv (n, 2) px; strength (n,) of response.
    first: +1 where the square beyond cell (0, 0) is bright, -1 where dark. beyond (m, 2): px of
    corners that were met outside the board's size.
    """

    cells: Index
    uv: Array
    strength: Array
    first: float
    beyond: Array

    def smooth(self) -> GridMap:
        """Return the map from squares to px."""
        return fit_map(self.cells.astype(float), self.uv)[0]


def find_saddles(image: Array) -> Saddles:
    """Return the corners of whatever boards there are in an image (h, w) of grey levels; others' too, weaker ones."""
    axes = edge_directions(image)
    g = np.asarray(image, dtype=np.float64)
    xx, yy, xy = (
        scipy.ndimage.gaussian_filter(g, SCALE_PX, order=order, mode="nearest") for order in ((0, 2), (2, 0), (1, 1))
    )
    (a, b), (c, d) = axes
    mixed = a * c * xx + (a * d + b * c) * xy + b * d * yy
    strength = np.abs(mixed)
    peak = (strength == scipy.ndimage.maximum_filter(strength, 2 * APART_PX + 1)) & (strength > 0.0)
    peak[:2] = peak[-2:] = peak[:, :2] = peak[:, -2:] = False
    row, col = np.nonzero(peak)
    order = np.argsort(-strength[row, col])[:MANY_CORNERS]
    row, col = row[order], col[order]
    if len(row) == 0:
        return Saddles(uv=np.empty((0, 2)), response=np.empty(0), axes=axes)
    usual = float(np.median(strength[row[:STRONG], col[:STRONG]]))
    noise = float(np.median(strength[::2, ::2])) / 0.6745
    strong = strength[row, col] > max(WEAK * usual, LOUD * noise)
    row, col = row[strong], col[strong]
    return Saddles(uv=_peaks(strength, row, col), response=mixed[row, col], axes=axes)


def _peaks(strength: Array, row: Index, col: Index) -> Array:
    """Return the positions (n, 2) of maxima, by a parabola along each axis."""
    out = []
    for dv, du in ((0, 1), (1, 0)):
        before, here, after = (strength[row + k * dv, col + k * du] for k in (-1, 0, 1))
        bend = np.maximum(2.0 * here - before - after, 1e-12)
        out.append(np.clip(0.5 * (after - before) / bend, -0.5, 0.5))
    return np.stack([col + out[0], row + out[1]], axis=1)


def edge_directions(image: Array) -> Array:
    """Return the two directions (2, 2) along which most edges run, as unit rows: towards the right, towards below."""
    gx = scipy.ndimage.gaussian_filter(image, 0.5 * SCALE_PX, order=(0, 1), mode="nearest")
    gy = scipy.ndimage.gaussian_filter(image, 0.5 * SCALE_PX, order=(1, 0), mode="nearest")
    power = gx * gx + gy * gy
    angle = np.mod(np.arctan2(gy, gx) + 0.5 * np.pi, np.pi)  # of the edge
    bin_index = np.minimum((angle * (BINS / np.pi)).astype(np.intp), BINS - 1)
    votes = np.bincount(bin_index.ravel(), weights=power.ravel(), minlength=BINS)
    votes = scipy.ndimage.gaussian_filter(votes, SMOOTH_BINS, mode="wrap")
    first = int(np.argmax(votes))
    away = np.abs((np.arange(BINS) - first + BINS // 2) % BINS - BINS // 2) * (180.0 / BINS)
    second = int(np.argmax(np.where(away >= OFF_AXIS_DEG, votes, -1.0)))
    axes = [np.array([np.cos(a), np.sin(a)]) for a in (np.array([first, second]) + 0.5) * (np.pi / BINS)]
    axes.sort(key=lambda e: -abs(e[0]))
    right, down = axes[0] * (1.0 if axes[0][0] >= 0 else -1.0), axes[1] * (1.0 if axes[1][1] >= 0 else -1.0)
    return np.stack([right, down])


def find_grids(saddles: Saddles, columns: int, rows: int) -> tuple[Grid, ...]:
    """Return the grid that holds most of a board's corners; two where they fall on one another and grow as one."""
    best: tuple[Grid, ...] = ()
    most = 0
    for start in _starts(saddles):
        cells, members = _grow(saddles, start, columns, rows)
        if min(len(cells), columns * rows) <= most:
            continue
        grids = _windows(saddles, cells, members, columns, rows)
        held = max(len(grid.cells) for grid in grids) if len(grids) == 1 else columns * rows
        if held > most:
            best, most = grids, held
        if most >= ENOUGH * columns * rows:
            break
    return best


def _starts(saddles: Saddles) -> Iterator[Index]:
    """Yield quadruples of saddles (4,) that may be corners of one square, round it, the strongest first."""
    uv, sign = saddles.uv, np.sign(saddles.response)
    for p in range(min(SEEDS, len(uv))):
        step = uv - uv[p]
        length = np.linalg.norm(step, axis=1)
        ahead = []
        for axis in saddles.axes:
            along = (step @ axis > AIM * length) & (length > LEAST_STEP_PX) & (sign == -sign[p])
            there = np.flatnonzero(along)
            ahead.append(there[np.argsort(length[there])][:NEIGHBOURS])
        for q in ahead[0]:
            for r in ahead[1]:
                a, b = step[q], step[r]
                open_enough = abs(a[0] * b[1] - a[1] * b[0]) > FLAT_RESPONSE * length[q] * length[r]
                if not (1.0 / SLENDER < length[q] / length[r] < SLENDER and open_enough):
                    continue
                gap = np.linalg.norm(uv - (uv[q] + uv[r] - uv[p]), axis=1)
                gap[sign != sign[p]] = np.inf
                s = int(np.argmin(gap))
                if gap[s] < 2.0 * _near(min(length[q], length[r])):
                    yield np.array([p, q, s, r])


def _near(size_px: Array | float) -> Array:
    """Return how near to its prediction a corner is, px, for squares of a size."""
    return np.clip(NEAR * np.asarray(size_px), *NEAR_PX)


def _grow(saddles: Saddles, start: Index, columns: int, rows: int) -> tuple[Index, Index]:
    """Return the cells (n, 2) and the saddles (n,) of the grid that one square grows into, each step by prediction."""
    uv, sign = saddles.uv, np.sign(saddles.response)
    cells = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    members = start
    longest = 2 * max(columns, rows) + 2  # of two boards that fall on one another
    around = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    while True:
        smooth = fit_map(cells.astype(float), uv[members])[0]
        new = np.unique((cells[:, None] + around[None]).reshape(-1, 2), axis=0)
        new = new[~(new[:, None] == cells[None]).all(axis=2).any(axis=1)]
        new = new[(np.maximum(new, cells.max(axis=0)) - np.minimum(new, cells.min(axis=0)) < longest).all(axis=1)]
        if len(new) == 0:
            return cells, members
        grid = new.astype(float)
        size = np.linalg.norm(smooth.derivatives(grid)[0], axis=1).min(axis=1)
        gap = np.linalg.norm(uv[None] - smooth(grid)[:, None], axis=2)
        wanted = np.where(new.sum(axis=1) % 2 == 0, 1.0, -1.0) * sign[start[0]]
        gap[sign[None] != wanted[:, None]] = np.inf
        gap[:, members] = np.inf
        near = np.argmin(gap, axis=1)
        tight = 1.0 if len(cells) < SETTLED_CORNERS else 0.5
        met = gap[np.arange(len(new)), near] < tight * _near(size)
        _, once = np.unique(near[met], return_index=True)
        if len(once) == 0:
            return cells, members
        cells = np.concatenate([cells, new[met][once]])
        members = np.concatenate([members, near[met][once]])


def _windows(saddles: Saddles, cells: Index, members: Index, columns: int, rows: int) -> tuple[Grid, ...]:
    """Return the part of a grown grid that is the board's size, where its corners are strongest; two parts where the
    corners are those of two boards, doubled where both are.

    The ends of the black squares at the board's edge respond too, half as much as a corner between four squares.
    """
    cells = cells - cells.min(axis=0)
    strength = np.abs(saddles.response[members])
    usual = float(np.median(strength))
    worth = np.full(cells.max(axis=0) + 1 + 2 * max(columns, rows), -MISSING)
    pad = max(columns, rows)
    worth[cells[:, 0] + pad, cells[:, 1] + pad] = np.minimum(strength / usual, CLIP) - EDGE_WORTH
    best: tuple[float, list[Cell], tuple[int, int]] = (-np.inf, [], (columns, rows))
    for size in {(columns, rows), (rows, columns)}:
        for value, corners in _best_windows(worth, size, pad):
            if value > best[0]:
                best = value, corners, size
    _, corners, size = best
    masks = [_inside(cells, corner, size) for corner in corners]
    if len(masks) == 2:
        both = masks[0] & masks[1]
        either = masks[0] ^ masks[1]
        if not both.any() or np.median(strength[both]) > DOUBLED * np.median(strength[either]):
            return tuple(
                _grid(saddles, cells, members, mask & ~both, ~(both | either), corner, size, size == (columns, rows))
                for mask, corner in zip(masks, corners, strict=True)
            )
        masks, corners = masks[:1], corners[:1]
    return (_grid(saddles, cells, members, masks[0], ~masks[0], corners[0], size, size == (columns, rows)),)


def _inside(cells: Index, corner: Cell, size: tuple[int, int]) -> Mask:
    """Tell which cells (n, 2) are in a window."""
    start = np.array(corner)
    return np.asarray(((cells >= start) & (cells < start + np.array(size))).all(axis=1))


def _best_windows(worth: Array, size: tuple[int, int], pad: int) -> Iterator[tuple[float, list[Cell]]]:
    """Yield the most worthy window of a size, and the most worthy pair of them, with their first cells."""
    w, h = size
    total = np.pad(worth.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    sums = total[w:, h:] - total[:-w, h:] - total[w:, :-h] + total[:-w, :-h]
    i, j = np.unravel_index(int(np.argmax(sums)), sums.shape)
    single = float(sums[i, j])
    yield single, [(int(i) - pad, int(j) - pad)]
    able = np.argwhere(sums > PAIR_SHARE * single)
    if single <= 0.0 or (worth.shape[0] - 2 * pad <= w + 2 and worth.shape[1] - 2 * pad <= h + 2):
        return
    best, pair = -np.inf, (able[0], able[0])
    for n, first in enumerate(able):
        for second in able[n + 1 :]:
            low, high = np.maximum(first, second), np.minimum(first, second) + np.array([w, h])
            value = float(sums[tuple(first)] + sums[tuple(second)])
            if (low < high).all():
                value -= float(worth[low[0] : high[0], low[1] : high[1]].sum())
            if value > best and np.abs(second - first).sum() % 2 == 0:
                best, pair = value, (first, second)
    if best > single + GAIN * w * h * (1.0 - EDGE_WORTH):
        yield best, [(int(c[0]) - pad, int(c[1]) - pad) for c in pair]


def _grid(
    saddles: Saddles,
    cells: Index,
    members: Index,
    inside: Mask,
    outside: Mask,
    corner: Cell,
    size: tuple[int, int],
    upright: bool,
) -> Grid:
    """Return the corners inside a window, counted from its own corner along the board's columns and rows."""
    node = cells[inside] - corner
    response = saddles.response[members]
    sign = float(np.sign(np.sum(np.where(node.sum(axis=1) % 2 == 0, 1.0, -1.0) * response[inside])))
    beyond = outside & (np.abs(response) > BEYOND * np.median(np.abs(response[inside])))
    if not upright:  # a quarter turn: rows become columns, the other way round; the other two sectors come first
        node = np.stack([size[1] - 1 - node[:, 1], node[:, 0]], axis=1)
        sign = -sign if size[1] % 2 == 1 else sign
    return Grid(
        cells=node,
        uv=saddles.uv[members[inside]],
        strength=np.abs(response[inside]),
        first=sign,
        beyond=saddles.uv[members[beyond]],
    )
