"""Circle grids: dots found as ellipses, ordered by growing the lattice, centred by a fit of their edges."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from armsight.errors import BadImage
from armsight.measure.boards.gridmap import fit_map
from armsight.measure.boards.kernels.subpixel import fit_dots
from armsight.measure.boards.orient import axis_px
from armsight.records import BoardView, Target, TargetKind

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LEAST_RADIUS_PX = 1.5
MOST_CONTOURS = 8000
"""A threshold that leaves more pieces than this has cut noise, not print."""
ROUNDNESS = 0.12
"""A dot's area may differ from its ellipse's by this share (pixel stairs of the smallest dots: 0.1)."""
FLATTEST = 0.2
"""Shortest half axis over longest: beyond this slant nobody measures."""
LEAST_LEVELS = 12.0
"""A dot must differ from its surroundings by this many grey levels."""
MOST_SEEDS = 40
"""Dots from which a lattice is grown, from the middle of all outwards, before a thresholded image is given up."""
NEAR = 0.3
"""The next dot of a lattice lies within this share of a step of where it is expected."""
ALIKE = 2.5
"""Neighbouring dots differ in area by less than this factor; the origin's bigger dot is allowed for apart."""
BIG_DOT = 1.7
"""A dot whose area is this many times its neighbours' marks the origin (printed twice as wide, so four times)."""
BIGGEST = 8.0
"""... and not more times than this: that is something else."""
REACH = 1.7
"""Half window in half axes: the gap to the next dot is usually as wide as a dot."""
LEAST_REACH = 1.25
"""... but never less than this, or there is no outside to compare with."""
GLARE = 0.3
"""The inner part of a dot, as a share of its area, that is not looked at: lamps mirror there."""
EXPLAINED = 0.8
LOW_CONTRAST = 0.2
LOST_SHARE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Dots:
    """Candidates: uv (n, 2), half axes (n, 2) in px, the long one's direction (n,) in rad."""

    uv: Array
    axes: Array
    angle: Array

    @property
    def area(self) -> Array:
        """Area (n,) in px^2."""
        return np.asarray(np.pi * self.axes[:, 0] * self.axes[:, 1])


def find_circles(image: Image, board: Target, source: str) -> BoardView:
    """Return all circles of a symmetric or asymmetric grid; raises BadImage with the reason."""
    incomplete: list[tuple[_Dots, dict[tuple[int, int], int]]] = []
    for dark in (True, False):
        for block in _blocks(image):
            dots = _candidates(image, block, dark=dark)
            for lattice in _lattices(dots):
                if len(lattice) == len(board.names):
                    numbering = _number(lattice, dots, board, source)
                    if numbering is not None:
                        return _refined(image, board, dots, numbering, source)
                incomplete.append((dots, lattice))
    incomplete.sort(key=lambda pair: len(pair[1]), reverse=True)
    for dots, lattice in incomplete:
        numbering = _number(lattice, dots, board, source)
        if numbering is not None:
            return _refined(image, board, dots, numbering, source)
    largest = incomplete[0][1] if incomplete else {}
    raise BadImage(
        f"{source}: no grid of {board.columns}x{board.rows} circles was found{_instead(largest, board)}",
        consequence="The image is not used",
        cure="Show the whole grid, sharp and evenly lit, and count its circles",
    )


def _blocks(image: Image) -> tuple[int, ...]:
    """Return the sizes of neighbourhood in which a pixel is compared with its surroundings: 0 is the whole image."""
    width = image.shape[1]
    return (0, width // 12 | 1, width // 40 | 1, width // 5 | 1)


def _candidates(image: Image, block: int, *, dark: bool) -> _Dots:
    """Return everything round, dark on light or light on dark, in one thresholded image."""
    kind = cv2.THRESH_BINARY_INV if dark else cv2.THRESH_BINARY
    if block == 0:
        binary = cv2.threshold(image, 0, 255, kind | cv2.THRESH_OTSU)[1]
    else:
        offset = LEAST_LEVELS / 2.0 if dark else -LEAST_LEVELS / 2.0
        binary = cv2.adaptiveThreshold(image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, max(block, 5), offset)
    contours, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    found: list[tuple[float, float, float, float, float]] = []
    if len(contours) > MOST_CONTOURS:
        contours = ()
    largest = image.size / 16.0
    for contour in contours:
        if len(contour) < 8 or len(contour) > image.shape[1]:
            continue
        moments = cv2.moments(contour)
        area = moments["m00"]
        if not np.pi * LEAST_RADIUS_PX**2 < area < largest:
            continue
        u, v = moments["m10"] / area, moments["m01"] / area
        shape = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) * 4.0 / area
        values, vectors = np.linalg.eigh(shape)  # squared half axes of the ellipse with the same moments
        if values[0] <= 0.0 or values[0] < FLATTEST**2 * values[1]:
            continue
        if abs(np.pi * np.sqrt(values[0] * values[1]) / area - 1.0) > ROUNDNESS:
            continue
        if (image[int(v), int(u)] > np.median(image[contour[:, 0, 1], contour[:, 0, 0]])) == dark:
            continue
        found.append((u, v, np.sqrt(values[1]), np.sqrt(values[0]), np.arctan2(vectors[1, 1], vectors[0, 1])))
    table = np.array(found).reshape(-1, 5)
    # the contour runs through the outermost pixels' centres: the dot is half a pixel larger all round
    return _Dots(uv=table[:, :2], axes=table[:, 2:4] + 0.5, angle=table[:, 4])


def _lattices(dots: _Dots) -> list[dict[tuple[int, int], int]]:
    """Return the lattices grown over the dots, the largest first: (i, j) -> position of the dot."""
    if len(dots.uv) < 4:
        return []
    tree = cKDTree(dots.uv)
    free = set(range(len(dots.uv)))
    lattices: list[dict[tuple[int, int], int]] = []
    tried = 0
    for seed in np.argsort(np.linalg.norm(dots.uv - np.median(dots.uv, axis=0), axis=1)):
        if int(seed) not in free or tried >= MOST_SEEDS:
            continue
        tried += 1
        lattice = _grow(dots, tree, int(seed))
        if len(lattice) >= 4:
            lattices.append(lattice)
            free -= set(lattice.values())
    return sorted(lattices, key=len, reverse=True)[:4]


def _grow(dots: _Dots, tree: cKDTree, seed: int) -> dict[tuple[int, int], int]:
    """Grow a lattice from the seed: its two nearest independent neighbours give the first steps."""
    near = np.atleast_1d(tree.query(dots.uv[seed], k=min(9, len(dots.uv)))[1])
    steps = [dots.uv[k] - dots.uv[seed] for k in near[1:] if _alike(dots, seed, int(k))]
    basis = None
    for a, b in ((a, b) for n, b in enumerate(steps) for a in steps[:n]):
        if abs(a[0] * b[1] - a[1] * b[0]) > 0.35 * np.linalg.norm(a) * np.linalg.norm(b):
            basis = np.stack([a, b], axis=1)
            break
    if basis is None:
        return {}
    lattice = {(0, 0): seed}
    local = {(0, 0): basis}
    queue = [(0, 0)]
    used = {seed}
    while queue:
        at = queue.pop(0)
        E = local[at]
        here = dots.uv[lattice[at]]
        for axis, sense in product((0, 1), (1, -1)):
            place = (at[0] + sense, at[1]) if axis == 0 else (at[0], at[1] + sense)
            if place in lattice:
                continue
            step = sense * E[:, axis]
            distance, k = tree.query(here + step)
            if distance > NEAR * np.linalg.norm(step) or int(k) in used or not _alike(dots, lattice[at], int(k)):
                continue
            lattice[place] = int(k)
            used.add(int(k))
            updated = E.copy()
            updated[:, axis] = sense * (dots.uv[k] - here)
            local[place] = updated
            queue.append(place)
    return lattice


def _alike(dots: _Dots, a: int, b: int) -> bool:
    """Tell whether two dots may be neighbours in one grid."""
    ratio = float(dots.area[b] / dots.area[a])
    ratio = max(ratio, 1.0 / ratio)
    return ratio < ALIKE or BIG_DOT < ratio < BIGGEST


def _number(lattice: dict[tuple[int, int], int], dots: _Dots, board: Target, source: str) -> NDArray[np.intp] | None:
    """Return for every point of the board its dot (-1: not among the candidates), or None where it is not this board.

    The lattice's own steps may be any basis of the grid (slanted views bring diagonals nearest), so all
    small unimodular changes of basis are tried. Raises BadImage for a mirrored board.
    """
    total = len(board.names)
    if not (1.0 - LOST_SHARE) * total <= len(lattice) <= total:
        return None
    wanted = _integers(board)
    places = np.array(list(lattice), dtype=int)
    members = np.array([lattice[(int(i), int(j))] for i, j in places], dtype=np.intp)
    numberings: list[NDArray[np.intp]] = []
    mirrored = False
    for entries in product((-1, 0, 1), repeat=4):
        M = np.array(entries).reshape(2, 2)
        if abs(M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]) != 1:
            continue
        moved = places @ M.T
        moved = moved - moved.min(axis=0)
        position = {(int(i), int(j)): int(m) for (i, j), m in zip(moved, members, strict=True)}
        numbering = np.array([position.get((int(i), int(j)), -1) for i, j in wanted], dtype=np.intp)
        if np.count_nonzero(numbering >= 0) < len(lattice) or (moved.max(axis=0) != wanted.max(axis=0)).any():
            continue
        if _right_handed(dots.uv, numbering, board):
            numberings.append(numbering)
        else:
            mirrored = True
    if not numberings:
        if mirrored:
            _refuse_mirrored(source, "")
        return None
    return _oriented(numberings, dots, board, source)


def _integers(board: Target) -> NDArray[np.intp]:
    """Return the board's points in a lattice basis of its own, from zero: along rows and columns, or diagonals."""
    c, r = board.columns, board.rows
    row, col = np.mgrid[0:r, 0:c]
    if board.kind is TargetKind.ACIRCLES:
        x, y = 2 * col + row % 2, row
        i, j = (x + y) // 2, (y - x) // 2  # x and y are odd together
    else:
        i, j = col, row
    table = np.stack([i.ravel(), j.ravel()], axis=1)
    return np.asarray(table - table.min(axis=0), dtype=np.intp)


def _right_handed(uv: Array, numbering: NDArray[np.intp], board: Target) -> bool:
    """Tell whether y lies to the right hand of x in the image, as on a board seen from its printed side."""
    seen = np.flatnonzero(numbering >= 0)
    design = np.column_stack([board.xyz_m[seen, :2], np.ones(len(seen))])
    slope = np.linalg.lstsq(design, uv[numbering[seen]], rcond=None)[0]
    return bool(slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0] > 0.0)


def _oriented(numberings: list[NDArray[np.intp]], dots: _Dots, board: Target, source: str) -> NDArray[np.intp]:
    """Choose the numbering that begins at the big dot, or the most upright one where there is none."""
    first = numberings[0]
    area = np.where(first >= 0, dots.area[first], 0.0)
    big = np.flatnonzero(area > BIG_DOT * np.median(area[area > 0.0]))
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


def _refined(image: Image, board: Target, dots: _Dots, numbering: NDArray[np.intp], source: str) -> BoardView:
    """Fit every dot's edge, those that the search missed where the grid expects them; keep what passes the checks."""
    seen = np.flatnonzero(numbering >= 0)
    grid = board.xyz_m[:, :2] / board.pitch_m
    smooth, _ = fit_map(grid[seen], dots.uv[numbering[seen]])
    guess, shape = smooth(grid), np.empty((len(grid), 2, 2))
    guess[seen] = dots.uv[numbering[seen]]
    axes, angle = dots.axes[numbering[seen]], dots.angle[numbering[seen]]
    c, s = np.cos(angle), np.sin(angle)
    shape[seen] = np.stack([c * axes[:, 0], -s * axes[:, 1], s * axes[:, 0], c * axes[:, 1]], axis=1).reshape(-1, 2, 2)
    missed = np.flatnonzero(numbering < 0)
    if len(missed):
        nearest = seen[np.linalg.norm(grid[missed][:, None] - grid[seen][None], axis=2).argmin(axis=1)]
        shape[missed] = shape[nearest]
    n = len(guess)
    uv, covariance, quality = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 4))
    fit_dots(image, guess, shape, _reach(guess, shape), GLARE, uv, covariance, quality)
    axes = np.linalg.norm(shape, axis=1)  # (n, 2)
    usual = float(np.median(quality[:, 1]))
    good = (quality[:, 0] > EXPLAINED) & (quality[:, 1] / usual > LOW_CONTRAST)
    good &= np.linalg.norm(uv - guess, axis=1) < np.maximum(1.0, 0.3 * axes.min(axis=1))
    if np.count_nonzero(~good) > LOST_SHARE * n:
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


def _reach(uv: Array, shape: Array) -> Array:
    """Return half windows (n,) in half axes that end before the neighbours begin."""
    radius = np.linalg.norm(shape, axis=1).max(axis=1)  # (n,)
    distance, nearest = (np.asarray(table)[:, 1] for table in cKDTree(uv).query(uv, k=2))
    gap = (distance - radius[nearest]) / radius
    return np.asarray(np.clip(gap, LEAST_REACH, REACH))


def _instead(lattice: dict[tuple[int, int], int], board: Target) -> str:
    """Return words on the grid that was found, if it is large enough to mean anything."""
    if len(lattice) < 9:
        return ""
    places = np.array(list(lattice))
    i, j = np.ptp(places, axis=0) + 1
    if board.kind is TargetKind.CIRCLES and i * j == len(lattice):
        return f", but one of {max(i, j)}x{min(i, j)} was"
    return f" (the largest grid has {len(lattice)} circles of {len(board.names)})"
