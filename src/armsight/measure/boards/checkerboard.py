"""Checkerboards: found by OpenCV or by templates, their corners fitted and verified here.

Corners may lie on a grid, but not on that of the squares: that is found, too, where the counts asked for are wrong.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import BadImage, Unseen
from armsight.measure.boards.gridmap import GridMap, fit_map, most_upright
from armsight.measure.boards.kernels.subpixel import fit_corners
from armsight.measure.boards.xcorner import xcorner_corners
from armsight.records import BoardView, Target
from armsight.records.board import grid_turns

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

REACH = 0.5
"""Half window in squares: the edges run on past it, and the next corner's blur stays out (0.4 to 0.7 do as well)."""
FIRST_HALF_PX = 8.0
LAST_HALF_PX = 24.0
"""Largest half window in px, for the first fit and for the last: larger ones add time, no accuracy."""
EXPLAINED = 0.6
"""A true corner's window is explained to 0.95 and better by the model, a corner beside one to less than this."""
END_OF_BOARD = 0.9
"""Likeness of the end of a black square on an evenly white margin to a corner: 0.895-0.906 on painted boards, where
true corners reach 0.97-0.999; a corner beyond the board must be nearer to its own corners' likeness."""
PERHAPS_BEYOND = 0.3
"""Where this share of one more row looks like corners, the whole image is searched for a larger board."""
ALTERNATING = 0.5
"""Share of the board's own step from black to white that the squares beyond must show to be the board's."""
BEHIND = 0.25
"""How far behind one more row of corners its squares are looked at: printed boards may end in half squares."""
OFF_GRID = 0.15
"""A corner further than this from the smooth grid, in squares, is not the board's."""
SMOOTH = 0.02
SCATTER = 8.0
"""... and after the last fit one further than this share of a square, and than this many times the median corner, is
pulled by something else: the medians of real boards are 0.005 squares."""
LOW_CONTRAST = 0.2
"""A corner of less than this share of the board's usual contrast is hidden or in glare."""
LOST_SHARE = 0.2
"""With more than this share of corners refused, the whole view is."""
BLUR_SHARE = 0.3
"""Edges blurred by more than this share of a square make neighbouring corners run together."""
COARSE_WIDTH_PX = 1300
"""The first search needs no more pixels than this; wider images are halved for it until they fit."""


def find_checkerboard(image: Image, board: Target, source: str, detector: str) -> BoardView:
    """Return all corners of the board, or those that could be verified; raises BadImage with the reason."""
    coarse = coarse_corners(image, board.columns, board.rows, detector)
    if coarse is None:
        instead, unseen, size = _instead(image, board)
        raise BadImage(
            f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found{instead}",
            consequence="The image is not used",
            cure="Show the whole board, sharp and evenly lit, and count its inner corners",
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


def shrunk(image: Image, factor: int) -> Image:
    """Return the image made smaller by a whole factor, grey levels averaged."""
    small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _full_size(corners: ArrayLike, factor: float) -> Array:
    """Return the corners (n, 2) in pixels of the full image."""
    uv = np.asarray(corners, float).reshape(-1, 2)
    return np.asarray((uv + 0.5) * factor - 0.5)


def number_corners(image: Image | Array, board: Target, uv: Array) -> Array:
    """Number the corners so that x runs along the columns, y is to its right hand, and the first square is black.

    Where the colours leave a choice, x points as far to the image's right as it can.
    """
    n = board.columns
    E, _ = fit_map(grid_of(board), uv)[0].derivatives(grid_of(board))
    if np.linalg.det(E.mean(axis=0)) < 0.0:
        uv = uv.reshape(-1, n, 2)[:, ::-1].reshape(-1, 2)
    turned = [uv[turn] for turn in grid_turns(board).values()]
    black_first = [t for t in turned if _first_square_is_black(image, board, t)]
    return most_upright(black_first or turned, board)


def grid_of(board: Target) -> Array:
    """Return the grid coordinates (n, 2) of the board's points, in squares."""
    return np.asarray(board.xyz_m[:, :2] / board.pitch_m)


def parity_of(board: Target) -> Array:
    """Return -1 where the square beyond a corner (towards +x, +y) has the first square's colour, else +1; (n,)."""
    return np.where(np.rint(grid_of(board).sum(axis=1)).astype(int) % 2 == 0, -1.0, 1.0)


def _first_square_is_black(image: Image | Array, board: Target, uv: Array) -> bool:
    """Tell whether the square between the first four corners is darker than its neighbours, over the whole board."""
    grid = grid_of(board)
    inner = (grid < grid.max(axis=0)).all(axis=1)
    centres = fit_map(grid, uv)[0](grid[inner] + 0.5)
    col = np.clip(np.rint(centres[:, 0]).astype(int), 0, image.shape[1] - 1)
    row = np.clip(np.rint(centres[:, 1]).astype(int), 0, image.shape[0] - 1)
    level = image[row, col].astype(float)
    dark = parity_of(board)[inner] < 0.0
    if dark.all():
        return True
    return bool(level[dark].mean() < level[~dark].mean())


def refine_corners(image: Image, board: Target, guess: Array, source: str) -> BoardView:
    """Fit every corner twice, the second time with straightened edges, and keep what passes the checks."""
    grid, sign = grid_of(board), parity_of(board)
    refuse_miscount(image, board, guess, source)
    if not _first_square_is_black(image, board, guess):
        sign = -sign
    uv = guess
    for half_px in (FIRST_HALF_PX, LAST_HALF_PX):
        smooth, distance = fit_map(grid, uv)
        size = _square_px(smooth, grid)
        uv, covariance, quality = _fit(
            image, smooth, grid, np.where((distance > OFF_GRID * size)[:, None], smooth(grid), uv), sign, half_px
        )
    smooth, distance = fit_map(grid, uv)
    size = _square_px(smooth, grid)
    contrast = quality[:, 1]
    limit = np.clip(SCATTER * np.median(distance), SMOOTH * size, OFF_GRID * size)
    good = (quality[:, 0] > EXPLAINED) & (distance < limit)
    usual = float(np.median(contrast[good])) if good.any() else 0.0
    good &= contrast > LOW_CONTRAST * usual
    _refuse(image, board, source, smooth, good, quality, size, sign)
    index = np.flatnonzero(good)
    return BoardView(
        uv_px=uv[index],
        index=index,
        sigma_px=float(np.sqrt(np.median(np.trace(covariance[index], axis1=1, axis2=2)) / 2.0)),
        width=image.shape[1],
        height=image.shape[0],
        source=source,
    )


def _square_px(smooth: GridMap, grid: Array) -> Array:
    """Return the shorter side (n,) of a square at each corner in px."""
    E, _ = smooth.derivatives(grid)
    return np.asarray(np.linalg.norm(E, axis=1).min(axis=1))


def _fit(
    image: Image, smooth: GridMap, grid: Array, guess: Array, sign: Array, half_px: float
) -> tuple[Array, Array, Array]:
    """Return the fitted corners (n, 2), covariances (n, 2, 2) and quality (n, 4)."""
    E, Q = smooth.derivatives(grid)
    longer = np.linalg.norm(E, axis=1).max(axis=1)
    n = len(grid)
    uv, covariance, quality = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 4))
    reach = np.minimum(REACH, half_px / longer)
    contiguous = np.ascontiguousarray
    fit_corners(
        image, contiguous(guess), contiguous(E), contiguous(Q), contiguous(reach), sign, uv, covariance, quality
    )
    return uv, covariance, quality


def _refuse_unclear(source: str, good: NDArray[np.bool_], quality: Array, size: Array) -> None:
    """Raise BadImage where too many corners are no corners, or too blurred to be placed."""
    lost = int(np.count_nonzero(~good))
    if lost > LOST_SHARE * len(good):
        raise BadImage(
            f"{source}: {lost} of {len(good)} corners are hidden, in glare or not corners",
            consequence="The image is not used",
            cure="Show the whole board without reflections",
        )
    blur = float(np.median(quality[good, 2] / size[good]))
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
    good: NDArray[np.bool_],
    quality: Array,
    size: Array,
    sign: Array,
) -> None:
    """Raise BadImage where the corners are not those of this board, or too blurred to be placed."""
    _refuse_unclear(source, good, quality, size)
    for side, more in _beyond(board).items():
        uv, _, beyond = _fit(image, smooth, more, smooth(more), _sign_at(more, sign), FIRST_HALF_PX)
        near = np.linalg.norm(uv - smooth(more), axis=1) < OFF_GRID * float(np.median(size))
        clear, contrast = np.median(quality[good, :2], axis=0)
        like = near & (beyond[:, 0] > 0.5 * (END_OF_BOARD + clear)) & (beyond[:, 1] > 0.5 * contrast)
        if like.mean() <= PERHAPS_BEYOND:
            continue
        sure = like.mean() > 1.0 - LOST_SHARE and not _margin(image, board, smooth, more, sign)
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


def _margin(image: Image, board: Target, smooth: GridMap, more: Array, sign: Array) -> bool:
    """Whether the squares behind one more row of corners (m, 2) do not alternate: the edge of a blurred board."""
    grid = grid_of(board)
    last = grid.max(axis=0)
    inner = grid[(grid < last).all(axis=1)]
    outwards = np.rint(more[0] - np.clip(more[0], 0, last))
    along = more[(np.where(outwards == 0.0, more, 0.0) < last).all(axis=1)]
    behind = along + np.minimum(outwards, 0.0)  # a square is named by its corner nearest to the origin
    usual = _step(image, smooth(inner + 0.5), _sign_at(inner, sign))
    beyond = _step(image, smooth(along + np.where(outwards == 0.0, 0.5, BEHIND * outwards)), _sign_at(behind, sign))
    return beyond < ALTERNATING * usual  # not where there is nothing to compare


def _step(image: Image, uv: Array, sign: Array) -> float:
    """Return how much brighter the image is at the pixels (n, 2) of sign +1 than at the others; NaN for none."""
    at = np.rint(uv).astype(int)
    seen = ((at >= 0) & (at < [image.shape[1], image.shape[0]])).all(axis=1)
    if len(np.unique(sign[seen])) < 2:
        return float("nan")
    level = image[at[seen, 1], at[seen, 0]].astype(float)
    return float(level[sign[seen] > 0.0].mean() - level[sign[seen] < 0.0].mean())


def _beyond(board: Target) -> dict[str, Array]:
    """Return the grid coordinates of the corners that one more row or column would have, by the side's name."""
    c, r = board.columns, board.rows
    i, j = np.arange(r, dtype=float), np.arange(c, dtype=float)
    return {
        "one more column before the first": np.stack([np.full(r, -1.0), i], axis=1),
        "one more column after the last": np.stack([np.full(r, float(c)), i], axis=1),
        "one more row before the first": np.stack([j, np.full(c, -1.0)], axis=1),
        "one more row after the last": np.stack([j, np.full(c, float(r))], axis=1),
    }


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


OFF_LINE = 0.3
"""An outer row or column further than this from where the rest of the board puts it, in squares, is not the board's:
the paper's edge behind half squares is off by half a square."""
ALTERNATE = 0.9
"""Share of neighbouring squares that must differ as black and white do: of boards in photographs all do, of grids laid
across the squares 0.4 to 0.82."""
WITHIN = (0.3, 0.7)
"""Where in a square its grey level is read, along each axis."""


def refuse_miscount(image: Image, board: Target, guess: Array, source: str) -> None:
    """Raise BadImage where corners (n, 2) px are not those of columns x rows neighbouring squares' corners."""
    grid = np.rint(board.xyz_m[:, :2] / board.pitch_m)
    smooth, _ = fit_map(grid, guess)
    if alternating_share(image, board, smooth) < ALTERNATE:
        raise BadImage(
            f"{source}: the grid of {board.columns}x{board.rows} corners that is there has no squares between them",
            consequence="The image is not used",
            cure="Count the inner corners again, or show the whole board, sharp and evenly lit",
        )
    for axis, count in enumerate((board.columns, board.rows)):
        for end, name in ((0, "first"), (count - 1, "last")):
            if off_line(grid, guess, grid[:, axis] == end) > OFF_LINE:
                raise BadImage(
                    f"{source}: the {name} {'row' if axis else 'column'} of {board.columns}x{board.rows} inner corners "
                    f"is not where the others put it",
                    consequence="There may be fewer, and the image is not used",
                    cure="Count the inner corners again",
                )


def off_line(grid: Array, uv_px: Array, line: NDArray[np.bool_]) -> float:
    """Return how far the corners of a line (n,) are from where the map of the others puts them: median, in squares."""
    smooth, _ = fit_map(grid[~line], uv_px[~line])
    square = np.linalg.norm(smooth.derivatives(grid[line])[0], axis=1).min(axis=1)
    return float(np.median(np.linalg.norm(smooth(grid[line]) - uv_px[line], axis=1) / square))


def alternating_share(image: Image, board: Target, smooth: GridMap) -> float:
    """Return the share of neighbouring inner squares, read at four places each, whose grey levels differ in turn."""
    x, y = np.meshgrid(np.arange(board.columns - 1.0), np.arange(board.rows - 1.0))
    steps: list[Array] = []
    for dx in WITHIN:
        for dy in WITHIN:
            at = np.rint(smooth(np.stack([(x + dx).ravel(), (y + dy).ravel()], axis=1))).astype(int)
            column, row = (np.clip(at[:, i], 0, image.shape[1 - i] - 1) for i in range(2))
            level = image[row, column].astype(float).reshape(x.shape) * np.where((x + y) % 2 == 0, 1.0, -1.0)
            steps += [(level[:, 1:] + level[:, :-1]).ravel(), (level[1:] + level[:-1]).ravel()]
    bright_less_dark = np.concatenate(steps)
    return float(max(np.mean(bright_less_dark > 0.0), np.mean(bright_less_dark < 0.0)))
