"""Readings of a beacon while one joint after the other moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent, NotEnoughData
from armsight.optics import Rig, triangulate
from armsight.records import frozen_array

Array = NDArray[np.float64]

FEWEST = 3
"""Three points lie on a circle always; from four on something is left to judge by."""
HELD = 5e-3
"""Joints that hold still within a sweep may differ by so much (rad, m): what encoders and brakes leave."""
UNEVEN = 1.8
"""Standard deviation of a reading's pixels over the median's from which it is left out; others come to 1.5."""
MOVED = 1e-3
"""Least movement (rad, m) of a joint in its own sweep."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweeps:
    """Readings row by row: joint (m,) that moves, from 0; q (m, n); xyz_m (m, 3) in rig axes.

    A joint may be swept several times, with the others at other places each time.
    uv_px: (m, 2, 2) as [row, side], where a rig saw them. std_px: (m,) of a coordinate of theirs, as whoever found them
    claims; identification claims no less, for not all of it shows in what a fit leaves. covariance_m2: (m, 3, 3) of the
    positions, where known.
    """

    joint: NDArray[np.intp]
    q: Array
    xyz_m: Array
    uv_px: Array | None = None
    covariance_m2: Array | None = None
    std_px: Array | None = None

    def __post_init__(self) -> None:
        m = len(self.joint)
        object.__setattr__(self, "joint", np.array(self.joint, dtype=np.intp))
        object.__setattr__(self, "q", frozen_array("q", self.q, (m, np.shape(self.q)[-1])))
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (m, 3)))
        if self.uv_px is not None:
            object.__setattr__(self, "uv_px", frozen_array("uv_px", self.uv_px, (m, 2, 2)))
        if self.std_px is not None:
            object.__setattr__(self, "std_px", frozen_array("std_px", self.std_px, (m,)))
        if self.covariance_m2 is not None:
            object.__setattr__(self, "covariance_m2", frozen_array("covariance_m2", self.covariance_m2, (m, 3, 3)))

    def __len__(self) -> int:
        return len(self.joint)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def rows(self, joint: int) -> NDArray[np.intp]:
        """Return the rows in which a joint (from 0) moves."""
        return np.flatnonzero(self.joint == joint)

    def sweeps(self, joint: int) -> list[NDArray[np.intp]]:
        """Return the rows of each sweep of a joint: another begins where the joints at rest have moved."""
        rows = self.rows(joint)
        others = np.delete(self.q[rows], joint, axis=1)
        moved = np.abs(np.diff(others, axis=0)).max(axis=1, initial=0.0) > HELD
        return [np.asarray(part) for part in np.split(rows, np.flatnonzero(moved) + 1)]

    def take(self, rows: NDArray[np.intp]) -> Sweeps:
        """Return some rows."""
        return Sweeps(
            joint=self.joint[rows],
            q=self.q[rows],
            xyz_m=self.xyz_m[rows],
            uv_px=None if self.uv_px is None else self.uv_px[rows],
            covariance_m2=None if self.covariance_m2 is None else self.covariance_m2[rows],
            std_px=None if self.std_px is None else self.std_px[rows],
        )


def placed(sweeps: Sweeps, rig: Rig, sigma_px: float) -> Sweeps:
    """Return the sweeps with positions and covariances triangulated from their pixels; Inconsistent without pixels."""
    if sweeps.uv_px is None:
        raise Inconsistent(
            "the sweep has no pixel columns",
            consequence="The rig cannot be used",
            cure="Give left_u_px, left_v_px, right_u_px, right_v_px, or leave the rig out",
        )
    noise = np.tile(sigma_px**2 * np.eye(2), (len(sweeps), 1, 1))
    found = triangulate(rig, sweeps.uv_px[:, 0], sweeps.uv_px[:, 1], noise, noise)
    return replace(sweeps, xyz_m=found.xyz_m, covariance_m2=found.covariance_m2)


def even_ones(sweeps: Sweeps) -> tuple[Sweeps, list[str]]:
    """Return the readings whose pixels are about as good as most, and notes on the others.

    Weighing would not do: an edge behind the beacon shifts it alike in both views and in neighbouring readings, and
    three of thirty turned an axis by seven standard deviations.
    """
    if sweeps.std_px is None or not len(sweeps):
        return sweeps, []
    typical = float(np.median(sweeps.std_px))
    even = sweeps.std_px <= UNEVEN * typical
    return sweeps.take(np.flatnonzero(even)), [
        f"reading {row + 1} (joint {sweeps.joint[row] + 1}) left out: what is behind the beacon may shift it by "
        f"{sweeps.std_px[row]:.2g} px, most by {typical:.2g} px"
        for row in np.flatnonzero(~even)
    ]


def check_sweeps(sweeps: Sweeps) -> None:
    """Raise NotEnoughData, Inconsistent for sweeps that cannot tell an arm: joints missing, moving together, few."""
    if len(sweeps) == 0 or sweeps.joint.min() < 0 or sweeps.joint.max() >= sweeps.n:
        numbers = sorted(set((sweeps.joint + 1).tolist()))
        raise Inconsistent(
            f"the sweep moves joints {numbers}, its rows have {sweeps.n} joint values",
            consequence="The arm is not identified",
            cure="Number joints from 1, and give q1 .. qn in every row",
        )
    for joint in range(sweeps.n):
        rows = sweeps.rows(joint)
        if len(rows) < FEWEST:
            raise NotEnoughData(
                f"joint {joint + 1} has {len(rows)} readings; {FEWEST} is the least, ten are good",
                consequence="Its axis cannot be found",
                cure="Move every joint in a sweep of its own",
            )
        others = [np.delete(sweeps.q[part], joint, axis=1) for part in sweeps.sweeps(joint)]
        drift = np.max([np.ptp(part, axis=0) for part in others], axis=0)
        if min(len(part) for part in others) < FEWEST or drift.max(initial=0.0) > HELD:
            moved = np.ptp(np.delete(sweeps.q[rows], joint, axis=1), axis=0)
            also = int(np.delete(np.arange(sweeps.n), joint)[moved.argmax()])
            raise Inconsistent(
                f"joint {also + 1} moves by {moved.max():.3g} rad or m in the sweep of joint {joint + 1}",
                consequence="The beacon's path is neither's",
                cure=f"Move one joint at a time; of several sweeps of a joint each needs {FEWEST} readings",
            )
        if min(np.ptp(sweeps.q[part, joint]) for part in sweeps.sweeps(joint)) <= MOVED:
            raise Inconsistent(
                f"joint {joint + 1} was not moved in its own sweep",
                consequence="Its axis cannot be found",
                cure="Move it, or correct the joint column",
            )
