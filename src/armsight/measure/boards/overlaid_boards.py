"""One board seen twice in one image: the views of a mirror rig, added on one sensor (Pachidis et al. 2005)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from armsight.errors import BadImage, Inconsistent
from armsight.measure.boards.checkerboard import (
    BLUR_SHARE,
    EXPLAINED,
    LAST_HALF_PX,
    LOW_CONTRAST,
    OFF_GRID,
    REACH,
    grid_of,
    number_corners,
    parity_of,
)
from armsight.measure.boards.corner_detector import ENOUGH, Grid, Saddles, find_grids, find_saddles
from armsight.measure.boards.find import check_exposure, grey_image
from armsight.measure.boards.gridmap import GridMap, fit_map, monomials
from armsight.measure.boards.kernels.render_board import draw_ink
from armsight.measure.boards.kernels.subpixel import fit_corners
from armsight.measure.boards.orient import same_way_up
from armsight.records import BoardView, Target, TargetKind

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SEEN_SHARE = 0.5
"""A board of which fewer corners are seen than this is refused,"""
PLACED_SHARE = 0.5
"""... and one of which fewer can be placed: what is known of the other board then comes from too few, and errors of 40
deviations were met among 24 corners of 54."""
PART_SHARE = 0.25
"""So much of a board is told as a board in part."""
FAINT = 0.3
"""What is left of a board that was taken off responds less than this share of it."""
RIM_SHARE = 0.7
"""Corners of the outer rows and columns respond as the others do; the ends of the rim's black squares by half."""
ON_PX = 2.0
"""Corners this near to a board's own are not looked for again."""
START_BLUR_PX = 1.0
ROUNDS = 12
"""Each board is fitted with the other taken off, in turn; this often at most."""
SETTLED_PX = 1e-3
"""... and until the corners move by less than this, on the whole: a tenth of the noise."""
NEAR_BLURS = 4.0
NEAR_PX = 3.0
"""Corners of the two boards nearer than so many blurs, and than this, cannot be told apart: neither is used."""
OUTWARD = np.linspace(0.15, 1.5, 55)
"""Squares outside the outermost corners at which the end of the ink is looked for, ..."""
INNER = 5
"""... the first of which are inside for certain."""
MAP_SIZE = 22
"""Numbers in a homography and cubics on top that it does not hold itself (8 + 20 - 6, the first-order ones shared)."""
LOOSE = 3.0
"""Where the other board's map is extrapolated until its variance is this many times a corner's, no corner is fitted
that has one of its corners in the window: what is taken off there may be off by more than the noise."""
SCATTER = 5.0
"""A corner further from the smooth grid than this many times the median one is pulled by something else, ..."""
STRAIGHT = 0.005
"""... but not one this near, in squares."""
RESTLESS = 1.8
"""Residuals in a corner's window, to the usual ones, that mean an edge of neither board: paper's rim, a hand, ..."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """One of the boards: its map, colours and light, and how its corners were last fitted.

    sign (n,): +1 where the square beyond a corner is white. rim (2, 2): where the ink begins and ends along columns and
    rows, in squares. contrast (3,): half the levels between black and white,
    and its slope along columns and rows, per square. uv (n, 2), covariance (n, 2, 2), quality (n, 4) as
    fit_corners gives them. good (n,): the corners that are kept.
    """

    smooth: GridMap
    sign: Array
    rim: Array
    contrast: Array
    blur_px: float
    uv: Array
    covariance: Array
    quality: Array
    good: Mask


def find_two_boards(image: Image, board: Target, *, source: str = "") -> tuple[BoardView, BoardView]:
    """Return the board as the left and as the right camera of a mirror rig sees it, from one complex image.

    image: uint8 (h, w) grey or (h, w, 3) BGR, the sum of two views that each show the whole checkerboard, in about
    the same size and attitude; they may overlap. The left view is the one further to the image's right (MATH 3.1:
    u_L - u_0L > u_R - u_0R for all points in front). Each board's corners are fitted with the other one's edges
    taken off; corners too near to one of the other board's are left out of the view, as are those on an edge that
    belongs to neither. Points are numbered as find_board does, and alike in both views.

    Raises BadImage, saying why: one board, three, in part, of another size, falling on one another, blurred;
    Inconsistent where the target is no checkerboard.
    """
    if board.kind is not TargetKind.CHECKERBOARD:
        raise Inconsistent(
            f"a target of kind {board.kind.value} cannot be found twice in one image", cure="Give a checkerboard"
        )
    source = source or "the image"
    grey = grey_image(image, source)
    check_exposure(grey, source)
    light = grey.astype(np.float64)
    layers = _separate(light, board, _two_layers(light, board, source))
    views = [_view(light, board, *pair, source) for pair in (layers, layers[::-1])]
    views.sort(key=lambda view: -_across(view, board))
    left, right = views
    return left, same_way_up(left, right, board)


def _two_layers(light: Array, board: Target, source: str) -> tuple[Layer, Layer]:
    """Return both boards as the corners' responses show them; raises BadImage where there are not two."""
    saddles = find_saddles(light)
    grids = find_grids(saddles, board.columns, board.rows)
    if not grids or len(grids[0].cells) < PART_SHARE * len(board.names):
        raise _refusal(f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found")
    if len(grids) == 2:
        layers = _start(grids[0], board), _start(grids[1], board)
        for part, other in zip(grids, layers[::-1], strict=True):
            _check_size(part, other, board, source)
    else:
        _check_whole(grids[0], board, source)
        first = _start(grids[0], board)
        grid = _second(light, saddles, first, board)
        if grid is None:
            _check_size(grids[0], None, board, source)
            raise _refusal(
                f"{source}: the board of {board.columns}x{board.rows} inner corners is there only once",
                cure="Show the whole board to both views, and no other way round the mirrors",
            )
        layers = first, _start(grid, board)
        for part, other in ((grids[0], layers[1]), (grid, first)):
            _check_size(part, other, board, source)
        _check_whole(grid, board, source)
    rest = saddles
    for layer in layers:
        _check_inside(layer, light, board, source)
        rest = rest.without(layer.smooth(_with_rim(board)), 2.0 * ON_PX)
    more = find_grids(rest, board.columns, board.rows)
    if more and len(more[0].cells) >= SEEN_SHARE * len(board.names):
        raise _refusal(f"{source}: the board is there three times or more", cure="Show one board, once in each view")
    return layers


def _second(light: Array, saddles: Saddles, first: Layer, board: Target) -> Grid | None:
    """Return the board beside the one found, or a part: in the image without that one, or among the other corners."""
    rim = first.smooth(_with_rim(board))
    without = light.copy()
    _take_off(without, _measure(light, first, None, board), board)
    rest = find_saddles(without).stronger(FAINT * saddles.usual)
    found: tuple[Grid, ...] = ()
    for others in (rest, rest.without(rim, ON_PX), saddles.without(rim, ON_PX)):
        grids = find_grids(others, board.columns, board.rows)
        if grids and (not found or len(grids[0].cells) > len(found[0].cells)):
            found = grids
        if found and len(found[0].cells) >= ENOUGH * len(board.names):
            break
    return found[0] if found and len(found[0].cells) >= PART_SHARE * len(board.names) else None


def _check_whole(grid: Grid, board: Target, source: str) -> None:
    """Raise BadImage for a grid that shows a part of the board only, or one of another size."""
    size = np.ptp(grid.cells, axis=0) + 1
    usual = np.median(grid.strength)
    for axis in range(2):
        for end in (grid.cells[:, axis].min(), grid.cells[:, axis].max()):
            if np.median(grid.strength[grid.cells[:, axis] == end]) < RIM_SHARE * usual:
                raise _refusal(
                    f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found, but one with "
                    f"fewer {'columns' if axis == 0 else 'rows'}, or a part of one",
                    cure="Count the inner corners again, show the whole board to both views, or move it a little: "
                    "corners of the two views may fall on one another",
                )
    if len(grid.cells) < SEEN_SHARE * len(board.names) or (size != [board.columns, board.rows]).any():
        raise _refusal(
            f"{source}: one of the two boards is there in part: {size[0]}x{size[1]} of its "
            f"{board.columns}x{board.rows} inner corners",
            cure="Show the whole board to both views",
        )


def _check_size(grid: Grid, other: Layer | None, board: Target, source: str) -> None:
    """Raise BadImage where a board goes on beyond its size, with corners that are not the other board's."""
    strange = grid.beyond
    if other is not None and len(strange):
        rim = other.smooth(_with_rim(board))
        strange = strange[np.linalg.norm(strange[:, None] - rim[None], axis=2).min(axis=1) > 2.0 * ON_PX]
    if len(strange) > 0.5 * min(board.columns, board.rows):
        raise _refusal(
            f"{source}: {len(strange)} corners continue a board beyond {board.columns}x{board.rows} inner corners",
            cure="Count the inner corners again; where they are right, look for a third reflection, or move the board: "
            "corners of the two views may fall on one another",
        )


def _check_inside(layer: Layer, light: Array, board: Target, source: str) -> None:
    """Raise BadImage where a board reaches out of the image."""
    uv = layer.smooth(grid_of(board))
    if (uv < 0.0).any() or (uv > [light.shape[1] - 1.0, light.shape[0] - 1.0]).any():
        raise _refusal(
            f"{source}: one of the two boards is half out of the image", cure="Show the whole board to both views"
        )


def _refusal(
    cause: str, cure: str = "Show the whole board, sharp and evenly lit, and count its inner corners"
) -> BadImage:
    return BadImage(cause, consequence="The image is not used", cure=cure)


def _with_rim(board: Target) -> Array:
    """Return the grid coordinates of the board's corners and of the black squares' ends round them."""
    s, t = np.meshgrid(np.arange(-1.0, board.columns + 1.0), np.arange(-1.0, board.rows + 1.0))
    return np.stack([s.ravel(), t.ravel()], axis=1)


def _start(grid: Grid, board: Target) -> Layer:
    n = len(board.names)
    smooth = grid.smooth()
    return Layer(
        smooth=smooth,
        sign=-grid.first * parity_of(board),
        rim=np.array([[-1.0, -1.0], [board.columns, board.rows]]),
        contrast=np.zeros(3),
        blur_px=START_BLUR_PX,
        uv=smooth(grid_of(board)),
        covariance=np.zeros((n, 2, 2)),
        quality=np.zeros((n, 4)),
        good=np.ones(n, dtype=np.bool_),
    )


def _separate(light: Array, board: Target, layers: tuple[Layer, Layer]) -> tuple[Layer, Layer]:
    """Return both boards fitted, each in the image without the other, until they rest."""
    one, two = (_measure(light, layer, None, board) for layer in layers)
    for _ in range(ROUNDS):
        before = np.concatenate([one.uv[one.good], two.uv[two.good]])
        kept = one.good, two.good
        one = _measure(light, one, two, board)
        two = _measure(light, two, one, board)
        if (kept[0] == one.good).all() and (kept[1] == two.good).all():
            moved = np.concatenate([one.uv[one.good], two.uv[two.good]]) - before
            if np.sqrt(np.mean(moved**2)) < SETTLED_PX:
                break
    return one, two


def _take_off(light: Array, layer: Layer, board: Target) -> None:
    """Add to an image the light that a board's ink holds back."""
    smooth = layer.smooth
    draw_ink(
        np.ascontiguousarray(smooth.H),
        np.ascontiguousarray(smooth.cubic),
        smooth.centre,
        smooth.half,
        board.columns,
        board.rows,
        layer.rim,
        float(layer.sign[0]),
        -layer.contrast,
        layer.blur_px,
        light,
    )


def _without(light: Array, other: Layer | None, board: Target) -> Array:
    rest = light.copy()
    if other is not None:
        _take_off(rest, other, board)
    return rest


def _measure(light: Array, layer: Layer, other: Layer | None, board: Target) -> Layer:
    """Return a board fitted anew in the image without the other one."""
    grid, smooth = grid_of(board), layer.smooth
    E, Q = smooth.derivatives(grid)
    size = np.linalg.norm(E, axis=1)
    reach = np.minimum(REACH, LAST_HALF_PX / size.max(axis=1))
    n = len(grid)
    uv, covariance, quality = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 4))
    contiguous = np.ascontiguousarray
    rest = _without(light, other, board)
    fit_corners(
        rest,
        contiguous(smooth(grid)),
        contiguous(E),
        contiguous(Q),
        contiguous(reach),
        contiguous(layer.sign),
        uv,
        covariance,
        quality,
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
        rim=_rim(rest, smooth, layer, board),
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
    rim = np.clip(_with_rim(board), *other.rim)
    gap = np.linalg.norm(layer.smooth(grid)[:, None] - other.smooth(rim)[None], axis=2)  # (n, rim)
    loose = _leverage(grid[other.good], rim) > LOOSE
    limit = np.where(loose, REACH * size[:, None], max(NEAR_PX, NEAR_BLURS * layer.blur_px))
    return np.asarray(good & (gap > limit).all(axis=1))


def _leverage(known: Array, grid: Array) -> Array:
    """Return the variance (m,) at grid (m, 2) of a cubic through corners at known (n, 2), by that of one corner."""
    centre = grid.mean(axis=0)
    scale = np.abs(grid - centre).max()
    A, B = monomials((known - centre) / scale), monomials((grid - centre) / scale)
    normal = A.T @ A + 1e-9 * np.eye(A.shape[1])
    return np.asarray(np.einsum("ij,ij->i", B, np.linalg.solve(normal, B.T).T))


def _rim(rest: Array, smooth: GridMap, layer: Layer, board: Target) -> Array:
    """Return where the ink ends on the four sides, (2, 2): printed or cut boards have outer squares of any width.

    Beyond its end the outer black squares look as the white ones between them: the difference falls by half there.
    """
    out = layer.rim.copy()
    count = (board.columns, board.rows)
    for axis in range(2):
        beside = np.arange(-0.5, count[1 - axis])[1:-1]  # middles of the squares along the side, without the ends
        for end in range(2):
            foot = float(end * (count[axis] - 1))
            grid = np.empty((len(beside), len(OUTWARD), 2))
            grid[:, :, axis] = foot + (OUTWARD if end else -OUTWARD)
            grid[:, :, 1 - axis] = beside[:, None]
            uv = smooth(grid.reshape(-1, 2))
            level = map_coordinates(rest, uv.T[::-1], order=1, mode="nearest").reshape(grid.shape[:2])
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


def _view(light: Array, board: Target, layer: Layer, other: Layer, source: str) -> BoardView:
    """Return the board of a layer, its points numbered as everywhere; raises BadImage where too few are left."""
    lost = int(np.count_nonzero(~layer.good))
    if lost > (1.0 - PLACED_SHARE) * len(layer.good):
        raise _refusal(
            f"{source}: {lost} of {len(layer.good)} corners of one board cannot be placed: they fall on the other "
            "board's, are hidden or are not corners",
            cure="Move the board a little, nearer or further, or turn it",
        )
    smooth, grid = layer.smooth, grid_of(board)
    size = np.linalg.norm(smooth.derivatives(grid)[0], axis=1).min(axis=1)
    blur = float(np.median(layer.quality[layer.good, 2] / size[layer.good]))
    if blur > BLUR_SHARE:
        raise _refusal(
            f"{source}: blurred: the edges are {blur:.2f} of a square wide (standard deviation)",
            cure="Hold the board still, shorten the exposure or focus the lens",
        )
    everywhere = np.where(layer.good[:, None], layer.uv, smooth(grid))
    numbered = number_corners(_without(light, other, board), board, everywhere)
    was = np.linalg.norm(numbered[:, None] - everywhere[None], axis=2).argmin(axis=1)
    index = np.flatnonzero(layer.good[was])
    # what shows through from the other view is no noise from pixel to pixel: the corners' scatter about the smooth grid
    # tells of it, the windows' residuals do not
    noise = float(np.sqrt(np.median(np.trace(layer.covariance[layer.good], axis1=1, axis2=2)) / 2.0))
    off = (layer.uv - smooth(grid))[layer.good]
    free = max(1, off.size - MAP_SIZE)
    scatter = float(np.sqrt((off**2).sum() / free))
    return BoardView(
        uv_px=numbered[index],
        index=index,
        sigma_px=max(noise, scatter),
        width=light.shape[1],
        height=light.shape[0],
        source=source,
    )


def _across(view: BoardView, board: Target) -> float:
    """Return how far to the image's right the board's middle is seen, whichever corners are."""
    return float(fit_map(board.xyz_m[view.index, :2], view.uv_px)[0](board.xyz_m[:, :2]).mean(axis=0)[0])
