"""What a person may set for every link to a controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import RigidTransform

from armsight.defaults import OPEN_S, STALE_S, TOOL_SPEED_M_S, TOOL_SPEED_RAD_S, UDP_CYCLE_S
from armsight.drivers.goals import JointLimits
from armsight.errors import UsageError

USUAL_JOINTS = 6
"""Of an arm whose controller is asked for no number of them."""
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


@runtime_checkable
class ArmOnLink(Protocol):
    """The arm's geometry, given by who opens the robot: the link itself speaks of poses of the flange."""

    def fk(self, q: NDArray[np.float64]) -> RigidTransform:
        """Return T_base_flange of joint values q (6,) in rad or m."""

    def ik(self, T_base_flange: RigidTransform, near: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint values (6,) of a pose, on the branch of near (6,). Raises DataRefused out of reach."""

    def flange(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return T_base_flange (4, 4) of joint values q (n,): what a cycle has no time to make a transform of."""

    def jacobian(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the flange's way and turn (6, n) in base axes by joint values q (n,)."""

    @property
    def ranges(self) -> NDArray[np.float64]:
        """Lower and upper ends (2, n) of its joint values by the arm's file, in rad or m; infinite where open."""


class LinkSettings(BaseModel):
    """Settings that every link has.

    open_s: how long to wait for the controller. max_speed_rad_s, lower_rad, upper_rad: of each joint. arm: its
    geometry, of use where poses are sent, and its ranges, which are compared with the controller's where it tells them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    link: ClassVar[str]
    """What a person calls the link."""

    open_s: Positive = OPEN_S
    max_speed_rad_s: Positive = math.pi / 3
    lower_rad: list[float] | None = None
    upper_rad: list[float] | None = None
    arm: ArmOnLink | None = None

    @classmethod
    def checked(cls, values: Mapping[str, Any] | None) -> Self:
        """Return checked settings. Raises UsageError that names the wrong key."""
        try:
            return cls.model_validate(dict(values or {}))
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "cycle_s"  # what a check of all of them is about
            raise UsageError(
                f"the setting {key!r} of {cls.link} cannot be: {first['msg']}",
                cure=f"Known are: {', '.join(cls.model_fields)}",
            ) from error

    def joint_limits(self, n: int) -> JointLimits:
        """Return the limits of n joints. Raises UsageError where others are given than so many."""
        return JointLimits(
            lower=_each(self.lower_rad, -math.inf, n),
            upper=_each(self.upper_rad, math.inf, n),
            max_speed=np.full(n, self.max_speed_rad_s),
        )


class UdpSettings(LinkSettings):
    """Settings of every link whose controller sends its state over UDP.

    cycle_s: how often the controller sends. stale_s: age of a reading that is stale: two packets in a row may be late,
    and an ordinary system too. controller: the only address that is listened to; empty: the first that speaks. bind:
    the own address to listen at; empty: the one that leads to the controller, and all where that is not given.
    speed_m_s, speed_rad_s: of the flange in pose guidance.
    """

    cycle_s: Positive = UDP_CYCLE_S
    stale_s: Positive = STALE_S
    controller: str = ""
    bind: str = ""
    speed_m_s: Positive = TOOL_SPEED_M_S
    speed_rad_s: Positive = TOOL_SPEED_RAD_S


def _each(values: list[float] | None, otherwise: float, n: int) -> NDArray[np.float64]:
    if values is None:
        return np.full(n, otherwise)
    if len(values) != n:
        raise UsageError(f"{len(values)} joint limits are given for {n} joints", cure=f"Give {n}")
    return np.array(values, dtype=float)
