"""Where target and tool were, and the axes that hold it, as numbers; what draws them is in curves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from armsight.arrays import Array
from armsight.units import MM

Point = tuple[float, float, float]

POINTS = 1500
"""Positions of a track that are kept: 12 m of a path at 80 mm/s, at ten a second."""
APART_M = 5e-4
"""What is seen so near to its track's end is at rest: the track goes on beyond it."""
DIGITS = 5
"""Of positions in m as they are sent."""
TICKS = 8
"""Of the longest axis at most."""


@dataclass(slots=True)
class Tracks:
    """Where the target was measured, with its standard deviation in m, and where the arm's tool was; all pages add to
    them and show the same."""

    measured: deque[tuple[Point, float]] = field(default_factory=lambda: deque(maxlen=POINTS))
    tool: deque[Point] = field(default_factory=lambda: deque(maxlen=POINTS))

    def add_measured(self, xyz_m: Array, std_m: float) -> None:
        """Add where the target is (3,) where it has gone on."""
        if not self.measured or _apart(xyz_m, self.measured[-1][0]):
            self.measured.append((_rounded(xyz_m), std_m))

    def add_tool(self, xyz_m: Array) -> None:
        """Add where the tool is (3,) where it has gone on."""
        if not self.tool or _apart(xyz_m, self.tool[-1]):
            self.tool.append(_rounded(xyz_m))

    def clear(self) -> None:
        """Begin anew."""
        self.measured.clear()
        self.tool.clear()


def _rounded(xyz_m: Array) -> Point:
    x, y, z = (round(float(value), DIGITS) for value in xyz_m)
    return x, y, z


def _apart(one: Array, other: Point) -> bool:
    return bool(np.linalg.norm(one - np.array(other)) > APART_M)


@dataclass(frozen=True, slots=True)
class Ticks:
    """Of the axes about curves, in whole mm: from, to (3,) and the step between two, the same on all axes."""

    low_mm: tuple[int, int, int]
    high_mm: tuple[int, int, int]
    step_mm: int

    @classmethod
    def about(cls, positions: Array) -> Ticks:
        """Return those about positions (n, 3) in m."""
        low, high = positions.min(axis=0) / MM, positions.max(axis=0) / MM
        wanted = max(float((high - low).max()) / (TICKS - 1), 1.0)
        size = 10 ** int(np.floor(np.log10(wanted)))
        step = next(n * size for n in (1, 2, 5, 10) if n * size >= wanted)
        first = np.floor(low / step).astype(int) * step
        last = np.maximum(np.ceil(high / step).astype(int) * step, first + step)
        return cls(tuple(first.tolist()), tuple(last.tolist()), step)

    @property
    def centre_m(self) -> Array:
        """The middle (3,) of what they hold."""
        return np.asarray(0.5 * MM * (np.array(self.low_mm) + np.array(self.high_mm)))

    @property
    def span_m(self) -> float:
        """The diagonal of what they hold."""
        return MM * float(np.linalg.norm(np.array(self.high_mm) - np.array(self.low_mm)))
