"""The whole arm as a product of motions about its axes: where the beacon is at known joint values (MATH 4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.identify.curves import Tilt, basis
from armsight.calibrate.identify.kernels import chain_beacon
from armsight.calibrate.identify.residuals import SweepResiduals
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Problem, Settings, solve

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axis:
    """A joint's axis in rig axes with all joints at zero: a point on it (of a slide: any), direction, what it does."""

    point_m: Array
    direction: Array
    revolute: bool


def moved_by(axis: Axis, q: Array, X: Array) -> Array:
    """Return points X (m, 3) after the joint moved by q (m,)."""
    if not axis.revolute:
        return X + np.outer(q, axis.direction)
    return axis.point_m + Rotation.from_rotvec(np.outer(q, axis.direction)).apply(X - axis.point_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainModel:
    """Parameters: tilt and place of every turning joint's axis (4), of a slide's its tilt (2), the beacon at zero (3).

    Measured from a start: the first axes given, each with its own basis (n, 3, 3).
    """

    axes: tuple[Axis, ...]
    beacon_m: Array
    bases: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "bases", np.stack([basis(axis.direction) for axis in self.axes]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        own = [
            f"axis{i}.{key}"
            for i, axis in enumerate(self.axes, 1)
            for key in (("tilt_u", "tilt_v", "u_m", "v_m") if axis.revolute else ("tilt_u", "tilt_v"))
        ]
        return (*own, "beacon.x_m", "beacon.y_m", "beacon.z_m")

    def axes_at(self, p: Array) -> tuple[list[Axis], Array]:
        """Return the axes and the beacon (3,) of parameters p."""
        out, k = [], 0
        for axis, B in zip(self.axes, self.bases, strict=True):
            direction, _ = Tilt(B=B).direction(p[k : k + 2])
            point = axis.point_m
            if axis.revolute:
                point = point + B[:, :2] @ p[k + 2 : k + 4]
            out.append(Axis(point_m=point, direction=direction, revolute=axis.revolute))
            k += 4 if axis.revolute else 2
        return out, self.beacon_m + p[k:]

    def predict(self, p: Array, q: Array) -> tuple[Array, Array]:
        """Return the beacon (m, 3) at joint values q (m, n), and its derivative (m, 3, P)."""
        X, J = np.empty((len(q), 3)), np.empty((len(q), 3, len(p)))
        revolute = np.array([axis.revolute for axis in self.axes])
        points = np.stack([axis.point_m for axis in self.axes])
        chain_beacon(revolute, self.bases, points, self.beacon_m, np.array(p), np.array(q), X, J)
        return X, J


def fit_chain(seen: SweepResiduals, model: ChainModel, *, robust: float) -> Fit:
    """Return the fit of the whole arm to all readings, the joint values taken as exact. robust: Huber's scale."""
    q = seen.sweeps.q

    def evaluate(p: Array, _: Array) -> Evaluation:
        r, J = seen.residuals(*model.predict(p, q))
        return Evaluation(residuals=r.reshape(1, -1), shared=J.reshape(1, -1, len(p)), local=np.empty((1, r.size, 0)))

    problem = Problem(
        names=model.names,
        guess=np.zeros(len(model.names)),
        evaluate=evaluate,
        n_residuals=seen.rows * len(q),
        loss=Loss(kind=LossKind.HUBER, scale=robust, block=seen.rows),
    )
    return solve(problem, Settings(max_iterations=100, allow_undetermined=True, cost_tolerance=1e-9))


def at_home(measured: Sequence[Axis], rests: Sequence[Array]) -> list[Axis]:
    """Return the axes with all joints at zero from axes measured each with the joints before it at rest (n,) values."""
    out: list[Axis] = []
    for axis, rest in zip(measured, rests, strict=True):
        ends = np.stack([axis.point_m, axis.point_m + axis.direction])
        for before, value in zip(out, rest, strict=False):  # joint 1 first: undo the motions from the base outwards
            ends = moved_by(before, np.full(2, -value), ends)
        out.append(Axis(point_m=ends[0], direction=ends[1] - ends[0], revolute=axis.revolute))
    return out
