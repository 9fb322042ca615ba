"""What moves a robot's tool: a target is followed, a path is run.

Nothing moves unasked: `confirm` is True, or a function that is given the motion in words and says whether it may begin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.defaults import APPROACH_SPEED_M_S, BLEND_M, HAND_SPEED_M_S, PATH_SPEED_M_S, RETRACT_M
from armsight.fields import Bounds, Doc, Flag
from armsight.file_names import FOLLOWED, PLAY_RECORDING, PLAYED, SERVO_RECORDING
from armsight.ops.action import Input, action
from armsight.ops.flags import KNOWN_ARM
from armsight.ops.kinds import (
    READERS,
    ROBOT_READERS,
    AnyRigLike,
    ArmLike,
    AsFile,
    CamerasLike,
    Confirm,
    GuardLimits,
    RobotLike,
    TargetLike,
    ToolTip,
)
from armsight.ops.requests.motion import (
    A_GAIN,
    A_LAG,
    ABOVE_0,
    ARM,
    CAMERAS,
    LATENCY_S,
    SIMULATED,
    STOP_M,
    WAY,
    Exposure,
    FollowedCell,
    HandSpeed,
    Latency,
    LiveImage,
    LiveLeft,
    LiveRight,
    MirrorImage,
    Override,
    RsiConfig,
    Seconds,
    Speed,
    negated,
)
from armsight.ops.requests.motion import RobotSettings as Settings
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.control.play import PathSource
    from armsight.control.status import RobotStatus
    from armsight.ops.play.play_job import Watcher
    from armsight.ops.play.play_path import PlayOutput
    from armsight.ops.robot.opening import ClockedRobot
    from armsight.ops.servo.run_servo import ServoOutput
    from armsight.ops.servo.vision import Beside
    from armsight.records import Progress

__all__ = ["play", "servo"]

Folder: TypeAlias = Annotated[
    Path | None, Doc("Where the results go."), Flag("-o --out", metavar="FOLDER", needed=True)
]

MOVED_ARM = (Input(f"{READERS}:arm", kind=str), Flag(metavar="ARM", panel=ARM))
"""An Arm, the path of an arm.yaml or URDF, or a known arm's name, of the robot that moves."""
DISTANCE_M = 0.6
"""From the camera or the tool to the target that is followed."""


@action(
    "servo",
    keeps=FOLLOWED,
    working="servo",
    examples=(
        "--robot sim:pachidis2005-static --rig rig.yaml --target target.yaml --handeye handeye.yaml --hand "
        "circle -o servo",
        "--robot rsi:49152 --arm arm.yaml --left camera:0 --right camera:1 --rig rig.yaml --target target.yaml "
        "--handeye handeye.yaml --distance 0.6 -o servo",
    ),
)
def servo(
    robot: RobotLike,
    rig: Annotated[AnyRigLike, Doc("rig.yaml of the cameras.")],
    target: Annotated[TargetLike, Doc("target.yaml of the lights that are followed.")],
    handeye: Annotated[AsFile, Doc("handeye.yaml: where the cameras are, on the flange or on the base.")],
    *,
    confirm: Confirm = False,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    out: Folder = None,
    distance_m: Annotated[
        float, Doc("How far along that axis the target is wanted."), Bounds(least=0.0), Flag(quantity="m")
    ] = DISTANCE_M,
    at: Annotated[
        Literal["camera", "tool"], Doc("Whose axis the target is wanted on: camera or tool."), Flag(read=str)
    ] = "camera",
    gain: Annotated[
        float | None, Doc("Gain in 1/s. [default: the largest without overshoot at the measured delay]"), A_GAIN
    ] = None,
    rotation: Annotated[
        Literal["align", "keep", "hold"],
        Doc(
            "align: turn until the target's axes are those of --at. keep: as the target first stood to it. "
            "hold: do not turn."
        ),
        Flag(metavar="align|keep|hold", read=str),
    ] = "align",
    predict: Annotated[
        bool,
        Doc("The law alone, which lags behind by speed over gain."),
        Flag("--no-prediction", default=False, read=negated),
    ] = True,
    seconds_s: Seconds = None,
    left: LiveLeft = None,
    right: LiveRight = None,
    cameras: CamerasLike = None,
    image: LiveImage = None,
    latency_s: Latency = LATENCY_S,
    exposure_s: Exposure = None,
    arm: Annotated[Any, Doc(f"{KNOWN_ARM}; needed unless the robot tells it."), *MOVED_ARM] = None,
    limits: Annotated[GuardLimits, Flag(panel=ARM)] = None,
    speed: Speed = 1.0,
    arm_lag_s: Annotated[
        float | None, Doc("From a command to the arm's motion, s. [default: two cycles]"), A_LAG, Flag(panel=ARM)
    ] = None,
    resume_m: Annotated[
        float,
        Doc("A target that jumped is followed again by itself so near to where it would be."),
        Bounds(least=0.0, most=0.5),
        Flag(unit=MM),
    ] = 20.0 * MM,
    resume_rad: Annotated[
        float, Doc("The same for its rotation."), Bounds(least=0.0, most=30.0 * DEG), Flag(unit=DEG)
    ] = 3.0 * DEG,
    hand: Annotated[
        Literal["still", "circle", "trapezium", "random"] | None,
        Doc("How the target is led: still, circle, trapezium or random. [default: as the scenario has it]"),
        Flag(read=str, panel=SIMULATED),
    ] = None,
    hand_speed_m_s: HandSpeed = HAND_SPEED_M_S,
    follow: FollowedCell = None,
    show: Callable[[RobotStatus, float | None], object] = lambda *_: None,
    beside: Beside | None = None,
    progress: Progress | None = None,
) -> ServoOutput:
    """Follow a target that the cameras see, through the guard. Ctrl-C brings the arm to rest.

    Parameters
    ----------
    robot
        DRIVER:DEVICE, or a driver of one's own. A simulated cell brings its cameras.
    handeye
        Where the cameras are: the result of calibrate_hand_eye, or handeye.yaml.
    confirm
        True, or a function that is told the motion and returns whether it may begin.
    distance_m, at
        Where the target is wanted: so far along the camera's or the tool's z axis.
    gain
        1/s; None: the largest without overshoot at the measured delay.
    rotation
        How the arm turns after the target.
    predict
        Go for where the target will be.
    robot_settings, rsi_config
        Of the robot's driver, by name, as its page has them; of rsi: the RSI Ethernet configuration.
    seconds_s
        End after so long; else progress ends it: its cancelled() is the operator's enable, let go of.
    left, right, cameras, image
        Live cameras, 'camera:NAME'.
    arm, limits, speed
        The arm where the robot does not tell it, what the guard keeps, and the share of its speeds.
    hand, hand_speed_m_s
        How the target of a simulated cell is led.
    follow
        A scenario, by name or file, whose simulated cameras watch the joints that the robot tells.
    show
        Is told now and then of a cycle's status, and of the error of position in m where the target is followed.
    beside
        Is told of each frame meanwhile, see app.servo.vision.Beside.
    out
        A folder for servo.json and the recording.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        Another arm's file, no hand-eye calibration, a gain that is not stable; nothing was moved, or the arm was
        brought to rest.
    """
    from armsight.control.servo import Mount, ServoSettings, on_axis
    from armsight.ops.measurement.warm_up import prepare
    from armsight.ops.robot.recorder import require_new
    from armsight.ops.robot.robot_run import RobotRun
    from armsight.ops.servo.cameras import CameraNames
    from armsight.ops.servo.run_servo import LAG_CYCLES, follow_target, require_axis, turning
    from armsight.ops.servo.vision import measuring, open_servo, placed_cameras

    record = None if out is None else require_new(out, SERVO_RECORDING)
    placed, turns = placed_cameras(handeye), turning(rotation)
    require_axis(at, placed, handeye)
    eyes = CameraNames.of(cameras, left, right, image, exposure_s, latency_s)
    device = open_servo(robot, rig, target, arm, eyes, hand=hand, hand_speed_m_s=hand_speed_m_s)
    run = RobotRun(robot, arm, progress, confirm=confirm, recording=record, limits=limits, speed=speed, device=device)
    run.require_lengths("Where its cameras are is not known, and nothing is moved")
    settings = ServoSettings(
        mount=Mount(placed.setup.value),
        T_parent_camera=placed.T_parent_camera,
        T_flange_desired=on_axis(placed.T_parent_camera if at == "camera" else run.guard.arm.T_flange_tool, distance_m),
        gain_t=0.0,
        gain_r=0.0,
        arm_lag_s=LAG_CYCLES * device.robot.cycle_s if arm_lag_s is None else arm_lag_s,
        predict=predict,
        turning=turns,
        resume_m=resume_m,
        resume_rad=resume_rad,
    )
    setup = measuring(rig, target, device)
    prepare(run.progress)
    for_s = math.inf if seconds_s is None else seconds_s
    return follow_target(run, device, setup, settings, gain, for_s, show, beside)


@action(
    "play",
    keeps=PLAYED,
    working="playing",
    examples=(
        "--robot sim:webcam-cell --path taught/path.csv -o played",
        "--robot rsi:49152 --arm arm.yaml --tip tip.yaml --path taught/path.csv --weave sine:0.002:0.008 -o played",
    ),
)
def play(
    robot: RobotLike,
    path: Annotated[Any, Doc("path.csv of the tip."), Input(f"{ROBOT_READERS}:taught")],
    *,
    confirm: Confirm = False,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    out: Folder = None,
    arm: Annotated[ArmLike, Doc(f"{KNOWN_ARM}, calibrated; needed unless the robot tells it.")] = None,
    tip: ToolTip = None,
    limits: GuardLimits = None,
    override: Override = 1.0,
    weave: Annotated[
        str, Doc("none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH, m."), Flag(panel=WAY)
    ] = "none",
    path_speed_m_s: Annotated[
        float, Doc("Speed along the path where it says none."), ABOVE_0, Flag(quantity="m/s", panel=WAY)
    ] = PATH_SPEED_M_S,
    blend_m: Annotated[
        float, Doc("Length over which corners are rounded."), ABOVE_0, Flag(quantity="m", panel=WAY)
    ] = BLEND_M,
    approach_speed_m_s: Annotated[
        float, Doc("Speed of the way to the path's start."), ABOVE_0, Flag(quantity="m/s", panel=WAY)
    ] = APPROACH_SPEED_M_S,
    retract_m: Annotated[
        float,
        Doc("The start is neared from so far before it along the tool's axis."),
        Bounds(least=0.0),
        Flag(quantity="m", panel=WAY),
    ] = RETRACT_M,
    keep_rotation: Annotated[bool, Doc("The tool keeps the rotation it has."), Flag(panel=WAY)] = False,
    frame: Annotated[
        Literal["world", "base"], Doc("Frame of the path: world or base."), Flag(read=str, panel=WAY)
    ] = "world",
    speed: Speed = 1.0,
    rig: Annotated[AnyRigLike, Doc("rig.yaml of cameras that watch."), Flag(panel=CAMERAS)] = None,
    target: Annotated[TargetLike, Doc("target.yaml they see."), Flag(panel=CAMERAS)] = None,
    handeye: Annotated[AsFile, Doc("handeye.yaml of them."), Flag(panel=CAMERAS)] = None,
    left: LiveLeft = None,
    right: LiveRight = None,
    cameras: CamerasLike = None,
    image: MirrorImage = None,
    latency_s: Latency = LATENCY_S,
    exposure_s: Exposure = None,
    stop_m: Annotated[
        float,
        Doc("Stop where the tip is seen so far from where it was told."),
        Flag("--stop-at", quantity="m", panel=CAMERAS),
    ] = STOP_M,
    follow: FollowedCell = None,
    show: Callable[..., object] = lambda *_: None,
    begun: Callable[[PathSource], object] = lambda _: None,
    enabled: Callable[[], bool] = lambda: True,
    progress: Progress | None = None,
) -> PlayOutput:
    """Run a path with the tip of the tool, through the guard. Ctrl-C brings the arm to rest.

    The whole way is checked first; before anything moves it is told in mm and degrees, and asked for.

    Parameters
    ----------
    robot, confirm, arm, limits, speed, robot_settings, rsi_config
        As `servo` takes them.
    path
        A TaughtPath, or path.csv in this frame.
    tip
        In flange axes: the result of calibrate_tool_tip, or tip.yaml; else the arm's tool.
    override
        Share of the planned speed.
    weave
        'none', 'sine:AMPLITUDE:WAVELENGTH' or 'zigzag:AMPLITUDE:WAVELENGTH' in m.
    path_speed_m_s, blend_m, approach_speed_m_s, retract_m, keep_rotation
        How it is run.
    rig, target, handeye, left, right, image, follow
        Cameras that watch; or simulated ones, as `servo` takes them.
    stop_m
        How far the tip may be seen from where it was told to be.
    show
        Is told now and then of a cycle's status, of where the path is, and of what the cameras saw.
    begun
        Is given the path once it may move: `pause()`, `resume()` and `override` of it steer it.
    enabled
        Asked in each cycle whether a deadman is held; while it is not the arm waits.
    progress
        Its cancelled() is the operator's enable, let go of.
    out
        A folder for play.json and the recording.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        A path that the arm cannot run (a jump, out of reach, singular), another arm's file, no hand-eye calibration;
        nothing was moved, or the arm was brought to rest.
    """
    from armsight.control.guard import Guard
    from armsight.control.play import PlaySettings, Weave, plan_path
    from armsight.ops.measurement.warm_up import prepare
    from armsight.ops.path.check import with_tip
    from armsight.ops.play import play_job
    from armsight.ops.play.play_path import run_path
    from armsight.ops.robot.opening import clocked_robot
    from armsight.ops.robot.recorder import require_new
    from armsight.ops.robot.robot_run import RobotRun
    from armsight.ops.servo.cameras import CameraNames
    from armsight.ops.servo.vision import measuring, open_servo, placed_cameras

    play_job.check(frame, stop_m)
    settings = PlaySettings(
        speed_m_s=path_speed_m_s,
        blend_m=blend_m,
        weave=Weave.parse(weave),
        approach_speed_m_s=approach_speed_m_s,
        retract_m=retract_m,
        keep_rotation=keep_rotation,
    )
    record = None if out is None else require_new(out, PLAY_RECORDING)
    watched = any(one is not None for one in (rig, target, handeye, left, right, cameras, image, follow))
    watcher: Watcher | None
    device: ClockedRobot
    if watched:
        play_job.require_cameras(rig=rig, target=target, handeye=handeye)
        placed = placed_cameras(handeye)
        eyes = CameraNames.of(cameras, left, right, image, exposure_s, latency_s)
        seen = device = open_servo(robot, rig, target, arm, eyes)
        watcher = play_job.TargetMonitor(seen, measuring(rig, target, seen), placed)
    else:
        device = clocked_robot(robot, arm)
        watcher = getattr(device, "watcher", None)
    run = RobotRun(robot, arm, progress, confirm=confirm, recording=record, limits=limits, speed=speed, device=device)
    run.require_lengths("Where its tip goes is not known, and nothing is moved")
    if tip is not None:
        run.guard = Guard(with_tip(run.guard.arm, tip), run.guard.limits, run.guard.cycle_s)
    play_job.check_speeds(settings, run.guard.limits, speed)
    if watched:
        prepare(run.progress)  # before the robot is opened: at its first picture the arm would wait for compilers
    return run_path(
        run,
        lambda q: plan_path(path.taught, run.guard.arm, run.guard.limits, q, settings),
        watcher,
        override=override,
        stop_m=stop_m,
        show=show,
        begun=begun,
        enabled=enabled,
    )
