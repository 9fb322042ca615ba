"""Rotations and lengths as people write them, and whether numbers can be what is said of them.

Rotations: Euler angles with a stated order, rotation vectors, and robot makers' ways. An order names the axes in the
sequence of the angles. `zyx` (or `zyx-rotating`): each turn is about an axis that the turns before have carried along,
R = Rz Ry Rx. `xyz-fixed`: each is about an axis that stands, R = Rz Ry Rx of the angles in the order x, y, z (Craig,
Introduction to Robotics, section 2.8: X-Y-Z fixed angles and Z-Y-X Euler angles). Degrees given for radians, and
millimetres for metres, are noticed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.units import DEG, MM

ROTVEC = "rotvec"
"""Instead of an order: the three numbers are a rotation vector."""
_ORDER = re.compile(r"([xyz]{3})(?:-(fixed|rotating))?", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class EulerOrder:
    """axes: of the three angles in their sequence, such as 'zyx', or ROTVEC; fixed: about standing axes, else carried
    along."""

    axes: str
    fixed: bool = False

    def rotation(self, angles_rad: Array) -> Rotation:
        """Return the rotations of angles (n, 3) in their sequence, rad."""
        if self.axes == ROTVEC:
            return Rotation.from_rotvec(angles_rad)
        return Rotation.from_euler(self.axes if self.fixed else self.axes.upper(), angles_rad)

    def sequence(self, about: Sequence[str]) -> tuple[int, ...]:
        """Return which of three columns is which angle, where about says the axis of each, '' where it is not said."""
        if self.axes == ROTVEC and sorted(about) == ["x", "y", "z"]:
            return tuple(about.index(axis) for axis in "xyz")
        if sorted(about) == sorted(self.axes):
            return tuple(about.index(axis) for axis in self.axes)
        return 0, 1, 2

    def __str__(self) -> str:
        return self.axes if self.axes == ROTVEC else f"{self.axes}-{'fixed' if self.fixed else 'rotating'}"


def euler_order(text: str) -> EulerOrder:
    """Return the order that a word such as 'zyx', 'zyz-rotating' or 'xyz-fixed' names. Raises UsageError."""
    if text.strip().lower() == ROTVEC:
        return EulerOrder(axes=ROTVEC)
    match = _ORDER.fullmatch(text.strip())
    axes = match[1].lower() if match else ""
    if match is None or axes[0] == axes[1] or axes[1] == axes[2]:
        raise UsageError(
            f"{text!r} is no order of Euler angles", cure="Write axes as in xyz-fixed, zyx, zyz-rotating, or rotvec"
        )
    return EulerOrder(axes=axes, fixed=(match[2] or "").lower() == "fixed")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotFormat:
    """How a robot's controller writes poses.

    length_m, angle_rad, joint_rad: its units of positions, of a pose's angles, of joints. angles: the names of its
    columns for the rotation; euler: their order; None for a rotation vector, or for a quaternion of four names
    (scalar first). source: where it is written down.
    """

    length_m: float = MM
    angle_rad: float = DEG
    joint_rad: float = DEG
    angles: tuple[str, ...]
    euler: EulerOrder | None = None
    source: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of a pose, where a table has none."""
        return ("x", "y", "z", *self.angles)


_XYZ_FIXED = EulerOrder(axes="xyz", fixed=True)
_XYZ_ROTATING = EulerOrder(axes="xyz")
_ZYZ = EulerOrder(axes="zyz")
_R = ("rx", "ry", "rz")

ROBOT_FORMATS: Mapping[str, RobotFormat] = {
    "abb": RobotFormat(
        angles=("q1", "q2", "q3", "q4"), source="RAPID reference: pos in mm, orient q1..q4 with q1 the scalar"
    ),
    "comau": RobotFormat(angles=("a", "e", "r"), euler=_ZYZ, source="PDL2: Euler angles about z, y', z''"),
    "fanuc": RobotFormat(angles=("w", "p", "r"), euler=_XYZ_FIXED, source="W, P, R about the fixed x, y, z"),
    "franka": RobotFormat(
        length_m=1.0, angle_rad=1.0, joint_rad=1.0, angles=_R, source="libfranka: O_T_EE column by column, m"
    ),
    "kawasaki": RobotFormat(angles=("o", "a", "t"), euler=_ZYZ, source="AS language: O, A, T about z, y', z''"),
    "kuka": RobotFormat(
        angles=("a", "b", "c"), euler=EulerOrder(axes="zyx"), source="KRL: A about z, B about y', C about x''"
    ),
    "mecademic": RobotFormat(angles=("alpha", "beta", "gamma"), euler=_XYZ_ROTATING, source="about x, y', z''"),
    "staubli": RobotFormat(angles=_R, euler=_XYZ_ROTATING, source="VAL 3: rx, ry, rz about x, y', z''"),
    "techman": RobotFormat(angles=_R, euler=_XYZ_FIXED, source="Rx, Ry, Rz about the fixed x, y, z"),
    "ur": RobotFormat(
        length_m=1.0,
        angle_rad=1.0,
        joint_rad=1.0,
        angles=_R,
        source="URScript: p[x, y, z, rx, ry, rz], rotation vector",
    ),
    "yaskawa": RobotFormat(angles=_R, euler=_XYZ_FIXED, source="Rx, Ry, Rz about the fixed x, y, z"),
}
"""By name. The same products of rotations as in the converters of RoboDK's public Python interface (robomath)."""


def robot_format(name: str) -> RobotFormat:
    """Return a maker's way by its name. Raises UsageError that lists those known."""
    found = ROBOT_FORMATS.get({"motoman": "yaskawa", "universal": "ur"}.get(name.lower(), name.lower()))
    if found is None:
        raise UsageError(f"no robot format is called {name!r}", cure=f"There are {', '.join(ROBOT_FORMATS)}")
    return found


LARGEST_RAD = 7.0
"""Joints and pose angles in radians stay below: a whole turn and a tenth. Those in degrees of an arm that moves at all
go beyond it."""
SMALLEST_DEG = 3.2
"""Where every angle of a table in degrees stays below, it holds radians: no arm is measured within three degrees."""
SMALLEST_SPREAD_RAD = 0.2
"""... but only where they spread by more than this: an arm may stand at zero."""
LARGEST_LIMIT_RAD = 4.0 * math.pi
"""Two turns either way: no revolute joint but an endless one has a wider limit, and degrees are wider with any arm."""
ENDLESS_RAD = 800.0
"""Beyond it a limit is that of an endless joint: in degrees it would be two turns and more."""
WHOLE_TURN = 0.01
"""Share of a turn by which a limit of many turns may miss a whole number of them: 50.3 for 16 pi."""
LARGEST_M = 30.0
"""A position further away is one in millimetres: no arm, rig or tracker's target is so far off."""
SMALLEST_MM = 3.0
"""Where all positions in millimetres lie closer than that to the origin, they are metres."""
FEWEST_ROWS = 5
"""Fewer rows than these say nothing of where an arm stays within."""


def largest(values: ArrayLike) -> float:
    """Return the largest absolute value that is finite, 0 where there is none."""
    array = np.abs(np.asarray(values, float)).ravel()
    array = array[np.isfinite(array)]
    return float(array.max()) if array.size else 0.0


def looks_like_degrees(values_rad: ArrayLike) -> bool:
    """Whether angles that are said to be radians can only be degrees."""
    return largest(values_rad) > LARGEST_RAD


def limits_look_like_degrees(values_rad: ArrayLike) -> bool:
    """Whether limits of revolute joints that are said to be radians are degrees; those that are not finite are none.

    A pair of as many whole turns either way is one of radians: 16 pi, also written as 50.3.
    """
    array = np.abs(np.asarray(values_rad, float)).ravel()
    array = array[np.isfinite(array)]
    turns = array / (2.0 * math.pi)
    if len(array) == 2 and array[0] == array[1] and abs(turns[0] - round(turns[0])) < WHOLE_TURN:
        return False
    return bool(((array > LARGEST_LIMIT_RAD) & (array <= ENDLESS_RAD)).any())


def looks_like_radians(values_deg: ArrayLike) -> bool:
    """Whether angles (n, k) that are said to be degrees are radians: all small, over several rows, and spread."""
    array = np.atleast_2d(np.asarray(values_deg, float))
    if len(array) < FEWEST_ROWS or largest(array) >= SMALLEST_DEG:
        return False
    return bool(np.nanmax(np.ptp(array, axis=0)) > SMALLEST_SPREAD_RAD * 5.0)


def looks_like_mm(xyz_m: ArrayLike) -> bool:
    """Whether positions that are said to be metres can only be millimetres."""
    return largest(xyz_m) > LARGEST_M


def looks_like_m(xyz_mm: ArrayLike) -> bool:
    """Whether positions (n, 3) that are said to be millimetres are metres."""
    array = np.atleast_2d(np.asarray(xyz_mm, float))
    return len(array) >= FEWEST_ROWS and 0.0 < largest(array) < SMALLEST_MM


def degrees_cause(values_rad: ArrayLike) -> str:
    """Return what is wrong with angles that look like degrees, in words."""
    return (
        f"these look like degrees: the largest value is {largest(values_rad):.4g}, and a turn has {2 * math.pi:.3g} rad"
    )
