"""Checkerboards: found by their saddles, OpenCV or templates, their corners fitted and verified here."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array, Image, Index, Mask
from armsight.errors import BadImage, Unseen, unused_image
from armsight.measure.boards.gridmap import (
    GridMap,
    fit_map,
    levels_at,
    most_upright,
    outer_lines,
    refuse_miscount,
    too_few,
)
from armsight.measure.boards.kernels.gridmap import median
from armsight.measure.boards.kernels.subpixel import ALONE, EVERYTHING, LAST_STEP_PX, TRIALS, fit_corners
from armsight.measure.boards.saddle_grid import grid_at_a_glance, shrunk
from armsight.measure.boards.xcorner import xcorner_corners
from armsight.records import BoardView, Target

REACH = 0.5
"""Half window in squares: the edges run on past it, and the next corner's blur stays out (0.4 to 0.7 do as well)."""
LAST_HALF_PX = 24.0
"""Largest half window in px of the last fit: a larger one adds time, no accuracy."""
ROUGH = (8.0, 0.05, TRIALS)
Fits = tuple[tuple[float, float, int], ...]
FITS: Fits = (ROUGH, ROUGH, (LAST_HALF_PX, LAST_STEP_PX, TRIALS))
"""Each fit's largest half window, the step in px that is its last, and how often the model is evaluated. A window's
middle is where the fit before put the corner, and moves the next one by some hundredths of its own error: after two
small windows the last is the same to 1e-5 px, wherever the search began."""
FROM_SADDLES = FITS[1:]
"""Saddles of the image itself are where a first small window would put them."""
EXPLAINED = 0.6
"""A true corner's window is explained to 0.95 and better by the model, a corner beside one to less than this."""
SURE = 0.9
"""The last fit begins with the first one's edges, blur and light where they explained this share."""
END_OF_BOARD = 0.9
"""Likeness of the end of a black square on an evenly white margin to a corner: 0.895-0.906 on painted boards, where
true corners reach 0.97-0.999; a corner beyond the board must be nearer to its own corners' likeness."""
OFF_GRID = 0.15
"""A corner further than this from the smooth grid, in squares, is not the board's."""
BEYOND = (8.0, 0.05, 8)
"""Of the fit of a corner beyond the board: a true one is explained as far as it will be after six evaluations of the
model, and what is none would take forty."""
PERHAPS_BEYOND = 0.3
"""Where this share of one more row looks like corners, the board goes on, if the squares behind them alternate; where
those are out of the image, the whole of it is searched for a larger board."""
ALTERNATING = 0.5
"""Share of the board's own step from black to white that the squares beyond show where it goes on: 0.78 and more of
boards in photographs, blurred or not; behind their ends 0.24 at most."""
BEHIND = 0.25
"""How far behind one more row of corners its squares are looked at: printed boards may end in half squares."""
SMOOTH = 0.02
SCATTER = 8.0
"""... and after the last fit one further than this share of a square, and than this many times the median corner, is
pulled by something else: the medians of real boards are 0.005 squares."""
LOW_CONTRAST = 0.2
"""A corner of less than this share of the board's usual contrast is hidden or in glare."""
LOST_SHARE = 0.2
"""With more than this share of corners refused, the whole view is."""
SEEN_SIDE = 0.5
"""Share of an outer row's or column's corners that must be kept: else the board may have fewer."""
BLUR_SHARE = 0.25
"""Edges blurred by more than this share of a square make neighbouring corners run together, off by twice what the fit
says."""
COARSE_WIDTH_PX = 1300
"""The first search needs no more pixels than this; wider images are halved for it until they fit."""


def find_checkerboard(image: Image, board: Target, source: str, detector: str) -> BoardView:
    """Return all corners of the board, or those that could be verified; raises BadImage with the reason."""
    quick = detector == "quick"
    coarse = grid_at_a_glance(image, board.columns, board.rows) if quick or detector == "auto" else None
    if coarse is not None:
        try:
            return refine_corners(image, board, number_corners(image, board, coarse), source, FROM_SADDLES)
        except BadImage:
            if quick:
                raise
    if not quick:
        coarse = coarse_corners(image, board.columns, board.rows, detector)
    if coarse is None:
        instead, unseen, size = (" at a glance", Unseen.OTHER, None) if quick else _instead(image, board)
        raise unused_image(
            f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found{instead}",
            unseen=unseen,
            size=size,
        )
    return refine_corners(image, board, number_corners(image, board, coarse), source)


def coarse_corners(image: Image, columns: int, rows: int, detector: str) -> Array | None:
    """Return the corners (n, 2) to about a pixel, row by row, or None; detector: auto, classic, sectors or xcorner."""
    scale = 1
    while image.shape[1] / scale > COARSE_WIDTH_PX:
        scale *= 2
    small = image if scale == 1 else shrunk(image, scale)
    images = [small] if scale == 1 else [small, image]
    size = (columns, rows)
    for picture in images:
        factor = image.shape[1] / picture.shape[1]
        if detector == "xcorner":
            placed = xcorner_corners(picture, columns, rows)
            if placed is not None:
                return _full_size(placed, factor)
            continue
        if detector != "sectors":
            flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
            found, corners = cv2.findChessboardCorners(picture, size, flags=flags)
            if found:
                return _full_size(corners, factor)
        if detector != "classic":
            found, corners = cv2.findChessboardCornersSB(picture, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if found:
                return _full_size(corners, factor)
    return None


def _full_size(corners: ArrayLike, factor: float) -> Array:
    """Return the corners (n, 2) in pixels of the full image."""
    uv = np.asarray(corners, float).reshape(-1, 2)
    return np.asarray((uv + 0.5) * factor - 0.5)


def number_corners(image: Image | Array, board: Target, uv: Array) -> Array:
    """Number the corners so that x runs along the columns, y is to its right hand, and the first square is black.

    Where the colours leave a choice, x points as far to the image's right as it can.
    """
    table = uv.reshape(board.rows, board.columns, 2)
    x, y = (table[:, -1] - table[:, 0]).mean(axis=0), (table[-1] - table[0]).mean(axis=0)
    if x[0] * y[1] - x[1] * y[0] < 0.0:
        uv = table[:, ::-1].reshape(-1, 2)
    table = uv.reshape(board.rows, board.columns, 2)
    alike = _squares_alike(board)
    quarters = range(4) if board.columns == board.rows else (0, 2)
    black = _first_square_is_black(image, board, uv)
    black_first = [q for q in quarters if bool(np.rot90(alike, q)[0, 0]) == black]
    return most_upright([np.rot90(table, q).reshape(-1, 2) for q in black_first or quarters], board)


def grid_of(board: Target) -> Array:
    """Return the grid coordinates (n, 2) of the board's points, in squares."""
    return np.asarray(board.xyz_m[:, :2] / board.pitch_m)


def parity_of(board: Target) -> Array:
    """Return -1 where the square beyond a corner (towards +x, +y) has the first square's colour, else +1; (n,)."""
    return np.where(np.rint(grid_of(board).sum(axis=1)).astype(int) % 2 == 0, -1.0, 1.0)


def _first_square_is_black(image: Image | Array, board: Target, uv: Array) -> bool:
    """Tell whether the square between the first four corners is darker than its neighbours, over the whole board."""
    table = uv.reshape(board.rows, board.columns, 2)
    centres = 0.25 * (table[:-1, :-1] + table[:-1, 1:] + table[1:, :-1] + table[1:, 1:])
    level = levels_at(image, centres.reshape(-1, 2)).reshape(centres.shape[:2])
    alike = _squares_alike(board)
    return bool(alike.all() or level[alike].mean() < level[~alike].mean())


def _squares_alike(board: Target) -> Mask:
    """Tell which of the squares between the corners (rows - 1, columns - 1) have the first one's colour."""
    return np.asarray(np.add.outer(np.arange(board.rows - 1), np.arange(board.columns - 1)) % 2 == 0)


def refine_corners(image: Image, board: Target, guess: Array, source: str, fits: Fits = FITS) -> BoardView:
    """Fit every corner several times, the last in a large window, and keep what passes the checks."""
    grid, sign = grid_of(board), parity_of(board)
    smooth, distance = fit_map(grid, guess)
    if not refuse_miscount(image, board, guess, smooth, source):
        sign = -sign
    uv, like = guess, ALONE
    for effort in fits:
        slopes = smooth.derivatives(grid)
        size = _square_px(slopes[0])
        start = np.where((distance > OFF_GRID * size)[:, None], smooth(grid), uv)
        uv, covariance, quality, like = _fit(image, slopes, start, sign, effort, like)
        like = np.where((quality[:, 0] > SURE)[:, None], like, np.nan)
        smooth, distance = fit_map(grid, uv)
    size = _square_px(smooth.derivatives(grid)[0])
    contrast = quality[:, 1]
    limit = np.clip(SCATTER * median(distance), SMOOTH * size, OFF_GRID * size)
    good = (quality[:, 0] > EXPLAINED) & (distance < limit)
    usual = float(median(contrast[good])) if good.any() else 0.0
    good &= contrast > LOW_CONTRAST * usual
    _refuse(image, board, source, smooth, good, quality, size, sign)
    for side, axis, line in () if good.all() else outer_lines(board):
        if good[np.abs(grid[:, axis] - line) < 0.5].mean() < SEEN_SIDE:
            raise too_few(f"{source}: most of the {side} of {board.columns}x{board.rows} inner corners are not there")
    index = np.flatnonzero(good)
    return BoardView(
        uv_px=uv[index],
        index=index,
        sigma_px=float(np.sqrt(median(np.trace(covariance[index], axis1=1, axis2=2)) / 2.0)),
        width=image.shape[1],
        height=image.shape[0],
        source=source,
    )


def _square_px(E: Array) -> Array:
    """Return the shorter side (n,) in px of a square at each corner, of the map's slopes E (n, 2, 2)."""
    return np.asarray(np.sqrt(np.square(E).sum(axis=1).min(axis=1)))


def _fit(
    image: Image,
    slopes: tuple[Array, Array],
    guess: Array,
    sign: Array,
    effort: tuple[float, float, int],
    like: Array = ALONE,
) -> tuple[Array, Array, Array, Array]:
    """Return the fitted corners (n, 2), covariances (n, 2, 2), quality (n, 4) and parameters (n, 10).

    slopes: of the map there, as GridMap.derivatives gives them.
    """
    E, Q = slopes
    half_px, last_px, most = effort
    reach = np.minimum(REACH, half_px / np.linalg.norm(E, axis=1).max(axis=1))
    fitted: tuple[Array, Array, Array, Array] = fit_corners(
        image, guess, E, Q, reach, sign, like, last_px, most, EVERYTHING
    )
    return fitted


def _refuse_unclear(source: str, good: Mask, quality: Array, size: Array) -> None:
    """Raise BadImage where too many corners are no corners, or too blurred to be placed."""
    lost = int(np.count_nonzero(~good))
    if lost > LOST_SHARE * len(good):
        raise unused_image(
            f"{source}: {lost} of {len(good)} corners are hidden, in glare or not corners",
            cure="Show the whole board without reflections",
        )
    blur = float(median(quality[good, 2] / size[good]))
    if blur > BLUR_SHARE:
        raise BadImage(
            f"{source}: blurred: the edges are {blur:.2f} of a square wide (standard deviation)",
            consequence="The corners cannot be placed and the image is not used",
            cure="Hold the board still, shorten the exposure or focus the lens",
            unseen=Unseen.BLURRED,
        )


def _refuse(
    image: Image,
    board: Target,
    source: str,
    smooth: GridMap,
    good: Mask,
    quality: Array,
    size: Array,
    sign: Array,
) -> None:
    """Raise BadImage where the corners are not those of this board, or too blurred to be placed."""
    _refuse_unclear(source, good, quality, size)
    sides, looked_at, kind = _beyond(board.columns, board.rows)
    usual, *steps = sign[0] * _steps(image, smooth(looked_at), kind)
    clear, contrast = median(quality[good, 0]), median(quality[good, 1])
    for (side, more), step in zip(sides.items(), steps, strict=True):
        if step < ALTERNATING * usual:
            continue
        there, unknown = smooth(more), np.isnan(step)
        uv, _, beyond, _ = _fit(image, smooth.derivatives(more), there, _sign_at(more, sign), BEYOND)
        like = np.linalg.norm(uv - there, axis=1) < OFF_GRID * median(size)
        like &= (beyond[:, 0] > (0.5 * (END_OF_BOARD + clear) if unknown else EXPLAINED)) & (
            beyond[:, 1] > 0.5 * contrast
        )
        if like.mean() <= PERHAPS_BEYOND:
            continue
        sure = not unknown or like.mean() > 1.0 - LOST_SHARE
        whole = _larger_grid(image, board)
        if whole is None and sure:
            whole = _one_more(image, board, column="column" in side)
        if sure or whole is not None:
            seen = "" if whole is None else f"; one of {whole[0]}x{whole[1]} was found"
            raise BadImage(
                f"{source}: the board goes on beyond {board.columns}x{board.rows} inner corners ({side}){seen}",
                consequence="Which of its corners are meant cannot be known and the image is not used",
                cure="Count the inner corners again",
                size=whole,
            )


def _steps(image: Image, uv: Array, kind: Index) -> Array:
    """Return of each group (k,) of pixels (n, 2) how much brighter the image is at those of kind 2 k + 1 than at those
    of kind 2 k; NaN where there are none of either.
    """
    seen = ((uv >= -0.5) & (uv < [image.shape[1] - 0.5, image.shape[0] - 0.5])).all(axis=1)
    count = np.bincount(kind[seen], minlength=kind.max() + 1)
    total = np.bincount(kind[seen], levels_at(image, uv[seen]), len(count))
    level = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return np.asarray(level[1::2] - level[::2])


@cache
def _beyond(columns: int, rows: int) -> tuple[dict[str, Array], Array, Index]:
    """Return the grid coordinates (m, 2) of the corners that one more row or column would have, by the side's name.

    And where squares are looked at (n, 2), the board's own and those behind these corners, side by side; and for each
    (n,) twice the number of its group, and 1 more where it has the colour of the first corner's own.
    """
    i, j = np.arange(rows, dtype=float), np.arange(columns, dtype=float)
    sides = {
        "one more column before the first": np.stack([np.full(rows, -1.0), i], axis=1),
        "one more column after the last": np.stack([np.full(rows, float(columns)), i], axis=1),
        "one more row before the first": np.stack([j, np.full(columns, -1.0)], axis=1),
        "one more row after the last": np.stack([j, np.full(columns, float(rows))], axis=1),
    }
    last = np.array([columns - 1.0, rows - 1.0])
    corners = np.stack(np.meshgrid(j[:-1], i[:-1]), axis=-1).reshape(-1, 2)
    looked_at, named = [corners + 0.5], [corners]
    for more in sides.values():
        outwards = np.rint(more[0] - np.clip(more[0], 0, last))
        along = more[(np.where(outwards == 0.0, more, 0.0) < last).all(axis=1)]
        looked_at.append(along + np.where(outwards == 0.0, 0.5, BEHIND * outwards))
        # a square is named by its corner nearest to the origin
        named.append(along + np.minimum(outwards, 0.0))
    first = [2 * group + (_sign_at(corner, np.ones(1)) > 0.0) for group, corner in enumerate(named)]
    return sides, np.concatenate(looked_at), np.concatenate(first)


def _sign_at(grid: Array, sign: Array) -> Array:
    """Return the sign (n,) that corners at grid (n, 2) have on a board whose first corner has sign[0]."""
    return np.asarray(np.where(np.rint(grid.sum(axis=1)).astype(int) % 2 == 0, sign[0], -sign[0]))


def _instead(image: Image, board: Target) -> tuple[str, Unseen, tuple[int, int] | None]:
    """Return words on what is there instead: a board of another size, the board out of focus, or nothing; its size."""
    larger = _larger_grid(image, board)
    if larger is not None:
        return f", but one of {larger[0]}x{larger[1]} was", Unseen.OTHER, larger
    for factor in (2, 4):
        if coarse_corners(shrunk(image, factor), board.columns, board.rows, "auto") is not None:
            return "; it is there, but blurred", Unseen.BLURRED, None
    other = _largest_grid(image)
    if other is None or other == _sorted_size(board):
        return "", Unseen.OTHER, None
    return f", but one of {other[0]}x{other[1]} was", Unseen.OTHER, other


def _sorted_size(board: Target) -> tuple[int, int]:
    return max(board.columns, board.rows), min(board.columns, board.rows)


def _larger_grid(image: Image, board: Target) -> tuple[int, int] | None:
    """Return the counts of a checkerboard in the image that is larger than the board, as _largest_grid does."""
    wanted, other = _sorted_size(board), _largest_grid(image)
    larger = other is not None and other != wanted and other[0] >= wanted[0] and other[1] >= wanted[1]
    return other if larger else None


def _one_more(image: Image, board: Target, *, column: bool) -> tuple[int, int] | None:
    """Return the counts, the larger first, of the board with one more column or row if that is found."""
    columns, rows = (board.columns + 1, board.rows) if column else (board.columns, board.rows + 1)
    found = coarse_corners(image, columns, rows, "auto") is not None
    return (max(columns, rows), min(columns, rows)) if found else None


def _largest_grid(image: Image) -> tuple[int, int] | None:
    """Return the larger and the smaller count of inner corners of whatever checkerboard is there."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags=flags)
    if not found or corners is None or meta is None:
        return None
    return int(max(meta.shape[:2])), int(min(meta.shape[:2]))
