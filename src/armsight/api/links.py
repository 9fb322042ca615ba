"""Links to robots: tested, moved joint by joint; and emulated controllers to try it on.

Nothing moves unasked: `confirm` is True, or a function that is given the motion in words and says whether it may begin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

from armsight.app.requests.motion import JogJob, RobotTestJob, TwinJob
from armsight.app.robot.jog import JogOutput, jog_robot
from armsight.app.robot.link_test import RobotTestOutput, test_robot
from armsight.app.robot.twin import twin_beside
from armsight.control.guard import Limits
from armsight.drivers import Robot, RobotState
from armsight.errors import ArmsightError, UsageError
from armsight.ops.checks import speaks_python
from armsight.ops.commands import in_python
from armsight.ops.given import (
    ArmLike,
    Given,
    PathText,
    as_text,
)
from armsight.records import Progress, require_count, require_kind

Confirm = bool | Callable[[str], bool]
"""Whether the arm may move: True, or what is asked with the motion in words."""
RobotLike = str | Robot
"""DRIVER:DEVICE, such as sim:webcam-cell or rtde:192.168.0.10; or a driver of one's own that keeps drivers.Robot."""

Settings = Mapping[str, Any]
"""Of a robot's driver, by name: {"controller": "192.168.0.10", "cycle_s": 0.012}; the driver's page has them all."""

ROBOT_MEMBERS = ("__enter__", "__exit__", *(name for name in vars(Robot) if not name.startswith("_")))
"""What a driver of one's own has to have."""


@speaks_python(JogJob)
def jog(
    robot: RobotLike,
    joint: int,
    by: float,
    *,
    confirm: Confirm = False,
    speed: float = JogJob.speed,
    arm: ArmLike | None = None,
    limits: Limits | PathText | None = None,
    record: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> JogOutput:
    """Move one joint (from 1) by so much, in rad or m, through the guard; return what was sent and reached.

    robot, confirm, arm, limits, speed, robot_settings, rsi_config: as `servo` takes them. record: an .mcap file for
    commands and readings. Raises Cancelled where it is not confirmed, UsageError, Inconsistent for a way beyond a
    limit, DeviceFailed.

    Examples
    --------
    >>> armsight.jog("sim:webcam-cell", 1, 0.01, confirm=True).state
    'ready'
    """
    require_count("joint", joint, least=1)
    with Given() as given:
        job = given.job(JogJob, locals(), robot=name_of(robot, robot_settings, rsi_config))
        return jog_robot(job, as_question(confirm), progress, opened=None if isinstance(robot, str) else robot)


@speaks_python(RobotTestJob)
def check_robot(
    robot: RobotLike,
    *,
    for_s: float = RobotTestJob.for_s,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> RobotTestOutput:
    """Read a robot once a cycle for a time, and return how punctual that is; nothing moves.

    robot, robot_settings, rsi_config: as `servo` takes them. Raises UsageError, DeviceNotFound, DeviceLost, StaleData,
    DeviceFailed.

    Examples
    --------
    >>> armsight.check_robot("sim:webcam-cell", for_s=0.1).state
    'ready'
    """
    with Given() as given:
        job = given.job(RobotTestJob, locals(), robot=name_of(robot, robot_settings, rsi_config))
        return test_robot(job, progress, opened=None if isinstance(robot, str) else robot)


@speaks_python(TwinJob)
@contextmanager
def twin(
    name: Literal["alter", "rsi", "egm", "rtde"],
    *,
    port: str | None = None,
    connect: str | None = None,
    arm: ArmLike | None = None,
    cycle_s: float | None = None,
) -> Iterator[str]:
    """Run an emulated controller in a process of its own while the block runs; gives what opens it, DRIVER:DEVICE.

    port: where it listens. connect: HOST:PORT where the driver listens, for rsi and egm. arm: which it has. cycle_s: of
    the controller. Raises UsageError, DeviceNotFound with the twins there are, DeviceFailed.

    Examples
    --------
    >>> with armsight.twin("alter") as robot:
    ...     robot.partition(":")[0]
    'alter'
    """
    for text, value in (("name", name), ("port", port or ""), ("connect", connect or "")):
        require_kind(text, value, str)
    with Given() as given:
        model = None if arm is None else given.arm("arm", arm)
        try:
            with twin_beside(name, port=port, connect=connect, arm=model, cycle_s=cycle_s) as address:
                yield address
        except ArmsightError as error:
            in_python(error)
            raise


def as_question(confirm: Confirm) -> Callable[[str], bool]:
    """Return what is asked before motion. Raises UsageError for what is neither truth nor function."""
    if callable(confirm):
        return confirm
    require_kind("confirm", confirm, bool, cure="Give True, or a function of the question")
    return lambda _: confirm


def name_of(robot: RobotLike, *told: object) -> str:
    """Return DRIVER:DEVICE, or the name of a driver of one's own.

    told: settings for the driver, None where there are none. Raises UsageError where a driver of one's own is not
    complete, or told something: it was made with its settings.
    """
    if isinstance(robot, str) or not hasattr(robot, "step_joints"):
        return as_text("robot", robot)
    lacking = [name for name in ROBOT_MEMBERS if not hasattr(robot, name)]
    if isinstance(robot, type):
        what = "is a class: it has to be called first"
    elif lacking:
        what = f"has no {', '.join(lacking)}"
    elif not isinstance(robot.state, RobotState):
        what = f"has the state {robot.state!r}, which is no RobotState"
    elif any(one is not None for one in told):
        raise UsageError(
            f"robot_settings and rsi_config are for robots that are named DRIVER:DEVICE, and {robot.name} is an object",
            consequence="They would not be used, and nothing is opened",
            cure="Make the object with its settings",
        )
    else:
        return robot.name
    raise UsageError(
        f"the robot {getattr(robot, 'name', type(robot).__name__)!r} {what}",
        consequence="It cannot be driven",
        cure="Give an object with all that help(armsight.Robot) lists; its state is such as RobotState.READY",
    )
