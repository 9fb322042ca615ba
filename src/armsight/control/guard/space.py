"""The arm in space: where tool and flange are at joint readings, how fast they go, and what of the limits is broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.control.guard.limits import JointBounds, Limits
from armsight.kinematics import Arm, fk_jacobian

Array = NDArray[np.float64]

NEWTON_STEPS = 4
"""From where the tool is to where it shall be within one cycle, two are enough; a pose not met by then is not reached."""
POSITION_M = 1e-7
ROTATION_RAD = 1e-7
HAIR = 1e-9
"""What is worse by less than this (m, rad, m/s) than it was is not worse."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The tool at readings q (m, n): T_base_tool T (m, 4, 4), its Jacobian J (m, 6, n) for the readings, base axes."""

    q: Array
    T: Array
    J: Array

    @property
    def position_m(self) -> Array:
        """The tool's origin (m, 3)."""
        return self.T[:, :3, 3]


@dataclass(frozen=True, slots=True, eq=False)
class Breach:
    """By how much each limit is broken, by name: 0 or less where it is kept."""

    by: dict[str, float]

    def worse_than(self, before: Breach) -> tuple[str, ...]:
        """Return the limits that are broken here, and more than before; who is beyond one may come back."""
        return tuple(
            name for name, depth in self.by.items() if depth > HAIR and depth > before.by.get(name, 0.0) + HAIR
        )


class Space:
    """An arm and the limits of where its tool and its flange may be and how fast they may go."""

    def __init__(self, arm: Arm, limits: Limits, bounds: JointBounds) -> None:
        self.arm = arm
        self._limits = limits
        self._bounds = bounds
        self._gearing = arm.gearing if arm.couplings else None
        self._T_base_world = arm.T_world_base.inv().as_matrix()
        self._R_base_world = self._T_base_world[:3, :3]
        self._flange = arm.T_flange_tool.inv().as_matrix()
        self._lengths = np.array([[arm.length_m]] * 3 + [[1.0]] * 3)
        self._boxes = [(f"forbidden box {box.name}", box) for box in limits.forbidden]

    def look(self, q: Array) -> Sight:
        """Return the tool at readings q (m, n)."""
        values = q if self._gearing is None else q @ self._gearing.T
        T, J = fk_jacobian(self.arm, values)
        T = self._T_base_world @ T
        J = np.concatenate([self._R_base_world @ J[:, :3], self._R_base_world @ J[:, 3:]], axis=1)
        return Sight(q, T, J if self._gearing is None else J @ self._gearing)

    def twist(self, J: Array, qd: Array) -> tuple[Array, Array]:
        """Return velocity (m, 3) and angular velocity (m, 3) of the tool for J (m, 6, n) and qd (m, n)."""
        both = np.einsum("mij,mj->mi", J, qd)
        return both[:, :3], both[:, 3:]

    def singularity(self, J: Array) -> float:
        """Return the least singular value of one Jacobian (6, n), lengths in mean links; of position only below six."""
        return float(np.linalg.svd(self.scaled(J), compute_uv=False)[-1])

    def scaled(self, J: Array) -> Array:
        """Return the rows of J (6, n) that motion in space uses, lengths in units of the arm's mean link."""
        return (J / self._lengths)[: self.rows]

    @property
    def rows(self) -> int:
        """How many rows of a Jacobian motion in space uses: six, or three where joints are too few to turn the tool."""
        return 6 if self.arm.n >= 6 else 3

    def breach(self, sight: Sight, qd: Array, *, in_space: bool) -> Breach:
        """Return what is broken at worst over the rows of sight, moving at qd (m, n); in_space: singularities count.

        Between two rows the tool goes no further than from row to row, which boxes allow for by half of it.
        """
        limits, p = self._limits, sight.position_m
        velocity, turning = self.twist(sight.J, qd)
        flange = p + (sight.T[:, :3, :3] @ self._flange[:3, 3])
        points = np.concatenate([p, flange])
        stride = 0.0
        if len(p) > 1:
            stride = 0.5 * float(np.sqrt(np.square(np.diff(np.array([p, flange]), axis=1)).sum(axis=-1).max()))
        broken = {
            "speed of the tool": float(np.sqrt(np.square(velocity).sum(axis=1).max())) - limits.speed_m_s,
            "turning of the tool": float(np.sqrt(np.square(turning).sum(axis=1).max())) - limits.turn_rad_s,
            "range of a joint": self._beyond_range(sight.q),
            "speed of a joint": float((np.abs(qd) - self._bounds.speed).max()),
        }
        keep = limits.margin_m + stride
        if limits.workspace is not None:
            low, high = limits.workspace.lower_m + keep, limits.workspace.upper_m - keep
            broken[f"workspace {limits.workspace.name}"] = float(np.maximum(low - points, points - high).max())
        for name, box in self._boxes:
            inside = np.minimum(points - (box.lower_m - keep), (box.upper_m + keep) - points).min(axis=1)
            broken[name] = float(inside.max())
        if in_space:
            least = min(self.singularity(sight.J[0]), self.singularity(sight.J[-1]))
            broken["distance to a singularity"] = limits.singularity - least
        return Breach(broken)

    def _beyond_range(self, q: Array) -> float:
        bounds = self._bounds
        depth = float(np.maximum(bounds.lower - q, q - bounds.upper).max())
        if self._gearing is None:
            return depth
        values = q @ self._gearing.T
        return max(depth, float(np.maximum(self.arm.lower - values, values - self.arm.upper).max()))

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
        """Return readings (n,) near those of sight's first row that put the tool at a pose (4, 4); None: none found.

        Arms of less than six joints meet the position only.
        """
        q = sight.q[0].copy()
        at = sight
        for _ in range(NEWTON_STEPS):
            way, turn = pose_difference(T_base_tool, at.T[0])
            turned = self.rows == 3 or float(np.abs(turn).max()) < ROTATION_RAD
            if turned and float(np.abs(way).max()) < POSITION_M:
                return q
            error = (np.concatenate([way, turn])[:, None] / self._lengths)[: self.rows, 0]
            J = self.scaled(at.J[0])
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(self.rows), error)
            if not (np.abs(q) < 1e3).all():
                return None
            at = self.look(q[None])
        way, turn = pose_difference(T_base_tool, at.T[0])
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
