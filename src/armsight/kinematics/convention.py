"""Standard (distal) and Craig's (proximal) Denavit-Hartenberg convention, and the way from one to the other.

Standard: T_i = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). Craig: T_i = Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d). The
parameters are the same with a, alpha, beta moved by one joint (MATH 4.5); what is left over at the ends goes into
frame 0 or the tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from math import cos, sin

import numpy as np

from armsight.arrays import Array

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
