"""Checkerboards by ordered segmentation and X-shaped templates, after Pachidis et al. 2005, appendix.

There: seeds are pixels in the middle of a cross of 9 x 9 (or 5 x 5) pixels of one colour; each is propagated over its
own square; the next square is looked for by the centre and the slope of the one before; and two 11 x 11 templates, an
X with one leg of the square's colour, place the corners at the mean of an inner and an outer peak.

Here beyond that: the threshold follows the light; squares of both colours are used, so that where a threshold too high
or too low makes one colour larger, the four squares round a corner cancel it; the templates' legs follow the
square's own edges; what is no square is left out by its shape; and the grid must be the board's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image, Index, Mask
from armsight.measure.boards.gridmap import fit_map
from armsight.measure.boards.kernels.subpixel import RINGS, place_corners

Cell = tuple[int, int]
"""Column and row on the grid, counted from where the ordering began."""

WINDOW_SHARES = (8, 4, 16, 32)
"""The threshold is the mean of a window of this part of the image's longer side: it should span about two squares."""
CROSSES = (4, 2)
"""Arms of the crosses in px: 9 x 9 with 17 pixels, and 5 x 5 with 9 for small squares."""
LEAST_SIDE_PX = 4.0
SHAPE = (0.75, 1.3)
"""Area of the four corners' polygon by that of the square's pixels: rounded corners and ragged edges stay within."""
SLENDER = 5.0
"""A square seen more slanted than this, side by side, is not used."""
SHARED: dict[Cell, tuple[tuple[int, int], ...]] = {
    (1, 0): ((1, 0), (2, 3)),
    (0, 1): ((3, 0), (2, 1)),
    (-1, 0): ((0, 1), (3, 2)),
    (0, -1): ((0, 3), (1, 2)),
    (1, 1): ((2, 0),),
    (-1, 1): ((3, 1),),
    (-1, -1): ((0, 2),),
    (1, -1): ((1, 3),),
}
"""Which corners a square shares with its neighbours (its own, the neighbour's), numbered round each."""
NEAR = 0.25
"""A neighbour's corners are where the square's own are, to this share of its shorter side."""
GROWTH = 3.0
"""Neighbouring sides differ by less than this factor: the squares at the board's edge may be cut to less than half."""
ALIKE = 0.85
"""Cosine between the sides of neighbours."""
FIT = 0.8
"""Share of the templates' pixels that must fit at a corner; at a square's true corner it is 0.9 and more."""
SEEN_SHARE = 0.8
"""With fewer of the board's corners seen than this, it is not taken for the board."""
STRAY_PX = 1.0
SCATTER = 5.0
"""A corner further from the smooth grid than this, and than so many times the median corner, is replaced by the grid's
own: dust and ragged edges move one in fifty by two pixels."""
OFF_GRID = 0.15
"""... and where more than a few are further than this, in squares, it is not the board."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Squares:
    """Squares of one image: corners (n, 4, 2) px in order round each, colour (n,) +1 light, -1 dark, score (n, 4)."""

    corners: Array
    colour: Index
    score: Array

    def __len__(self) -> int:
        return len(self.colour)


def xcorner_corners(image: Image, columns: int, rows: int) -> Array | None:
    """Return the inner corners (columns * rows, 2) in px, row by row, or None where the board is not found.

    image: uint8 (h, w). Each corner is the mean of the X templates' inner and outer peaks over the squares round it
    (Pachidis et al. 2005, appendix); it is good to about a quarter of a pixel. Corners that were not seen, up to a
    fifth of them, are those of the smooth grid through the others. Which corner is the first is left open.
    """
    for squares in _segmentations(image):
        used = np.zeros(len(squares), dtype=np.bool_)
        for start in _by_distance(squares, np.array([image.shape[1], image.shape[0]]) / 2.0):
            if not used[start]:
                found = _corners_of(squares, order_squares(squares, int(start), used), columns, rows)
                if found is not None:
                    return found
    return None


def _segmentations(image: Image) -> Iterator[Squares]:
    """Yield the squares of the image under one threshold and cross after the other."""
    calm = cv2.GaussianBlur(image, (3, 3), 0)
    for share in WINDOW_SHARES:
        block = max(image.shape) // share | 1
        mean = cv2.blur(calm, (block, block), borderType=cv2.BORDER_REPLICATE)
        for cross in CROSSES:
            yield segment(np.asarray(calm > mean, dtype=np.uint8), cross)


def segment(light: Image, cross_px: int) -> Squares:
    """Return the squares of a binary image (h, w), light ones 1 and dark ones 0, each grown from its seed.

    cross_px: length of the arms of the seed's cross.
    """
    side = 2 * cross_px + 1
    arms = np.asarray(cv2.getStructuringElement(cv2.MORPH_CROSS, (side, side)), dtype=np.uint8)
    parts = [_one_colour(mask, arms, cross_px, colour) for mask, colour in ((light, 1), (1 - light, -1))]
    return Squares(
        corners=np.concatenate([part.corners for part in parts]),
        colour=np.concatenate([part.colour for part in parts]),
        score=np.concatenate([part.score for part in parts]),
    )


def _one_colour(mask: Image, arms: Image, cross_px: int, colour: int) -> Squares:
    """Return the squares of one colour: seeds, their propagation, and their corners by the X templates."""
    seeds = np.asarray(cv2.erode(mask, arms, borderType=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)
    n, cores, stats, _ = cv2.connectedComponentsWithStats(seeds, connectivity=4)
    labels = _propagate(mask, seeds, np.asarray(cores, dtype=np.int32), 1.5 * cross_px)
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    area = np.bincount(labels.ravel(), minlength=n)
    whole = sides.max(axis=1) < 0.5 * min(mask.shape)
    own, quads = [], []
    for label in np.flatnonzero(whole & (area > LEAST_SIDE_PX**2)):
        if label > 0:
            quad = _quad(labels, int(label), stats[label], cross_px, int(area[label]))
            if quad is not None:
                own.append(label)
                quads.append(quad)
    rough = np.array(quads).reshape(-1, 4, 2)
    side = np.linalg.norm(np.roll(rough, -1, axis=1) - rough, axis=2).min(axis=1, initial=np.inf)
    radius = np.clip(np.rint(0.25 * side), 2, 6).astype(np.int64)
    rings = np.clip(np.rint(0.4 * side), 2, RINGS).astype(np.int64)
    corners, score = np.empty_like(rough), np.empty(rough.shape[:2])
    place_corners(labels, np.array(own, dtype=np.int64), rough, radius, rings, corners, score)
    return Squares(corners=corners, colour=np.full(len(own), colour, dtype=np.intp), score=score)


def _propagate(mask: Image, seeds: Image, cores: NDArray[np.int32], reach_px: float) -> NDArray[np.int32]:
    """Return the squares' labels (h, w): every pixel of the mask belongs to the nearest core within reach."""
    distance, nearest = cv2.distanceTransformWithLabels(
        1 - seeds, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    at_seed = seeds > 0
    core_of = np.zeros(int(nearest.max()) + 1, dtype=np.int32)
    core_of[nearest[at_seed]] = cores[at_seed]
    return np.where((mask > 0) & (distance <= reach_px), core_of[nearest], 0).astype(np.int32)


def _quad(labels: NDArray[np.int32], label: int, stats: NDArray[Any], margin_px: int, area: int) -> Array | None:
    """Return the four corners (4, 2) of a label's outline in order round it, or None where it is no square."""
    left, top = max(0, stats[cv2.CC_STAT_LEFT] - 2 * margin_px), max(0, stats[cv2.CC_STAT_TOP] - 2 * margin_px)
    right = stats[cv2.CC_STAT_LEFT] + stats[cv2.CC_STAT_WIDTH] + 2 * margin_px
    bottom = stats[cv2.CC_STAT_TOP] + stats[cv2.CC_STAT_HEIGHT] + 2 * margin_px
    row, col = np.nonzero(labels[top:bottom, left:right] == label)
    hull = cv2.convexHull(np.stack([col, row], axis=1).astype(np.int32)).reshape(-1, 2).astype(float)
    if len(hull) < 4:
        return None
    first = hull[np.argmax(np.linalg.norm(hull - hull.mean(axis=0), axis=1))]
    third = hull[np.argmax(np.linalg.norm(hull - first, axis=1))]
    along = third - first
    beside = along[0] * (hull[:, 1] - first[1]) - along[1] * (hull[:, 0] - first[0])
    quad = np.array([first, hull[np.argmin(beside)], third, hull[np.argmax(beside)]])
    sides = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1)
    # the polygon runs through the outer pixels' centres: half a pixel is missing all round
    polygon = 0.5 * float(np.ptp(beside)) + 0.5 * float(sides.sum()) + 1.0
    if sides.min() < LEAST_SIDE_PX or sides.max() > SLENDER * sides.min():
        return None
    if not SHAPE[0] < polygon / area < SHAPE[1]:
        return None
    return np.asarray(quad + np.array([left, top]))


def _by_distance(squares: Squares, point: Array) -> Index:
    """Return the squares' positions by their distance from a point, the nearest first."""
    return np.argsort(np.linalg.norm(squares.corners.mean(axis=1) - point, axis=1))


def order_squares(squares: Squares, start: int, used: Mask) -> dict[Cell, tuple[int, int]]:
    """Return the squares that hang together with the one to start from, by their cell on the grid.

    Each is looked for where the corners and slope of a square before it say (the paper's ordered segmentation; it
    goes by the centre, which a square cut off at the board's edge does not have where it should). Gives the square's
    position, and which of its corners is the first (towards lower column and row). Marks them as used.
    """
    turned = np.stack([np.roll(squares.corners, -turn, axis=1) for turn in range(4)], axis=1)  # (n, turn, corner, 2)
    placed: dict[Cell, tuple[int, int]] = {(0, 0): (start, 0)}
    used[start] = True
    queue = deque([(0, 0)])
    while queue:
        cell = queue.popleft()
        here = turned[placed[cell]]
        colour = squares.colour[placed[cell][0]]
        free = {1: ~used & (squares.colour == colour), -1: ~used & (squares.colour != colour)}
        for step, shared in SHARED.items():
            node = (cell[0] + step[0], cell[1] + step[1])
            candidates = np.flatnonzero(free[1 if step[0] and step[1] else -1] & ~used)
            if node in placed or len(candidates) == 0:
                continue
            mine, theirs = ([pair[i] for pair in shared] for i in range(2))
            gap = np.linalg.norm(turned[candidates][:, :, theirs] - here[mine], axis=3).max(axis=2)
            best, turn = np.unravel_index(int(np.argmin(gap)), gap.shape)
            other = int(candidates[best])
            if gap[best, turn] < NEAR * _shortest(here) and _alike(here, turned[other, turn]):
                placed[node] = other, int(turn)
                used[other] = True
                queue.append(node)
    return placed


def _sides(quad: Array) -> tuple[Array, Array]:
    """Return the mean sides along the columns and along the rows of corners (4, 2), which begin at the first cell."""
    return 0.5 * (quad[1] - quad[0] + quad[2] - quad[3]), 0.5 * (quad[3] - quad[0] + quad[2] - quad[1])


def _shortest(quad: Array) -> float:
    return min(float(np.linalg.norm(side)) for side in _sides(quad))


def _alike(quad: Array, other: Array) -> bool:
    """Tell whether the sides of two squares run alike, and are of about the same length."""
    for a, b in zip(_sides(quad), _sides(other), strict=True):
        lengths = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        if float(a @ b) < ALIKE * lengths[0] * lengths[1] or max(lengths) > GROWTH * min(lengths):
            return False
    return True


def _corners_of(squares: Squares, placed: dict[Cell, tuple[int, int]], columns: int, rows: int) -> Array | None:
    """Return the board's corners (n, 2), row by row, where the ordered squares are that board's; else None."""
    if len(placed) < SEEN_SHARE * 0.5 * columns * rows:
        return None
    crossings = _crossings(squares, placed)
    if len(crossings) < max(4.0, SEEN_SHARE * columns * rows):
        return None
    cells = np.array(list(crossings))
    uv = np.array(list(crossings.values()))
    cells -= cells.min(axis=0)
    width, height = cells.max(axis=0) + 1
    if (width, height) == (rows, columns) != (columns, rows):
        cells = cells[:, ::-1]
    elif (width, height) != (columns, rows):
        return None
    grid = np.stack([np.tile(np.arange(columns), rows), np.repeat(np.arange(rows), columns)], axis=1).astype(float)
    smooth, distance = fit_map(cells.astype(float), uv)
    side = np.linalg.norm(smooth.derivatives(cells.astype(float))[0], axis=1).min(axis=1)
    if np.count_nonzero(distance < OFF_GRID * side) < SEEN_SHARE * columns * rows:
        return None
    good = distance < np.clip(SCATTER * np.median(distance), STRAY_PX, OFF_GRID * side)
    out = smooth(grid)
    out[cells[good, 1] * columns + cells[good, 0]] = uv[good]
    return out


def _crossings(squares: Squares, placed: dict[Cell, tuple[int, int]]) -> dict[Cell, Array]:
    """Return the inner corners by their cell: where two squares of one colour meet, the mean over all that do."""
    seen: dict[Cell, dict[Cell, Array]] = {}
    for (col, row), (square, turn) in placed.items():
        for c, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            corner = (c + turn) % 4
            if squares.score[square, corner] > FIT:
                seen.setdefault((col + i, row + j), {})[i, j] = squares.corners[square, corner]
    out: dict[Cell, Array] = {}
    for cell, corners in seen.items():
        pairs = [pair for pair in (((0, 0), (1, 1)), ((1, 0), (0, 1))) if all(node in corners for node in pair)]
        if pairs:
            out[cell] = np.mean([corners[node] for pair in pairs for node in pair], axis=0)
    return out
