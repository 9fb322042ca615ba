"""Corrections of a flange's pose by external offsets of LinuxCNC's axes, and where they would make a joint run away.

LinuxCNC adds offsets to the X Y Z and A B C of its program, R = Rz(C) Ry(B) Rx(A), and turns the sum into joints
without any limit of theirs: near a singular pose a small correction turns the wrist as fast as it will.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.drivers.goals import away, between
from armsight.drivers.link_settings import ArmOnLink
from armsight.drivers.linuxcnc.machine import SPEED_SHARE
from armsight.drivers.proof import PROBE_M, PROBE_RAD, RETURN_S
from armsight.units import DEG

BRAKES_M, BRAKES_RAD = 2e-4, 2e-3
"""A correction that is let go of in motion goes on by no more: that limits its speed."""

PROBE_FORCE = 0.3
"""Share of the offsets' acceleration that the probe takes; at 0.8 the planner's lag made 1.09 of the way of it."""

AHEAD_S = 0.15
"""The arm is looked at where it will be so long from now: meanwhile the program is paused and its axes brake."""

SHARE = 0.9
"""Of a joint's MAX_VELOCITY that program and correction may need together."""

LEAST_COS_B = 0.3
"""Nearer to B = 90 degrees A and C turn far for a small turn of the flange; here by 1 / LEAST_COS_B at most."""

SINGULAR = 1e-12
"""A Jacobian's determinant, in m3, that is none: far smaller than any that passes for near."""

ROUND = 6
"""Decimals of an offset in mm or degrees: what changes behind them is no motion."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncorrected:
    """Where LinuxCNC's program alone has the flange: xyz_m (3,), and abc_rad (3,) as LinuxCNC has them."""

    xyz_m: Array
    abc_rad: Array

    @classmethod
    def of(cls, commanded: Array, offsets: Array) -> Self:
        """Return it, of the commanded pose (4, 4) and the offsets (6,) in force in m and rad."""
        return cls(xyz_m=commanded[:3, 3] - offsets[:3], abc_rad=abc_of(commanded[:3, :3]) - offsets[3:])

    def correction(self, T_base_flange: Array) -> RigidTransform:
        """Return what brings the flange to a pose (4, 4): way and turn about the flange in base axes."""
        turn = Rotation.from_matrix(T_base_flange[:3, :3] @ turned(self.abc_rad).T)
        return RigidTransform.from_components(T_base_flange[:3, 3] - self.xyz_m, turn)

    def corrected(self, correction: RigidTransform) -> Array:
        """Return the flange's pose (4, 4) with a correction."""
        T = correction.as_matrix()
        T[:3, :3], T[:3, 3] = T[:3, :3] @ turned(self.abc_rad), T[:3, 3] + self.xyz_m
        return T

    def offsets(self, correction: RigidTransform) -> Array:
        """Return the offsets (6,) in m and rad that make a correction."""
        T = self.corrected(correction)
        turn = abc_of(T[:3, :3]) - self.abc_rad
        return np.concatenate([T[:3, 3] - self.xyz_m, (turn + math.pi) % math.tau - math.pi])

    def applied(self, offsets: Array) -> RigidTransform:
        """Return the correction that offsets (6,) in m and rad make."""
        turn = turned(self.abc_rad + offsets[3:]) @ turned(self.abc_rad).T
        return RigidTransform.from_components(offsets[:3], Rotation.from_matrix(turn))


def turned(abc_rad: Array) -> Array:
    """Return R (3, 3) of A B C; written out, as abc_of, since each state needs them several times."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(abc_rad), np.cos(abc_rad)
    return np.array(
        [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
            [-sb, cb * sa, cb * ca],
        ]
    )


def abc_of(R: Array) -> Array:
    """Return A B C (3,) of R (3, 3), B within 90 degrees."""
    b = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    return np.array([math.atan2(R[2, 1], R[2, 2]), b, math.atan2(R[1, 0], R[0, 0])])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrections:
    """What corrections of one machine may do, and where they would make a joint too fast.

    joint_speed (n,): MAX_VELOCITY of the joints. axis_speed (6,): of the axes' offsets. speeds: of a correction, in m/s
    and rad/s. braking: in m/s2 and rad/s2. probe_share: by how much the proof's probe is smaller.
    """

    arm: ArmOnLink
    joint_speed: Array
    axis_speed: Array
    speeds: tuple[float, float]
    braking: tuple[float, float]
    probe_share: float

    @classmethod
    def of(cls, arm: ArmOnLink, *, axes: Array, joint_speed: Array, speeds: tuple[float, float]) -> Self:
        """Return them; axes (2, 6): speed and acceleration of the axes' offsets; speeds: that are allowed at most."""
        limit = np.minimum(SPEED_SHARE * axes[0], np.sqrt(2.0 * np.repeat([BRAKES_M, BRAKES_RAD], 3) * axes[1]))
        # the probe's way back, half a cosine, is its hardest; A and C turn farther than the flange
        hardest = 0.5 * np.repeat([PROBE_M[0], 2.0 * PROBE_RAD[0]], 3) * (math.pi / RETURN_S) ** 2
        made = cls(
            arm=arm,
            joint_speed=joint_speed,
            axis_speed=axes[0],
            speeds=(min(speeds[0], float(limit[:3].min())), min(speeds[1], LEAST_COS_B * float(limit[3:].min()))),
            braking=(0.5 * float(axes[1, :3].min()), 0.5 * LEAST_COS_B * float(axes[1, 3:].min())),
            probe_share=min(1.0, float((PROBE_FORCE * axes[1] / hardest).min())),
        )
        made.warm_up(np.full(len(joint_speed), 0.1))
        return made

    def warm_up(self, q: Array) -> None:
        """Call all that a cycle calls once, so that none waits for the compiler."""
        self.why_not(q, q)
        bare = Uncorrected.of(self.arm.flange(q), np.zeros(6))
        bare.offsets(self.slowed(RigidTransform.identity(), bare.correction(self.arm.flange(1.01 * q)), 1e-3))

    def slowed(self, sent: RigidTransform, goal: RigidTransform, cycle_s: float) -> RigidTransform:
        """Return a goal on the way to one, as far as a cycle may go to come to rest there."""
        way = np.concatenate(between(sent, goal))
        share = 1.0
        for part, braking in zip((way[:3], way[3:]), self.braking, strict=True):
            if size := float(np.linalg.norm(part)):
                share = min(share, math.sqrt(2.0 * braking * size) * cycle_s / size)
        return away(sent, share * way)

    def why_not(self, q: Array, qd: Array) -> str:
        """Return why no correction may be made at q (n,) in rad while the joints go at qd (n,); empty: it may.

        The twist that the joints make now is taken on to where they will be, with a correction in its worst direction.
        """
        R = self.arm.flange(q)[:3, :3]
        cos_b = math.hypot(R[2, 1], R[2, 2])
        if cos_b < LEAST_COS_B:
            return f"LinuxCNC's B is within {math.degrees(math.asin(cos_b)):.0f} degrees of 90, where A and C run away"
        J = self.arm.jacobian(q)  # (6, n)
        twist = J @ qd
        for at in (J, self.arm.jacobian(q + AHEAD_S * qd)) if qd.any() else (J,):
            if abs(np.linalg.det(at)) < SINGULAR:
                return "the arm is in a singular pose"
            back = np.linalg.inv(at)
            way, turn = (np.sqrt((back[:, part] ** 2).sum(axis=1)) for part in (slice(3), slice(3, 6)))  # (n,) each
            needed = np.abs(back @ twist) + self.speeds[0] * way + self.speeds[1] * turn
            worst = int(np.argmax(needed / self.joint_speed))
            if needed[worst] > SHARE * self.joint_speed[worst]:
                return (
                    f"the arm is near a singular pose: joint {worst + 1} would need up to "
                    f"{needed[worst] / DEG:.0f} of its {self.joint_speed[worst] / DEG:.0f} degrees/s"
                )
        return ""


def bounded(correction: RigidTransform, most_m: float, most_rad: float) -> tuple[RigidTransform, tuple[str, ...]]:
    """Return a correction cut to its largest way and turn, and what cut it, in words."""
    way, turn = np.asarray(correction.translation), correction.rotation.as_rotvec()
    share_m = min(1.0, most_m / max(float(np.linalg.norm(way)), 1e-300))
    share_rad = min(1.0, most_rad / max(float(np.linalg.norm(turn)), 1e-300))
    words = ("largest correction",) if min(share_m, share_rad) < 1.0 else ()
    return RigidTransform.from_components(share_m * way, Rotation.from_rotvec(share_rad * turn)), words
