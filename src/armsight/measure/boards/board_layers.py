"""Two boards in one image as layers that add up: each is fitted with the other's edges taken off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its ndimage where it is used

from armsight.arrays import Array, Mask
from armsight.measure.boards.checkerboard import (
    EXPLAINED,
    LAST_HALF_PX,
    LOW_CONTRAST,
    OFF_GRID,
    REACH,
    grid_of,
    parity_of,
)
from armsight.measure.boards.corner_detector import Grid
from armsight.measure.boards.gridmap import GridMap, fit_map, monomials
from armsight.measure.boards.kernels.gridmap import render_pattern
from armsight.measure.boards.kernels.subpixel import ALONE, EVERYTHING, LAST_STEP_PX, TRIALS, fit_corners
from armsight.records import Target

PART_SHARE = 0.25
"""So much of a board is told as a board in part."""

START_BLUR_PX = 1.0

LAYER_ROUNDS = 12
"""Each board is fitted with the other taken off, in turn; this often at most."""

SETTLED_PX = 1e-3
"""... and until the corners move by less than this, on the whole: a tenth of the noise."""

NEAR_BLURS = 4.0

NEAR_PX = 3.0
"""Corners of the two boards nearer than so many blurs, and than this, cannot be told apart: neither is used."""

OUTWARD = np.linspace(0.15, 1.5, 55)
"""Squares outside the outermost corners at which the end of the printed pattern is looked for, ..."""

INNER = 5
"""... the first of which are inside for certain."""

LAYER_LOOSE = 3.0
"""Where the other board's map is extrapolated until its variance is this many times a corner's, no corner is fitted
that has one of its corners in the window: what is taken off there may be off by more than the noise."""

SCATTER = 5.0
"""A corner further from the smooth grid than this many times the median one is pulled by something else, ..."""

STRAIGHT = 0.005
"""... but not one this near, in squares."""

RESTLESS = 1.8
"""Residuals in a corner's window, to the usual ones, that mean an edge of neither board: paper's edge, a hand, ..."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """One of the boards: its map, colours and light, and how its corners were last fitted.

    sign (n,): +1 where the square beyond a corner is white. board_edge (2, 2): where the printed pattern begins and
    ends along columns and rows, in squares. contrast (3,): half the levels between black and white,
    and its slope along columns and rows, per square. uv (n, 2), covariance (n, 2, 2), quality (n, 4) as
    fit_corners gives them. good (n,): the corners that are kept.
    """

    smooth: GridMap
    sign: Array
    board_edge: Array
    contrast: Array
    blur_px: float
    uv: Array
    covariance: Array
    quality: Array
    good: Mask


def with_edge(board: Target) -> Array:
    """Return the grid coordinates of the board's corners and of the black squares' ends round them."""
    s, t = np.meshgrid(np.arange(-1.0, board.columns + 1.0), np.arange(-1.0, board.rows + 1.0))
    return np.stack([s.ravel(), t.ravel()], axis=1)


def first_layer(grid: Grid, board: Target) -> Layer:
    """Return the board as the corners of its grid show it, before anything was fitted."""
    n = len(board.names)
    smooth = grid.smooth()
    return Layer(
        smooth=smooth,
        sign=-grid.first * parity_of(board),
        board_edge=np.array([[-1.0, -1.0], [board.columns, board.rows]]),
        contrast=np.zeros(3),
        blur_px=START_BLUR_PX,
        uv=smooth(grid_of(board)),
        covariance=np.zeros((n, 2, 2)),
        quality=np.zeros((n, 4)),
        good=np.ones(n, dtype=np.bool_),
    )


def separate_layers(light: Array, board: Target, layers: tuple[Layer, Layer]) -> tuple[Layer, Layer]:
    """Return both boards fitted, each in the image without the other, until they rest."""
    one, two = (measure_layer(light, layer, None, board) for layer in layers)
    for _ in range(LAYER_ROUNDS):
        before = np.concatenate([one.uv[one.good], two.uv[two.good]])
        kept = one.good, two.good
        one = measure_layer(light, one, two, board)
        two = measure_layer(light, two, one, board)
        if (kept[0] == one.good).all() and (kept[1] == two.good).all():
            moved = np.concatenate([one.uv[one.good], two.uv[two.good]]) - before
            if np.sqrt(np.mean(moved**2)) < SETTLED_PX:
                break
    return one, two


def take_off(light: Array, layer: Layer, board: Target) -> None:
    """Add to an image the light that a board's printed pattern holds back."""
    smooth = layer.smooth
    render_pattern(
        (np.ascontiguousarray(smooth.H), np.ascontiguousarray(smooth.cubic), smooth.centre, smooth.half),
        board.columns,
        board.rows,
        layer.board_edge,
        float(layer.sign[0]),
        -layer.contrast,
        layer.blur_px,
        light,
    )


def without_layer(light: Array, other: Layer | None, board: Target) -> Array:
    """Return the image (h, w) with the other board, if there is one, taken off."""
    rest = light.copy()
    if other is not None:
        take_off(rest, other, board)
    return rest


def measure_layer(light: Array, layer: Layer, other: Layer | None, board: Target) -> Layer:
    """Return a board fitted anew in the image without the other one."""
    grid, smooth = grid_of(board), layer.smooth
    E, Q = smooth.derivatives(grid)
    size = np.linalg.norm(E, axis=1)
    reach = np.minimum(REACH, LAST_HALF_PX / size.max(axis=1))
    n = len(grid)
    rest = without_layer(light, other, board)
    uv, covariance, quality, _ = fit_corners(
        rest, smooth(grid), E, Q, reach, layer.sign, ALONE, LAST_STEP_PX, TRIALS, EVERYTHING
    )
    if other is None:  # half of the corners are disturbed: the others tell light and blur, the map stays
        clear = quality[:, 0] >= np.median(quality[:, 0])
        contrast, blur = np.median(quality[clear, 1:3], axis=0)
        return replace(layer, uv=uv, quality=quality, contrast=np.array([contrast, 0.0, 0.0]), blur_px=float(blur))
    good = _good(layer, other, board, uv, quality, size.min(axis=1))
    if np.count_nonzero(good) < PART_SHARE * n:  # nothing to go by: as it was
        return replace(layer, uv=uv, covariance=covariance, quality=quality, good=good)
    smooth = fit_map(grid[good], uv[good])[0]
    return Layer(
        smooth=smooth,
        sign=layer.sign,
        board_edge=_board_edge(rest, smooth, layer, board),
        contrast=_slope(grid[good], quality[good, 1]),
        blur_px=float(np.median(quality[good, 2])),
        uv=uv,
        covariance=covariance,
        quality=quality,
        good=good,
    )


def _good(layer: Layer, other: Layer, board: Target, uv: Array, quality: Array, size: Array) -> Mask:
    """Tell which corners (n,) are fitted well, and by themselves."""
    grid = grid_of(board)
    good = quality[:, 0] > EXPLAINED
    distance = np.linalg.norm(uv - layer.smooth(grid), axis=1)
    good &= distance < OFF_GRID * size
    if not good.any():
        return np.asarray(good)
    good &= distance < np.clip(SCATTER * np.median(distance[good]), STRAIGHT * size, OFF_GRID * size)
    good &= quality[:, 1] > LOW_CONTRAST * np.median(quality[good, 1])
    good &= quality[:, 3] < RESTLESS * np.median(quality[good, 3])
    edge = np.clip(with_edge(board), *other.board_edge)
    gap = np.linalg.norm(layer.smooth(grid)[:, None] - other.smooth(edge)[None], axis=2)  # (n, edge)
    loose = _leverage(grid[other.good], edge) > LAYER_LOOSE
    limit = np.where(loose, REACH * size[:, None], max(NEAR_PX, NEAR_BLURS * layer.blur_px))
    return np.asarray(good & (gap > limit).all(axis=1))


def _leverage(known: Array, grid: Array) -> Array:
    """Return the variance (m,) at grid (m, 2) of a cubic through corners at known (n, 2), by that of one corner."""
    centre = grid.mean(axis=0)
    scale = np.abs(grid - centre).max()
    A, B = monomials((known - centre) / scale), monomials((grid - centre) / scale)
    normal = A.T @ A + 1e-9 * np.eye(A.shape[1])
    return np.asarray(np.einsum("ij,ij->i", B, np.linalg.solve(normal, B.T).T))


def _board_edge(rest: Array, smooth: GridMap, layer: Layer, board: Target) -> Array:
    """Return where the printed pattern ends on the four sides, (2, 2): printed or cut boards have outer squares of any
    width.

    Beyond its end the outer black squares look as the white ones between them: the difference falls by half there.
    """
    out = layer.board_edge.copy()
    count = (board.columns, board.rows)
    for axis in range(2):
        beside = np.arange(-0.5, count[1 - axis])[1:-1]  # middles of the squares along the side, without the ends
        for end in range(2):
            foot = float(end * (count[axis] - 1))
            grid = np.empty((len(beside), len(OUTWARD), 2))
            grid[:, :, axis] = foot + (OUTWARD if end else -OUTWARD)
            grid[:, :, 1 - axis] = beside[:, None]
            uv = smooth(grid.reshape(-1, 2))
            level = scipy.ndimage.map_coordinates(rest, uv.T[::-1], order=1, mode="nearest").reshape(grid.shape[:2])
            cell = np.floor(grid[:, 0]).sum(axis=1).astype(np.intp)
            white = np.where(cell % 2 == 0, layer.sign[0], -layer.sign[0]) > 0.0
            if white.all() or not white.any():
                continue
            fall = np.median(level[white], axis=0) - np.median(level[~white], axis=0)
            past = np.flatnonzero(fall < 0.5 * np.median(fall[:INNER]))
            if len(past) and past[0] > 0:
                i = int(past[0])
                share = (fall[i - 1] - 0.5 * np.median(fall[:INNER])) / (fall[i - 1] - fall[i])
                way = OUTWARD[i - 1] + share * (OUTWARD[i] - OUTWARD[i - 1])
                out[end, axis] = foot + (way if end else -way)
    return out


def _slope(grid: Array, contrast: Array) -> Array:
    """Return the contrast's plane (3,) over the grid: at the first corner, along columns, along rows."""
    design = np.column_stack([np.ones(len(grid)), grid])
    return np.asarray(np.linalg.lstsq(design, contrast, rcond=None)[0])
