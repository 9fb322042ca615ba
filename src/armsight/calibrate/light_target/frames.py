"""What one pair of frames shows of a lit target: pairs of spots, and every choice of n that can be the lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.optics import SIDES, Rig, Triangulation, triangulate
from armsight.records import NotSeen, Spots

Array = NDArray[np.float64]
Index = NDArray[np.intp]

MAX_CHOICES = 150
"""Choices of lights searched in one frame: of the brightest pairs, as many as give no more; ten for three lights."""

SLACK_PX = 0.1
"""What a good calibration leaves beside a spot's own standard deviation; it decides what belongs together, not the
answer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitFrame:
    """Pairs of spots of one moment: row i of left and row i of right may be the same light.

    A spot may stand in several rows where the epipolar lines do not decide; name: how the frame is called to people.
    """

    name: str
    left: Spots
    right: Spots

    def __post_init__(self) -> None:
        if len(self.left) != len(self.right):
            raise Inconsistent(f"{self.name}: {len(self.left)} spots at left, {len(self.right)} at right: no pairs")

    def __len__(self) -> int:
        return len(self.left)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """A frame's choices: rows (c, n) of its pairs; xyz_m (c, n, 3), cov_m2 (c, n, 3, 3) with slack, in rig axes."""

    frame: int
    rows: Index
    xyz_m: Array
    cov_m2: Array


def sights_of(rig: Rig, frames: Sequence[LitFrame], n: int) -> tuple[list[Sight], list[tuple[int, str]]]:
    """Return the frames in which n lights may be seen, and (number, why) of those in which not."""
    sights: list[Sight] = []
    rejected: list[tuple[int, str]] = []
    points = _triangulated(rig, frames)
    ends = np.cumsum([len(frame) for frame in frames])
    for number, (frame, end) in enumerate(zip(frames, ends.tolist(), strict=True)):
        of = slice(end - len(frame), end)
        choices = _choices(frame, points.found[of], n)
        if isinstance(choices, NotSeen):
            rejected.append((number, choices.why))
        else:
            xyz, cov = points.xyz_m[of], points.covariance_m2[of]
            sights.append(Sight(frame=number, rows=choices, xyz_m=xyz[choices], cov_m2=cov[choices]))
    return sights, rejected


def _triangulated(rig: Rig, frames: Sequence[LitFrame]) -> Triangulation:
    """Return the points of all frames, one after the other."""
    slack = SLACK_PX**2 * np.eye(2)
    views = [[getattr(frame, side) for frame in frames] for side in SIDES]
    uv = [np.concatenate([np.empty((0, 2)), *(spots.uv_px for spots in view)]) for view in views]
    cov = [np.concatenate([np.empty((0, 2, 2)), *(spots.covariance_px2 for spots in view)]) for view in views]
    return triangulate(rig, *uv, *(c + slack for c in cov))


def _choices(frame: LitFrame, found: NDArray[np.bool_], n: int) -> Index | NotSeen:
    """Return (c, n) rows of the frame that are n different lights, or why there are none."""
    if len(frame) < n:
        return NotSeen(f"{len(frame)} of {n} lights are seen in both views")
    good = _brightest(frame, np.flatnonzero(found), n)
    sides = [np.unique(s.uv_px, axis=0, return_inverse=True)[1].reshape(-1) for s in (frame.left, frame.right)]
    rows = [c for c in combinations(good, n) if all(len(set(side[list(c)].tolist())) == n for side in sides)]
    if not rows:
        return NotSeen(f"{len(good)} pairs of spots, among them no {n} different lights")
    return np.array(rows, dtype=np.intp)


def _brightest(frame: LitFrame, good: Index, n: int) -> list[int]:
    """Return the rows among which to search: all, or of too many those brightest in the view that shows them darker."""
    most = n
    while comb(most + 1, n) <= MAX_CHOICES:
        most += 1
    peak = np.minimum(frame.left.peak, frame.right.peak)[good]
    return sorted(good[np.argsort(-peak, kind="stable")[:most]].tolist())
