"""The test cube, and the motions of a test in the order in which they are made (ISO 9283:1998, 6.8 to 6.10)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.records import frozen_array
from armsight.records.checks import Shape
from armsight.records.output import Output, figure, output
from armsight.verify.iso9283 import drift, path, pose

POSE_ORDER = ("P1", "P5", "P4", "P3", "P2", "P1")
"""One cycle of AP and RP: every pose is always reached from the same one before, from one direction."""
DISTANCE_ORDER = ("P4", "P2", "P4")
"""One cycle of AD and RD."""
MULTI_DIRECTIONAL = ("P1", "P2", "P4")
"""The poses of vAP."""
APPROACH = 0.1
"""How far off an approach to vAP's poses begins, as a share of the cube's side, towards the inside of the cube."""


@output
class Motion(Output):
    """A motion of the plan.

    Straight through xyz_m (k, 3) in the base frame. names: the pose's name at each row, empty where the row is only on
    the way.
    """

    test: Annotated[str, Doc("Its name: the tag of its rows in plan.csv.")]
    figures: Annotated[tuple[str, ...], Doc("What it is for.")]
    repeats: Annotated[int, Doc("How often it is made.")]
    xyz_m: Array
    names: tuple[str, ...]

    @figure("Its rows.")
    def n(self) -> int:
        return len(self.names)

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
        runs = max(path.RUNS, path.CORNER_RUNS)
        out.append(Motion(test=name, figures=figures, xyz_m=points, names=("",) * len(points), repeats=runs))
    return tuple(out)


def _through(test: str, figures: tuple[str, ...], order: tuple[str, ...], cube: TestCube, repeats: int) -> Motion:
    points = np.array([cube.points_m[name] for name in order])
    return Motion(test=test, figures=figures, xyz_m=points, names=order, repeats=max(repeats, drift.ARRIVALS))


# The standard's test cube: its planes, the poses P1 to P5, the test paths (ISO 9283:1998, 6.8).

SIDES_M = (1.0, 0.63, 0.4, 0.25)
"""Sides that the standard prefers, largest first."""
INSET = 0.1
"""How far P2 to P5 lie from the ends of the diagonals, as a share of them: the standard allows 8 to 12 %."""
LARGE_CIRCLE, SMALL_CIRCLE = 0.8, 0.1
"""Diameters of the test circles over the cube's side."""
CIRCLE_STEPS = 72
"""Chords of a circle as a polyline: turns of 5 degrees, far from a corner."""

PLANES: Mapping[str, tuple[int, int, int, int]] = MappingProxyType(
    {"a": (1, 2, 7, 8), "b": (2, 3, 8, 5), "c": (3, 4, 5, 6), "d": (4, 1, 6, 7)}
)
"""The four diagonal planes by their corners, in order round the plane; P2 to P5 lie inward of these."""

SIGNS = np.array([[1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, -1]])
"""C1 to C8: the upper face seen from above counter-clockwise from (+x, -y), then the lower face beneath it."""


@output
class TestCube(Output):
    """The test cube, in the arm's base frame.

    Its edges are along the base's axes. Raises UsageError for an unknown plane or a side that is not positive.
    """

    __test__ = False  # not a test of pytest's

    centre_m: Annotated[Array, Shape((3,)), Doc("Its centre, x y z.")]
    side_m: Annotated[float, Doc("Its side.")]
    plane: Annotated[str, Doc("The test plane: a, b, c or d.")] = "a"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_m", frozen_array("centre_m", self.centre_m, (3,)))
        if self.plane not in PLANES:
            raise UsageError(f"there is no test plane {self.plane!r}", cure=f"Use one of: {', '.join(PLANES)}")
        if not (np.isfinite(self.side_m) and self.side_m > 0.0):
            raise UsageError(f"a cube's side of {self.side_m:g} m is not a positive number", cure="Give more than zero")

    @figure("C1 to C8, x y z.")
    def corners_m(self) -> dict[str, Annotated[Array, Shape((3,))]]:
        return {f"C{i}": self.centre_m + 0.5 * self.side_m * signs for i, signs in enumerate(SIGNS, start=1)}

    @property
    def points_m(self) -> dict[str, Array]:
        """P1 to P5 (3,): the centre, then inward of the corners on the plane's diagonals; P2 and P4 are opposite."""
        corners_m = self.corners_m
        outer = np.array([corners_m[f"C{i}"] for i in PLANES[self.plane]])  # (4, 3)
        inner = outer + 2.0 * INSET * (self.centre_m - outer)  # a corner is half a diagonal from the centre
        return {"P1": np.array(self.centre_m), **{f"P{i}": inner[i - 2] for i in range(2, 6)}}

    @property
    def paths_m(self) -> dict[str, Array]:
        """The test paths as polylines (k, 3): line, rectangle, large_circle, small_circle.

        line: P2 to P4. rectangle: through P2, P3, P4, P5, begun and ended in the middle of the side from P5 to P2. The
        circles lie in the plane about P1 and begin towards the side from P2 to P3.
        """
        p = self.points_m
        start = 0.5 * (p["P5"] + p["P2"])
        up, right = 0.5 * (p["P2"] + p["P3"]) - p["P1"], p["P3"] - p["P2"]
        up, right = up / np.linalg.norm(up), right / np.linalg.norm(right)
        angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_STEPS + 1)[:, None]
        circle = np.cos(angle) * up + np.sin(angle) * right
        return {
            "line": np.array([p["P2"], p["P4"]]),
            "rectangle": np.array([start, p["P2"], p["P3"], p["P4"], p["P5"], start]),
            "large_circle": p["P1"] + 0.5 * LARGE_CIRCLE * self.side_m * circle,
            "small_circle": p["P1"] + 0.5 * SMALL_CIRCLE * self.side_m * circle,
        }
