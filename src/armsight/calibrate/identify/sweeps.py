"""Readings of a beacon while one joint after the other moves, and how far a model is from them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.identify.kernels import see_many
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.fitting.groups import taken, whitener
from armsight.optics import SIDES, PackedRig, Rig, as_pair, moved_rig, triangulate
from armsight.records.checks import checked_array, freeze

FEWEST = 3
"""Three points lie on a circle always; from four on something is left to judge by."""
HELD = 5e-3
"""Joints that hold still within a sweep may differ by so much (rad, m): what encoders and brakes leave."""
UNEVEN = 1.8
"""Standard deviation of a reading's pixels over the median's from which it is left out; others come to 1.5."""
ONE_HOME = 0.02
"""Joints whose values are not exact rest in one pose where those differ by no more (rad, m)."""
FINEST_STEP = 1e-6
"""Steps of values (rad, m) below it are no encoder's."""
OPEN_M, SETTLED = 1.0, 4
"""How far a reading that one camera saw may be from where it is said to be, along its ray; steps to the likeliest place
of one that several saw: pixels are nearly linear in it."""
MOVED = 1e-3
"""Least movement (rad, m) of a joint in its own sweep."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweeps:
    """Readings row by row: joint (m,) that moves, from 0; q (m, n); xyz_m (m, 3) in rig axes.

    A joint may be swept several times, with the others at other positions each time.
    uv_px: (m, v, 2) as [row, camera], where a rig saw them, NaN in a camera that did not; of two cameras each row has
    both. cameras: their names. std_px: (m,) of a coordinate of theirs, as whoever found them claims; identification
    claims no less, for not all of it shows in what a fit leaves. covariance_m2: (m, 3, 3) of the positions, where
    known.
    """

    joint: NDArray[np.intp]
    q: Array
    xyz_m: Array
    uv_px: Array | None = None
    covariance_m2: Array | None = None
    std_px: Array | None = None
    cameras: tuple[str, ...] = SIDES

    def __post_init__(self) -> None:
        m, v = len(self.joint), len(self.cameras)
        object.__setattr__(self, "joint", np.array(self.joint, dtype=np.intp))
        freeze(self, q=(m, np.shape(self.q)[-1]), xyz_m=(m, 3))
        for name, shape in (("std_px", (m,)), ("covariance_m2", (m, 3, 3))):
            if getattr(self, name) is not None:
                freeze(self, **{name: shape})
        if self.uv_px is not None:
            uv = np.array(checked_array("uv_px", self.uv_px, (m, v, 2), nan=v != len(SIDES)))
            uv.setflags(write=False)
            object.__setattr__(self, "uv_px", uv)

    def __len__(self) -> int:
        return len(self.joint)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def sights(self) -> NDArray[np.bool_]:
        """Which camera saw the beacon in which row (m, v)."""
        uv = np.empty((len(self), 0, 2)) if self.uv_px is None else self.uv_px
        return np.asarray(np.isfinite(uv).all(axis=2))

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
        return taken(self, rows, "joint", "q", "xyz_m", "uv_px", "covariance_m2", "std_px")


def placed(sweeps: Sweeps, rig: Rig, sigma_px: float) -> Sweeps:
    """Return the sweeps with positions and covariances triangulated from their pixels; Inconsistent without pixels."""
    if sweeps.uv_px is None:
        raise Inconsistent(
            "the sweep has no pixel columns",
            consequence="The rig cannot be used",
            cure="Give left_u_px, left_v_px, right_u_px, right_v_px, or leave the rig out",
        )
    if not rig.is_pair:
        return _placed_by_views(sweeps, rig, sigma_px)
    noise = np.tile(sigma_px**2 * np.eye(2), (len(sweeps), 1, 1))
    found = triangulate(rig, sweeps.uv_px[:, 0], sweeps.uv_px[:, 1], noise, noise)
    return replace(sweeps, xyz_m=found.xyz_m, covariance_m2=found.covariance_m2)


def _placed_by_views(sweeps: Sweeps, rig: Rig, sigma_px: float) -> Sweeps:
    """Return what placed returns, of any number of cameras: by all that saw a reading, from two of them.

    One that a single camera saw stays where it is said to be, open by OPEN_M along its ray.
    """
    uv, packed = np.array(sweeps.uv_px), PackedRig.of(rig)
    X, seen = np.array(sweeps.xyz_m), sweeps.sights
    for a, b in combinations(range(len(rig.cameras)), 2):
        rows = np.flatnonzero(seen[:, a] & seen[:, b] & (np.cumsum(seen, axis=1)[:, b] == 2))  # its first two
        if len(rows):
            X[rows] = triangulate(as_pair(rig, a, b), uv[rows, a], uv[rows, b], np.eye(2), np.eye(2)).xyz_m
    loose = np.where(seen.sum(axis=1) > 1, 0.0, OPEN_M**-2.0)[:, None, None] * np.eye(3)
    first, at, D = X.copy(), np.empty(uv.shape), np.empty((*uv.shape, 3))
    for _ in range(SETTLED):
        see_many(packed.k, packed.R, packed.t, np.ascontiguousarray(X), at, D)
        J = np.where(seen[:, :, None, None], D, 0.0).reshape(len(X), -1, 3) / sigma_px
        r = np.where(seen[:, :, None], uv - at, 0.0).reshape(len(X), -1, 1) / sigma_px
        H = J.transpose(0, 2, 1) @ J + loose
        X = X + np.linalg.solve(H, J.transpose(0, 2, 1) @ r + loose @ (first - X)[:, :, None])[:, :, 0]
    return replace(sweeps, xyz_m=X, covariance_m2=np.asarray(np.linalg.inv(H), np.float64))


def require_two(rig: Rig) -> None:
    """Raise UsageError for one camera: a small circle near by and a large one far away are the same picture."""
    if len(rig.cameras) < 2:
        raise UsageError(
            "one camera sees a light's path in no size: near and small, or far and large",
            consequence="The arm is not identified",
            cure="Give two cameras and more",
        )


def of_rig(sweeps: Sweeps, rig: Rig) -> Sweeps:
    """Return the sweeps with the cameras of a rig, in its order; those that two cameras saw together or, its place
    said, one did. Raises UsageError where they are of others, Inconsistent where none is left."""
    if sweeps.uv_px is None or (rig.is_pair and sweeps.cameras == rig.names):
        return sweeps
    unknown = [name for name in sweeps.cameras if name not in rig.names]
    if unknown:
        raise UsageError(
            f"the sweep has pixels of {', '.join(unknown)}, and the rig's cameras are {', '.join(rig.names)}",
            consequence="Where these cameras stand is not known",
            cure="Give the rig.yaml with which the sweep was made",
        )
    require_two(rig)
    uv = np.full((len(sweeps), len(rig.cameras), 2), np.nan)
    uv[:, [rig.names.index(name) for name in sweeps.cameras]] = sweeps.uv_px
    sweeps = replace(sweeps, uv_px=uv, cameras=rig.names)
    n = sweeps.sights.sum(axis=1)
    rows = np.flatnonzero((n > 1) | ((n == 1) & sweeps.xyz_m.any(axis=1)))
    return sweeps.take(rows)


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


def one_home(sweeps: Sweeps, joint: int) -> bool:
    """Tell whether a joint (from 0) rests at one value while the others move."""
    held = sweeps.q[sweeps.joint != joint, joint] if sweeps.n > 1 else sweeps.q[:1, 0]
    return bool(np.ptp(held) <= ONE_HOME)


def step_of(q: Array) -> float:
    """Return the step of which all differences of values q (m,) are whole multiples, an encoder's or of rounding.

    0 where there is none but the values' own spacing.
    """
    ways = np.diff(np.unique(q))
    ways = ways[ways > FINEST_STEP]
    step = functools.reduce(_common, ways.tolist(), 0.0)
    return step if FINEST_STEP < step < 0.5 * ways.min(initial=np.inf) else 0.0


def _common(a: float, b: float) -> float:
    """Return the greatest common measure of two lengths, by Euclid, to FINEST_STEP."""
    while b > FINEST_STEP:
        a, b = b, a % b if b - a % b > FINEST_STEP else 0.0
    return a


# How far readings are from where a model puts the beacon, in standard deviations: by pixels of both cameras, or by
# positions.

SAME = 1e-12
"""Share of the largest variance below which a direction of a rig's covariance was held fixed: rounding."""
MOST = 0.75
"""Share of the readings whose spots claim no more than what the residuals tell. With it 95 % intervals of an arm seen
in rendered pictures hold 97 to 98 % (benchmarks/identify.py), with a half of them 99."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepResiduals:
    """Readings, and what a residual is.

    With a rig: pixels over sigma (px). Else positions, whitened with their covariances times sigma^2, or over sigma (m)
    where there are none. unit: the sigma with which the positions' covariances were worked out.
    """

    sweeps: Sweeps
    rig: PackedRig | None = None
    sigma: float = 1.0
    whitener: Array | None = field(default=None)
    unit: float = 1.0

    @property
    def rows(self) -> int:
        """Residuals of a reading; those of a camera that did not see it are 0."""
        return 3 if self.rig is None else 2 * len(self.rig.k)

    @property
    def counts(self) -> NDArray[np.intp]:
        """How many residuals (m,) of each reading are of something that was seen."""
        m = len(self.sweeps)
        return np.full(m, 3) if self.rig is None else np.asarray(2 * self.sweeps.sights.sum(axis=1))

    def rms(self, of: Array, rows: NDArray[np.intp]) -> float:
        """Return the root mean square of what was seen in some of the readings; of: (m, rows), 0 where nothing was."""
        return float(np.sqrt(np.mean(of[rows] ** 2) * (self.rows / np.mean(self.counts[rows]))))

    @property
    def n_unseen(self) -> int:
        """How many residuals are of nothing."""
        return int(self.rows * len(self.sweeps) - self.counts.sum())

    def residuals(self, xyz_m: Array, J: Array) -> tuple[Array, Array]:
        """Return whitened residuals (m, rows) of model positions (m, 3), and derivatives (m, rows, P) from J (m, 3,
        P)."""
        m = len(xyz_m)
        if self.rig is None:
            r = xyz_m - self.sweeps.xyz_m
            W = self.whitener
            if W is None:
                return r / self.sigma, J / self.sigma
            return np.einsum("mij,mj->mi", W, r) / self.sigma, W @ J / self.sigma
        if self.sweeps.uv_px is None:
            raise ValueError("readings without pixels")
        v = len(self.rig.k)
        uv, D = np.empty((m, v, 2)), np.empty((m, v, 2, 3))
        see_many(self.rig.k, self.rig.R, self.rig.t, np.ascontiguousarray(xyz_m), uv, D)
        off, unseen = uv - self.sweeps.uv_px, ~self.sweeps.sights
        off[unseen], D[unseen] = 0.0, 0.0
        return off.reshape(m, 2 * v) / self.sigma, D.reshape(m, 2 * v, 3) @ J / self.sigma

    @property
    def relative(self) -> float:
        """Standard deviations of the positions over those of their covariances."""
        return self.sigma / self.unit

    def take(self, rows: NDArray[np.intp]) -> SweepResiduals:
        """Return some readings."""
        return taken(self, rows, "whitener", sweeps=self.sweeps.take(rows))

    def at(self, sigma: float) -> SweepResiduals:
        """Return the same readings with another noise."""
        return replace(self, sigma=sigma)


def or_inexact(seen: SweepResiduals, joint: int) -> str:
    """Return what else can be done, as the end of a sentence, where a joint's values (from 0) are not exact."""
    sweeps, ways = seen.sweeps, []
    if all(one_home(sweeps, j) for j in range(sweeps.n)):
        ways.append("use only their order (--increments order)")
    step, rows = step_of(sweeps.q[:, joint]), max(sweeps.sweeps(joint), key=len)
    readings = sweeps.xyz_m
    if seen.rig is not None and sweeps.uv_px is not None:  # of the cameras that showed all of it
        readings = sweeps.uv_px[:, sweeps.sights[rows].all(axis=0)].reshape(len(sweeps), -1)
    by = np.abs(np.diff(sweeps.q[rows, joint]))
    moved = (np.linalg.norm(np.diff(readings[rows], axis=0), axis=1) / np.where(by > 0.0, by, np.inf))[by > 0.0]
    # rounding to a step is an error of step / sqrt(12), of each coordinate its share
    sigma = step / math.sqrt(12.0) * float(np.median(moved)) / math.sqrt(max(readings.shape[1], 1))
    if sigma > 0.0:
        ways.append(f"count the steps of its values, {step:.3g} rad or m, as noise (--sigma {sigma:.2g})")
    return "".join(f", or {way}" for way in ways)


def rig_shifts(kept: SweepResiduals, rig: Rig | None, xyz_m: Array) -> Array:
    """Return whitened residuals' changes (2 v m, k) by what a rig's calibration leaves open: k independent directions
    of its covariance, each by one standard deviation; at model positions (m, 3). (.., 0) without rig or covariance."""
    none = np.empty((kept.rows * len(xyz_m), 0))
    if rig is None or not PackedRig.of(rig).covariance.any():
        return none
    variances, directions = np.linalg.eigh(PackedRig.of(rig).covariance)
    steps = (directions * np.sqrt(np.maximum(variances, 0.0))).T[variances > SAME * variances[-1]]
    m, v = len(xyz_m), len(rig.cameras)
    ray, uv, D = np.ascontiguousarray(xyz_m), np.empty((m, v, 2)), np.empty((m, v, 2, 3))
    seen, unseen = [], ~kept.sweeps.sights
    for step in (np.zeros(len(directions)), *steps):
        packed = PackedRig.of(moved_rig(rig, step))
        see_many(packed.k, packed.R, packed.t, ray, uv, D)
        uv[unseen] = 0.0
        seen.append(uv.ravel() / kept.sigma)
    return np.stack(seen[1:], axis=1) - seen[0][:, None]


def position_residuals(sweeps: Sweeps, sigma: float) -> SweepResiduals:
    """Return readings judged by their positions."""
    C = sweeps.covariance_m2
    return SweepResiduals(sweeps=sweeps, sigma=sigma, whitener=None if C is None else whitener(C))


def background_shifts(kept: SweepResiduals) -> Array:
    """Return whitened residuals' changes (2 v m, 2 k) by what the spots of k readings claim beyond what MOST do.

    That is what is behind the beacon, and the views see nearly the same of it: it shifts both alike, by u or by v. The
    rest of a claim differs from reading to reading, and the residuals tell it. (.., 0) without claims.
    """
    m, std = len(kept.sweeps), kept.sweeps.std_px
    if kept.rig is None or std is None:
        return np.empty((kept.rows * m, 0))
    beyond = np.sqrt(np.maximum(std**2 - np.quantile(std, MOST) ** 2, 0.0)) / kept.sigma
    rows = np.flatnonzero(beyond)
    shifts = np.zeros((m, len(kept.rig.k), 2, len(rows), 2))  # reading, view, u or v; which reading, shifted by u or v
    for axis in (0, 1):
        shifts[rows, :, axis, np.arange(len(rows)), axis] = beyond[rows, None]
    shifts[~kept.sweeps.sights] = 0.0
    return shifts.reshape(kept.rows * m, -1)


def leaning(rig: Rig, sweeps: Sweeps) -> float | None:
    """Return the readings' deviation along the viewing direction (from between the cameras) over that across it, from
    their covariances at one px of noise; None of readings that are not from images, and of other cameras than a pair,
    which may look from all sides."""
    if sweeps.uv_px is None or not rig.is_pair:
        return None
    noise = np.eye(2)
    seen = triangulate(rig, sweeps.uv_px[:, 0], sweeps.uv_px[:, 1], noise, noise)
    view = seen.xyz_m - np.mean([rig.T_rig_camera(side).translation for side in SIDES], axis=0)
    view /= np.linalg.norm(view, axis=1)[:, None]
    along = np.einsum("mi,mij,mj->m", view, seen.covariance_m2, view)
    across = 0.5 * (np.einsum("mii->m", seen.covariance_m2) - along)
    return float(np.sqrt(np.nansum(along) / np.nansum(across)))
