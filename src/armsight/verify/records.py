"""What goes into a verification: what was measured, row by row; what was left out of it; figures of errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent
from armsight.fields import Doc
from armsight.fitting.groups import taken
from armsight.records import frozen_array
from armsight.records.checks import check_spread
from armsight.records.output import Output, output

Columns = dict[str, Array | Index | list[str]]
"""A table by column: numbers, NaN where there is none, or texts."""
Rejected = tuple[tuple[int, str], ...]
"""(row of the file from 1, why)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Measured positions xyz_m (m, 3), rotations (m, 3, 3) where known, in any fixed frame.

    t_s (m,): stamps, None where rows have none. std (m, 6): standard deviations of x, y, z in m and of a turn about
    each axis in rad, None where nobody says. covariance (m, 6, 6): the same with what relates the axes; by std,
    diagonal, where only that is given. row (m,): the row of the file, from 1. point (m,): which of several points
    of the tool was measured.
    """

    xyz_m: Array
    rotation: Array | None = None
    t_s: Array | None = None
    std: Array | None = None
    covariance: Array | None = None
    row: Index | None = None
    point: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        m = len(self.xyz_m)
        if self.covariance is not None:
            object.__setattr__(self, "std", np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))
        elif self.std is not None:
            squares = np.asarray(self.std, float) ** 2
            object.__setattr__(self, "covariance", squares[:, :, None] * np.eye(6))
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (m, 3)))
        check_spread(self.xyz_m, "the measured positions")
        for name, shape in (("rotation", (m, 3, 3)), ("t_s", (m,)), ("std", (m, 6)), ("covariance", (m, 6, 6))):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(name, value, shape))
        row = np.arange(1, m + 1) if self.row is None else np.array(self.row, dtype=np.intp)
        row.setflags(write=False)
        object.__setattr__(self, "row", row)
        object.__setattr__(self, "point", tuple(self.point) or ("",) * m)
        if len(self.point) != m or row.shape != (m,):
            raise Inconsistent(f"{m} positions, but {len(self.point)} names of points and {len(row)} numbers of rows")

    def __len__(self) -> int:
        return len(self.xyz_m)

    @property
    def rows(self) -> Index:
        """The row of the file (m,) of each measurement, from 1."""
        return np.arange(1, len(self) + 1) if self.row is None else self.row

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the tool's points, sorted."""
        return tuple(sorted(set(self.point)))

    @property
    def which(self) -> Index:
        """Which of the labels each row (m,) is of."""
        number = {label: k for k, label in enumerate(self.labels)}
        return np.array([number[label] for label in self.point], dtype=np.intp)

    def take(self, index: Index) -> Measured:
        """Return the measurements at the given positions."""
        return taken(self, index, "xyz_m", "rotation", "t_s", "covariance", "row", "point", std=None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeats:
    """Which repeat each measured row (m,) is of, "" where the file does not say: the commanded pose and its visit, or
    the path (its tag) and the run along it; approach: the direction a visit came from. systematic (m, 6, 6): the part
    of the covariance that all rows share, None where nobody says. arrival: which arrival at the pose a row shows
    the arm on its way in; robot: which of several exchanged robots."""

    pose: tuple[str, ...]
    visit: tuple[str, ...]
    run: tuple[str, ...]
    path: tuple[str, ...]
    approach: tuple[str, ...]
    systematic: Array | None = None
    arrival: tuple[str, ...] = ()
    robot: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("arrival", "robot"):
            object.__setattr__(self, name, tuple(getattr(self, name)) or ("",) * len(self.pose))

    @property
    def any(self) -> bool:
        """Whether a row says which pose or run it is of."""
        return any(self.pose) or any(self.run)

    @property
    def at_pose(self) -> tuple[str, ...]:
        """The pose that each row (m,) is a visit of, with the robot's name; "" for rows on a path or on their way."""
        rows = zip(self.robot, self.pose, self.run, self.arrival, strict=True)
        return tuple(
            f"{robot} {pose}".strip() if pose and not run and not moving else "" for robot, pose, run, moving in rows
        )


# Figures of errors, and how much a series of them is worth where neighbours hang together.


@output
class Figures(Output):
    """Mean, mean absolute, largest absolute, standard deviation and RMS of errors, in their own unit."""

    me: Annotated[float, Doc("Mean.", unit="as named")]
    mae: Annotated[float, Doc("Mean of the absolute error.", unit="as named")]
    max: Annotated[float, Doc("Largest absolute error.", unit="as named")]
    sd: Annotated[float, Doc("Standard deviation about the mean.", unit="as named")]
    rms: Annotated[float, Doc("Root mean square.", unit="as named")]

    @classmethod
    def of(cls, errors: Array) -> Figures:
        """Return the figures of errors (m,), m >= 1."""
        size = np.abs(errors)
        return cls(
            me=float(errors.mean()),
            mae=float(size.mean()),
            max=float(size.max()),
            sd=float(errors.std(ddof=1)) if len(errors) > 1 else 0.0,
            rms=float(np.sqrt(np.mean(errors**2))),
        )
