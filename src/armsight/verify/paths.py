"""What the arm, or the command, says at any time: pose and velocity between the rows, and where rows are missing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial.transform import Rotation, Slerp

from armsight.geometry.lie import skew
from armsight.kinematics import Arm, fk_jacobian

Array = NDArray[np.float64]

GAP_PERIODS = 6.0
"""Rows further apart than so many usual periods leave a gap in which nothing is known."""
GAP_LEAST_S = 0.05
STEP_S = 1e-3
"""Over which the velocity of a commanded path is taken."""


def gap_s(t_s: Array) -> float:
    """Return the time between rows (n,) from which on nothing is known between them."""
    return max(GAP_PERIODS * float(np.median(np.diff(t_s))), GAP_LEAST_S)


def covered(t_s: Array, at_s: Array) -> NDArray[np.bool_]:
    """Return which times (m,) lie between rows t_s (n,) that are no gap apart."""
    i = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 2)
    inside = (at_s >= t_s[0]) & (at_s <= t_s[-1])
    return np.asarray(inside & (t_s[i + 1] - t_s[i] <= gap_s(t_s)))


@dataclass(frozen=True, eq=False)
class JointStream:
    """Joint values q (n, joints) at times t_s (n,), growing; bare: the arm without base and tool."""

    bare: Arm
    t_s: Array
    q: Array

    @cached_property
    def _curve(self) -> Akima1DInterpolator:
        return Akima1DInterpolator(self.t_s, self.q)

    @cached_property
    def _slope(self) -> Akima1DInterpolator:
        return self._curve.derivative()

    @cached_property
    def _bend(self) -> Akima1DInterpolator:
        return self._curve.derivative(2)

    def q_at(self, at_s: Array) -> Array:
        """Return joint values (m, joints); times beyond the rows take the first or last one's."""
        return np.asarray(self._curve(self._inside(at_s)))

    def speed_at(self, at_s: Array) -> Array:
        """Return joint speeds (m, joints)."""
        return np.asarray(self._slope(self._inside(at_s)))

    def acceleration_at(self, at_s: Array) -> Array:
        """Return joint accelerations (m, joints)."""
        return np.asarray(self._bend(self._inside(at_s)))

    def at(self, at_s: Array) -> tuple[Array, Array]:
        """Return F (m, 4, 4), base to flange, and its velocity (m, 6) in base axes."""
        F, J = fk_jacobian(self.bare, self.q_at(at_s))
        return F, np.einsum("mij,mj->mi", J, self.speed_at(at_s))

    def _inside(self, at_s: Array) -> Array:
        return np.clip(at_s, self.t_s[0], self.t_s[-1])


@dataclass(frozen=True, eq=False)
class PoseStream:
    """Commanded poses T (n, 4, 4) at times t_s (n,), growing."""

    t_s: Array
    T: Array

    @cached_property
    def _place(self) -> Akima1DInterpolator:
        return Akima1DInterpolator(self.t_s, self.T[:, :3, 3])

    @cached_property
    def _turn(self) -> Slerp:
        return Slerp(self.t_s, Rotation.from_matrix(self.T[:, :3, :3]))

    def at(self, at_s: Array) -> tuple[Array, Array]:
        """Return the commanded poses (m, 4, 4) and their velocity (m, 6) in their frame's axes."""
        t = np.clip(at_s, self.t_s[0] + STEP_S, self.t_s[-1] - STEP_S)
        F = np.tile(np.eye(4), (len(t), 1, 1))
        F[:, :3, 3] = self._place(t)
        F[:, :3, :3] = self._turn(t).as_matrix()
        turn = (self._turn(t + STEP_S) * self._turn(t - STEP_S).inv()).as_rotvec() / (2.0 * STEP_S)
        return F, np.concatenate([self._place.derivative()(t), turn], axis=1)


Stream = JointStream | PoseStream


def at_tool(F: Array, V: Array, x_m: Array) -> tuple[Array, Array]:
    """Return the places (m, 3) and velocities (m, 3) of a point x_m (3,) of the flange."""
    arm = F[:, :3, :3] @ x_m
    return F[:, :3, 3] + arm, V[:, :3] - np.einsum("mij,mj->mi", skew(arm), V[:, 3:])
