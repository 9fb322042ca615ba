"""Rotations as people write them: Euler angles with a stated order, rotation vectors, and robot makers' ways.

An order names the axes in the sequence of the angles. `zyx` (or `zyx-rotating`): each turn is about an axis that the
turns before have carried along, R = Rz Ry Rx. `xyz-fixed`: each is about an axis that stands, R = Rz Ry Rx of the
angles in the order x, y, z (Craig, Introduction to Robotics, section 2.8: X-Y-Z fixed angles and Z-Y-X Euler angles).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.units import DEG, MM

_ORDER = re.compile(r"([xyz]{3})(?:-(fixed|rotating))?", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class EulerOrder:
    """axes: of the three angles in their sequence, such as 'zyx'; fixed: about standing axes, else carried along."""

    axes: str
    fixed: bool = False

    def rotation(self, angles_rad: Array) -> Rotation:
        """Return the rotations of angles (n, 3) in their sequence, rad."""
        return Rotation.from_euler(self.axes if self.fixed else self.axes.upper(), angles_rad)

    def sequence(self, about: Sequence[str]) -> tuple[int, ...]:
        """Return which of three columns is which angle, where about says the axis of each, '' where it is not said."""
        if sorted(about) == sorted(self.axes):
            return tuple(about.index(axis) for axis in self.axes)
        return 0, 1, 2

    def __str__(self) -> str:
        return f"{self.axes}-{'fixed' if self.fixed else 'rotating'}"


def euler_order(text: str) -> EulerOrder:
    """Return the order that a word such as 'zyx', 'zyz-rotating' or 'xyz-fixed' names. Raises UsageError."""
    match = _ORDER.fullmatch(text.strip())
    axes = match[1].lower() if match else ""
    if match is None or axes[0] == axes[1] or axes[1] == axes[2]:
        raise UsageError(
            f"{text!r} is no order of Euler angles",
            cure="Write three axes and maybe -fixed or -rotating, for instance xyz-fixed, zyx, zyz-rotating",
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
