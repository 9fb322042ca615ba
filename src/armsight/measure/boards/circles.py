"""Circle grids: dots found as ellipses, ordered by growing the lattice, centred by a fit of their edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # loads its spatial search where it is used

from armsight.arrays import Array, Image, Index, Mask
from armsight.errors import BadImage, unused_image
from armsight.measure.boards.gridmap import axis_px, fit_map
from armsight.measure.boards.kernels.subpixel import TRIALS, fit_dots
from armsight.measure.boards.lattice import (
    FULL_SIDE,
    LOST_SHARE,
    Dots,
    Grid,
    Lattice,
    Placed,
    lattices,
    neighbourhoods,
    placements,
    round_dots,
)
from armsight.records import BoardView, Target, TargetKind

BIG_DOT = 1.7
"""A dot whose area is this many times its neighbours' marks the origin (printed twice as wide, so four times)."""
RING = 1.5
"""Radius, in the other dots' own, of a ring that lies inside a dot twice as wide, and outside one like the others."""
INSIDE, OUTSIDE = 0.75, 1.4
"""Radii of two rings: one in the dot, where no lamp mirrors and though it lies a little off, and one round it."""
FAINT = 0.1
"""What differs less from what is round it, in shares of the usual contrast, is not looked at as a dot."""
LIKE_OTHERS = 1.15
"""A dot's radius agrees with the others' to this factor, or a threshold cut it."""
AS_LARGE = 1.4
"""Fitted radii of a print's dots agree to this factor; what lies beside the paper's edge fits as a far larger one."""
REACH = 2.1
"""Radius of the window in half axes, where the next dot is not nearer: an even ring outside steadies the fit."""
LEAST_REACH = 1.25
"""... but never less than this, or there is no outside to compare with."""
NARROW = 1.4
"""Radius of the smaller window."""
CLEAN = 0.98
"""Where a dot explains less of its window's grey levels, the paper's edge may be in it: a smaller one is tried."""
BEYOND_TRIALS = 10
"""Evaluations of the model for a dot beyond the board: a true one is there after eight, what is none would take 40."""
GLARE = 0.3
"""The inner part of a dot, as a share of its area, that is not looked at: lamps mirror there."""
EXPLAINED = 0.8
LOW_CONTRAST = 0.2
HIGH_CONTRAST = 1.5
"""Dots have between these multiples of the usual contrast."""

LIVE_CONTOURS = 6_000
"""Things that are looked at in a live picture before the next way to tell dark from light is not tried: 40 ms."""


def find_circles(image: Image, board: Target, source: str, *, quick: bool = False) -> BoardView:
    """Return all circles of a symmetric or asymmetric grid; raises BadImage with the reason.

    quick: the other neighbourhoods are left where a picture is so full that they would take longer than a live one may.
    """
    search = _Search(image=image, board=board, grid=_grid_of(board), source=source)
    shades: tuple[bool, ...] = (True, False)
    contours = 0
    for block in neighbourhoods(image):
        for dark in shades:
            if quick and contours > LIVE_CONTOURS:
                raise search.refusal()
            dots = round_dots(image, block, dark=dark)
            contours += dots.contours
            search.look(dots)
            if search.best is not None:
                if len(search.best) == len(board.names):
                    return search.best
                shades = (dark,)
                break
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
    largest: Lattice | None = None
    beyond: bool = False
    unclean: BadImage | None = None

    def look(self, dots: Dots) -> None:
        """Look for the board in one image's dots. Raises BadImage for a mirrored board."""
        for lattice in lattices(dots):
            if self.largest is None or len(lattice) > len(self.largest):
                self.largest = lattice
            ways = placements(lattice, dots, self.grid)
            self.beyond = self.beyond or any(way.beyond for way in ways)
            numbering = self._number(ways, dots)
            if numbering is None:
                continue
            try:
                view = self._refined(dots, numbering)
            except BadImage as error:
                self.unclean = error
                continue
            if view is None:
                continue
            if self.best is None or len(view) > len(self.best):
                self.best = view
            return

    def _number(self, ways: list[Placed], dots: Dots) -> Index | None:
        """Return for every point its dot (-1: not among the candidates), or None where it is not this board.

        Raises BadImage for a mirrored board.
        """
        ways = [way for way in ways if self.grid.rims_held(np.flatnonzero(way.numbering >= 0))] or ways
        ways = [way for way in ways if way.count == ways[0].count]
        if not ways or any(way.beyond for way in ways):
            return None
        members = {frozenset(way.numbering.tolist()) for way in ways}
        if len(members) > 1:  # the board could lie here or one step further: neither may be guessed
            return None
        numberings = [way.numbering for way in ways if _right_handed(dots.uv, way.numbering, self.board)]
        if not numberings:
            if not self.grid.rims_held(np.flatnonzero(ways[0].numbering >= 0)):  # a smaller board
                return None
            _refuse_mirrored(self.source, "")
        return self._oriented(numberings, dots)

    def _oriented(self, numberings: list[Index], dots: Dots) -> Index:
        """Choose the numbering that begins at the big dot, or the most upright one where there is none."""
        board, first = self.board, numberings[0]
        seen = np.flatnonzero(first >= 0)
        # a slanted board's dots grow towards the camera: compared is with what their places lead to expect
        design = np.column_stack([board.xyz_m[seen, :2] / board.pitch_m, np.ones(len(seen))])
        log_area = np.log(dots.area[first[seen]])
        excess = log_area - design @ np.linalg.lstsq(design, log_area, rcond=None)[0]
        big = seen[excess > np.log(BIG_DOT)]
        if len(big) == 1 and _twice_as_wide(self.image, self.grid, dots, first, int(big[0])):
            beginning = [n for n in numberings if n[0] == first[big[0]]]
            if beginning:
                return beginning[0]
            if int(big[0]) in (board.columns - 1, len(board.names) - board.columns):
                _refuse_mirrored(self.source, f", or it is a board of {board.rows}x{board.columns} circles")
        return max(numberings, key=lambda n: float(axis_px(dots.uv[n[n >= 0]], np.flatnonzero(n >= 0), board)[0]))

    def _refined(self, dots: Dots, numbering: Index) -> BoardView | None:
        """Fit every dot's edge, those that the search missed where the grid expects them; keep what passes the checks.

        None where the grid ends before the board's, or goes on. Raises BadImage where too few have a clean edge.
        """
        guess, shape = _expected(self.grid, dots, numbering)
        uv, covariance, quality = _centred(self.image, guess, shape)
        contrast = float(np.median(quality[:, 1]))
        good = _clean(uv, quality, guess, shape, contrast)
        radius = float(np.median(_radius(quality[good], shape[good]))) if good.any() else 1.0
        good &= (numbering >= 0) | _as_large(quality, shape, radius)  # nobody has seen the others as dots yet
        if not self.grid.rims_held(np.flatnonzero(good)):  # a smaller board
            return None
        lost = np.count_nonzero(~good)
        if lost > LOST_SHARE * len(guess):
            raise unused_image(
                f"{self.source}: {lost} of {len(guess)} circles have no clean edge",
                cure="Hold the board still, focus the lens and avoid reflections",
            )
        if _goes_on(self.image, self.grid, dots, numbering, contrast, radius):
            self.beyond = True
            return None
        index = np.flatnonzero(good)
        return BoardView(
            uv_px=uv[index],
            index=index,
            sigma_px=float(np.sqrt(np.median(np.trace(covariance[index], axis1=1, axis2=2)) / 2.0)),
            width=self.image.shape[1],
            height=self.image.shape[0],
            source=self.source,
        )

    def refusal(self) -> BadImage:
        """Return why there is no view."""
        if self.unclean is not None:
            return self.unclean
        wanted = f"{self.board.columns}x{self.board.rows}"
        instead = _instead(self.largest, self.board, beyond=self.beyond)
        return unused_image(
            f"{self.source}: no grid of {wanted} circles was found{instead}",
            cure="Show the whole grid, sharp and evenly lit, and count its circles",
            size=_complete_size(self.largest, self.board),
        )


def _grid_of(board: Target) -> Grid:
    """Return the board's points in a lattice basis of its own, and what lies at its four sides."""
    c, r = board.columns, board.rows
    row, col = np.mgrid[0:r, 0:c]
    table = _nodes(board, row.ravel(), col.ravel())
    low = table.min(axis=0)
    rows, columns = np.arange(r), np.arange(c)
    outside = ((np.full(c, -1), columns), (np.full(c, r), columns), (rows, np.full(r, -1)), (rows, np.full(r, c)))
    point = np.arange(c * r).reshape(r, c)
    return Grid(
        nodes=table - low,
        rims=(point[0], point[-1], point[:, 0], point[:, -1]),
        beyond=tuple(_nodes(board, *side) - low for side in outside),
    )


def _nodes(board: Target, row: Index, col: Index) -> Index:
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


def _twice_as_wide(image: Image, grid: Grid, dots: Dots, numbering: Index, point: int) -> bool:
    """Tell whether this point's dot is printed wider, by the light around it: a threshold joins dots to what is near.

    Compared on a ring that only a wide dot fills: it is then nearer to the other dots' middle than to the paper.
    """
    guess, shape, _ = _usual_dots(grid, dots, numbering, grid.nodes)
    ring = _ring(image, guess, shape, RING)
    paper, ink = np.median(ring), np.median(_levels(image, guess))
    return bool(abs(ring[point] - ink) < abs(ring[point] - paper))


def _levels(image: Image, uv: Array) -> Array:
    """Return the grey levels (...,) at the pixels nearest to places (..., 2)."""
    at = np.clip(np.rint(uv).astype(int), 0, np.array(image.shape[::-1]) - 1)
    return np.asarray(image[at[..., 1], at[..., 0]], float)


def _refuse_mirrored(source: str, otherwise: str) -> None:
    raise unused_image(
        f"{source}: the board is mirrored{otherwise}",
        cure="Switch off the camera's mirror mode, or print the board as it is and count columns along x",
    )


def _usual_dots(grid: Grid, dots: Dots, numbering: Index, at: Index) -> tuple[Array, Array, Array]:
    """Return where the map through all dots has the grid's places at (n, 2), and the usual dot's half axes (n, 2, 2)
    there, both in px, and for each dot that was seen its radius over the usual one's (m,).
    """
    seen = np.flatnonzero(numbering >= 0)
    nodes = grid.nodes.astype(float)
    smooth, _ = fit_map(nodes[seen], dots.uv[numbering[seen]])
    step = smooth.derivatives(nodes[seen])[0]
    share = np.sqrt(dots.area[numbering[seen]] / (np.pi * np.abs(np.linalg.det(step))))  # radius over pitch
    usual = float(np.median(share))
    asked = at.astype(float)
    return smooth(asked), usual * smooth.derivatives(asked)[0], share / usual


def _expected(grid: Grid, dots: Dots, numbering: Index) -> tuple[Array, Array]:
    """Return for every point where its dot should lie (n, 2) and its half axes (n, 2, 2), both in px.

    They are the dot's own where they agree with the map through all dots: a threshold may have cut one in part.
    """
    seen = np.flatnonzero(numbering >= 0)
    guess, shape, ratio = _usual_dots(grid, dots, numbering, grid.nodes)
    own = (ratio > 1.0 / LIKE_OTHERS) & ((ratio < LIKE_OTHERS) | (ratio**2 > BIG_DOT))
    guess[seen[own]] = dots.uv[numbering[seen[own]]]
    shape[seen[own]] = dots.shape[numbering[seen[own]]]
    return guess, shape


def _goes_on(image: Image, grid: Grid, dots: Dots, numbering: Index, contrast: float, radius: float) -> bool:
    """Tell whether the image has dots of this contrast and radius where the grid would go on: another board, cut short.

    The search may have missed them, as a threshold does where the light falls off.
    """
    ends = np.cumsum([len(side) for side in grid.beyond])[:-1]
    around = _usual_dots(grid, dots, numbering, np.concatenate(grid.beyond))[:2]
    for guess, shape in zip(*(np.split(part, ends) for part in around), strict=True):
        edge = _ring(image, guess, shape, OUTSIDE) - _ring(image, guess, shape, INSIDE)
        perhaps = edge * np.sign(contrast) > FAINT * abs(contrast)
        if np.count_nonzero(perhaps) < FULL_SIDE * len(guess):
            continue
        uv, _, quality = _centred(image, guess, shape, BEYOND_TRIALS)
        alike = _clean(uv, quality, guess, shape, contrast) & _as_large(quality, shape, radius)
        if np.count_nonzero(alike) >= FULL_SIDE * len(guess):
            return True
    return False


def _ring(image: Image, guess: Array, shape: Array, radius: float) -> Array:
    """Return the median grey level (n,) on a ring round each place, its radius in the dots' own."""
    turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    circle = radius * np.stack([np.cos(turn), np.sin(turn)])  # (2, m)
    return np.asarray(np.median(_levels(image, guess[:, None] + np.swapaxes(shape @ circle, 1, 2)), axis=1))


def _radius(quality: Array, shape: Array) -> Array:
    """Return the fitted radii (n,) over those expected."""
    return np.asarray(quality[:, 3] / np.sqrt(np.abs(np.linalg.det(shape))))


def _as_large(quality: Array, shape: Array, radius: float) -> Mask:
    """Tell which fitted dots (n,) are as large as the usual one, whose radius over the expected one is given."""
    size = _radius(quality, shape) / radius
    return np.asarray((size < AS_LARGE) & (size > 1.0 / AS_LARGE))


def _clean(uv: Array, quality: Array, guess: Array, shape: Array, contrast: float) -> Mask:
    """Tell which fitted dots (n,) are dots of the board: explained by the model, as dark, and where they should be."""
    good = (quality[:, 0] > EXPLAINED) & (quality[:, 1] * np.sign(contrast) > LOW_CONTRAST * abs(contrast))
    near = np.maximum(1.0, 0.3 * np.linalg.norm(shape, axis=1).min(axis=1))
    return np.asarray(good & (np.linalg.norm(uv - guess, axis=1) < near))


def _centred(image: Image, guess: Array, shape: Array, most: int = TRIALS) -> tuple[Array, Array, Array]:
    """Return centres (n, 2), their covariance (n, 2, 2) and quality (n, 4) by a fit of every dot's edge."""

    reach = _reach(guess, shape)
    first: tuple[Array, Array, Array] = fit_dots(image, guess, shape, reach, GLARE, most)
    unclean = np.flatnonzero(first[2][:, 0] < CLEAN)
    if len(unclean):
        second = fit_dots(image, guess[unclean], shape[unclean], np.minimum(NARROW, reach[unclean]), GLARE, most)
        better = second[2][:, 0] > first[2][unclean, 0]
        # a ring this narrow may be explained by a dot with no light level in common with the others
        usual = float(np.median(first[2][:, 1]))
        better &= second[2][:, 1] * np.sign(usual) < HIGH_CONTRAST * abs(usual)
        for mine, other in zip(first, second, strict=True):
            mine[unclean[better]] = other[better]
    return first


def _reach(uv: Array, shape: Array) -> Array:
    """Return half windows (n,) in half axes that end before the neighbours begin."""
    radius = np.linalg.norm(shape, axis=1).max(axis=1)  # (n,)
    distance, nearest = (np.asarray(table)[:, 1] for table in scipy.spatial.cKDTree(uv).query(uv, k=2))
    gap = (distance - radius[nearest]) / radius
    return np.asarray(np.clip(gap, LEAST_REACH, REACH))


def _instead(lattice: Lattice | None, board: Target, *, beyond: bool) -> str:
    """Return words on the grid that was found, if it is large enough to mean anything."""
    if lattice is None or len(lattice) < 9:
        return ""
    size = _complete_size(lattice, board)
    if size is not None:
        return f", but one of {size[0]}x{size[1]} was"
    if beyond:
        return ": the grid that is there goes on beyond it"
    return f" (the largest grid has {len(lattice)} circles of {len(board.names)})"


def _complete_size(lattice: Lattice | None, board: Target) -> tuple[int, int] | None:
    """Return counts of a whole grid of another size, or None: of a symmetric one the larger first, of an asymmetric one
    columns and rows exchanged."""
    if lattice is None or len(lattice) < 9:
        return None
    found = lattice.nodes
    if board.kind is TargetKind.ACIRCLES:
        return (board.rows, board.columns) if _is_exchanged(found, board) else None
    i, j = (np.ptp(found, axis=0) + 1).tolist()
    return (max(i, j), min(i, j)) if i * j == len(lattice) and {i, j} != {board.columns, board.rows} else None


def _is_exchanged(found: Index, board: Target) -> bool:
    """Tell whether lattice coordinates (n, 2) are those of a board with columns and rows exchanged, from any side."""
    row, col = np.mgrid[0 : board.columns, 0 : board.rows]
    nodes = _nodes(board, row.ravel(), col.ravel())
    wanted = {(i, j) for i, j in (nodes - nodes.min(axis=0)).tolist()}
    turns = [np.array(turn) for turn in (((1, 0), (0, 1)), ((1, 0), (0, -1)), ((-1, 0), (0, 1)), ((-1, 0), (0, -1)))]
    for turned in (found @ turn for side in turns for turn in (side, side[::-1])):
        if {(i, j) for i, j in (turned - turned.min(axis=0)).tolist()} == wanted:
            return True
    return False
