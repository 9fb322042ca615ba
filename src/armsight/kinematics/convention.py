"""Standard (distal) and Craig's (proximal) Denavit-Hartenberg convention, and the way from one to the other.

Standard: T_i = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). Craig: T_i = Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d). The
parameters are the same with a, alpha, beta moved by one joint (MATH 4.5); what is left over at the ends goes into
frame 0 or the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from math import cos, sin
from typing import TYPE_CHECKING

import numpy as np

from armsight.arrays import Array
from armsight.kinematics.joints import JointType

if TYPE_CHECKING:
    from armsight.kinematics.arm import Arm

Link = tuple[float, float, float]
"""a in m, alpha and beta in rad."""


class Convention(StrEnum):
    """Where the link stands: behind its joint (standard) or before it (craig)."""

    STANDARD = "standard"
    CRAIG = "craig"


def link_matrix(a_m: float, alpha_rad: float, beta_rad: float) -> Array:
    """Return Tx(a) Rx(alpha) Ry(beta) as a (4, 4) matrix."""
    ca, sa, cb, sb = cos(alpha_rad), sin(alpha_rad), cos(beta_rad), sin(beta_rad)
    return np.array([[cb, 0.0, sb, a_m], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, 0.0], [0, 0, 0, 1.0]])


def distal_rows(
    convention: Convention, T_world_frame0: Array, links: Sequence[Link], T_flange_tool: Array
) -> tuple[Array, list[Link], Array]:
    """Return frame 0, links and tool of the same arm in standard convention; matrices (4, 4)."""
    if convention is Convention.STANDARD:
        return T_world_frame0, list(links), T_flange_tool
    return T_world_frame0 @ link_matrix(*links[0]), [*links[1:], (0.0, 0.0, 0.0)], T_flange_tool


def proximal_rows(
    convention: Convention, T_world_frame0: Array, links: Sequence[Link], T_flange_tool: Array
) -> tuple[Array, list[Link], Array]:
    """Return frame 0, links and tool of the same arm in Craig's convention; matrices (4, 4)."""
    if convention is Convention.CRAIG:
        return T_world_frame0, list(links), T_flange_tool
    return T_world_frame0, [(0.0, 0.0, 0.0), *links[:-1]], link_matrix(*links[-1]) @ T_flange_tool


# An arm as compiled code sees it.


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
