"""The whole arm as a product of motions about its axes: where the beacon is at known joint values (MATH 4.3), and
whether what it leaves looks like coupled gears."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.identify.kernels import chain_beacon
from armsight.calibrate.identify.path_fit import basis, tilted
from armsight.calibrate.identify.sweeps import SweepResiduals, rig_shifts
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Problem, Settings, solve
from armsight.fitting.quantiles import f_sf
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, Joint, JointType, link_to_line
from armsight.optics import Rig
from armsight.records import NamedCovariance


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
    """Parameters: tilt and position of every turning joint's axis (4), of a slide's its tilt (2), the beacon at zero
    (3).

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
            direction, _ = tilted(B, p[k : k + 2])
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
        return Evaluation.of_one(*seen.residuals(*model.predict(p, q)))

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


# Whether a joint's value moves along with another's reading: coupled gears show in what the whole arm's fit leaves.

STEP = 1e-4
"""Share of a joint's reading by which another is moved for the derivative."""
CHANCE = 1e-4
"""Chance, over all pairs of joints, below which a coupling is suggested: one arm in ten thousand without one."""
ALIKE = 10.0
"""Chi-square within which two couplings explain the readings alike."""
OWN = 1e-3
"""Share of a coupling's effect that must be its own, not that of the arm's parameters."""


def suggest_coupling(kept: SweepResiduals, model: ChainModel, p: Array, rig: Rig | None = None) -> list[str]:
    """Return a note of the coupling, or joint's scale, that explains most of what the fit p (P,) leaves of readings.

    rig: what its calibration leaves open explains of it what it can first.

    None where chance would do. Each share is tested alone, to first order beside the arm's parameters (F-test with one
    degree of freedom), for all pairs of joints; Bonferroni's bound over the pairs. Those alike are named.
    """
    q, n = kept.sweeps.q, kept.sweeps.n
    predicted, J = model.predict(p, q)
    r, slopes = (x.reshape(-1, *x.shape[2:]) for x in kept.residuals(predicted, J))
    shifts = rig_shifts(kept, rig, predicted)
    k = shifts.shape[1]  # each a parameter with a reading of its own: 0 +- 1
    r, slopes = np.append(r, np.zeros(k)), np.block([[slopes, shifts], [np.zeros((k, slopes.shape[1])), np.eye(k)]])
    U, s, _ = np.linalg.svd(slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300), full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    left = r - Q @ (Q.T @ r)
    dof = len(r) - kept.n_unseen - Q.shape[1] - 1
    if dof < 1:
        return []
    found: list[tuple[float, int, int, float, float]] = []
    for i in range(n):
        for by in range(n):
            column = np.append(_effect(kept, model, p, i, by), np.zeros(k))
            # beside the arm's parameters a share tells only by the part of its effect that they cannot make (Frisch,
            # Waugh 1933)
            own = column - Q @ (Q.T @ column)
            size2 = float(own @ own)
            if size2 <= OWN**2 * float(column @ column):
                continue
            share = -float(own @ left) / size2
            rest = float(left @ left) - share**2 * size2
            chance = float(f_sf(share**2 * size2 * dof / max(rest, 1e-300), 1, dof)) * n * n
            found.append((rest, i, by, share, chance))
    if not found:
        return []
    least = min(found)
    if least[4] >= CHANCE:
        return []
    alike = sorted(one for one in found if one[0] <= least[0] * (1.0 + ALIKE / dof))
    return ["; or ".join(_note(i, by, share) for _, i, by, share, _ in alike[:3])]


def _effect(kept: SweepResiduals, model: ChainModel, p: Array, i: int, by: int) -> Array:
    """Return the derivative of the whitened residuals by the share of joint by's reading in joint i's value."""
    sides = []
    for step in (STEP, -STEP):
        q = kept.sweeps.q.copy()
        q[:, i] += step * kept.sweeps.q[:, by]
        sides.append(kept.residuals(*model.predict(p, q))[0].ravel())
    return np.asarray((sides[0] - sides[1]) / (2.0 * STEP))


def _note(i: int, by: int, share: float) -> str:
    if i == by:
        return (
            f"joint {i + 1} moves by about {1.0 + share:.4g} times its readings: what the arm leaves goes with them; "
            "check its gear ratio"
        )
    return (
        f"the readings look coupled: joint {i + 1} moves along by about {share:.3g} of joint {by + 1}'s reading, as "
        "coupled gears do; give values with that taken out, or use calibrate arm with the arm's coupling in its file"
    )


# From axes to a Denavit-Hartenberg table (MATH 4.5), with standard deviations, and what of it means nothing.

KEYS = ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
TABLE_STEP = 1e-7
"""Of the differences by which standard deviations are carried over, in the axes' own parameters (m, rad)."""
VAGUE = 0.05
"""Share of the arm's size beyond which a standard deviation leaves open how axes lie to each other."""
INTERSECT = 2.0
"""Axes closer than this many standard deviations meet, as far as anyone can tell; the same for angles of parallel
ones."""


def assign_frames(
    axes: Sequence[Axis], beacon_m: Array, base: Array, slide_at_beacon: bool = True
) -> tuple[Array, Array, Array]:
    """Return rows (n, 5) by KEYS, T_world_base (4, 4) and T_flange_tool (4, 4) of axes with all joints at zero.

    base (4, 4): its origin's foot on the first axis becomes the first frame's origin, its x the side of x. A slide's
    position is free: the last joint's goes through the beacon, as in the paper, any other through the frame before it.
    """
    T = _first(axes[0], base)
    first = T.copy()
    rows = np.zeros((len(axes), len(KEYS)))
    for i in range(1, len(axes) + 1):
        if i < len(axes):
            axis = axes[i]
            last_slide = not axis.revolute and i == len(axes) - 1
            point = beacon_m if last_slide and slide_at_beacon else axis.point_m
            # from frame i - 1 to the line of axis i: theta, d along z, a along the common normal, alpha; Hayati's beta
            # where the two are nearly parallel and d would run away (MATH 4.5)
            link = link_to_line(T, point, axis.direction, prismatic=not axis.revolute and not last_slide)
            rows[i - 1] = link.theta_rad, link.d_m, link.a_m, link.alpha_rad, link.beta_rad
            T = T @ link.matrix()
    tool = np.eye(4)
    tool[:3, 3] = T[:3, :3].T @ (beacon_m - T[:3, 3])
    if not axes[-1].revolute or len(axes) == 1:
        rows[-1, 1], tool[2, 3] = tool[2, 3], 0.0  # along a slide the beacon's position is its offset
    return rows, first, tool


def _first(axis: Axis, base: Array) -> Array:
    z = axis.direction
    x = base[:3, 0] - (base[:3, 0] @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = base[:3, 1] - (base[:3, 1] @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, skew(z) @ x, z], axis=1)
    # the foot of the base's origin: along axis 1 nothing measured says where a frame begins
    T[:3, 3] = axis.point_m + ((base[:3, 3] - axis.point_m) @ z) * z
    return T


def arm_of(name: str, axes: Sequence[Axis], rows: Array, T_world_base: Array, tool: Array, limits: Array) -> Arm:
    """Return the arm of a table; limits (n, 2) are the travel seen."""
    joints = tuple(
        Joint(
            name=f"j{i}",
            type=JointType.REVOLUTE if axis.revolute else JointType.PRISMATIC,
            lower=float(low),
            upper=float(high),
            **dict(zip(KEYS, row.tolist(), strict=True)),
        )
        for i, (axis, row, (low, high)) in enumerate(zip(axes, rows, limits, strict=True), 1)
    )
    return Arm(
        name=name,
        joints=joints,
        T_world_base=RigidTransform.from_matrix(T_world_base),
        T_flange_tool=RigidTransform.from_matrix(tool),
    )


def placed_by(T_parent_rig: RigidTransform, arm: Arm, *, on_base: bool) -> Arm:
    """Return an arm that was found in a rig's axes in those of its parent: of the world, or on_base of the arm's base.

    The base is then the one that the rig was calibrated to, and where the table's first frame lies in it was found.
    """
    T = T_parent_rig * arm.T_world_base
    return (
        replace(arm, T_world_base=RigidTransform.identity(), T_base_frame0=T)
        if on_base
        else replace(arm, T_world_base=T)
    )


def propagate_covariance(make: Callable[[Array], Array], p: Array, covariance: Array) -> Array:
    """Return the covariance (5 n, 5 n) of make(p)'s table entries, by differences, angles unwrapped."""
    here = make(p)
    A = np.empty((here.size, len(p)))
    for i in range(len(p)):
        step = np.zeros(len(p))
        step[i] = TABLE_STEP
        change = (make(p + step) - here).reshape(-1, len(KEYS))
        for k in (0, 3, 4):
            change[:, k] = np.mod(change[:, k] + np.pi, 2.0 * np.pi) - np.pi
        A[:, i] = change.ravel() / TABLE_STEP
    return np.asarray(A @ covariance @ A.T)


def deviations(covariance: Array) -> Array:
    """Return the standard deviations (n, 5) of table entries."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, len(KEYS)))


def measured_entries(covariance: Array, known: Array) -> NamedCovariance | None:
    """Return the covariance of the entries that were measured: known (n, 5) is NaN, or 0, where one is chosen."""
    there = np.flatnonzero((np.isfinite(known) & (known > 0.0)).ravel())
    names = tuple(f"j{1 + i // len(KEYS)}.{KEYS[i % len(KEYS)]}" for i in there.tolist())
    return NamedCovariance(names=names, matrix=covariance[np.ix_(there, there)]) if names else None


def degeneracy_notes(axes: Sequence[Axis], rows: Array, std: Array) -> tuple[list[str], Array]:
    """Return notes on degenerate pairs of axes, and std with NaN where an entry is chosen, not measured (MATH 4.5)."""
    notes, known = [], std.copy()
    known[-1, [0, 2, 3, 4]] = np.nan  # behind the last joint there is only the beacon
    size = float(np.abs(rows[:, 1:3]).sum())
    if not axes[0].revolute and len(axes) > 1:
        notes.append("joint 1 slides: only its direction is seen, its place is chosen")
    if axes[-1].revolute:
        known[-1, 1] = np.nan
    for i in range(len(axes) - 1):
        pair = f"axes {i + 1} and {i + 2}"
        sine, sine_std = abs(np.sin(rows[i, 3])), std[i, 3]
        if not axes[i + 1].revolute:
            notes.append(f"joint {i + 2} slides: only its direction is seen, its place is chosen")
            if i + 2 < len(axes):
                known[i, 1:3] = np.nan
        elif rows[i, 4] != 0.0 or sine <= INTERSECT * sine_std:
            apart = "coincide" if abs(rows[i, 2]) <= INTERSECT * std[i, 2] else "are parallel"
            notes.append(f"{pair} {apart} as far as can be told: d of joint {i + 1} is chosen")
            known[i, 1] = np.nan
            if apart == "coincide":
                known[i, 0] = np.nan
        elif abs(rows[i, 2]) <= INTERSECT * std[i, 2]:
            told = (
                "it cannot be told whether {} meet"
                if std[i, 2] > VAGUE * size
                else "{} intersect as far as can be told"
            )
            notes.append(f"{told.format(pair)}: a is {1e3 * rows[i, 2]:.3g} +- {1e3 * std[i, 2]:.2g} mm")
    known[known == 0.0] = np.nan  # what nothing measured moves is chosen
    return notes, known
