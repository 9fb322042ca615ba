"""A robot's joints: one moved by a given way or by hand, a motion run, and the link to it tested.

Nothing moves unasked: `confirm` is True, or a function that is given the motion in words and says whether it may begin.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.file_names import FRAMES, MOTION_RECORDING, MOVED
from armsight.ops.action import action
from armsight.ops.flags import KNOWN_ARM, Cameras
from armsight.ops.kinds import ArmLike, AsFile, CamerasLike, Confirm, GuardLimits, RobotLike
from armsight.ops.motion import Folder
from armsight.ops.requests.motion import A_WAY, HOW_FAR, JOINT, LIVE_SRC, SHARE, UP_TO_1, Override, RsiConfig, Speed
from armsight.ops.requests.motion import RobotSettings as Settings

if TYPE_CHECKING:
    from armsight.control.play.path_source import JointMotionSource
    from armsight.drivers.jog_inputs import JogInput
    from armsight.ops.robot.jog import JogOutput
    from armsight.ops.robot.link_test import RobotTestOutput
    from armsight.ops.robot.run_motion import RunMotionOutput
    from armsight.records import Progress

__all__ = ["check_robot", "jog"]


@action(
    "robot test",
    working="reading",
    examples=("--robot rsi:49152 --for 60", "--robot feetech:/dev/ttyACM0 --for 300 --record joints.csv"),
)
def check_robot(
    robot: RobotLike,
    *,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    for_s: Annotated[
        float, Doc("How many seconds to read it."), Bounds(above=0.0, most=1e5), Flag("--for", metavar="S")
    ] = 5.0,
    record: Annotated[
        Path | None, Doc("A joints.csv for the readings, such as of an arm led by hand."), Flag(metavar="FILE.csv")
    ] = None,
    progress: Progress | None = None,
) -> RobotTestOutput:
    """Read a robot once a cycle and tell how punctual that is. Nothing moves.

    Parameters
    ----------
    robot, robot_settings, rsi_config
        As `servo` takes them.
    record
        A joints.csv for the readings, by the link's clock from the first one on; also where Ctrl-C ends it.

    Raises
    ------
    UsageError, DeviceNotFound, DeviceLost, StaleData, DeviceFailed, Cancelled

    Examples
    --------
    >>> armsight.check_robot("sim:webcam-cell", for_s=0.1).state
    'ready'
    """
    from armsight.ops.robot.link_test import test_robot
    from armsight.ops.robot.opening import clocked_robot
    from armsight.records import Silent

    return test_robot(robot.robot.partition(":")[0], clocked_robot(robot), for_s, progress or Silent(), record)


@action(
    "robot jog",
    working="moving",
    examples=(
        "--robot sim:webcam-cell --joint 1 --by 0.02",
        "--robot rsi:49152 --arm arm.yaml --with gamepad --frame tool",
    ),
)
def jog(
    robot: RobotLike,
    joint: Annotated[int | None, JOINT] = None,
    by: Annotated[float | None, HOW_FAR, A_WAY] = None,
    *,
    confirm: Confirm = False,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    hand: Annotated[
        str | None,
        Doc("Move by hand, while a key or the enable is held."),
        Flag("--with", metavar="keyboard|gamepad"),
    ] = None,
    frame: Annotated[
        Literal["joints", "base", "tool"],
        Doc("Of --with: what moves, and along which axes."),
        Flag(metavar="joints|base|tool", read=str),
    ] = "joints",
    speed: Annotated[float, SHARE, UP_TO_1, Flag(metavar="SHARE")] = 0.5,
    arm: Annotated[ArmLike, Doc(f"{KNOWN_ARM}; without it only joints are limited, and slow.")] = None,
    limits: GuardLimits = None,
    record: Annotated[Path | None, Doc("An .mcap file for commands, readings and events.")] = None,
    inputs: Callable[[str, int], AbstractContextManager[JogInput]] | None = None,
    progress: Progress | None = None,
) -> JogOutput:
    """Move one joint by a given way (--joint, --by), or the arm by hand (--with), through the guard.

    Ctrl-C brings it to rest.

    Parameters
    ----------
    robot, confirm, arm, limits, speed, robot_settings, rsi_config
        As `servo` takes them.
    joint, by
        Which joint, from 1, and how far, rad or m.
    hand, frame
        In their place 'keyboard' or 'gamepad[:DEVICE]', and what it moves: joints, or the tool in base or tool axes.
    inputs
        In place of the device that hand names: opens one by its name and the number of axes.
    record
        An .mcap file for commands and readings.

    Raises
    ------
    Cancelled
        Not confirmed, or let go of.
    UsageError, Inconsistent, DeviceNotFound, DeviceFailed
        A way beyond a limit; robot, guard or gamepad stopped it.

    Examples
    --------
    >>> armsight.jog("sim:webcam-cell", 1, 0.01, confirm=True).state
    'ready'
    """
    from armsight.drivers.jog_inputs import open_jog_input
    from armsight.ops.robot.jog import jog_by_hand, jog_joint
    from armsight.ops.robot.robot_run import RobotRun

    by_hand = hand is not None and joint is None and by is None
    if not by_hand and (hand is not None or joint is None or by is None):
        raise UsageError(
            "it is not clear what is to move",
            consequence="Nothing is moved",
            cure="Give --joint and --by for one way, or --with keyboard or gamepad alone",
        )
    run = RobotRun(robot, arm, progress, confirm=confirm, recording=record, limits=limits, speed=speed)
    if hand is not None:
        return jog_by_hand(run, hand, frame, inputs or open_jog_input)
    return jog_joint(run, joint or 0, by or 0.0)


@action(
    "robot run",
    keeps=MOVED,
    working="moving",
    examples=(
        "--robot sim:webcam-cell --motion motion.csv -o moved",
        "--robot rtde:192.168.0.10 --arm ur5e --motion motion.csv --left camera:0 --right camera:2 -o moved",
    ),
)
def run_motion(
    robot: RobotLike,
    motion: Annotated[AsFile, Doc("joints.csv of the motion: t_s,q1,...,qn."), Flag(metavar="MOTION.csv")],
    *,
    confirm: Confirm = False,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    out: Folder = None,
    arm: Annotated[ArmLike, Doc(f"{KNOWN_ARM}; needed unless the robot tells it.")] = None,
    limits: GuardLimits = None,
    override: Override = 1.0,
    speed: Speed = 1.0,
    left: Annotated[str | None, Doc("Left camera, camera:NAME, recorded meanwhile: frames.mcap."), LIVE_SRC] = None,
    right: Annotated[str | None, Doc("Right camera; both, or none."), LIVE_SRC] = None,
    cameras: CamerasLike = None,
    camera_settings: Cameras | None = None,
    begun: Callable[[JointMotionSource], object] = lambda _: None,
    enabled: Callable[[], bool] = lambda: True,
    progress: Progress | None = None,
) -> RunMotionOutput:
    """Run a motion of the joints through the guard, and record the readings. Ctrl-C brings the arm to rest.

    The whole motion is checked first: ranges of the joints, boxes of tool and flange. The cameras are recorded beside
    it, from before it until after it: one that fails or falls silent brings the arm to rest.

    Parameters
    ----------
    robot, confirm, arm, limits, speed, robot_settings, rsi_config
        As `servo` takes them.
    motion
        The motion (t_s, q), or joints.csv; the arm goes to its first reading, then along it.
    override, begun, enabled
        As `play` takes them.
    left, right, cameras, camera_settings
        Cameras that are recorded meanwhile.
    out
        A folder for motion.json, the recordings and the readings.

    Raises
    ------
    Cancelled
        Not confirmed.
    UsageError, DataRefused, DeviceFailed
        A motion beyond a limit; nothing was moved, or the arm was brought to rest.
    """
    from armsight.ops.robot.recorder import require_new
    from armsight.ops.robot.robot_run import RobotRun
    from armsight.ops.robot.run_motion import checked_motion, recorded_cameras, run_joints
    from armsight.ops.sources.cameras import named_cameras
    from armsight.store.tracks import read_joints

    recorded = recorded_cameras(named_cameras(cameras or {}, left, right), camera_settings, out)
    record = None if out is None else require_new(out, MOTION_RECORDING, FRAMES)
    run = RobotRun(robot, arm, progress, confirm=confirm, recording=record, limits=limits, speed=speed)
    wanted = checked_motion(read_joints(motion), run.guard, str(motion))
    return run_joints(run, wanted, recorded, override=override, begun=begun, enabled=enabled)
