"""Lattices grown over dots, candidates for which is everything round in an image.

And the board's own dots taken out of a lattice that strangers joined.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import cv2
import numpy as np
import scipy  # loads its spatial search where it is used

from armsight.arrays import Array, Image, Index
from armsight.measure.boards.gridmap import GridMap, fit_map
from armsight.measure.boards.kernels.lattice import chain, fullest, grow_lattice, seed_steps

NEIGHBOURS = 8
OPPOSITE = 0.2
"""The middle of two opposite neighbours lies within this share of their distance from the dot between them."""
CELL_PX = 16.0
"""Width of the cells by which the nearest dot is found."""
MOST_SEEDS = 60
"""Dots from which a lattice is grown; the most regular come first, so this ends a search among strangers only."""
NEAR = 0.3
"""The next dot of a lattice lies within this share of a step of where it is expected."""
ALIKE = 2.0
"""Neighbouring dots differ in area by less than this factor."""
BIGGEST = 8.0
"""The origin's bigger dot (twice as wide, so four times) has at most this many times the others' area."""
PART = 0.75
"""A lattice must hold this share of a board's places before the rest is looked for among the other dots."""
MOST_PLACES = 12
"""Places on a lattice at which the board is tried: one to four where it is (415 pictures); where more are as full, the
lattice is larger than the board."""
LOST_SHARE = 0.1
"""Share of a board's dots that may be missing."""
ON_MAP = 0.12
"""A dot of the board lies within this share of the pitch of the smooth map through all of them."""
FULL_SIDE = 0.6
"""A side of the board has this share of its dots; where as many lie next to it, the grid goes on: another board."""
NEAR_SIDE = 0.25
"""Those are looked for within this share of the pitch: the map is less sure outside the board."""
BASES = tuple(
    np.array(entries).reshape(2, 2)
    for entries in product((-1, 0, 1), repeat=4)
    if abs(entries[0] * entries[3] - entries[1] * entries[2]) == 1
)
"""A lattice's own steps may be any basis of the grid: slanted views bring diagonals nearest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """A board in whole numbers: its places (n, 2) from zero, and for each of its four sides what lies there.

    rims: positions of the outermost points. beyond: the places (m, 2) next to them, outside.
    """

    nodes: Index
    rims: tuple[Index, ...]
    beyond: tuple[Index, ...]

    def rims_held(self, index: Index) -> bool:
        """Tell whether every side has enough of its points among these; else the board may be a smaller one."""
        return all(np.isin(rim, index).mean() >= FULL_SIDE for rim in self.rims)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Dots (m,) and their places (m, 2) in whole numbers, from the first one's on."""

    members: Index
    nodes: Index

    def __len__(self) -> int:
        return len(self.members)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """One way a board may lie on a lattice: dot (n,) of each of its points, -1 where none; beyond: the grid goes on."""

    numbering: Index
    beyond: bool

    @property
    def count(self) -> int:
        """How many of the points have a dot."""
        return int(np.count_nonzero(self.numbering >= 0))


def lattices(dots: Dots) -> Iterator[Lattice]:
    """Yield the lattices of at least four dots grown from the most regular dots outwards, none from a used dot."""
    if len(dots.uv) < 4:
        return
    used = np.zeros(len(dots.uv), dtype=np.bool_)
    order, steps = _seeds(dots)
    tried = 0
    first, after = dots.chained
    for seed in order.tolist():
        if used[seed]:
            continue
        members, nodes = grow_lattice(dots.uv, dots.area, first, after, CELL_PX, seed, steps[seed], NEAR, ALIKE)
        tried += 1
        if len(members) >= 4:
            used[members] = True
            yield Lattice(members=members, nodes=nodes)
        if tried >= MOST_SEEDS:
            return


def _seeds(dots: Dots) -> tuple[Index, Array]:
    """Return dots (m,) with two pairs of opposite, alike neighbours, the most regular first, and the steps to them
    (n, 2, 2) of all dots."""
    n = min(NEIGHBOURS + 1, len(dots.uv))
    near = np.asarray(dots.tree.query(dots.uv, k=n)[1])[:, 1:]  # (n, k)
    step = dots.uv[near] - dots.uv[:, None]
    length = np.linalg.norm(step, axis=2)
    log_area = np.log(dots.area)
    alike = np.abs(log_area[near] - log_area[:, None]) < np.log(ALIKE)
    a, b = np.triu_indices(n - 1, 1)
    error = np.linalg.norm(step[:, a] + step[:, b], axis=2) / np.maximum(length[:, a] + length[:, b], 1e-9)
    error = np.where(alike[:, a] & alike[:, b] & (error < OPPOSITE), error, np.inf)
    order = np.argsort(np.minimum(length[:, a], length[:, b]), axis=1, kind="stable")
    irregular, steps = seed_steps(step, error, np.stack([a, b], axis=1), order)
    best = np.argsort(irregular, kind="stable")
    return best[irregular[best] < np.inf], steps


def placements(lattice: Lattice, dots: Dots, grid: Grid) -> list[Placed]:
    """Return the ways in which a board lies on a lattice that holds it, those with most dots first.

    What lies beside the map through all the dots is no dot of the board; places left empty get the dot that lies where
    the map says, whatever its size.
    """
    wanted = grid.nodes
    found: list[Placed] = []
    nodes, members = lattice.nodes, lattice.members
    if len(nodes) < PART * len(wanted):
        return found
    fitted: dict[bytes, tuple[Placed | None, Index]] = {}
    margin = wanted.max(axis=0)
    options, least = [], PART * len(wanted)
    for basis in BASES:
        moved = nodes @ basis.T
        shift = moved.min(axis=0) - margin
        table = np.full(np.ptp(moved, axis=0) + 1 + 2 * margin, -1, dtype=np.intp)
        table[tuple((moved - shift).T)] = members
        held, corners = fullest(table, wanted, least)
        options.append((held, basis, shift, table, corners))
        least = max(least, held - LOST_SHARE * len(wanted))  # what is slanted holds fewer
    for held, basis, shift, table, corners in options:
        for corner in corners if held >= least else ():
            at = corner + wanted
            on_lattice = (at + shift) @ np.rint(np.linalg.inv(basis)).astype(np.intp).T
            order = np.lexsort(on_lattice.T)
            key = on_lattice[order].tobytes()
            if key not in fitted:  # a board's own turns lie on the same places
                if len(fitted) == MOST_PLACES:
                    return [replace(placed, beyond=True) for placed in found]
                fitted[key] = _fitted(table, at, dots, grid), order
            placed, first = fitted[key]
            if placed is not None:
                numbering = np.empty(len(wanted), dtype=np.intp)
                numbering[order] = placed.numbering[first]
                found.append(replace(placed, numbering=numbering))
    return sorted(found, key=lambda placed: -placed.count)


def _fitted(table: Index, at: Index, dots: Dots, grid: Grid) -> Placed | None:
    """Return the board at these places (n, 2) of the table, cleaned by the map through its dots, or None."""
    wanted = grid.nodes
    numbering = table[at[:, 0], at[:, 1]]
    seen = np.flatnonzero(numbering >= 0)
    smooth, distance = fit_map(wanted[seen].astype(float), dots.uv[numbering[seen]])
    first, _ = smooth.derivatives(wanted.astype(float))
    pitch_px = np.linalg.norm(first, axis=1).min(axis=1)  # (n,)
    numbering = numbering.copy()
    numbering[seen[distance > ON_MAP * pitch_px[seen]]] = -1
    expected = smooth(wanted.astype(float))
    usual = float(np.median(dots.area[numbering[numbering >= 0]])) if (numbering >= 0).any() else 0.0
    empty = np.flatnonzero(numbering < 0)
    if len(empty) and usual > 0.0:
        gap, nearest = (np.asarray(part) for part in dots.tree.query(expected[empty]))
        fits = (gap < ON_MAP * pitch_px[empty]) & (dots.area[nearest] < BIGGEST * usual)
        fits &= (dots.area[nearest] > usual / ALIKE) & ~np.isin(nearest, numbering)
        numbering[empty[fits]] = nearest[fits]
    held = np.flatnonzero(numbering >= 0)
    if len(held) < PART * len(wanted):
        return None
    return Placed(numbering=numbering, beyond=_goes_on(grid.beyond, dots, smooth, usual))


def _goes_on(sides: tuple[Index, ...], dots: Dots, smooth: GridMap, usual_px2: float) -> bool:
    """Tell whether most places (m, 2) next to one of the board's sides hold a dot like the board's."""
    at = np.concatenate(sides).astype(float)
    pitch_px = np.linalg.norm(smooth.derivatives(at)[0], axis=1).min(axis=1)
    gap, nearest = (np.asarray(part) for part in dots.tree.query(smooth(at)))
    ratio = dots.area[nearest] / usual_px2
    held = (gap < NEAR_SIDE * pitch_px) & (ratio < ALIKE**2) & (ratio > ALIKE**-2)
    ends = np.cumsum([len(side) for side in sides])[:-1]
    return any(np.count_nonzero(side) >= FULL_SIDE * len(side) for side in np.split(held, ends))


LEAST_RADIUS_PX = 1.5
ROUNDNESS = 0.12
"""A dot's area may differ from its ellipse's by this share (pixel stairs of the smallest dots: 0.1)."""
FLATTEST = 0.2
"""Shortest half axis over longest: beyond this slant nobody measures."""
LEAST_LEVELS = 12.0
"""A dot must differ from its surroundings by this many grey levels."""
SHORTEST_CONTOUR = 8
CORE, ROUND = np.ones((2, 2), np.uint8), np.ones((3, 3), np.uint8)
"""The smallest dot holds so many pixels in a square; what is further than one from such squares is not a dot's: texture
and noise are thousands of speckles, whose contours took most of the time."""
LARGEST_SHARE = 1.0 / 16.0
"""A dot covers at most this share of the image."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dots:
    """Candidates: uv (n, 2), half axes (n, 2) in px, the long one first, and its direction (n,) in rad.

    contours: how many things were looked at to find them, round or not.
    """

    uv: Array
    axes: Array
    angle: Array
    contours: int = 0

    @cached_property
    def area(self) -> Array:
        """Area (n,) in px^2."""
        return np.asarray(np.pi * self.axes[:, 0] * self.axes[:, 1])

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """What finds the dot nearest to a pixel."""
        return scipy.spatial.cKDTree(self.uv)

    @cached_property
    def chained(self) -> tuple[Index, Index]:
        """First dot of each cell of CELL_PX and the next after each dot, -1 for none."""
        columns, rows = (int(largest / CELL_PX) + 1 for largest in self.uv.max(axis=0))
        first, after = chain(self.uv, CELL_PX, columns, rows)
        return first, after

    @property
    def shape(self) -> Array:
        """Matrices (n, 2, 2) whose columns are the half axes in px."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        long, short = self.axes.T
        return np.stack([c * long, -s * short, s * long, c * short], axis=1).reshape(-1, 2, 2)


def neighbourhoods(image: Image) -> tuple[int, ...]:
    """Return the sizes of neighbourhood in which a pixel is compared with its surroundings: 0 is the whole image."""
    width = image.shape[1]
    return (0, width // 12 | 1, width // 40 | 1, width // 5 | 1, width // 72 | 1)


def round_dots(image: Image, block: int, *, dark: bool) -> Dots:
    """Return everything round, dark on light or light on dark, in one thresholded image.

    However many contours there are: wood, gravel and noise give thousands, and the board may lie among them.
    """
    kind = cv2.THRESH_BINARY_INV if dark else cv2.THRESH_BINARY
    if block == 0:
        binary = cv2.threshold(image, 0, 255, kind | cv2.THRESH_OTSU)[1]
    else:
        offset = LEAST_LEVELS / 2.0 if dark else -LEAST_LEVELS / 2.0
        speckled = cv2.adaptiveThreshold(image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, max(block, 5), offset)
        binary = cv2.bitwise_and(speckled, cv2.dilate(cv2.morphologyEx(speckled, cv2.MORPH_OPEN, CORE), ROUND))
    found, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    length = np.fromiter(map(len, found), dtype=np.intp, count=len(found))
    fit = np.flatnonzero((length >= SHORTEST_CONTOUR) & (length <= image.shape[1]))
    if not len(fit):
        return Dots(uv=np.empty((0, 2)), axes=np.empty((0, 2)), angle=np.empty(0))
    length = length[fit]
    begin = np.cumsum(length) - length
    xy = np.concatenate([found[k] for k in fit.tolist()]).reshape(-1, 2)
    area, uv, spread = _moments(xy.astype(float), begin)
    values, vectors = np.linalg.eigh(4.0 * spread)  # squared half axes of the ellipse with the same moments
    keep = (area > np.pi * LEAST_RADIUS_PX**2) & (area < LARGEST_SHARE * image.size)
    keep &= (values[:, 0] > 0.0) & (values[:, 0] >= FLATTEST**2 * values[:, 1])
    keep &= np.abs(np.pi * np.sqrt(np.maximum(values.prod(axis=1), 0.0)) - area) <= ROUNDNESS * area
    edge = np.add.reduceat(image[xy[:, 1], xy[:, 0]].astype(float), begin) / length
    at = np.clip(uv, 0, np.array(image.shape[::-1]) - 1).astype(int)
    middle = image[at[:, 1], at[:, 0]]
    keep &= (middle < edge) if dark else (middle > edge)
    axes = np.sqrt(np.maximum(values[keep], 0.0))
    # the contour runs through the outermost pixels' centres: the dot is half a pixel larger all round
    return Dots(
        uv=uv[keep],
        axes=axes[:, ::-1] + 0.5,
        angle=np.arctan2(vectors[keep, 1, 1], vectors[keep, 0, 1]),
        contours=len(fit),
    )


def _moments(xy: Array, begin: Index) -> tuple[Array, Array, Array]:
    """Return area (n,), centre (n, 2) and second central moments over area (n, 2, 2) of polygons.

    xy (m, 2): the vertices of all, one polygon after the other; begin (n,): where each begins. Green's theorem;
    polygons without area get zeros.
    """
    after = np.arange(1, len(xy) + 1)
    after[np.append(begin[1:], len(xy)) - 1] = begin
    origin = np.repeat(xy[begin], np.diff(np.append(begin, len(xy))), axis=0)
    p, q = xy - origin, xy[after] - origin  # near zero, or the products would lose digits
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    terms = np.column_stack(
        [
            cross / 2.0,
            (p + q) * cross[:, None] / 6.0,
            (p * p + p * q + q * q) * cross[:, None] / 12.0,
            (p[:, 0] * (2.0 * p[:, 1] + q[:, 1]) + q[:, 0] * (2.0 * q[:, 1] + p[:, 1])) * cross / 24.0,
        ]
    )
    m00, m10, m01, m20, m02, m11 = np.add.reduceat(terms, begin, axis=0).T
    some = np.where(m00 == 0.0, 1.0, m00)
    u, v = m10 / some, m01 / some
    uu, vv, uv = m20 / some - u * u, m02 / some - v * v, m11 / some - u * v
    spread = np.stack([uu, uv, uv, vv], axis=1).reshape(-1, 2, 2)
    spread[m00 == 0.0] = 0.0
    return np.abs(m00), xy[begin] + np.stack([u, v], axis=1), spread
