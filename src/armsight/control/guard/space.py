"""The arm in space: where tool and flange are at joint readings, how fast they go, and what of the limits is broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.control.guard.kernels import RANGE, WORKSPACE, depths
from armsight.control.guard.limits import Box, JointBounds, Limits
from armsight.kinematics import Arm, fk_jacobian

Array = NDArray[np.float64]

NEWTON_STEPS = 4
"""For the way of one cycle two are enough; a pose not met by then is not reached."""
POSITION_M = 1e-7
ROTATION_RAD = 1e-7
EVERYWHERE = Box(lower_m=np.full(3, -1e9), upper_m=np.full(3, 1e9), name="without walls")
KEPT_BACK = 0.99
"""Share of the limits of the tool that is checked for: the real arm differs from its model by parts in a thousand."""
OF_MOTION = frozenset(
    {
        "speed of the tool",
        "turning of the tool",
        "acceleration of the tool",
        "turning acceleration of the tool",
        "speed of a joint",
    }
)
"""Limits that a slower motion keeps: where only these are broken the arm slows down and goes on."""
HAIR = 1e-9
"""What is worse by less than this (m, rad, m/s) than it was is not worse."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The tool at readings q (n,): T_base_tool (4, 4), and its Jacobian J (6, n) for the readings in base axes."""

    q: Array
    T: Array
    J: Array


@dataclass(frozen=True, slots=True, eq=False)
class Breach:
    """By how much each limit is broken, in the order of names; 0 or less where it is kept."""

    names: tuple[str, ...]
    depths: Array

    def worse_than(self, before: Breach) -> tuple[str, ...]:
        """Return the limits that are broken here, and more than before; who is beyond one may come back."""
        worse = self.depths > np.maximum(before.depths, 0.0) + HAIR
        return tuple(self.names[i] for i in np.flatnonzero(worse)) if worse.any() else ()


class Space:
    """An arm and the limits of where its tool and its flange may be and how fast they may go."""

    def __init__(self, arm: Arm, limits: Limits, bounds: JointBounds) -> None:
        self.arm = arm
        self._limits = limits
        self._gearing = arm.gearing if arm.couplings else None
        self._T_base_world = arm.T_world_base.inv().as_matrix()
        self._flange = np.ascontiguousarray(arm.T_flange_tool.inv().as_matrix()[:3, 3])
        self._lengths = np.array([[arm.length_m]] * 3 + [[1.0]] * 3)
        self._joints = np.array([bounds.lower, bounds.upper, bounds.speed])
        self._most = KEPT_BACK * np.array(
            [limits.speed_m_s, limits.turn_rad_s, limits.acceleration_m_s2, limits.turn_acceleration_rad_s2]
        )
        spaces = (limits.workspace or EVERYWHERE, *limits.forbidden)
        self._boxes = np.array([[*box.lower_m, *box.upper_m] for box in spaces])
        self._kept = np.zeros(len(spaces), dtype=bool)
        self.rows = 6 if arm.n >= 6 else 3
        """How many rows of a Jacobian motion in space uses: three where joints are too few to turn the tool."""
        self._names = (
            "speed of the tool",
            "turning of the tool",
            "acceleration of the tool",
            "turning acceleration of the tool",
            "range of a joint",
            "speed of a joint",
            f"workspace {spaces[0].name}",
            *(f"forbidden box {box.name}" for box in limits.forbidden),
            "distance to a singularity",
        )

    def look(self, q: Array) -> Sight:
        """Return the tool at readings q (n,)."""
        T, J = fk_jacobian(self.arm, self._values(q))
        return self._in_base(q, T, J)

    def along(
        self, q: Array, qd: Array, qdd: Array, dt_s: float, before: Breach | None = None, *, in_space: bool
    ) -> tuple[Breach, Sight]:
        """Return what is broken at worst over readings q (m, n) moving at qd and qdd, and the tool at the first.

        dt_s: between two rows. before: what is broken already. in_space: singularities count, in every row, as a way to
        rest may pass one and end far from it.
        """
        values = self._values(q)
        T, J = fk_jacobian(self.arm, values, all_cores=False)
        if self._gearing is not None:
            J = np.ascontiguousarray(J @ self._gearing)
        found = np.empty(len(self._names))
        depths(
            T,
            J,
            q,
            qd,
            qdd,
            dt_s,
            self._T_base_world,
            self._flange,
            self._joints,
            self._most,
            self._boxes,
            self._limits.margin_m,
            self._kept if before is None else before.depths[WORKSPACE:-1] > 0.0,
            found[:-1],
        )
        if self._gearing is not None:
            beyond = np.maximum(self.arm.lower - values, values - self.arm.upper)
            found[RANGE] = max(found[RANGE], float(beyond.max()))
        found[-1] = self._limits.singularity - self.singularity(J) if in_space else -np.inf
        return Breach(self._names, found), self._in_base(q[0], T[0], J[0])

    def at(self, q: Array, qd: Array, qdd: Array, *, in_space: bool) -> Breach:
        """Return what is broken at readings q (n,), moving at qd and qdd (n,)."""
        return self.along(q[None], qd[None], qdd[None], 0.0, in_space=in_space)[0]

    def _values(self, q: Array) -> Array:
        return q if self._gearing is None else q @ self._gearing.T

    def _in_base(self, q: Array, T: Array, J: Array) -> Sight:
        R = self._T_base_world[:3, :3]
        return Sight(q, self._T_base_world @ T, (R @ J.reshape(2, 3, -1)).reshape(6, -1))

    def twist(self, J: Array, qd: Array) -> tuple[Array, Array]:
        """Return velocity (3,) and angular velocity (3,) of the tool for J (6, n) and qd (n,)."""
        both = J @ qd
        return both[:3], both[3:]

    def singularity(self, J: Array) -> float:
        """Return the least singular value of Jacobians (m, 6, n), lengths in mean links; below six of position only."""
        return float(np.linalg.svd(self.scaled(J), compute_uv=False)[..., -1].min())

    def scaled(self, J: Array) -> Array:
        """Return the rows of J (..., 6, n) that motion in space uses, lengths in units of the arm's mean link."""
        return np.asarray((J / self._lengths)[..., : self.rows, :])

    def inverse_twist(self, J: Array, velocity_m_s: Array, angular_rad_s: Array) -> Array:
        """Return joint velocities (n,) for a twist, damped near singularities (Nakamura, Hanafusa 1986).

        Damping begins at twice the limit's distance; it slows the tool in the direction that is being lost.
        """
        scaled = self.scaled(J)
        wanted = (np.concatenate([velocity_m_s, angular_rad_s])[:, None] / self._lengths)[: self.rows, 0]
        u, s, vt = np.linalg.svd(scaled, full_matrices=False)
        start = 2.0 * self._limits.singularity
        damping = 0.0 if s[-1] >= start else (1.0 - (s[-1] / start) ** 2) * (0.5 * start) ** 2
        share = np.divide(s, s * s + damping, out=np.zeros_like(s), where=s > 0.0)
        return np.asarray(vt.T @ (share * (u.T @ wanted)))

    def inverse_pose(self, T_base_tool: Array, sight: Sight) -> Array | None:
        """Return readings (n,) near those of sight that put the tool at a pose (4, 4); None: none found.

        Arms of less than six joints meet the position only.
        """
        q = sight.q.copy()
        at = sight
        for _ in range(NEWTON_STEPS):
            way, turn = pose_difference(T_base_tool, at.T)
            turned = self.rows == 3 or float(np.abs(turn).max()) < ROTATION_RAD
            if turned and float(np.abs(way).max()) < POSITION_M:
                return q
            error = (np.concatenate([way, turn])[:, None] / self._lengths)[: self.rows, 0]
            J = self.scaled(at.J)
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(self.rows), error)
            if not (np.abs(q) < 1e3).all():
                return None
            at = self.look(q)
        way, turn = pose_difference(T_base_tool, at.T)
        close = float(np.abs(way).max()) < POSITION_M and (self.rows == 3 or float(np.abs(turn).max()) < ROTATION_RAD)
        return q if close else None


def pose_difference(T_to: Array, T_from: Array) -> tuple[Array, Array]:
    """Return the way (3,) in m and the rotation vector (3,) in rad from one pose (4, 4) to another, in base axes."""
    R = T_to[:3, :3] @ T_from[:3, :3].T
    if np.trace(R) > 2.99:  # below 6 degrees: the sine's vector, made long enough
        v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        sine = float(np.sqrt(v @ v))
        turn = v * (np.arcsin(min(1.0, sine)) / sine) if sine > 1e-12 else v
    else:
        turn = np.asarray(Rotation.from_matrix(R).as_rotvec())
    return T_to[:3, 3] - T_from[:3, 3], turn
