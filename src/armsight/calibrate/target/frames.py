"""What one pair of frames shows of a lit target: pairs of spots, and every choice of n that can be the lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.optics import Rig, triangulate
from armsight.records import Spots

Array = NDArray[np.float64]
Index = NDArray[np.intp]

MAX_CHOICES = 150
"""Choices of lights searched in one frame: nine pairs for three lights give 84. More is clutter."""

SLACK_PX = 0.1
"""What a good calibration leaves beside a spot's own deviation; it decides what belongs together, not the answer."""


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
    for number, frame in enumerate(frames):
        found = _sight(rig, number, frame, n)
        if isinstance(found, str):
            rejected.append((number, found))
        else:
            sights.append(found)
    return sights, rejected


def _sight(rig: Rig, number: int, frame: LitFrame, n: int) -> Sight | str:
    if len(frame) < n:
        return f"{len(frame)} of {n} lights are seen in both views"
    slack = SLACK_PX**2 * np.eye(2)
    left, right = frame.left, frame.right
    points = triangulate(rig, left.uv_px, right.uv_px, left.covariance_px2 + slack, right.covariance_px2 + slack)
    good = np.flatnonzero(points.found)
    sides = [np.unique(s.uv_px, axis=0, return_inverse=True)[1].reshape(-1) for s in (left, right)]
    rows: list[tuple[int, ...]] = []
    for choice in combinations(good.tolist(), n):
        if all(len(set(side[list(choice)].tolist())) == n for side in sides):
            rows.append(choice)
        if len(rows) > MAX_CHOICES:
            return f"{len(frame)} pairs of spots, too many to tell {n} lights from clutter: mask the background"
    if not rows:
        return f"{len(good)} pairs of spots, among them no {n} different lights"
    index = np.array(rows, dtype=np.intp)
    return Sight(frame=number, rows=index, xyz_m=points.xyz_m[index], cov_m2=points.covariance_m2[index])
