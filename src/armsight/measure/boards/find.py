"""Finding a printed board in an image, or saying why not; also twice in one image.

The latter are the views of a mirror rig, added on one sensor (Pachidis et al. 2005).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image
from armsight.errors import BadImage, Inconsistent, Unseen, UsageError, unused_image
from armsight.measure.boards.board_layers import (
    PART_SHARE,
    Layer,
    first_layer,
    measure_layer,
    separate_layers,
    take_off,
    with_edge,
    without_layer,
)
from armsight.measure.boards.checkerboard import (
    BLUR_SHARE,
    find_checkerboard,
    grid_of,
    number_corners,
)
from armsight.measure.boards.circles import find_circles
from armsight.measure.boards.corner_detector import ENOUGH, Grid, Saddles, find_grids, find_saddles
from armsight.measure.boards.gridmap import fit_map, same_way_up
from armsight.measure.boards.kernels.subpixel import ALONE, EVERYTHING, fit_corners, fit_dots
from armsight.measure.boards.marker_corners import find_aprilgrid, find_charuco
from armsight.records import BoardView, Target, TargetKind

DETECTORS = ("auto", "quick", "classic", "sectors", "xcorner")
"""How checkerboards are first looked for: auto tries quick, then classic and sectors, OpenCV's two; xcorner is the one
of Pachidis et al. 2005. The corners are fitted the same way afterwards."""

DARK_LEVEL = 40.0
WHITE_LEVEL = 215.0
LEAST_CONTRAST = 15.0
"""Grey levels between the image's darkest and brightest percent, or, as the board may be small before an even ground,
between those thousandths of its blocks' means: below this no print can be told from noise."""
BLOCK_PX = 4
SMALLEST_PX = 32


def find_board(image: NDArray[np.uint8], board: Target, *, source: str = "", detector: str = "auto") -> BoardView:
    """Return the board's points in an image, uint8 (h, w) grey or (h, w, 3) BGR, to sub-pixel precision.

    Points are numbered as in board.xyz_m: x along the columns, y to the right hand of it as the camera sees the
    printed side, of an AprilGrid to the left as Kalibr has it. A checkerboard begins at a black square where its
    colours tell; a circle grid with one bigger dot begins there; where the print leaves a choice, x points right in it
    (see same_way_up for pairs). detector: one of DETECTORS. Raises BadImage, saying why: dark, white, blurred, another
    size, mirrored, not there; Inconsistent where the target is not a board; UsageError for an unknown detector.
    """
    if detector not in DETECTORS:
        raise UsageError(f"no detector is called {detector!r}", cure=f"Use one of {', '.join(DETECTORS)}")
    source = source or "the image"
    grey = grey_image(image, source)
    poor = check_exposure(grey, source)
    try:
        return _find(grey, board, source, detector)
    except BadImage as error:
        if poor is None or error.unseen is not Unseen.OTHER or error.size is not None:
            raise
        raise poor from None


def _find(grey: Image, board: Target, source: str, detector: str) -> BoardView:
    """Return the board as the detector of its kind finds it."""
    if board.kind is TargetKind.CHECKERBOARD:
        return find_checkerboard(grey, board, source, detector)
    if board.kind is TargetKind.CHARUCO:
        return find_charuco(grey, board, source)
    if board.kind is TargetKind.APRILGRID:
        return find_aprilgrid(grey, board, source)
    if board.kind in (TargetKind.CIRCLES, TargetKind.ACIRCLES):
        return find_circles(grey, board, source, quick=detector == "quick")
    raise Inconsistent(f"a target of kind {board.kind.value} is not a printed board", cure="Give a board")


def warm_up() -> None:
    """Compile the fits, or load them from the cache, so that the first image does not wait for it."""
    image = grey_image(np.zeros((SMALLEST_PX, SMALLEST_PX), np.uint8), "")
    middle, axes, one = np.full((1, 2), 16.0), np.eye(2)[None] * 4.0, np.ones(1)
    fit_corners(image, middle, axes, np.zeros((1, 2, 3)), one, one, ALONE, 1.0, 1, EVERYTHING)
    fit_dots(image, middle, axes, one, 0.0, 1)


def grey_image(image: NDArray[np.uint8], source: str) -> NDArray[np.uint8]:
    """Return the image as contiguous uint8 (h, w)."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or min(image.shape[:2]) < SMALLEST_PX:
        raise unused_image(
            f"{source}: an image of type {image.dtype} and shape {image.shape} cannot show a board",
            cure="Give 8-bit grey or BGR images",
        )
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    contiguous: NDArray[np.uint8] = np.ascontiguousarray(grey, dtype=np.uint8).view()
    contiguous.setflags(write=False)  # as a frame's image is: one compilation serves all
    return contiguous


def check_exposure(grey: NDArray[np.uint8], source: str) -> BadImage | None:
    """Raise BadImage for an image that is black, white or grey all over; return it where all but a small part is."""
    count = cv2.calcHist([grey[::4]], [0], None, [256], [0, 256]).cumsum()
    low, middle, high = (int(np.searchsorted(count, share * count[-1])) for share in (0.01, 0.5, 0.99))
    if high - low >= LEAST_CONTRAST:
        return None
    if middle < DARK_LEVEL:
        what, cure = "is dark all over", "Light the board, lengthen the exposure or take the lens cap off"
    elif middle > WHITE_LEVEL:
        what, cure = "is white all over", "Shorten the exposure"
    else:
        what, cure = "has no contrast", "Light the board and focus the lens"
    poor = unused_image(f"{source}: {what} (grey levels {low:.0f} to {high:.0f})", cure=cure)
    small = cv2.resize(grey, None, fx=1 / BLOCK_PX, fy=1 / BLOCK_PX, interpolation=cv2.INTER_AREA)
    if np.ptp(np.percentile(small, (0.1, 99.9))) < LEAST_CONTRAST:
        raise poor
    return poor


SEEN_SHARE = 0.5
"""A board of which fewer corners are seen than this is refused,"""
PLACED_SHARE = 0.5
"""... and one of which fewer can be placed: what is known of the other board then comes from too few, and errors of 40
standard deviations were met among 24 corners of 54."""
FAINT = 0.3
"""What is left of a board that was taken off responds less than this share of it."""
RIM_SHARE = 0.7
"""Corners of the outer rows and columns respond as the others do; the ends of the edge's black squares by half."""
ON_PX = 2.0
"""Corners this near to a board's own are not looked for again."""
MAP_SIZE = 22
"""Numbers in a homography and cubics on top that it does not hold itself (8 + 20 - 6, the first-order ones shared)."""


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
    layers = separate_layers(light, board, _two_layers(light, board, source))
    views = [_view(light, board, *pair, source) for pair in (layers, layers[::-1])]
    views.sort(key=lambda view: -_across(view, board))
    left, right = views
    return left, same_way_up(left, right, board)


def _two_layers(light: Array, board: Target, source: str) -> tuple[Layer, Layer]:
    """Return both boards as the corners' responses show them; raises BadImage where there are not two."""
    saddles = find_saddles(light)
    grids = find_grids(saddles, board.columns, board.rows)
    if not grids or len(grids[0].cells) < PART_SHARE * len(board.names):
        raise unused_image(f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found")
    if len(grids) == 2:
        layers = first_layer(grids[0], board), first_layer(grids[1], board)
        for part, other in zip(grids, layers[::-1], strict=True):
            _check_size(part, other, board, source)
    else:
        _check_complete(grids[0], board, source)
        first = first_layer(grids[0], board)
        grid = _second(light, saddles, first, board)
        if grid is None:
            _check_size(grids[0], None, board, source)
            raise unused_image(
                f"{source}: the board of {board.columns}x{board.rows} inner corners is there only once",
                cure="Show the whole board to both views, and no other way round the mirrors",
                unseen=Unseen.ONLY_ONCE,
            )
        layers = first, first_layer(grid, board)
        for part, other in ((grids[0], layers[1]), (grid, first)):
            _check_size(part, other, board, source)
        _check_complete(grid, board, source)
    rest = saddles
    for layer in layers:
        _check_inside(layer, light, board, source)
        rest = rest.without(layer.smooth(with_edge(board)), 2.0 * ON_PX)
    more = find_grids(rest, board.columns, board.rows)
    if more and len(more[0].cells) >= SEEN_SHARE * len(board.names):
        raise unused_image(
            f"{source}: the board is there three times or more",
            cure="Show one board, once in each view",
            unseen=Unseen.THRICE,
        )
    return layers


def _second(light: Array, saddles: Saddles, first: Layer, board: Target) -> Grid | None:
    """Return the board beside the one found, or a part: in the image without that one, or among the other corners."""
    edge = first.smooth(with_edge(board))
    without = light.copy()
    take_off(without, measure_layer(light, first, None, board), board)
    rest = find_saddles(without).stronger(FAINT * saddles.usual)
    found: tuple[Grid, ...] = ()
    for others in (rest, rest.without(edge, ON_PX), saddles.without(edge, ON_PX)):
        grids = find_grids(others, board.columns, board.rows)
        if grids and (not found or len(grids[0].cells) > len(found[0].cells)):
            found = grids
        if found and len(found[0].cells) >= ENOUGH * len(board.names):
            break
    return found[0] if found and len(found[0].cells) >= PART_SHARE * len(board.names) else None


def _check_complete(grid: Grid, board: Target, source: str) -> None:
    """Raise BadImage for a grid that shows a part of the board only, or one of another size."""
    size = np.ptp(grid.cells, axis=0) + 1
    usual = np.median(grid.strength)
    for axis in range(2):
        for end in (grid.cells[:, axis].min(), grid.cells[:, axis].max()):
            if np.median(grid.strength[grid.cells[:, axis] == end]) < RIM_SHARE * usual:
                raise unused_image(
                    f"{source}: no checkerboard of {board.columns}x{board.rows} inner corners was found, but one with "
                    f"fewer {'columns' if axis == 0 else 'rows'}, or a part of one",
                    cure="Count the inner corners again, show the whole board to both views, or move it a little: "
                    "corners of the two views may fall on one another",
                )
    if len(grid.cells) < SEEN_SHARE * len(board.names) or (size != [board.columns, board.rows]).any():
        raise unused_image(
            f"{source}: one of the two boards is there in part: {size[0]}x{size[1]} of its "
            f"{board.columns}x{board.rows} inner corners",
            cure="Show the whole board to both views",
            unseen=Unseen.IN_PART,
        )


def _check_size(grid: Grid, other: Layer | None, board: Target, source: str) -> None:
    """Raise BadImage where a board goes on beyond its size, with corners that are not the other board's."""
    strange = grid.beyond
    if other is not None and len(strange):
        edge = other.smooth(with_edge(board))
        strange = strange[np.linalg.norm(strange[:, None] - edge[None], axis=2).min(axis=1) > 2.0 * ON_PX]
    if len(strange) > 0.5 * min(board.columns, board.rows):
        raise unused_image(
            f"{source}: {len(strange)} corners continue a board beyond {board.columns}x{board.rows} inner corners",
            cure="Count the inner corners again; where they are right, look for a third reflection, or move the board: "
            "corners of the two views may fall on one another",
            unseen=Unseen.BEYOND_SIZE,
        )


def _check_inside(layer: Layer, light: Array, board: Target, source: str) -> None:
    """Raise BadImage where a board reaches out of the image."""
    uv = layer.smooth(grid_of(board))
    if (uv < 0.0).any() or (uv > [light.shape[1] - 1.0, light.shape[0] - 1.0]).any():
        raise unused_image(
            f"{source}: one of the two boards is half out of the image",
            cure="Show the whole board to both views",
            unseen=Unseen.IN_PART,
        )


def _view(light: Array, board: Target, layer: Layer, other: Layer, source: str) -> BoardView:
    """Return the board of a layer, its points numbered as everywhere; raises BadImage where too few are left."""
    lost = int(np.count_nonzero(~layer.good))
    if lost > (1.0 - PLACED_SHARE) * len(layer.good):
        raise unused_image(
            f"{source}: {lost} of {len(layer.good)} corners of one board cannot be placed: they fall on the other "
            "board's, are hidden or are not corners",
            cure="Move the board a little, nearer or further, or turn it",
        )
    smooth, grid = layer.smooth, grid_of(board)
    size = np.linalg.norm(smooth.derivatives(grid)[0], axis=1).min(axis=1)
    blur = float(np.median(layer.quality[layer.good, 2] / size[layer.good]))
    if blur > BLUR_SHARE:
        raise unused_image(
            f"{source}: blurred: the edges are {blur:.2f} of a square wide (standard deviation)",
            cure="Hold the board still, shorten the exposure or focus the lens",
            unseen=Unseen.BLURRED,
        )
    everywhere = np.where(layer.good[:, None], layer.uv, smooth(grid))
    numbered = number_corners(without_layer(light, other, board), board, everywhere)
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
