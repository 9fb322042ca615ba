"""One joint of an arm and the link behind it, and how its reading may hang on another's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from numbers import Real

from armsight.errors import Inconsistent
from armsight.records import frozen_array, require_kind, require_number

GAIN_RANGE = (0.5, 2.0)
"""The sign carries the joint's scale where one was identified; further from one it is a mistake of units."""


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
    way, rad per N m or m per N. mass_kg, com_m: of the link behind the joint, its centre of mass (3,) in the frame that
    `link_frames` has for it; 0 where not known.
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
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

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
        for key in ("a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad", "sign"):
            value = getattr(self, key)
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
            require_kind(f"{key} of joint {self.name}", value, Real, cure="Give a number")
            if not (math.isfinite(value) and value >= 0.0):
                raise Inconsistent(
                    f"{key} of joint {self.name} is {value:g}",
                    consequence="How far it gives way under the arm's weight is not known",
                    cure="Give a number from 0 up; 0 where it is not known",
                )
        com_m = frozen_array(f"com_m of joint {self.name}", self.com_m, (3,))
        object.__setattr__(self, "com_m", tuple(com_m.tolist()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """A controller's reading that is not the joint's own: value of joint = its reading + share * reading of by."""

    joint: str
    by: str
    share: float = 1.0
