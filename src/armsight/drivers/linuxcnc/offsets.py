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
from armsight.drivers.link_settings import ArmOnLink
from armsight.units import DEG

AHEAD_S = 0.15
"""The arm is looked at where it will be so long from now: meanwhile the program is paused and its axes brake."""

SHARE = 0.9
"""Of a joint's MAX_VELOCITY that program and correction may need together."""

LEAST_COS_B = 0.3
"""Nearer to B = 90 degrees A and C turn far for a small turn of the flange; here by 1 / LEAST_COS_B at most."""

ROUND = 6
"""Decimals of an offset in mm or degrees: what changes behind them is no motion."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncorrected:
    """Where LinuxCNC's program alone has the flange: xyz_m (3,), and abc_rad (3,) as LinuxCNC has them."""

    xyz_m: Array
    abc_rad: Array

    @classmethod
    def of(cls, commanded: RigidTransform, offsets: Array) -> Self:
        """Return it, of the commanded pose and the offsets (6,) in force in m and rad."""
        abc = commanded.rotation.as_euler("xyz")
        return cls(xyz_m=np.asarray(commanded.translation) - offsets[:3], abc_rad=abc - offsets[3:])

    def correction(self, T_base_flange: RigidTransform) -> RigidTransform:
        """Return what brings the flange to a pose: way and turn about the flange in base axes."""
        turn = T_base_flange.rotation * Rotation.from_euler("xyz", self.abc_rad).inv()
        return RigidTransform.from_components(np.asarray(T_base_flange.translation) - self.xyz_m, turn)

    def corrected(self, correction: RigidTransform) -> RigidTransform:
        """Return the flange's pose with a correction."""
        turned = correction.rotation * Rotation.from_euler("xyz", self.abc_rad)
        return RigidTransform.from_components(self.xyz_m + np.asarray(correction.translation), turned)

    def offsets(self, correction: RigidTransform) -> Array:
        """Return the offsets (6,) in m and rad that make a correction."""
        turn = self.corrected(correction).rotation.as_euler("xyz") - self.abc_rad
        return np.concatenate([np.asarray(correction.translation), (turn + math.pi) % math.tau - math.pi])

    def applied(self, offsets: Array) -> RigidTransform:
        """Return the correction that offsets (6,) in m and rad make."""
        abc = Rotation.from_euler("xyz", self.abc_rad + offsets[3:])
        return RigidTransform.from_components(offsets[:3], abc * Rotation.from_euler("xyz", self.abc_rad).inv())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Runaway:
    """Tells where a joint would be too fast. max_speed (n,) of the joints; speeds of a correction in m/s and rad/s."""

    arm: ArmOnLink
    max_speed: Array
    speed_m_s: float
    speed_rad_s: float

    def why(self, q: Array, qd: Array) -> str:
        """Return why no correction may be made at q (n,) in rad while the joints go at qd (n,); empty: it may.

        The twist that the joints make now is taken on to where they will be, with a correction in its worst direction.
        """
        cos_b = math.cos(self.arm.fk(q).rotation.as_euler("xyz")[1])
        if cos_b < LEAST_COS_B:
            return f"LinuxCNC's B is within {math.degrees(math.asin(cos_b)):.0f} degrees of 90, where A and C run away"
        twist, ahead = self.arm.jacobian(q) @ qd, q + AHEAD_S * qd
        for there in (q, ahead) if qd.any() else (q,):
            J = self.arm.jacobian(there)  # (6, n)
            if np.linalg.cond(J) > 1e6:
                return "the arm is in a singular pose"
            back = np.linalg.inv(J)
            way, turn = (np.linalg.norm(back[:, part], axis=1) for part in (slice(3), slice(3, 6)))  # (n,) each
            needed = np.abs(back @ twist) + self.speed_m_s * way + self.speed_rad_s * turn
            worst = int(np.argmax(needed / self.max_speed))
            if needed[worst] > SHARE * self.max_speed[worst]:
                return (
                    f"the arm is near a singular pose: joint {worst + 1} would need up to "
                    f"{needed[worst] / DEG:.0f} of its {self.max_speed[worst] / DEG:.0f} degrees/s"
                )
        return ""


def bounded(correction: RigidTransform, most_m: float, most_rad: float) -> tuple[RigidTransform, tuple[str, ...]]:
    """Return a correction cut to its largest way and turn, and what cut it, in words."""
    way, turn = np.asarray(correction.translation), correction.rotation.as_rotvec()
    share_m = min(1.0, most_m / max(float(np.linalg.norm(way)), 1e-300))
    share_rad = min(1.0, most_rad / max(float(np.linalg.norm(turn)), 1e-300))
    words = ("largest correction",) if min(share_m, share_rad) < 1.0 else ()
    return RigidTransform.from_components(share_m * way, Rotation.from_rotvec(share_rad * turn)), words
