"""Joints and their parameters in standard (distal) or proximal (Craig) Denavit-Hartenberg convention.

Standard: T_i = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). Craig: T_i = Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d). The
parameters are the same with a, alpha, beta moved by one joint (MATH 4.5); what is left over at the ends goes into
frame 0 or the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import cos, sin
from numbers import Real
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import DH_ROW
from armsight.errors import Inconsistent
from armsight.records import frozen_array, require_kind, require_number
from armsight.records.checks import Shape

if TYPE_CHECKING:
    from armsight.kinematics.arm import Arm


SAME_DIRECTION = 1e-12
"""Share (squared) of an axis along another below which they are square to each other."""

GAIN_RANGE = (0.5, 2.0)
"""The sign carries the joint's scale where one was identified; further from one it is a mistake of units."""


AT_FRAME = (0.0, 0.0, 0.0)
"""The centre of mass of a link that is not known to be elsewhere."""


class JointType(StrEnum):
    """A joint turns about its z axis or slides along it."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joint:
    """One joint and the link behind it.

    Revolute: theta = sign * q + theta_rad. Prismatic: d = sign * q + d_m. beta_rad: Hayati's turn about y, for
    nearly parallel axes. lower, upper: limits of q (rad or m). max_speed (rad/s or m/s) and stall_effort (N m or N)
    where known. sign: +1 or -1, times the joint's scale where one was identified. compliance: how far the joint gives
    way, rad per N m or m per N. driven: False for a joint that only follows others by couplings, and has no reading of
    its own. mass_kg, com_m: of the link behind the joint, its centre of mass (3,) in the frame that `link_frames` has
    for it; 0 where not known.
    """

    name: str
    type: JointType = JointType.REVOLUTE
    a_m: float = 0.0
    alpha_rad: float = 0.0
    d_m: float = 0.0
    theta_rad: float = 0.0
    beta_rad: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    sign: float = 1.0
    max_speed: float | None = None
    stall_effort: float | None = None
    compliance: float = 0.0
    mass_kg: float = 0.0
    com_m: tuple[float, float, float] = AT_FRAME
    driven: bool = True

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "type", JointType(self.type))
        except ValueError:
            raise Inconsistent(
                f"joint {self.name} is of unknown type {str(self.type)!r}",
                consequence="The arm cannot be modelled",
                cure="Use one of: " + ", ".join(JointType),
            ) from None
        require_kind("the name of a joint", self.name, str)
        require_kind(f"driven of joint {self.name}", self.driven, bool)
        for key in (*DH_ROW, "sign"):
            value = getattr(self, key)
            if type(value) is float and math.isfinite(value):  # fits make arms by the thousand
                continue
            if isinstance(value, Real) and not math.isfinite(value):
                raise Inconsistent(f"{key} of joint {self.name} is not finite", consequence="The arm has no geometry")
            require_number(f"{key} of joint {self.name}", value)
        for key in ("lower", "upper"):
            require_kind(f"{key} of joint {self.name}", getattr(self, key), Real, cure="Give a number")
        if not GAIN_RANGE[0] <= abs(self.sign) <= GAIN_RANGE[1]:
            raise Inconsistent(
                f"the sign of joint {self.name} is {self.sign:g}",
                consequence="Its readings cannot be turned into angles",
                cure="Use +1 or -1, times the joint's scale where that was identified",
            )
        if not self.lower < self.upper:
            raise Inconsistent(
                f"the limits of joint {self.name} are swapped or equal: lower {self.lower:g}, upper {self.upper:g}",
                consequence="The joint could not move",
                cure="Give the smaller one as lower; leave both out for a joint without limits",
            )
        self._check_drive()

    def _check_drive(self) -> None:
        """Raise Inconsistent where speed, effort, compliance or mass are none."""
        for key in ("max_speed", "stall_effort"):
            value = getattr(self, key)
            if value is None:
                continue
            require_kind(f"{key} of joint {self.name}", value, Real, cure="Give a number")
            if not (math.isfinite(value) and value > 0.0):
                raise Inconsistent(
                    f"{key} of joint {self.name} is {value:g}, which is not a positive number",
                    consequence="No track can be held against it",
                    cure="Leave it out where it is not known",
                )
        for key in ("compliance", "mass_kg"):
            value = getattr(self, key)
            if type(value) is float and 0.0 <= value < math.inf:
                continue
            require_kind(f"{key} of joint {self.name}", value, Real, cure="Give a number")
            if not (math.isfinite(value) and value >= 0.0):
                raise Inconsistent(
                    f"{key} of joint {self.name} is {value:g}",
                    consequence="How far it gives way under the arm's weight is not known",
                    cure="Give a number from 0 up; 0 where it is not known",
                )
        if self.com_m is not AT_FRAME:  # fits make arms by the thousand
            com_m = frozen_array(f"com_m of joint {self.name}", self.com_m, (3,))
            object.__setattr__(self, "com_m", tuple(com_m.tolist()))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolPoint:
    """A named point of the tool: xyz_m (3,) in flange axes, std_m (3,) of its coordinates, infinite where not known."""

    name: str
    xyz_m: Annotated[Array, Shape((3,))]
    std_m: Annotated[Array, Shape((3,), endless=True)] = field(default_factory=lambda: np.full(3, math.inf))

    def __post_init__(self) -> None:
        if not self.name:
            raise Inconsistent("a point of the tool has no name", cure="Name it, for instance A")
        object.__setattr__(self, "xyz_m", frozen_array(f"the place of tool point {self.name}", self.xyz_m, (3,)))
        std = np.array(self.std_m, dtype=np.float64)
        if std.shape != (3,) or not (std >= 0.0).all():  # also false for NaN
            raise Inconsistent(
                f"the standard deviations of tool point {self.name} are {std.tolist()}",
                cure="Give three of x, y, z in m, none negative",
            )
        std.setflags(write=False)
        object.__setattr__(self, "std_m", std)

    def seen_from(self, T: RigidTransform) -> ToolPoint:
        """Return the point in other axes, T those of the old ones in them; deviations turned as if independent."""
        turn = np.asarray(T.rotation.as_matrix())
        known = np.where(np.isfinite(self.std_m), self.std_m, 0.0)
        std = np.sqrt(turn**2 @ known**2)
        std[(turn**2 @ np.isinf(self.std_m)) > SAME_DIRECTION] = np.inf
        return ToolPoint(name=self.name, xyz_m=np.asarray(T.apply(self.xyz_m)), std_m=std)


# How joints' own values follow a controller's readings: coupled readings, and joints that only follow others.

MOST_SHARE, MOST_FOLLOWED = 2.0, 1e3
"""Largest shares of couplings: of a joint's own reading and another's, and of a joint without a drive (rad per m)."""

FOLLOWED = 1e-3
"""Readings (rad or m) of a joint without a drive that miss what it follows by more are not its own: logs have three
digits and more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """A controller's reading that is not the joint's own: value of joint = its reading + share * reading of by.

    A joint without a drive has no reading to add; by may be one, and its value then takes the place of its reading.
    """

    joint: str
    by: str
    share: float = 1.0


def check_couplings(couplings: Sequence[Coupling], joints: Sequence[Joint]) -> None:
    """Raise Inconsistent where couplings name no joints, or one that does not come before, or are no drive's."""
    names = [joint.name for joint in joints]
    driven = {joint.name: joint.driven for joint in joints}
    for coupling in couplings:
        known = coupling.joint in names and coupling.by in names
        if not known or names.index(coupling.by) >= names.index(coupling.joint):
            raise Inconsistent(
                f"{coupling.joint} is coupled to {coupling.by}, which is no joint before it",
                consequence="Its readings cannot be turned into values",
                cure=f"Name joints in their order from the base: {', '.join(names)}",
            )
        if not abs(coupling.share) <= (MOST_SHARE if driven[coupling.joint] else MOST_FOLLOWED):  # also for NaN
            raise Inconsistent(
                f"{coupling.joint} is coupled to {coupling.by} by {coupling.share:g}",
                consequence="Its readings cannot be turned into values",
                cure="Give a share of about one, in rad per rad",
            )
    followers = {coupling.joint for coupling in couplings}
    for name in names:
        if not driven[name] and name not in followers:
            raise Inconsistent(
                f"joint {name} has no drive, and is coupled to no other joint",
                consequence="Its value is not known",
                cure="Name the joint that it follows under coupled, or leave driven out",
            )


def gearing(joints: Sequence[Joint], couplings: Sequence[Coupling]) -> Array:
    """Return (n, n): how the joints' values follow the controller's readings; zeros for one without a drive's own."""
    index = {joint.name: i for i, joint in enumerate(joints)}
    own = np.eye(len(joints))
    out = np.diag([float(joint.driven) for joint in joints])
    for coupling in sorted(couplings, key=lambda one: index[one.joint]):
        by = index[coupling.by]
        out[index[coupling.joint]] += coupling.share * (own[by] if joints[by].driven else out[by])
    return out


def gearing_back(joints: Sequence[Joint], couplings: Sequence[Coupling]) -> Array:
    """Return (n, n): how readings follow the joints' values; a joint without a drive reads its own value."""
    out = gearing(joints, couplings)
    for i, joint in enumerate(joints):
        if not joint.driven:
            out[i] = np.eye(len(joints))[i]
    return np.asarray(np.linalg.inv(out), dtype=np.float64)


def require_followed(joints: Sequence[Joint], couplings: Sequence[Coupling], readings: Array, values: Array) -> None:
    """Raise Inconsistent where what is given, (n,) or (m, n), for a joint without a drive is neither 0 nor follows."""
    for i, joint in enumerate(joints):
        given, off = readings[..., i], readings[..., i] - values[..., i]
        follows = np.ptp(off) <= FOLLOWED and (off.size > 1 or np.abs(off).max() <= FOLLOWED)
        if joint.driven or follows or np.abs(given).max() <= FOLLOWED:
            continue
        what = ", ".join(f"{one.by} by {one.share:g}" for one in couplings if one.joint == joint.name)
        raise Inconsistent(
            f"joint {joint.name} has no drive and follows {what}, and its readings do not",
            consequence="Where the arm stands cannot be told",
            cure=f"Give 0 for {joint.name}, or the value that it has; where it has a drive, make it driven: true and "
            "leave coupled out in the arm's file",
        )


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
