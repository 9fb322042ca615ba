"""Rows of a taught path that do not belong to it, and jumps of the joints between two rows, found and named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.control.paths.along import positive
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fields import Doc
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.units import DEG, MM

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


@output
class PathOutlier(Output):
    """A row that is off_m and off_rad from what its neighbours foretell, and the same in words."""

    row: Annotated[int, Doc("The row of the path read, from 0.")]
    off_m: Annotated[float, Doc("How far it is from where its neighbours say, m.")]
    off_rad: Annotated[float, Doc("How far it is turned from what they say, rad.")]
    text: Annotated[str, Doc("The same in words.")]


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
    index = int(np.searchsorted(good, row))
    first = max(0, index - 2 * SIDE)
    near = np.insert(good[first : index + 2 * SIDE], index - first, row)
    m, rad = _off(t[near], xyz[near], R[near])[index - first]
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
        distance = np.linalg.norm(np.einsum("mk,mkc->mc", weights, xyz[near]) - xyz[rows], axis=1)
        back = R[np.repeat(rows, len(offsets))].inv() * R[near.ravel()]
        turns = back.as_rotvec().reshape(*near.shape, 3)
        angle = np.linalg.norm(np.einsum("mk,mkc->mc", weights, turns), axis=1)
        best[rows] = np.minimum(best[rows], np.stack([distance, angle], axis=1))
    return best


def _apart(t: Array, xyz: Array) -> NDArray[np.bool_]:
    """Tell of each row's position and rotation (n, 2) whether they can be outliers: a position that its neighbours'
    ways, for their time, reach as they reach each other is none."""
    rate = np.linalg.norm(np.diff(xyz, axis=0), axis=1) / np.diff(t)
    about = sliding_window_view(np.pad(rate, SIDE, constant_values=np.nan), 2 * SIDE)  # (n, 2 SIDE)
    usual = np.nanmedian(about, axis=1)
    ways = np.pad(rate, 1)
    return np.stack([np.maximum(ways[1:], ways[:-1]) > FASTER * usual, np.ones(len(t), dtype=bool)], axis=1)


def _line_weights(t: Array) -> Array:
    """Return weights (m, k) that give the value at 0 of the least-squares line through values at times t (m, k)."""
    mean = t.mean(axis=1, keepdims=True)
    return np.asarray(1.0 / t.shape[1] - mean * (t - mean) / np.sum((t - mean) ** 2, axis=1, keepdims=True))


SAME_M = 1e-6
"""Rows nearer together than this are one position."""
LEAST_SHIFT_M = 0.005
"""A shorter step is none: a hand at 100 mm/s goes so far in 50 ms."""
JUMP_M = 0.05
"""A longer one is a jump even where it goes straight on."""
JUMP_TIMES = 10.0
"""How many of the steps before or after it a jump is as long as; a hand that starts or stops has such on one side."""
ABOUT = 5
"""Steps before and after that it is held against: their median leaves out the way back from an outlier."""
ON_RAD = 30.0 * DEG
"""A step within this of the direction of its neighbour goes straight on."""
HAND_M_S = 1.0
"""No hand teaches faster."""
TURN_RAD = 90.0 * DEG
"""A tool does not turn further between two rows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathJump:
    """A jump to a row: its size in m or, where only the tool turns, in rad; in words, and what helps."""

    row: int
    size: float
    text: str
    cure: str


def distinct_rows(path: TaughtPath, *, turn_m: float = 0.0) -> list[int]:
    """Return a path without rows at the place before them, tagged ones staying; turn_m: what a radian counts as."""
    keep = [0] if len(path) else []
    # the Frobenius norm of the difference of two rotations a little apart is the square root of 2 times their angle
    scaled = np.concatenate([path.xyz_m, turn_m / math.sqrt(2.0) * path.T_world_tip[:, :3, :3].reshape(-1, 9)], axis=1)
    for row in range(1, len(path)):
        if np.linalg.norm(scaled[row] - scaled[keep[-1]]) > SAME_M:
            keep.append(row)
        elif path.tags[row] and not path.tags[keep[-1]]:
            keep[-1] = row
    return keep


def of_rows(path: TaughtPath, rows: list[int]) -> TaughtPath:
    """Return the path of some of its rows, in their order."""
    return TaughtPath(
        T_world_tip=path.T_world_tip[rows],
        t_s=path.t_s[rows],
        speed_m_s=path.speed_m_s[rows],
        tags=tuple(path.tags[row] for row in rows),
        parent=path.parent,
    )


def path_jumps(path: TaughtPath) -> tuple[PathJump, ...]:
    """Return where a row is far from its neighbours, the worst first: by this alone paths are checked and played."""
    rows = distinct_rows(path)
    kept = of_rows(path, rows)
    if len(kept) < 2:
        return ()
    found = [
        PathJump(
            row=rows[off.row],
            size=off.off_m,
            text=f"the path jumps by {off.off_m / MM:.0f} mm and back at row {rows[off.row]}",
            cure="Take the outlier out (armsight path smooth --outliers drop), or teach it anew",
        )
        for off in (outliers(kept, least_m=LEAST_SHIFT_M, least_rad=TURN_RAD) if len(kept) >= LEAST_ROWS else ())
    ]
    return (*found, *_long_step(kept, rows), *_wide_turn(path))


def _long_step(path: TaughtPath, rows: list[int]) -> list[PathJump]:
    step = jump_step(path.xyz_m, path.t_s)
    if step is None:
        return []
    size_m = float(np.linalg.norm(path.xyz_m[step + 1] - path.xyz_m[step]))
    text = f"the path jumps by {size_m / MM:.0f} mm before row {rows[step + 1]}"
    cure = "Take the outlier out, teach it anew, or where it is meant put rows between (armsight path resample)"
    return [PathJump(row=rows[step + 1], size=size_m, text=text, cure=cure)]


def _wide_turn(path: TaughtPath) -> list[PathJump]:
    R = path.poses.rotation
    turns = np.asarray((R[1:] * R[:-1].inv()).magnitude())
    worst = int(np.argmax(turns))
    if turns[worst] <= TURN_RAD:
        return []
    text = f"the tool turns by {turns[worst] / DEG:.0f} deg before row {worst + 1}"
    cure = "Correct the row, or put rows between; armsight play --keep-rotation runs the path without turning"
    return [PathJump(row=worst + 1, size=float(turns[worst]), text=text, cure=cure)]


def jump_step(xyz_m: Array, t_s: Array) -> int | None:
    """Return the first step that is a jump of a path through positions (n, 3), or None. Step i leads to row i + 1.

    t_s (n,): when each was taught, NaN where it was not; a step that no hand is fast enough for is a jump in any case.
    """
    way, took_s = np.diff(xyz_m, axis=0), np.diff(t_s)
    size = np.linalg.norm(way, axis=1)
    direction = way / size[:, None]
    for i in np.flatnonzero(size > LEAST_SHIFT_M):
        if size[i] > HAND_M_S * took_s[i]:
            return int(i)
        sides = [part for part in (size[max(0, i - ABOUT) : i], size[i + 1 : i + 1 + ABOUT]) if len(part)]
        if len(size) < 3 or size[i] <= JUMP_TIMES * max(float(np.median(part)) for part in sides):
            continue
        beside = [k for k in (i - 1, i + 1) if 0 <= k < len(size)]
        on = all(float(direction[k] @ direction[i]) > np.cos(ON_RAD) for k in beside)
        if size[i] > JUMP_M or not on:
            return int(i)
    return None
