"""Joints that count the other way than the nominal arm has it: of all choices of senses the one that explains the rows.

Home-made and retrofitted arms, and models typed by hand, have it: a reading that falls where the model's rises. Base,
tool and the zeros of joints are free beside the senses, so that zeros that were set elsewhere hide nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import ArmsightError, Inconsistent
from armsight.kinematics import Arm, fk
from armsight.units import DEG, MM

Array = NDArray[np.float64]

ROWS = 60
"""Rows that senses are looked for with; fewer than FEWEST fit one of so many choices by chance."""
FEWEST = 12
MOST_JOINTS = 7
"""Joints of which all choices are tried."""
STEPS = 25
"""Evaluations of one choice: those that fit need ten."""
FITS = 0.05
"""Share of how far the tool moved that may be left: lengths of a home-made arm, not the next best choice of senses."""
NEXT = 0.3
"""... and of what choices leave that reverse others."""
TOLD_ZERO_RAD = 2.0 * DEG


@dataclass(frozen=True, slots=True, kw_only=True)
class Senses:
    """Joints that run the other way, zeros (n,) by which the others are then off, and what is left, RMS in m."""

    joints: tuple[str, ...]
    zeros_rad: Array
    left_m: float

    def refusal(self, arm: Arm, given_m: float) -> Inconsistent:
        """Return the refusal of an arm's file whose joints have other senses than its readings."""
        named = ", ".join(self.joints)
        off = [
            (joint.name, zero)
            for joint, zero in zip(arm.joints, self.zeros_rad.tolist(), strict=True)
            if abs(zero) > TOLD_ZERO_RAD
        ]
        zeros = f" (and zeros off: {', '.join(f'{x} by {z / DEG:.1f}' for x, z in off)} degrees)" if off else ""
        add = f", and add to theta_rad there {', '.join(f'{z:.3f} ({x})' for x, z in off)}" if off else ""
        many = len(self.joints) > 1
        return Inconsistent(
            f"the nominal arm misses the positions by {given_m / MM:.3g} mm (root mean square); with {named} "
            f"counted the other way it fits them to {self.left_m / MM:.2g} mm{zeros}",
            consequence=f"The reading{'s' if many else ''} of {named} run{'' if many else 's'} the other way than in "
            "the model, and nothing is written",
            cure=f"Change the sign of {named} in the arm's file: `sign: -1` there in an arm.yaml (`armsight convert "
            f"arm` writes one){add}; in a URDF reverse the axis",
        )


def other_senses(arm: Arm, points: ArmPoints) -> tuple[Senses, float] | None:
    """Return the senses that explain the rows where the given ones do not, and their RMS error in m; else None."""
    turning = np.flatnonzero(arm.revolute)
    if not 1 <= len(turning) <= MOST_JOINTS or len(points) < FEWEST or len(points.labels) > 1 or arm.couplings:
        return None
    rows = np.unique(np.linspace(0, len(points) - 1, ROWS).astype(np.intp))
    q, xyz_m = points.q[rows], points.xyz_m[rows]
    choices = sorted(product((1.0, -1.0), repeat=len(turning)), key=lambda signs: signs.count(-1.0))
    found = [_fit(arm, turning, np.array(signs), q, xyz_m) for signs in choices]
    left = np.array([one[0] for one in found])
    given_m, alike = found[0][0], np.flatnonzero(left * NEXT <= left.min())
    best = int(alike[0])  # of those that fit alike the one that reverses fewest
    left_m, zeros = found[best]
    spread = float(np.sqrt(((xyz_m - xyz_m.mean(axis=0)) ** 2).sum(axis=1).mean()))
    # a joint that turns the tool about itself, or a wrist that flips, fits both ways: the others are known all the same
    common = np.all([np.array(choices[i]) < 0.0 for i in alike], axis=0)
    if best == 0 or left_m > FITS * spread or not np.array_equal(common, np.array(choices[best]) < 0.0):
        return None
    names = tuple(arm.joints[j].name for j, sign in zip(turning, choices[best], strict=True) if sign < 0.0)
    mirrored = _fit(arm, turning, np.ones(len(turning)), q, xyz_m * [-1.0, 1.0, 1.0])[0]
    if len(names) > 1 and mirrored * NEXT <= left_m:
        return None  # an arm with a plane of symmetry whose positions are a reflection: one fault, not several
    every = np.zeros(arm.n)
    every[turning] = zeros
    every[[turning[0], turning[-1]]] = 0.0  # base and tool take these up
    return Senses(joints=names, zeros_rad=every, left_m=left_m), given_m


def _fit(arm: Arm, turning: NDArray[np.intp], signs: Array, q: Array, xyz_m: Array) -> tuple[float, Array]:
    """Return what is left, RMS in m, and the zeros of the turning joints, base and tool free."""
    k, around, out_of_tool = len(turning), xyz_m - xyz_m.mean(axis=0), np.linalg.inv(arm.T_flange_tool.as_matrix())

    def residuals(x: Array) -> Array:
        read = q.copy()
        read[:, turning] = signs * q[:, turning] + x[:k]
        flange = fk(arm, read) @ out_of_tool
        there = flange[:, :3, :3] @ x[k:] + flange[:, :3, 3]
        there -= there.mean(axis=0)
        U, _, Vt = np.linalg.svd(around.T @ there)
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        return np.asarray((there @ (U @ Vt).T - around).ravel())

    try:
        first = np.concatenate([np.zeros(k), arm.T_flange_tool.translation])
        found = least_squares(residuals, first, x_scale=[0.1] * k + [0.05] * 3, max_nfev=STEPS, ftol=1e-6)
    except (ArmsightError, ValueError, np.linalg.LinAlgError):
        return np.inf, np.zeros(k)
    return float(np.sqrt(2.0 * found.cost / len(q))), np.remainder(found.x[:k] + np.pi, 2.0 * np.pi) - np.pi
