"""The rigid arm that is nearest to one whose joints give way, for formats that know no others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.kinematics.arm import Arm
from armsight.kinematics.derivatives import moved, parameter_jacobian, parameter_names
from armsight.kinematics.forward_kinematics import fk
from armsight.kinematics.kernels.derivatives import PER_JOINT

POSTURES = 500
"""Drawn in the joints' ranges: ten times as many numbers as an arm has parameters."""

ROUNDS = 5
"""Steps of Gauss and Newton; two settle what an arm gives way, some milliradians."""

WEAK = 1e-6
"""Share of the strongest direction of the parameters below which one is left as it is, such as a joint's height."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rigid:
    """A rigid arm, and how far its tool is from the other's over the joints' ranges, rms_m and most_m."""

    arm: Arm
    rms_m: float
    most_m: float

    @property
    def lost(self) -> str:
        """What to know of it."""
        return (
            f"a rigid arm is written, as there is no place for joints that give way: its tool is "
            f"{1e3 * self.rms_m:.3g} mm RMS, {1e3 * self.most_m:.3g} mm at most, from this one's over the ranges"
        )


def nearest_rigid(arm: Arm) -> Rigid:
    """Return the rigid arm on the same base whose tool is nearest to that of an arm that gives way under its weight.

    Least squares of the tool's pose, a turn counted by the mean link, over postures drawn in the joints' ranges.
    """
    low, high = np.clip(arm.lower, -np.pi, np.pi), np.clip(arm.upper, -np.pi, np.pi)
    q = np.random.default_rng(0).uniform(low, high, (POSTURES, arm.n))
    wanted = fk(arm, arm.sagged(q))
    near = replace(arm, joints=tuple(replace(joint, compliance=0.0) for joint in arm.joints), covariance=None)
    names = parameter_names(arm)
    free = [
        *range(PER_JOINT * arm.n),
        *range(len(names) - 6, len(names)),
    ]  # all but the base, which is the model's root
    for _ in range(ROUNDS):
        T, J = parameter_jacobian(near, q)
        turned = Rotation.from_matrix(wanted[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)).as_rotvec()
        r = np.concatenate([wanted[:, :3, 3] - T[:, :3, 3], arm.length_m * turned], axis=1)
        J[:, 3:] *= arm.length_m
        step = np.linalg.lstsq(J[:, :, free].reshape(-1, len(free)), r.ravel(), rcond=WEAK)[0]
        near = moved(near, {names[k]: float(by) for k, by in zip(free, step, strict=True)})
    off = np.linalg.norm(fk(near, q)[:, :3, 3] - wanted[:, :3, 3], axis=1)
    return Rigid(arm=near, rms_m=float(np.sqrt(np.mean(off**2))), most_m=float(off.max()))
