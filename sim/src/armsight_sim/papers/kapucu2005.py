"""Kapucu and Baysec 2005: the beacon's centroid and place, a joint from its path, and the arm's table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.arrays import Array
from armsight.errors import Degenerate, NotEnoughData
from armsight.fitting.quantiles import chauvenet
from armsight.kinematics.axes import Link, link_to_line
from armsight.optics import Rig
from armsight.records import frozen_array

WINDOW_PX = 90
"""Side of the window that is searched pixel by pixel (paper, section 2.2)."""

REDDER_BY = 60
"""Levels by which red exceeds green and blue in the beacon's colour; the paper does not print its definition."""

COARSEST_PX = 64
"""First spacing of the pixels that are tried; it is halved until one of the beacon's colour is met."""


def is_red(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels of an image (rows, columns, 3), blue first, have the beacon's colour."""
    levels = image.astype(np.int16)
    return np.asarray(levels[..., 2] - np.maximum(levels[..., 0], levels[..., 1]) > REDDER_BY)


def beacon_centroid(image: NDArray[np.uint8]) -> Array:
    """Return the mean place (2,) in px, u then v, of the red pixels in the window about the first one met.

    Raises NotEnoughData where no pixel is red.
    """
    red = is_red(image)
    row, column = _first_met(red)
    half = WINDOW_PX // 2
    top, left = max(row - half, 0), max(column - half, 0)
    rows, columns = np.nonzero(red[top : row + half, left : column + half])
    return np.array([left + columns.mean(), top + rows.mean()])


def _first_met(red: NDArray[np.bool_]) -> tuple[int, int]:
    spacing = COARSEST_PX
    while spacing >= 1:
        rows, columns = np.nonzero(red[::spacing, ::spacing])
        if len(rows):
            return int(rows[0]) * spacing, int(columns[0]) * spacing
        spacing //= 2
    raise NotEnoughData(
        "no pixel of the image is red",
        consequence="The beacon has no place in it",
        cure="Look at the frames: the beacon must shine red in both views",
    )


TO_CAMERA = np.diag([1.0, -1.0, 1.0])
"""From x right, y down, z forward to the paper's axes, and back."""


def camera_places(rig: Rig, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return places (n, 3) in m in the paper's camera frame from pixels (n, 2) of identical parallel cameras.

    The heights that the two images give are averaged. Raises Degenerate where a disparity is not positive.
    """
    left, right = np.atleast_2d(left_px).astype(float), np.atleast_2d(right_px).astype(float)
    fu, fv, ru, rv = rig.right.intrinsics[:4]
    lu, lv = rig.left.intrinsics[2:4]
    baseline_m = float(np.linalg.norm(rig.T_rig_right.translation - rig.T_rig_left.translation))
    x_left, x_right = left[:, 0] - lu, right[:, 0] - ru
    disparity = x_left - x_right
    if (disparity <= 0.0).any():
        raise Degenerate("the disparity of a pair is not positive", consequence="Its rays do not meet before the rig")
    Z = fu * baseline_m / disparity
    Y = -0.5 * ((left[:, 1] - lv) + (right[:, 1] - rv)) * Z / fv
    return np.stack([x_right * Z / fu, Y, Z], axis=1)


def to_world(rig: Rig, T_world_rig: Array, places_m: Array) -> Array:
    """Return places (n, 3) of the paper's camera frame in world; T_world_rig: (4, 4)."""
    in_rig = places_m @ TO_CAMERA + rig.T_rig_right.translation
    return np.asarray(in_rig @ T_world_rig[:3, :3].T + T_world_rig[:3, 3])


def from_world(rig: Rig, T_world_rig: Array, world_m: Array) -> Array:
    """Return places (n, 3) of the world in the paper's camera frame; T_world_rig: (4, 4)."""
    in_rig = (world_m - T_world_rig[:3, 3]) @ T_world_rig[:3, :3]
    return np.asarray((in_rig - rig.T_rig_right.translation) @ TO_CAMERA)


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
