"""Corners of a path rounded to arcs of a given radius."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.control.paths.along import corners, moving, places_at, poses_at, positive, with_poses
from armsight.errors import Degenerate, Inconsistent
from armsight.records import TaughtPath
from armsight.units import DEG

Array = NDArray[np.float64]

STEP_RAD = 5.0 * DEG
"""Between two rows of an arc: its chords stay within a thousandth of the radius."""
STRAIGHT = 0.02
"""How far, as a share of the radius, a leg of a corner may be from straight."""


@dataclass(frozen=True, slots=True, eq=False)
class _Arc:
    """An arc from length first_m to last_m of the path: places (k, 3) and the lengths (k,) they stand for."""

    row: int
    first_m: float
    last_m: float
    xyz_m: Array
    at_m: Array


def filleted(path: TaughtPath, radius_m: float, *, at: Sequence[int] | None = None) -> TaughtPath:
    """Return the path with its corners (the rows at; found by `corners` where None) rounded to arcs of radius_m.

    An arc touches both legs at radius_m tan(turn / 2) from the corner; rotations run on along it. A tag of a row that
    gives way stays at the row of the arc nearest to it along the path. Raises Inconsistent where legs are too short or
    not straight, or two arcs overlap, Degenerate where the path turns back on itself.
    """
    positive("radius_m", radius_m)
    s = moving(path)
    rows = sorted(range(len(path))[row] for row in (corners(path) if at is None else at))
    arcs = [_arc(path, s, row, radius_m) for row in rows]
    for one, other in itertools.pairwise(arcs):
        if one.last_m > other.first_m + 1e-12:
            raise Inconsistent(
                f"the arcs of {radius_m:g} m at rows {one.row} and {other.row} overlap",
                consequence="The corners are not rounded",
                cure="Take a smaller radius",
            )
    if not arcs:
        return path
    kept = np.ones(len(s), dtype=bool)
    for arc in arcs:
        kept &= (s < arc.first_m - 1e-9) | (s > arc.last_m + 1e-9)
    lengths = np.concatenate([s[kept], *(arc.at_m for arc in arcs)])
    places = np.concatenate([path.xyz_m[kept], *(arc.xyz_m for arc in arcs)])
    order = np.argsort(lengths, kind="stable")
    T = poses_at(path, lengths[order])
    T[:, :3, 3] = places[order]
    return with_poses(path, T, lengths[order], _tags(path, s, lengths[order]))


def _arc(path: TaughtPath, s: Array, row: int, radius_m: float) -> _Arc:
    if not 0 < row < len(path) - 1:
        raise Inconsistent(f"row {row} is an end of the path and no corner", consequence="It is not rounded")
    corner = path.xyz_m[row]
    into, out, turn = _legs(path, s, row, min(s[row] - s[row - 1], s[row + 1] - s[row]))
    into, out, turn = _legs(path, s, row, radius_m * math.tan(0.5 * min(turn, 0.5 * math.pi)))
    if turn > math.pi - 1.0 * DEG or turn < 1e-6:
        raise Degenerate(
            f"the path turns by {turn / DEG:.3g} deg at row {row}",
            consequence="No arc touches both legs",
            cure="Leave this row out of the corners",
        )
    leg = radius_m * math.tan(0.5 * turn)
    if leg > s[row] + 1e-12 or leg > s[-1] - s[row] + 1e-12:
        raise _unfit(row, radius_m, f"it needs {leg:.4g} m of path on both sides")
    inside = np.flatnonzero(np.abs(s - s[row]) < leg)
    ends = places_at(path, np.array([s[row] - leg, s[row] + leg]))
    along = (s[inside] - s[row])[:, None]
    line = corner + np.where(along < 0.0, along * into, along * out)
    off = np.concatenate([path.xyz_m[inside] - line, ends - np.array([corner - leg * into, corner + leg * out])])
    worst = float(np.linalg.norm(off, axis=1).max())
    if worst > STRAIGHT * radius_m:
        raise _unfit(row, radius_m, f"its legs bend by {worst:.3g} m over the {leg:.4g} m that the arc takes")
    count = max(2, math.ceil(turn / STEP_RAD - 1e-9))
    angle = np.linspace(0.0, turn, count + 1)
    aside = out - (out @ into) * into
    aside = aside / np.linalg.norm(aside)
    start = corner - leg * into
    xyz = start + radius_m * (np.sin(angle)[:, None] * into + (1.0 - np.cos(angle))[:, None] * aside)
    at = s[row] - leg + 2.0 * leg * angle / turn
    return _Arc(row, float(at[0]), float(at[-1]), xyz, at)


def _legs(path: TaughtPath, s: Array, row: int, length_m: float) -> tuple[Array, Array, float]:
    """Return the directions (3,) of the chords of length_m before and behind a row, and the angle between them."""
    length_m = max(length_m, 1e-9)
    ends = places_at(path, np.array([max(s[row] - length_m, 0.0), min(s[row] + length_m, s[-1])]))
    into, out = path.xyz_m[row] - ends[0], ends[1] - path.xyz_m[row]
    into, out = into / np.linalg.norm(into), out / np.linalg.norm(out)
    return into, out, math.atan2(float(np.linalg.norm(np.cross(into, out))), float(into @ out))


def _unfit(row: int, radius_m: float, why: str) -> Inconsistent:
    return Inconsistent(
        f"an arc of {radius_m:g} m does not fit the corner at row {row}: {why}",
        consequence="The corners are not rounded",
        cure="Take a smaller radius, or smooth the path first",
    )


def _tags(path: TaughtPath, s: Array, lengths: Array) -> tuple[str, ...]:
    """Return the tags (k,) at the rows nearest to where they were."""
    tags = [""] * len(lengths)
    for row, tag in enumerate(path.tags):
        if not tag:
            continue
        nearest = int(np.argmin(np.abs(lengths - s[row])))
        if tags[nearest]:
            raise Inconsistent(
                f"the tags {tags[nearest]} and {tag} would meet at one row",
                consequence="The corners are not rounded",
                cure="Take a smaller radius",
            )
        tags[nearest] = tag
    return tuple(tags)
