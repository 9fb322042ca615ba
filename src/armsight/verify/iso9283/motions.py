"""The motions of a test, in the order in which they are made (ISO 9283:1998, 6.8 to 6.10)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armsight.records import frozen_array
from armsight.verify.iso9283 import arrival, corner, path, pose
from armsight.verify.iso9283.cube import TestCube

Array = NDArray[np.float64]

POSE_ORDER = ("P1", "P5", "P4", "P3", "P2", "P1")
"""One cycle of AP and RP: every pose is always reached from the same one before, from one direction."""
DISTANCE_ORDER = ("P4", "P2", "P4")
"""One cycle of AD and RD."""
MULTI_DIRECTIONAL = ("P1", "P2", "P4")
"""The poses of vAP."""
APPROACH = 0.1
"""How far off an approach to vAP's poses begins, as a share of the cube's side, towards the inside of the cube."""
SPEED_SHARES = (1.0, 0.5, 0.1)
"""Shares of the rated speed at which the standard wants paths and poses tested."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Straight motions through xyz_m (k, 3) in the base frame, repeated as often as the standard asks.

    figures: what it is for. names: the pose's name at each row, empty where the row is only on the way.
    """

    test: str
    figures: tuple[str, ...]
    xyz_m: Array
    names: tuple[str, ...]
    repeats: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (len(self.names), 3)))

    def dense(self, step_m: float) -> tuple[Array, Array]:
        """Return points along the motion (m, 3), no further apart than step_m, and their distance gone (m,)."""
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.xyz_m, axis=0), axis=1))])
        inner = [np.linspace(a, b, max(int(np.ceil((b - a) / step_m)), 1), endpoint=False) for a, b in pairwise(length)]
        at = np.concatenate([*inner, length[-1:]])
        return np.stack([np.interp(at, length, self.xyz_m[:, i]) for i in range(3)], axis=1), at


def motions_of(cube: TestCube) -> tuple[Motion, ...]:
    """Return all motions of the tests in a cube: poses, distance, approaches from three directions, paths."""
    p = cube.points_m
    out = [
        _through("poses", ("AP", "RP", "t", "OV", "E"), POSE_ORDER, cube, pose.VISITS),
        _through("distance", ("AD", "RD"), DISTANCE_ORDER, cube, pose.VISITS),
    ]
    for name in MULTI_DIRECTIONAL:
        inward = np.where(cube.centre_m - p[name] < 0.0, -1.0, 1.0)
        for i, axis in enumerate("xyz"):
            begin = p[name] + APPROACH * cube.side_m * inward[i] * np.eye(3)[i]
            out.append(
                Motion(
                    test=f"approach_{axis}",
                    figures=("vAP",),
                    xyz_m=np.array([begin, p[name]]),
                    names=("", name),
                    repeats=pose.VISITS,
                )
            )
    for name, points in cube.paths_m.items():
        figures = ("AT", "RT", "AV", "RV", "FV") if name != "rectangle" else ("AT", "RT", "CR", "CO")
        runs = max(path.RUNS, corner.RUNS)
        out.append(Motion(test=name, figures=figures, xyz_m=points, names=("",) * len(points), repeats=runs))
    return tuple(out)


def _through(test: str, figures: tuple[str, ...], order: tuple[str, ...], cube: TestCube, repeats: int) -> Motion:
    points = np.array([cube.points_m[name] for name in order])
    return Motion(test=test, figures=figures, xyz_m=points, names=order, repeats=max(repeats, arrival.ARRIVALS))
