"""A joint from the places of the beacon while it alone moves: steps 1 to 6 of section 3.1, corrected (MATH C1-C6)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate, NotEnoughData
from armsight.fitting.quantiles import chauvenet
from armsight.records import frozen_array

Array = NDArray[np.float64]

STRAIGHT = 0.15
"""Mean distance from the x''' axis over the length along it, up to which a path counts as straight. The paper gives no
bound; an arc of 90 degrees has 0.13 to 0.2, noise at 4.5 m under 0.1 of 46 cm."""

FEWEST = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathJoint:
    """A joint: its axis through point_m (3,) along the unit vector direction (3,); radius_m is 0 of a sliding one.

    n_used, n_triples: combinations of three points kept by Chauvenet's criterion, and all of them.
    """

    revolute: bool
    point_m: Array
    direction: Array
    radius_m: float
    n_used: int
    n_triples: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_m", frozen_array("point_m", self.point_m, (3,)))
        object.__setattr__(self, "direction", frozen_array("direction", self.direction, (3,)))


def plane_frame(first: Array, second: Array, third: Array) -> Array:
    """Return the transform (4, 4) into x'''' y'''' z'''': origin at the first point, the second on x, all three in x y.

    Translation (1), then the turns about z, y (2, 3) and x (4) as corrected: eq. (2) transposed, and sin(alpha) =
    -z'''/rho, cos(alpha) = y'''/rho of the third point. Raises Degenerate for points on one line.
    """
    T = np.eye(4)
    T[:3, 3] = -first
    x, y, z = second - first
    flat, long = float(np.hypot(x, y)), float(np.linalg.norm(second - first))
    c, s = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
    Rz = np.array([[c, s, 0.0, 0.0], [-s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    if long == 0.0:
        raise Degenerate("two of the three points are one", consequence="They span no plane")
    c, s = flat / long, z / long
    Ry = np.array([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0], [0.0, 0.0, 0.0, 1.0]])
    _, y, z = (Ry @ Rz @ T @ np.append(third, 1.0))[:3]
    rho = float(np.hypot(y, z))
    if rho <= 1e-12 * long:
        raise Degenerate("the three points lie on one line", consequence="They span no plane")
    c, s = y / rho, -z / rho
    Rx = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return np.asarray(Rx @ Ry @ Rz @ T)


def circumcentres(xy_m: Array) -> tuple[Array, Array]:
    """Return centres (m, 2) and radii (m,) of the circles through every three of the points (n, 2), lines left out."""
    index = np.array(list(combinations(range(len(xy_m)), 3)))
    p, q, r = (xy_m[index[:, k]] for k in range(3))
    a, b = q - p, r - p
    cross = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    good = np.abs(cross) > 1e-12 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    a, b, cross = a[good], b[good], cross[good]
    aa, bb = (a * a).sum(axis=1), (b * b).sum(axis=1)
    off = np.stack([b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa], axis=1) / cross[:, None]
    return p[good] + off, np.linalg.norm(off, axis=1)


def joint_of_path(xyz_m: ArrayLike) -> PathJoint:
    """Return the joint that moved the beacon through the places (n, 3), in the order of its positive motion.

    The three points that set the plane are the first, the middle and the last: the paper says any. Raises
    NotEnoughData for fewer than three places, Degenerate for a path that ends where it begins.
    """
    P = np.asarray(xyz_m, float)
    if P.ndim != 2 or len(P) < FEWEST:
        raise NotEnoughData(f"a path of {len(P)} places", consequence="No circle is defined", cure="Give three or more")
    n_triples = len(P) * (len(P) - 1) * (len(P) - 2) // 6
    chord = P[-1] - P[0]
    length = float(np.linalg.norm(chord))
    if length == 0.0:
        raise Degenerate("the path ends where it begins", consequence="It has no x axis", cure="Leave one end away")
    direction = chord / length
    off_axis = np.linalg.norm(np.cross(P - P[0], direction), axis=1)
    if off_axis.mean() <= STRAIGHT * length:
        return PathJoint(revolute=False, point_m=P[0], direction=direction, radius_m=0.0, n_used=0, n_triples=n_triples)
    T = plane_frame(P[0], P[-1], P[len(P) // 2])
    local = P @ T[:3, :3].T + T[:3, 3]
    centres, radii = circumcentres(local[:, :2])
    kept = chauvenet(np.column_stack([centres, radii]))
    centre = np.append(centres[kept].mean(axis=0), 0.0)
    turned = np.cross(local[len(P) // 2] - local[0], local[-1] - local[0])[2]
    return PathJoint(
        revolute=True,
        point_m=T[:3, :3].T @ (centre - T[:3, 3]),
        direction=np.sign(turned) * T[2, :3],
        radius_m=float(radii[kept].mean()),
        n_used=int(kept.sum()),
        n_triples=n_triples,
    )
