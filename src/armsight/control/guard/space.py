"""The arm in space: where tool and flange are at joint readings, how fast they go, and what of the limits is broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.control.guard.kernels import (
    FACES,
    TOOL,
    clear_of_singularities,
    depths,
    depths_each,
    least_motion,
)
from armsight.control.guard.limits import Box, JointBounds, Limits
from armsight.geometry.kernels import rotvec
from armsight.kinematics import Arm, fk_jacobian
from armsight.records import for_kernels

NEWTON_STEPS = 4
"""For the way of one cycle two are enough; a pose not met by then is not reached."""
ASTRAY = np.pi
"""rad or m from where it began beyond which a search ran away: a pose of the next cycle is near."""
POSITION_M = 1e-7
ROTATION_RAD = 1e-7
EVERYWHERE = Box(lower_m=np.full(3, -1e9), upper_m=np.full(3, 1e9), name="without walls")
KEPT_BACK = 0.99
"""Share of the limits of the tool that is checked for: the real arm differs from its model by parts in a thousand."""
HAIR = 1e-9
"""What is worse by less than this (m, rad, m/s) than it was is not worse: rounding."""
OUTSIDE = 1e-6
"""Who is beyond a limit by less than this (m, rad) stands at it: where motion has ended within rounding and HAIR."""
LESS, LESS_SHARE = 1e-12, 0.02
"""A way back lessens by more than this, and by more than this share of the joints' largest way (m or rad): a straight
motion along a wall bends away from it a little, and is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The tool at readings q (n,): T_base_tool (4, 4), and its Jacobian J (6, n) for the readings in base axes."""

    q: Array
    T: Array
    J: Array


@dataclass(frozen=True, slots=True, eq=False)
class LimitNames:
    """What messages call each limit. of_motion, of_position: which of them a slower motion keeps, and which are
    positions.

    Where only limits of motion are broken the arm slows down and goes on.
    """

    names: tuple[str, ...]
    of_motion: NDArray[np.bool_]
    of_position: NDArray[np.bool_]

    def of(self, which: NDArray[np.bool_]) -> tuple[str, ...]:
        """Return the names of those in a mask."""
        return tuple(self.names[i] for i in np.flatnonzero(which))

    def only_motion(self, names: tuple[str, ...]) -> bool:
        """Tell whether a slower motion keeps all limits of these names."""
        return set(names) <= set(self.of(self.of_motion))


@dataclass(frozen=True, slots=True, eq=False)
class Breach:
    """By how much each limit is broken, in the order of its names; 0 or less where it is kept.

    end: the same at the end alone, which is asked for where the arm stands outside.
    """

    limits: LimitNames
    depths: Array
    end: Array

    def worse_than(self, allowed: Array) -> tuple[str, ...]:
        """Return the limits that are broken here, and more than allowed: each for itself."""
        worse = self.depths > np.maximum(allowed, 0.0) + HAIR
        return self.limits.of(worse) if worse.any() else ()

    def outside(self) -> NDArray[np.bool_]:
        """Return the limits of position that are broken by more than rounding."""
        return np.asarray(self.limits.of_position & (self.end > OUTSIDE))

    def lessens(self, before: Breach, way: float) -> bool:
        """Tell whether this ends less far outside than before, of one limit at least; inside there is nothing to.

        way: of the joint that goes furthest until then, in rad or m.
        """
        out = before.outside()
        return not out.any() or bool((self.end < before.end - LESS - LESS_SHARE * way)[out].any())

    def describe(self) -> str:
        """Return where it stands outside and the way back, in words; empty inside."""
        found = ", ".join(
            f"{self.limits.names[i]} by {self.end[i]:.3g} (way back: {_way_back(self.limits.names[i])})"
            for i in np.flatnonzero(self.outside())
        )
        return f"outside its limits (rad, m): {found}; only motion back towards them is followed" if found else ""


def _way_back(name: str) -> str:
    """Return in which direction a limit of position is kept again."""
    return "+" if "(lower" in name else "-" if "(upper" in name else "out of it"


class Space:
    """An arm and the limits of where its tool and its flange may be and how fast they may go."""

    def __init__(self, arm: Arm, limits: Limits, bounds: JointBounds) -> None:
        self.arm = arm
        self._limits = limits
        self._gearing = arm.gearing if arm.couplings else None
        self._direct = arm.direct
        self._T_base_world = arm.T_world_base.inv().as_matrix()
        self._flange = np.ascontiguousarray(arm.T_flange_tool.inv().as_matrix()[:3, 3])
        self._lengths = np.array([[arm.length_m]] * 3 + [[1.0]] * 3)
        self._joints = np.array([bounds.lower, bounds.upper, bounds.speed])
        self._most = KEPT_BACK * np.array(
            [limits.speed_m_s, limits.turn_rad_s, limits.acceleration_m_s2, limits.turn_acceleration_rad_s2]
        )
        spaces = (limits.workspace or EVERYWHERE, *limits.forbidden)
        self._boxes = np.array([[*box.lower_m, *box.upper_m] for box in spaces])
        self._kept = np.zeros(2 * FACES + 2 * len(limits.forbidden), dtype=bool)
        self._constants = (
            self._T_base_world,
            self._flange,
            self._joints,
            self._most,
            self._boxes,
            limits.margin_m,
        )
        self._walls = TOOL + 3 * arm.n
        self.rows = 6 if arm.n >= 6 else 3
        """How many rows of a Jacobian motion in space uses: three where joints are too few to turn the tool."""
        self._row_lengths = np.ascontiguousarray(self._lengths[: self.rows, 0])
        self.names = self._named(spaces[0].name)
        still = np.zeros((1, arm.n))
        T, J = fk_jacobian(arm, still, all_cores=False)
        out = np.empty((1, self._walls + len(self._kept)))
        depths_each((T, J, still, still, still), self._constants, self._kept, out)  # compiled before a cycle needs it

    def _named(self, workspace: str) -> LimitNames:
        """Return the names of all limits, in the kernel's order, then those of coupled values, then singularities."""
        joints = range(1, self.arm.n + 1)
        ends = [f"range of joint {i} ({end})" for end in ("lower", "upper") for i in joints]
        tool = (
            "speed of the tool",
            "turning of the tool",
            "acceleration of the tool",
            "turning acceleration of the tool",
        )
        speeds = [f"speed of joint {i}" for i in joints]
        points = ("tool", "flange")
        faces = [
            f"workspace {workspace} ({side} {axis}, {point})"
            for point in points
            for axis in "xyz"
            for side in ("lower", "upper")
        ]
        boxes = [f"forbidden box {box.name} ({point})" for box in self._limits.forbidden for point in points]
        coupled = [] if self._gearing is None else [f"coupled {end}" for end in ends]
        names = (*tool, *ends, *speeds, *faces, *boxes, *coupled, "distance to a singularity")
        motion, single = {*tool, *speeds}, names[-1]
        return LimitNames(
            names,
            np.array([name in motion for name in names]),
            np.array([name not in motion and name != single for name in names]),
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
        q, qd, qdd = (for_kernels(part) for part in (q, qd, qdd))
        values = self._values(q)
        T, J = fk_jacobian(self.arm, values, all_cores=False)
        if self._gearing is not None:
            J = np.ascontiguousarray(J @ self._gearing)
        kept = self._kept if before is None else before.depths[self._walls :][: len(self._kept)] > 0.0
        found = self._depths(T, J, (q, qd, qdd), dt_s, values, kept)
        end = found
        if before is not None and before.outside().any():
            end = self._on_the_way_back(T, J, (q, qd, qdd), values, before, found)
        if in_space and not self._beyond(found, before):
            found[-1] = self._singular(J)
        return Breach(self.names, found, end), self._in_base(q[0], T[0], J[0])

    def _beyond(self, found: Array, before: Breach | None) -> bool:
        """Tell whether a limit of position is broken more than before: then singularities need not be looked for."""
        if before is None:
            return False
        return bool((self.names.of_position & (found > np.maximum(before.depths, 0.0) + HAIR)).any())

    def _singular(self, J: Array) -> float:
        """Return by how much the distance to singularities is too small over Jacobians (m, 6, n); 0 where it is not.

        The singular values themselves are needed only where one is near.
        """
        least = self._limits.singularity
        return 0.0 if clear_of_singularities(J, self._row_lengths, least) else least - self.singularity(J)

    def _on_the_way_back(
        self, T: Array, J: Array, motion: tuple[Array, ...], values: Array, before: Breach, found: Array
    ) -> Array:
        """Return the depths at the end of a motion that begins outside, and tell in found what grows anywhere on it.

        The largest depth alone would let it come nearer and go out again.
        """
        out, kept = before.outside(), before.depths[self._walls : self._walls + len(self._kept)] > 0.0
        each = np.full((len(values), len(found)), -np.inf)
        n = self._walls + len(kept)
        there = each[:, :n].copy()  # contiguous, as it was compiled for: a strided part is another type to numba
        depths_each((T, J, *motion), self._constants, kept, there)
        each[:, :n] = there
        if self._gearing is not None:
            each[:, n:-1] = np.hstack([self.arm.lower - values, values - self.arm.upper])
        least = np.minimum.accumulate(np.vstack([before.depths, each[:-1]]))
        found[(out & (each > np.maximum(least, 0.0) + HAIR)).any(axis=0)] = np.inf
        return np.asarray(each[-1])

    def _depths(
        self,
        T: Array,
        J: Array,
        motion: tuple[Array, ...],
        dt_s: float,
        values: Array,
        kept: NDArray[np.bool_],
    ) -> Array:
        """Return the depths of all limits, that of singularities left at none."""
        found = np.full(len(self.names.names), -np.inf)
        n = self._walls + len(kept)
        depths((T, J, *motion), dt_s, self._constants, kept, found[:n])
        if self._gearing is not None:
            found[n:-1] = np.concatenate([(self.arm.lower - values).max(axis=0), (values - self.arm.upper).max(axis=0)])
        return found

    def at(self, q: Array, qd: Array, qdd: Array, *, in_space: bool) -> Breach:
        """Return what is broken at readings q (n,), moving at qd and qdd (n,)."""
        return self.along(q[None], qd[None], qdd[None], 0.0, in_space=in_space)[0]

    def _values(self, q: Array) -> Array:
        return q if self._direct else self.arm.values(q)

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
        wanted, start, qd = (
            np.concatenate([velocity_m_s, angular_rad_s]),
            2.0 * self._limits.singularity,
            np.empty(self.arm.n),
        )
        if least_motion(J, self._row_lengths, start, wanted, qd):
            return qd
        wanted = wanted[: self.rows] / self._row_lengths
        u, s, vt = np.linalg.svd(self.scaled(J), full_matrices=False)
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
            if not (np.abs(q - sight.q) < ASTRAY).all():
                return None
            at = self.look(q)
        way, turn = pose_difference(T_base_tool, at.T)
        close = float(np.abs(way).max()) < POSITION_M and (self.rows == 3 or float(np.abs(turn).max()) < ROTATION_RAD)
        return q if close else None


def pose_difference(T_to: Array, T_from: Array) -> tuple[Array, Array]:
    """Return the way (3,) in m and the rotation vector (3,) in rad from one pose (4, 4) to another, in base axes."""
    return T_to[:3, 3] - T_from[:3, 3], rotvec(T_to[:3, :3] @ T_from[:3, :3].T)
