"""Rows of a taught path that do not belong to it, found and named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.control.paths.along import positive
from armsight.errors import Inconsistent, NotEnoughData
from armsight.records import TaughtPath
from armsight.units import DEG, MM

Array = NDArray[np.float64]

SIDE = 5
"""Rows on one side that foretell a row; a run of outliers may be one shorter."""
LEAST_ROWS = 2 * SIDE + 1
LEAST_M, LEAST_RAD = 1e-3, 2.0 * DEG
"""Nearer to what its neighbours foretell no row is an outlier; ten times the noise of a taught path."""
TIMES = 6.0
"""An outlier is off by more than so many times the median row."""
FASTER = 1.5
"""The way to an outlier and back is so many times its neighbours' ways; about a corner it is as long as they. So no
corner of 288 rasters and saws is an outlier (91 had some without it), also in noise of 0.2 mm; 5 mm off are found where
rows lie 4.5 mm apart or less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathOutlier:
    """A row that is off_m and off_rad from what its neighbours foretell, and the same in words."""

    row: int
    off_m: float
    off_rad: float
    text: str


def outliers(path: TaughtPath, *, least_m: float = LEAST_M, least_rad: float = LEAST_RAD) -> tuple[PathOutlier, ...]:
    """Return the rows that are off the path, by their number.

    Each row is foretold from SIDE rows before, from as many behind, and from both, on a straight line in time (in row
    numbers where no times are known). What counts is the best of the three, so that stops and ends are none; and the
    way to the row or from it must be longer than those about it, so that narrow corners are none.
    The worst rows are taken out and the others judged anew, until none is off by more than least_m or least_rad and
    TIMES the median. Raises NotEnoughData below LEAST_ROWS rows, UsageError for a bound that is none.
    """
    positive("least_m", least_m)
    positive("least_rad", least_rad)
    if len(path) < LEAST_ROWS:
        raise NotEnoughData(
            f"a path of {len(path)} rows is too short to tell outliers; {LEAST_ROWS} are needed",
            consequence="None is looked for",
        )
    t = path.t_s if np.isfinite(path.t_s).all() else np.arange(len(path), dtype=np.float64)
    R = path.poses.rotation
    good = np.arange(len(path))
    limits: tuple[float, float] | None = None
    while len(good) >= LEAST_ROWS:
        off = _off(t[good], path.xyz_m[good], R[good])  # (m, 2)
        if limits is None:
            m, rad = (float(value) for value in TIMES * np.median(off, axis=0))
            limits = max(least_m, m), max(least_rad, rad)
        ratio = (off * _apart(t[good], path.xyz_m[good]) / np.array(limits)).max(axis=1)
        worst = [i for i in np.flatnonzero(ratio > 1.0) if ratio[i] == ratio[max(0, i - SIDE) : i + SIDE + 1].max()]
        if not worst:
            break
        good = np.delete(good, worst)
    found = np.setdiff1d(np.arange(len(path)), good)
    return tuple(_named(int(row), *_off_alone(t, path.xyz_m, R, good, row)) for row in found)


def without_rows(path: TaughtPath, rows: Sequence[int]) -> TaughtPath:
    """Return the path without some rows; the tag of one goes to the nearest row that stays.

    Raises NotEnoughData where fewer than two rows stay, Inconsistent where that row has another tag.
    """
    gone = {range(len(path))[row] for row in rows}
    stay = np.array([row for row in range(len(path)) if row not in gone], dtype=np.intp)
    if len(stay) < 2:
        raise NotEnoughData(f"{len(stay)} rows would be left of the path", consequence="None is taken out")
    tags = list(path.tags)
    for row in sorted(gone):
        if not tags[row]:
            continue
        near = int(stay[np.argmin(np.abs(stay - row))])
        if tags[near] and tags[near] != tags[row]:
            raise Inconsistent(
                f"the tag {tags[row]} of row {row}, which is taken out, would meet {tags[near]} at row {near}",
                consequence="No row is taken out",
                cure="Move one of the tags first",
            )
        tags[near] = tags[row]
    return TaughtPath(
        T_world_tip=path.T_world_tip[stay],
        t_s=path.t_s[stay],
        speed_m_s=path.speed_m_s[stay],
        tags=tuple(tags[row] for row in stay),
        parent=path.parent,
    )


def _named(row: int, off_m: float, off_rad: float) -> PathOutlier:
    text = f"row {row} is {off_m / MM:.3g} mm and {off_rad / DEG:.3g} deg from where its neighbours say"
    return PathOutlier(row=row, off_m=off_m, off_rad=off_rad, text=text)


def _off_alone(t: Array, xyz: Array, R: Rotation, good: NDArray[np.intp], row: np.intp) -> tuple[float, float]:
    """Return how far a row is off good rows only, in m and rad."""
    place = int(np.searchsorted(good, row))
    first = max(0, place - 2 * SIDE)
    near = np.insert(good[first : place + 2 * SIDE], place - first, row)
    m, rad = _off(t[near], xyz[near], R[near])[place - first]
    return float(m), float(rad)


def _off(t: Array, xyz: Array, R: Rotation) -> Array:
    """Return how far each row (n, 2) is from the nearest of what it is foretold to be, in m and rad."""
    n = len(t)
    best = np.full((n, 2), math.inf)
    half = np.arange(1, SIDE + 1)
    for offsets in (-half, half, np.concatenate([-half[:3], half[:3]])):
        rows = np.arange(max(0, -offsets.min()), n - max(0, offsets.max()))
        near = rows[:, None] + offsets  # (m, k)
        weights = _line_weights(t[near] - t[rows, None])
        place = np.linalg.norm(np.einsum("mk,mkc->mc", weights, xyz[near]) - xyz[rows], axis=1)
        back = R[np.repeat(rows, len(offsets))].inv() * R[near.ravel()]
        turns = back.as_rotvec().reshape(*near.shape, 3)
        angle = np.linalg.norm(np.einsum("mk,mkc->mc", weights, turns), axis=1)
        best[rows] = np.minimum(best[rows], np.stack([place, angle], axis=1))
    return best


def _apart(t: Array, xyz: Array) -> NDArray[np.bool_]:
    """Tell of each row's place and rotation (n, 2) whether they can be outliers: a place that its neighbours' ways,
    for their time, reach as they reach each other is none."""
    rate = np.linalg.norm(np.diff(xyz, axis=0), axis=1) / np.diff(t)
    about = sliding_window_view(np.pad(rate, SIDE, constant_values=np.nan), 2 * SIDE)  # (n, 2 SIDE)
    usual = np.nanmedian(about, axis=1)
    ways = np.pad(rate, 1)
    return np.stack([np.maximum(ways[1:], ways[:-1]) > FASTER * usual, np.ones(len(t), dtype=bool)], axis=1)


def _line_weights(t: Array) -> Array:
    """Return weights (m, k) that give the value at 0 of the least-squares line through values at times t (m, k)."""
    mean = t.mean(axis=1, keepdims=True)
    return np.asarray(1.0 / t.shape[1] - mean * (t - mean) / np.sum((t - mean) ** 2, axis=1, keepdims=True))
