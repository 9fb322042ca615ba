"""Steps of a path that nobody led: far longer than those about them, and out of their direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.control.paths.outliers import LEAST_ROWS, outliers
from armsight.records import TaughtPath
from armsight.units import DEG, MM

Array = NDArray[np.float64]

SAME_M = 1e-6
"""Rows nearer together than this are one place."""
LEAST_M = 0.005
"""A shorter step is none: a hand at 100 mm/s goes so far in 50 ms."""
JUMP_M = 0.05
"""A longer one is a jump even where it goes straight on."""
TIMES = 10.0
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


def distinct_rows(path: TaughtPath) -> list[int]:
    """Return the rows of a path without those at the place of the one before; of two the tagged one stays."""
    keep = [0] if len(path) else []
    for row in range(1, len(path)):
        if np.linalg.norm(path.xyz_m[row] - path.xyz_m[keep[-1]]) > SAME_M:
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
    """Return where a row is far from the one before, or from those about it, in place or rotation; the worst first.

    What is checked, exported and played is judged by this alone.
    """
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
        for off in (outliers(kept, least_m=LEAST_M, least_rad=TURN_RAD) if len(kept) >= LEAST_ROWS else ())
    ]
    return (*found, *_long_step(kept, rows), *_wide_turn(kept, rows))


def _long_step(path: TaughtPath, rows: list[int]) -> list[PathJump]:
    step = jump_step(path.xyz_m, path.t_s)
    if step is None:
        return []
    size_m = float(np.linalg.norm(path.xyz_m[step + 1] - path.xyz_m[step]))
    text = f"the path jumps by {size_m / MM:.0f} mm before row {rows[step + 1]}"
    cure = "Take the outlier out, teach it anew, or where it is meant put rows between (armsight path resample)"
    return [PathJump(row=rows[step + 1], size=size_m, text=text, cure=cure)]


def _wide_turn(path: TaughtPath, rows: list[int]) -> list[PathJump]:
    R = path.poses.rotation
    turns = np.asarray((R[1:] * R[:-1].inv()).magnitude())
    worst = int(np.argmax(turns))
    if turns[worst] <= TURN_RAD:
        return []
    text = f"the tool turns by {turns[worst] / DEG:.0f} deg before row {rows[worst + 1]}"
    cure = "Correct the row, or put rows between; armsight play --keep-rotation runs the path without turning"
    return [PathJump(row=rows[worst + 1], size=float(turns[worst]), text=text, cure=cure)]


def jump_step(xyz_m: Array, t_s: Array) -> int | None:
    """Return the first step that is a jump of a path through places (n, 3), or None. Step i leads to row i + 1.

    t_s (n,): when each was taught, NaN where it was not; a step that no hand is fast enough for is a jump in any case.
    """
    way, took_s = np.diff(xyz_m, axis=0), np.diff(t_s)
    size = np.linalg.norm(way, axis=1)
    direction = way / size[:, None]
    for i in np.flatnonzero(size > LEAST_M):
        if size[i] > HAND_M_S * took_s[i]:
            return int(i)
        sides = [part for part in (size[max(0, i - ABOUT) : i], size[i + 1 : i + 1 + ABOUT]) if len(part)]
        if len(size) < 3 or size[i] <= TIMES * max(float(np.median(part)) for part in sides):
            continue
        beside = [k for k in (i - 1, i + 1) if 0 <= k < len(size)]
        on = all(float(direction[k] @ direction[i]) > np.cos(ON_RAD) for k in beside)
        if size[i] > JUMP_M or not on:
            return int(i)
    return None
