"""Table 1: Denavit-Hartenberg parameters of an arm of two turning joints and a slide (steps 8 to 11, MATH 4.5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armsight.kinematics.lines import Link, link_to_line

Array = NDArray[np.float64]
Line = tuple[Array, Array]


def rrp_links(axes: Sequence[Line], beacon_m: Array, x0_hint: Array) -> tuple[Link, Link, float]:
    """Return links 1 and 2 and d3 (m) of axes (point (3,), direction (3,)) in world, at one pose of the arm.

    Frame 0 stands on axis 1 at the height of the world's origin, its x along x0_hint (3,). The slide's axis is put
    through the beacon (3,), as the paper does. d3: from the second frame's origin to the beacon along the slide. x1
    is chosen so that alpha1 is positive, x2 so that alpha2 is.
    """
    (p0, z0), _, (_, z2) = axes
    foot = p0 - (p0 @ z0) * z0
    x0 = x0_hint - (x0_hint @ z0) * z0
    x0 = x0 / np.linalg.norm(x0)
    T0 = np.eye(4)
    T0[:3, :3], T0[:3, 3] = np.stack([x0, np.cross(z0, x0), z0], axis=1), foot
    first = _positive(T0, axes[1])
    T1 = T0 @ first.matrix()
    second = _positive(T1, (beacon_m, z2))
    T2 = T1 @ second.matrix()
    return first, second, float((beacon_m - T2[:3, 3]) @ T2[:3, 2])


def _positive(T: Array, line: Line) -> Link:
    """Return the link to a line with the sign of x that makes alpha positive."""
    link = link_to_line(T, line[0], line[1])
    if link.alpha_rad >= 0.0:
        return link
    x = (T @ link.matrix())[:3, 0]
    return link_to_line(T, line[0], line[1], x_hint=-x)
