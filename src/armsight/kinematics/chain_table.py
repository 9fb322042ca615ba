"""An arm as compiled code sees it: the table of kernels.chain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from armsight.arrays import Array
from armsight.kinematics.convention import distal_rows
from armsight.kinematics.joints import JointType

if TYPE_CHECKING:
    from armsight.kinematics.arm import Arm


def chain_table(arm: Arm) -> Array:
    """Return the table (n + 2, 12) of kernels.chain."""
    T_frame0, rows, T_tool = distal_rows(
        arm.convention,
        arm.T_world_frame0,
        [(joint.a_m, joint.alpha_rad, joint.beta_rad) for joint in arm.joints],
        arm.T_flange_tool.as_matrix(),
    )
    chain = np.zeros((arm.n + 2, 12))
    chain[0] = T_frame0[:3].ravel()
    chain[-1] = T_tool[:3].ravel()
    for row, joint, (a, alpha, beta) in zip(chain[1:-1], arm.joints, rows, strict=True):
        row[0] = float(joint.type is JointType.PRISMATIC)
        row[1:4] = joint.sign, joint.theta_rad, joint.d_m
        row[4] = a
        row[5:7] = exact_cos_sin(alpha)
        row[7:9] = exact_cos_sin(beta)
        row[9:12] = joint.lower, joint.upper, alpha
    return chain


def exact_cos_sin(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine, exact where the angle is the nearest float64 to a quarter turn."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    if abs(c) < math.ulp(1.0):
        return 0.0, math.copysign(1.0, s)
    if abs(s) < math.ulp(1.0):
        return math.copysign(1.0, c), 0.0
    return c, s
