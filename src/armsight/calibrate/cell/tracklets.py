"""Spots followed from frame to frame: pieces of the ways of single lights, before anybody knows which light it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from armsight.arrays import Array, Index
from armsight.calibrate.cell.observations import Spots

GATE_PX = 15.0
"""A spot further than this from where its way leads is another one's."""
RIVAL = 1.5
"""The second nearest spot must be so many times as far off, or the way ends: two lights that pass are not mixed up."""
BRIDGED = 3
"""Frames that a light may be missing for."""
SHORTEST = 15
STILL_PX = 3.0
"""Spots that stay within so much while the arm moves are lamps."""
WINDOW, MOVING = 150, 1.0 / 3.0
"""Spots of a way that are looked at together, and the share of such windows in which a light of the arm moves."""


@dataclass(slots=True)
class _Way:
    rows: list[int]
    frame: int
    uv: Array
    step: Array


def tracklets(spots: Spots, number: Index) -> list[Index]:
    """Return the ways (rows of spots) of moving lights in one camera; number (frames,): of each frame, lost counted."""
    ways: list[_Way] = []
    open_: list[_Way] = []
    edges = np.searchsorted(spots.frame, np.arange(int(spots.frame[-1]) + 2)) if len(spots) else np.zeros(1, np.intp)
    for frame in range(len(edges) - 1):
        rows = np.arange(edges[frame], edges[frame + 1])
        now = int(number[frame])
        uv = spots.uv_px[rows]
        open_ = [way for way in open_ if now - way.frame <= BRIDGED + 1]
        taken = _joined(open_, uv, now) if len(rows) and open_ else {}
        for k, row in enumerate(rows.tolist()):
            way = taken.get(k)
            if way is None:
                way = _Way([row], now, uv[k], np.zeros(2))
                ways.append(way)
                open_.append(way)
                continue
            gap = max(now - way.frame, 1)
            way.step, way.uv, way.frame = (uv[k] - way.uv) / gap, uv[k], now
            way.rows.append(row)
    found = [np.array(way.rows, dtype=np.intp) for way in ways if len(way.rows) >= SHORTEST]
    return [rows for rows in found if moves(spots.uv_px[rows])]


def moves(uv_px: Array) -> bool:
    """Tell whether a way (k, 2) is of a light on the arm, which moves all along; a lamp jumps where a camera is hit."""
    parts = np.array_split(uv_px, max(round(len(uv_px) / WINDOW), 1))
    return bool(np.mean([extent_px(part) > STILL_PX for part in parts]) > MOVING)


def extent_px(uv_px: Array) -> float:
    """Return over how much a way (k, 2) extends, the wildest twentieth of its spots at each end left out."""
    low, high = np.percentile(uv_px, (5.0, 95.0), axis=0)
    return float((high - low).max())


def _joined(ways: list[_Way], uv: Array, now: int) -> dict[int, _Way]:
    """Return which way each spot (k,) goes on with: each the other's nearest, and no rival near."""
    ahead = np.array([way.uv + way.step * (now - way.frame) for way in ways])
    back, there = cKDTree(ahead), cKDTree(uv)
    near, which = back.query(uv, k=min(2, len(ways)), distance_upper_bound=GATE_PX * RIVAL)
    near, which = np.reshape(near, (len(uv), -1)), np.reshape(which, (len(uv), -1))
    mutual = np.atleast_1d(there.query(ahead)[1])
    out = {}
    for k in range(len(uv)):
        # an ended way costs a piece, a mixed one the start
        rival = near[k, 1] if near.shape[1] > 1 else np.inf
        if near[k, 0] < GATE_PX and mutual[which[k, 0]] == k and rival > RIVAL * near[k, 0]:
            out[k] = ways[which[k, 0]]
    return out
