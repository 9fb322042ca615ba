"""Circle grids: dots found as ellipses, ordered by growing the lattice, centred by a fit of their edges."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from armsight.errors import BadImage
from armsight.measure.boards.dots import Dots, neighbourhoods, round_dots
from armsight.measure.boards.gridmap import fit_map
from armsight.measure.boards.kernels.subpixel import fit_dots
from armsight.measure.boards.lattice import LOST_SHARE, Grid, Lattice, Placed, lattices, placements
from armsight.measure.boards.orient import axis_px
from armsight.records import BoardView, Target, TargetKind

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Image = NDArray[np.uint8]

BIG_DOT = 1.7
"""A dot whose area is this many times its neighbours' marks the origin (printed twice as wide, so four times)."""
LIKE_OTHERS = 1.15
"""A dot's radius agrees with the others' to this factor, or a threshold cut it."""
REACH = 2.1
"""Radius of the window in half axes, where the next dot is not nearer: an even ring outside steadies the fit."""
LEAST_REACH = 1.25
"""... but never less than this, or there is no outside to compare with."""
NARROW = 1.4
"""Radius of the smaller window."""
CLEAN = 0.98
"""Where a dot explains less of its window's grey levels, the paper's edge may be in it: a smaller one is tried."""
GLARE = 0.3
"""The inner part of a dot, as a share of its area, that is not looked at: lamps mirror there."""
EXPLAINED = 0.8
LOW_CONTRAST = 0.2
HIGH_CONTRAST = 1.5
"""Dots have between these multiples of the usual contrast."""


def find_circles(image: Image, board: Target, source: str) -> BoardView:
    """Return all circles of a symmetric or asymmetric grid; raises BadImage with the reason."""
    search = _Search(image=image, board=board, grid=_grid_of(board), source=source)
    for dark in (True, False):
        for block in neighbourhoods(image):
            search.look(round_dots(image, block, dark=dark))
            if search.best is not None and len(search.best) == len(board.names):
                return search.best
        if search.best is not None:  # some dots are hidden, whatever the threshold
            return search.best
    raise search.refusal()


@dataclass(slots=True, kw_only=True)
class _Search:
    """One board looked for in the dots of several thresholded images: the best view, or what stood against it."""

    image: Image
    board: Target
    grid: Grid
    source: str
    best: BoardView | None = None
    largest: Lattice = field(default_factory=dict)
    beyond: bool = False
    unclean: BadImage | None = None

    def look(self, dots: Dots) -> None:
        """Look for the board in one image's dots. Raises BadImage for a mirrored board."""
        for lattice in lattices(dots):
            if len(lattice) > len(self.largest):
                self.largest = lattice
            ways = placements(lattice, dots, self.grid)
            self.beyond = self.beyond or any(way.beyond for way in ways)
            numbering = _number(ways, dots, self.board, self.source)
            if numbering is None:
                continue
            try:
                view = _refined(self.image, self.board, self.grid, dots, numbering, self.source)
            except BadImage as error:
                self.unclean = error
                continue
            if self.best is None or len(view) > len(self.best):
                self.best = view
            return

    def refusal(self) -> BadImage:
        """Return why there is no view."""
        if self.unclean is not None:
            return self.unclean
        wanted = f"{self.board.columns}x{self.board.rows}"
        instead = _instead(self.largest, self.board, beyond=self.beyond)
        return BadImage(
            f"{self.source}: no grid of {wanted} circles was found{instead}",
            consequence="The image is not used",
            cure="Show the whole grid, sharp and evenly lit, and count its circles",
            size=_whole_size(self.largest, self.board),
        )


def _number(ways: list[Placed], dots: Dots, board: Target, source: str) -> Index | None:
    """Return for every point of the board its dot (-1: not among the candidates), or None where it is not this board.

    Raises BadImage for a mirrored board.
    """
    ways = [way for way in ways if way.count == ways[0].count]
    if not ways or any(way.beyond for way in ways):
        return None
    members = {frozenset(way.numbering.tolist()) for way in ways}
    if len(members) > 1:  # the board could lie here or one step further: neither may be guessed
        return None
    numberings = [way.numbering for way in ways if _right_handed(dots.uv, way.numbering, board)]
    if not numberings:
        _refuse_mirrored(source, "")
    return _oriented(numberings, dots, board, source)


def _grid_of(board: Target) -> Grid:
    """Return the board's points in a lattice basis of its own, and what lies at its four sides."""
    c, r = board.columns, board.rows
    row, col = np.mgrid[0:r, 0:c]
    table = _places(board, row.ravel(), col.ravel())
    low = table.min(axis=0)
    rows, columns = np.arange(r), np.arange(c)
    outside = ((np.full(c, -1), columns), (np.full(c, r), columns), (rows, np.full(r, -1)), (rows, np.full(r, c)))
    point = np.arange(c * r).reshape(r, c)
    return Grid(
        places=table - low,
        rims=(point[0], point[-1], point[:, 0], point[:, -1]),
        beyond=tuple(_places(board, *side) - low for side in outside),
    )


def _places(board: Target, row: Index, col: Index) -> Index:
    """Return integer lattice coordinates (n, 2): along rows and columns, or along diagonals."""
    if board.kind is TargetKind.ACIRCLES:
        x, y = 2 * col + row % 2, row
        return np.stack([(x + y) // 2, (y - x) // 2], axis=1)  # x and y are odd together
    return np.stack([col, row], axis=1)


def _right_handed(uv: Array, numbering: Index, board: Target) -> bool:
    """Tell whether y lies to the right hand of x in the image, as on a board seen from its printed side."""
    seen = np.flatnonzero(numbering >= 0)
    design = np.column_stack([board.xyz_m[seen, :2], np.ones(len(seen))])
    slope = np.linalg.lstsq(design, uv[numbering[seen]], rcond=None)[0]
    return bool(slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0] > 0.0)


def _oriented(numberings: list[Index], dots: Dots, board: Target, source: str) -> Index:
    """Choose the numbering that begins at the big dot, or the most upright one where there is none."""
    first = numberings[0]
    seen = np.flatnonzero(first >= 0)
    # a slanted board's dots grow towards the camera: compared is with what their places lead to expect
    design = np.column_stack([board.xyz_m[seen, :2] / board.pitch_m, np.ones(len(seen))])
    log_area = np.log(dots.area[first[seen]])
    excess = log_area - design @ np.linalg.lstsq(design, log_area, rcond=None)[0]
    big = seen[excess > np.log(BIG_DOT)]
    if len(big) == 1:
        beginning = [n for n in numberings if n[0] == first[big[0]]]
        if beginning:
            return beginning[0]
        if int(big[0]) in (board.columns - 1, len(board.names) - board.columns):
            _refuse_mirrored(source, f", or it is a board of {board.rows}x{board.columns} circles")
    return max(numberings, key=lambda n: float(axis_px(dots.uv[n[n >= 0]], np.flatnonzero(n >= 0), board)[0]))


def _refuse_mirrored(source: str, otherwise: str) -> None:
    raise BadImage(
        f"{source}: the board is mirrored{otherwise}",
        consequence="The image is not used",
        cure="Switch off the camera's mirror mode, or print the board as it is and count columns along x",
    )


def _expected(board: Target, dots: Dots, numbering: Index) -> tuple[Array, Array]:
    """Return for every point where its dot should lie (n, 2) and its half axes (n, 2, 2), both in px.

    They are the dot's own where they agree with the map through all dots: a threshold may have cut one in part.
    """
    seen = np.flatnonzero(numbering >= 0)
    plane = board.xyz_m[:, :2] / board.pitch_m
    smooth, _ = fit_map(plane[seen], dots.uv[numbering[seen]])
    step, _ = smooth.derivatives(plane)
    share = np.sqrt(dots.area[numbering[seen]] / (np.pi * np.abs(np.linalg.det(step[seen]))))  # radius over pitch
    usual = float(np.median(share))
    guess, shape = smooth(plane), usual * step
    own = (share > usual / LIKE_OTHERS) & ((share < usual * LIKE_OTHERS) | (share**2 > BIG_DOT * usual**2))
    guess[seen[own]] = dots.uv[numbering[seen[own]]]
    shape[seen[own]] = dots.shape[numbering[seen[own]]]
    return guess, shape


def _refined(image: Image, board: Target, grid: Grid, dots: Dots, numbering: Index, source: str) -> BoardView:
    """Fit every dot's edge, those that the search missed where the grid expects them; keep what passes the checks."""
    guess, shape = _expected(board, dots, numbering)
    n = len(guess)
    uv, covariance, quality = _centred(image, guess, shape)
    axes = np.linalg.norm(shape, axis=1)  # (n, 2)
    usual = float(np.median(quality[:, 1]))
    good = (quality[:, 0] > EXPLAINED) & (quality[:, 1] / usual > LOW_CONTRAST)
    good &= np.linalg.norm(uv - guess, axis=1) < np.maximum(1.0, 0.3 * axes.min(axis=1))
    if np.count_nonzero(~good) > LOST_SHARE * n or not grid.rims_held(np.flatnonzero(good)):
        raise BadImage(
            f"{source}: {np.count_nonzero(~good)} of {n} circles have no clean edge",
            consequence="The image is not used",
            cure="Hold the board still, focus the lens and avoid reflections",
        )
    index = np.flatnonzero(good)
    return BoardView(
        uv_px=uv[index],
        index=index,
        sigma_px=float(np.sqrt(np.median(np.trace(covariance[index], axis1=1, axis2=2)) / 2.0)),
        width=image.shape[1],
        height=image.shape[0],
        source=source,
    )


def _centred(image: Image, guess: Array, shape: Array) -> tuple[Array, Array, Array]:
    """Return centres (n, 2), their covariance (n, 2, 2) and quality (n, 4) by a fit of every dot's edge."""

    def fit(at: Array, axes: Array, reach: Array) -> tuple[Array, Array, Array]:
        n = len(at)
        uv, covariance, quality = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 4))
        fit_dots(image, at, np.ascontiguousarray(axes), reach, GLARE, uv, covariance, quality)
        return uv, covariance, quality

    reach = _reach(guess, shape)
    first = fit(guess, shape, reach)
    unclean = np.flatnonzero(first[2][:, 0] < CLEAN)
    if len(unclean):
        second = fit(guess[unclean], shape[unclean], np.minimum(NARROW, reach[unclean]))
        better = second[2][:, 0] > first[2][unclean, 0]
        # a ring this narrow may be explained by a dot with no light level in common with the others
        better &= second[2][:, 1] / np.median(first[2][:, 1]) < HIGH_CONTRAST
        for mine, other in zip(first, second, strict=True):
            mine[unclean[better]] = other[better]
    return first


def _reach(uv: Array, shape: Array) -> Array:
    """Return half windows (n,) in half axes that end before the neighbours begin."""
    radius = np.linalg.norm(shape, axis=1).max(axis=1)  # (n,)
    distance, nearest = (np.asarray(table)[:, 1] for table in cKDTree(uv).query(uv, k=2))
    gap = (distance - radius[nearest]) / radius
    return np.asarray(np.clip(gap, LEAST_REACH, REACH))


def _instead(lattice: Lattice, board: Target, *, beyond: bool) -> str:
    """Return words on the grid that was found, if it is large enough to mean anything."""
    if len(lattice) < 9:
        return ""
    size = _whole_size(lattice, board)
    if size is not None:
        return f", but one of {size[0]}x{size[1]} was"
    if beyond:
        return ": the grid that is there goes on beyond it"
    return f" (the largest grid has {len(lattice)} circles of {len(board.names)})"


def _whole_size(lattice: Lattice, board: Target) -> tuple[int, int] | None:
    """Return larger and smaller count of a whole symmetric grid of another size, or None."""
    if len(lattice) < 9 or board.kind is not TargetKind.CIRCLES:
        return None
    i, j = (np.ptp(np.array(list(lattice)), axis=0) + 1).tolist()
    return (max(i, j), min(i, j)) if i * j == len(lattice) and {i, j} != {board.columns, board.rows} else None
