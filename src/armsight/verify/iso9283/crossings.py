"""Where runs cross planes square to a path: what path accuracy and repeatability are computed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from armsight.arrays import Array
from armsight.verify.iso9283.observations import CommandedPath, PathRun

PLANES = 50
"""Planes along a path, however many corners it has."""
CORNER_ZONE = 0.1
"""Share of a leg next to a corner that has no planes: rounding is judged by CR and CO, and no plane is square there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """Planes through points xyz_m (k, 3) with unit normals along the path (k, 3), spacing_m apart.

    rotation: the commanded orientations there as one stack, or None.
    """

    xyz_m: Array
    normal: Array
    spacing_m: float
    rotation: Rotation | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossings:
    """Where each run crosses each plane: xyz_m (runs, planes, 3), NaN where it does not.

    rotations: by run the orientations as one stack over the planes, the identity where there is no crossing; None where
    a run has none.
    """

    xyz_m: Array
    rotations: tuple[Rotation, ...] | None


def planes_of(path: CommandedPath) -> Planes:
    """Return the planes square to a commanded path, evenly spaced on each leg between its corners."""
    at = np.concatenate([[0.0], np.cumsum(path.lengths)])  # (k,) arc length of the vertices
    ends = np.unique([0, *path.corners, len(at) - 1])
    stations: list[float] = []
    for first, last in pairwise(ends):
        a, b = at[first], at[last]
        start = a + CORNER_ZONE * (b - a) * (first in path.corners)
        stop = b - CORNER_ZONE * (b - a) * (last in path.corners)
        count = max(round(PLANES * (b - a) / at[-1]), 1)
        stations += (start + (stop - start) * (np.arange(count) + 0.5) / count).tolist()
    s = np.array(stations)  # (planes,)
    segment = np.clip(np.searchsorted(at, s, side="right") - 1, 0, len(at) - 2)
    xyz = path.xyz_m[segment] + (s - at[segment])[:, None] * path.directions[segment]
    rotation = None if path.quat_xyzw is None else Slerp(at, Rotation.from_quat(path.quat_xyzw))(s)
    return Planes(xyz_m=xyz, normal=path.directions[segment], spacing_m=float(at[-1]) / len(s), rotation=rotation)


def planes_of_run(run: PathRun) -> Planes | None:
    """Return planes square to a run itself, for paths whose command is not known; None where it has too few samples.

    Means of blocks of samples stand for the path: their chords are long beside the measurement's noise.
    """
    blocks = min(PLANES, len(run.xyz_m) // 3)
    if blocks < 4:
        return None
    knots = np.array([block.mean(axis=0) for block in np.array_split(run.xyz_m, blocks)])
    if not (np.linalg.norm(np.diff(knots, axis=0), axis=1) > 0.0).all():
        return None
    path = CommandedPath(xyz_m=knots)
    middle = 0.5 * (knots[:-1] + knots[1:])
    return Planes(xyz_m=middle, normal=path.directions, spacing_m=float(path.lengths.mean()), rotation=None)


def cross(planes: Planes, runs: Sequence[PathRun]) -> Crossings:
    """Return where each run crosses each plane, interpolated between samples.

    Where noise makes a slow run cross several times, the mean of those crossings is taken; other parts of a path that
    comes back to the plane's position lie further off than half the planes' spacing and are left out.
    """
    points, fractions = [], []
    for run in runs:
        found = [_crossing(p, u, planes.spacing_m, run.xyz_m) for p, u in zip(planes.xyz_m, planes.normal, strict=True)]
        points.append([point for point, _ in found])
        fractions.append([index for _, index in found])
    rotations = [_orientations(run, np.array(index)) for run, index in zip(runs, fractions, strict=True)]
    known = tuple(rotation for rotation in rotations if rotation is not None)
    return Crossings(xyz_m=np.array(points), rotations=known if len(known) == len(runs) else None)


def _crossing(point: Array, normal: Array, spacing_m: float, xyz: Array) -> tuple[Array, float]:
    """Return the crossing (3,) of the track xyz (m, 3) with a plane, and its fractional row; NaN for none."""
    height = (xyz - point) @ normal  # (m,)
    rows = np.flatnonzero((height[:-1] < 0.0) != (height[1:] < 0.0))
    if not len(rows):
        return np.full(3, np.nan), np.nan
    share = height[rows] / (height[rows] - height[rows + 1])
    found = xyz[rows] + share[:, None] * (xyz[rows + 1] - xyz[rows])  # (c, 3)
    distance = np.linalg.norm(found - point, axis=1)
    near = distance <= distance.min() + 0.5 * spacing_m
    return np.asarray(found[near].mean(axis=0)), float((rows + share)[np.argmin(distance)])


def _orientations(run: PathRun, row: Array) -> Rotation | None:
    """Return the run's orientations at fractional rows (k,), the identity at NaN."""
    if run.quat_xyzw is None or len(run.quat_xyzw) < 2:
        return None
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(row), 1))
    seen = np.isfinite(row)
    if seen.any():
        track = Slerp(np.arange(len(run.quat_xyzw)), Rotation.from_quat(run.quat_xyzw))
        quat[seen] = track(row[seen]).as_quat()
    return Rotation.from_quat(quat)
