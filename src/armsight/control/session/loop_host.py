"""What a robot server, and a console in its process, need of the loop that moves the robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from threading import RLock
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, cast

from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.session.channels import LineChannels
from armsight.control.setpoints import SetPoint
from armsight.control.status import RobotStatus
from armsight.drivers.remote.protocol import RobotDescription
from armsight.kinematics import Arm
from armsight.records import JointReading


class HasLock(Protocol):
    """An object with a lock of its own, or one that it shares with others."""

    lock: RLock


Params = ParamSpec("Params")
Result = TypeVar("Result")
Owner = TypeVar("Owner", bound=HasLock)


def synchronized(method: Callable[Concatenate[Owner, Params], Result]) -> Callable[Concatenate[Owner, Params], Result]:
    """Return the method, which waits until no other thread is in one under the same lock."""

    @wraps(method)
    def locked(self: Owner, *args: Params.args, **kwargs: Params.kwargs) -> Result:
        with self.lock:
            return method(self, *args, **kwargs)

    return cast(Callable[Concatenate[Owner, Params], Result], locked)


SETPOINT_S = 0.25
"""A velocity holds so long, in s; a goal holds until it is reached."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopEvent:
    """Something that the loop did or met; level: info, warning or error."""

    t_s: float
    level: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopCommand:
    """What the loop sent to the robot: joints or pose, and its values."""

    t_s: float
    kind: str
    values: dict[str, Any]


LoopRecord = LoopEvent | LoopCommand | JointReading


class LoopHost(Protocol):
    """A robot's loop with its guard, wherever it runs. No method waits for the loop.

    Motion needs beat(enable=True), sent no longer ago than enable_age_s; without it the loop holds the robot by itself.
    """

    @property
    def enable_age_s(self) -> float:
        """How old an enable or a set point may be."""

    @property
    def description(self) -> RobotDescription:
        """What robot it is."""

    @property
    def arm(self) -> Arm | None:
        """The arm's model; None where there is none, and then poses cannot be taken."""

    def now_s(self) -> float:
        """Return the time on the loop's clock."""

    def status(self) -> RobotStatus:
        """Return the loop's newest cycle. Raises DeviceLost where the loop has ended."""

    def lateness_p99_s(self) -> float:
        """Return by how much at most 99 % of the cycles began too late."""

    @property
    def line(self) -> LineChannels:
        """What the line for stops shares with the loop and with the server."""

    def grant(self, lease: int, key: str, person: str = "") -> None:
        """Let the line for stops take the enables of lease number lease from a person, by its key; an empty key: of
        nobody."""

    def post(self, setpoint: SetPoint, *, age_s: float = 0.0) -> None:
        """Replace what is asked of the robot, sent age_s ago. Raises DeviceLost where the loop does not take it."""

    def beat(self, *, enable: bool, age_s: float = 0.0, lease: int = 0, number: int | None = None) -> None:
        """Tell the loop that a driver was alive age_s ago, and whether motion was allowed then. Raises DeviceLost.

        number: of the enable, which grows; one that another way has overtaken does not count.
        """

    def release(self, why: str, *, lease: int = 0) -> None:
        """Hold at once and forget what was asked and enabled: the driver is gone, and this lease. Never raises."""

    def stop(self, why: str) -> None:
        """Come to rest and take nothing until reset. Never raises."""

    def reset(self) -> None:
        """Take set points again after a stop. Raises DeviceLost."""

    def records(self) -> list[LoopRecord]:
        """Return what the loop did since this was last asked, the oldest first. Never raises."""


def flange_pose(arm: Arm | None, q: Array) -> RigidTransform | None:
    """Return T_base_flange at the controller's readings q (n,) by the arm's model; None without one."""
    if arm is None:
        return None
    T_world_tool = RigidTransform.from_matrix(arm.fk(arm.values(q)))
    return arm.T_world_base.inv() * T_world_tool * arm.T_flange_tool.inv()
