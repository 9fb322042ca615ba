"""The target's motion in base axes: where it will be when a command takes effect."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array
from armsight.control.guard.space import pose_difference
from armsight.fitting.quantiles import chi2_isf
from armsight.geometry.poses import skew
from armsight.measure.motion.estimate import MotionFilter
from armsight.optics import PackedRig, Rig

MOST_MAHALANOBIS2 = float(chi2_isf(1e-6, 6))
"""Squared Mahalanobis distance from where even a knock would have put the target, beyond which it jumped."""
UNKNOWN_TURN_RAD = 10.0
"""Standard deviation of a rotation of which nothing is known."""
ARM_M, ARM_RAD = 1e-4, 2e-4
"""Standard deviations added to a pose for the arm that carries the cameras: it shakes, its model errs, and its readings
come in steps."""
ARM_COVARIANCE = np.diag(np.repeat(np.square([ARM_M, ARM_RAD]), 3))
SETTLED_S = 0.15
"""A track so young is not followed: its velocity is not known yet."""
CALM_S = 0.3
"""After a jump the target is followed again once its poses have agreed with each other for so long."""
HAND_M_S2, HAND_RAD_S2 = 10.0, 50.0
"""A target in steady sight that is further from where it was going than this acceleration since the last pose explains
jumped: hands of up to 0.5 m/s with stops and reversals needed 4.9 m/s^2 and 13 rad/s^2 (benchmarks/servo_lies.py)."""
NOISE_SIGMAS = 4.0
"""Standard deviations of a pose that are no motion of the target."""
STEADY_S = 0.1
"""After a gap the velocity is known again once poses came for so long: sooner, honest hands needed up to 23 m/s^2."""
GAP_S = 0.15
"""A longer time between two poses is a gap."""
LOST_S = 0.5
"""A target not seen for so long is lost, and what was known of its motion is forgotten."""
LOST_TURN_RAD = 1.0
"""A target that comes back turned by more than it was seen last jumped: a hand seldom does that out of sight, pictures
that come back turned by 90 or 180 degrees do."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetMotion:
    """Pose T_base_target (4, 4) at a moment, with the velocity (3,) of its origin in m/s and its angular velocity (3,).

    has_rotation: whether its rotation was measured; else it is the one last seen, and means nothing where none was.
    """

    T_base_target: Array
    velocity_m_s: Array
    angular_rad_s: Array
    has_rotation: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracked:
    """What is known of a target: its motion since begun_s, where it was at T_begun (4, 4), after a jump or not.

    steady_s: since when there was no gap. has_rotation: whether the newest pose has its rotation; turned: whether any
    since begun_s had.
    """

    filter: MotionFilter
    begun_s: float
    T_begun: Array
    steady_s: float
    jumped: bool
    has_rotation: bool
    turned: bool

    @property
    def seen_s(self) -> float:
        """When it was exposed last."""
        return self.filter.t_s

    @property
    def settled(self) -> bool:
        """Whether its poses have agreed with each other for long enough to be followed."""
        return self.seen_s - self.begun_s >= (CALM_S if self.jumped else SETTLED_S)

    def at(self, t_s: float) -> TargetMotion:
        """Return where the target is expected at t_s, and how it moves."""
        state = self.filter.at(t_s)
        return TargetMotion(
            T_base_target=state.T_rig_target,
            velocity_m_s=state.velocity[:3],
            angular_rad_s=state.velocity[3:],
            has_rotation=self.has_rotation,
        )


class TargetTrack:
    """Follows a target by a filter of its acceleration; one thread adds, any may look at `now`, one record."""

    def __init__(self, rig: Rig) -> None:
        """Begin without a target. rig: whose poses they are."""
        self._packed = PackedRig.of(rig)
        self.now: Tracked | None = None

    def add(self, t_s: float, T_base_target: Array, covariance: Array) -> None:
        """Take a pose (4, 4) exposed at t_s; covariance (6, 6), translation then rotation vector, in base axes.

        Where no motion leads to it, the target jumped: the track begins anew there. So it does after LOST_S without
        the target, which jumped where it is turned by much more. A pose that is not newer than the last is left out.
        """
        self._add(t_s, T_base_target, covariance, has_rotation=True, turned=True)

    def add_position(self, t_s: float, xyz_m: Array, covariance: Array, centre_m: Array) -> None:
        """Take where the middle of the lights seen is, xyz_m (3,) with covariance (3, 3) in base axes.

        centre_m (3,): that middle in target axes. The rotation goes on as the track has it; where it was never seen,
        the middle stands for the target's origin.
        """
        T, C = np.eye(4), np.diag(np.full(6, UNKNOWN_TURN_RAD**2))
        T[:3, 3], C[:3, :3] = xyz_m, covariance
        now = self.now
        turned = now is not None and now.turned
        if now is not None and turned:
            state = now.filter.at(t_s)
            T[:3, :3] = state.T_rig_target[:3, :3]
            arm = T[:3, :3] @ centre_m
            T[:3, 3] -= arm
            C[:3, :3] += skew(arm) @ state.covariance[3:, 3:] @ skew(arm).T
        self._add(t_s, T, C, has_rotation=False, turned=turned)

    def _add(self, t_s: float, T: Array, covariance: Array, *, has_rotation: bool, turned: bool) -> None:
        C = covariance + ARM_COVARIANCE
        now = self.now
        if now is None or t_s - now.seen_s > LOST_S:
            jumped = has_rotation and now is not None and self._turned_away(now, T)
            self.now = self._begun(t_s, T, C, jumped=jumped, has_rotation=has_rotation)
            return
        if t_s <= now.seen_s:
            return
        after, _, knocked2 = now.filter.add_pose(t_s, T, C)
        if knocked2 > MOST_MAHALANOBIS2 or self._sudden(now, t_s, T, C, has_rotation=has_rotation):
            self.now = self._begun(t_s, T, C, jumped=True, has_rotation=has_rotation)
            return
        self.now = replace(
            now,
            filter=after,
            steady_s=t_s if t_s - now.seen_s > GAP_S else now.steady_s,
            jumped=now.jumped and not (t_s - now.begun_s >= CALM_S),
            has_rotation=has_rotation,
            turned=now.turned or turned,
        )

    def _turned_away(self, now: Tracked, T: Array) -> bool:
        """Tell whether a target that was lost comes back turned by more than LOST_TURN_RAD."""
        if not now.turned:
            return False
        return float(np.linalg.norm(pose_difference(now.at(now.seen_s).T_base_target, T)[1])) > LOST_TURN_RAD

    def _sudden(self, now: Tracked, t_s: float, T: Array, covariance: Array, *, has_rotation: bool) -> bool:
        """Tell whether no hand brings the target there: a knock could, and so the filter would take 10 mm for 3 m/s."""
        since_s = t_s - now.seen_s
        if since_s > GAP_S or now.seen_s - max(now.steady_s, now.begun_s) < STEADY_S:
            return False
        way_m, turn = pose_difference(now.at(t_s).T_base_target, T)
        noise = NOISE_SIGMAS * np.sqrt([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])
        far = float(np.linalg.norm(way_m)) > 0.5 * HAND_M_S2 * since_s**2 + noise[0]
        return bool(far or (has_rotation and float(np.linalg.norm(turn)) > 0.5 * HAND_RAD_S2 * since_s**2 + noise[1]))

    def _begun(self, t_s: float, T: Array, covariance: Array, *, jumped: bool, has_rotation: bool) -> Tracked:
        begun = MotionFilter.begin(self._packed, np.zeros((0, 3)), t_s, T, covariance)
        return Tracked(
            filter=begun,
            begun_s=t_s,
            T_begun=T,
            steady_s=t_s,
            jumped=jumped,
            has_rotation=has_rotation,
            turned=has_rotation,
        )
