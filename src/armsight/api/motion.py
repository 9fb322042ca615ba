"""Robots that move: servo, teach, play.

Nothing moves unasked: `confirm` is True, or a function that is given the motion in words and says whether it may begin.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

from armsight.api.links import Confirm, RobotLike, Settings, as_question, name_of
from armsight.app.play.play_path import Opened, PlayOutput, run_play
from armsight.app.requests.motion import STOP_M, FollowJob, PlayJob, ServoJob, StandingJob, TeachJob
from armsight.app.servo.run_servo import ServoOutput, run_servo
from armsight.app.servo.vision import ServoDevices
from armsight.app.teach import PATH, TeachOutput, teach_following, teach_poses, teach_standing
from armsight.clock import SystemClock
from armsight.control.guard import Limits
from armsight.drivers import CameraSettings, Robot
from armsight.errors import UsageError
from armsight.ops.checks import speaks_python
from armsight.ops.given import (
    ArmLike,
    Given,
    PathText,
    PoseLike,
    RigLike,
    Source,
    TableLike,
    TargetLike,
)
from armsight.ops.sources.frames import complex_pairs, open_pairs, open_source
from armsight.records import Progress, TaughtPath
from armsight.records.output import extended, output
from armsight.store import read_rig
from armsight.store.path_file import read_path


@output
class TeachResult(TeachOutput):
    """What `teach` found: its figures, and `taught`, the path."""

    taught: TaughtPath


@speaks_python(ServoJob)
def servo(
    robot: RobotLike,
    rig: RigLike,
    target: TargetLike,
    handeye: PoseLike,
    *,
    confirm: Confirm = False,
    distance_m: float = ServoJob.distance_m,
    at: Literal["camera", "tool"] = "camera",
    gain: float | None = None,
    rotation: Literal["align", "keep", "hold"] = "align",
    predict: bool = True,
    seconds_s: float | None = None,
    left: str | None = None,
    right: str | None = None,
    image: str | None = None,
    latency_s: float = ServoJob.latency_s,
    exposure_s: float | None = None,
    arm: ArmLike | None = None,
    limits: Limits | PathText | None = None,
    speed: float = ServoJob.speed,
    arm_lag_s: float | None = None,
    resume_m: float = ServoJob.resume_m,
    resume_rad: float = ServoJob.resume_rad,
    hand: Literal["still", "circle", "trapezium", "random"] | None = None,
    hand_speed_m_s: float = ServoJob.hand_speed_m_s,
    out: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> ServoOutput:
    """Let an arm follow a target that the cameras see, through the guard, and return what it came to.

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
        End after so long; else progress ends it.
    left, right, image
        Live cameras, 'camera:NAME'.
    arm, limits, speed
        The arm where the robot does not tell it, what the guard keeps, and the share of its speeds.
    hand, hand_speed_m_s
        How the target of a simulated cell is led.
    out
        A folder for servo.json and the recording.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        Nothing was moved, or the arm was brought to rest.
    """
    with Given(out) as given:
        job, devices = _servo_job(given, locals())
        return run_servo(job, as_question(confirm), progress=progress, devices=devices)


@speaks_python(TeachJob, FollowJob, StandingJob)
def teach(
    rig: RigLike | None = None,
    target: TargetLike | None = None,
    left: Source | None = None,
    right: Source | None = None,
    *,
    image: Source | None = None,
    world: PoseLike | None = None,
    poses: TableLike | None = None,
    robot: RobotLike | None = None,
    handeye: PoseLike | None = None,
    confirm: Confirm = False,
    tip: PoseLike | None = None,
    every: int = TeachJob.every,
    mean: bool = False,
    path_speed_m_s: float | None = None,
    seconds_s: float | None = None,
    distance_m: float = FollowJob.distance_m,
    at: Literal["camera", "tool"] = "camera",
    gain: float | None = None,
    rotation: Literal["align", "keep", "hold"] = "align",
    latency_s: float = FollowJob.latency_s,
    exposure_s: float | None = None,
    arm: ArmLike | None = None,
    limits: Limits | PathText | None = None,
    speed: float = FollowJob.speed,
    arm_lag_s: float | None = None,
    hand: Literal["still", "circle", "trapezium", "random"] | None = None,
    hand_speed_m_s: float = FollowJob.hand_speed_m_s,
    out: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> TeachResult:
    """Return the path along which a target was led: before cameras that stand, before an arm that follows, or measured.

    Parameters
    ----------
    rig, target, left, right, image
        As `measure` takes them; with robot as `servo` does.
    world
        T_base_rig of cameras that stand.
    poses
        Instead of frames: poses that were measured, as `measure` returns them.
    robot, handeye, confirm, robot_settings, rsi_config
        The arm that follows, as `servo` takes them.
    tip
        The result of calibrate_tool_tip, or tip.yaml; else the target's origin.
    every, mean
        Frames per row of the path, and whether a row is their mean.
    path_speed_m_s
        Written into the path.
    out
        A folder for path.csv and teach.json.

    Raises
    ------
    NotEnoughData
        Less than two poses.
    UsageError, DataRefused, DeviceFailed
        As measure and servo.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=4)
    >>> seen = armsight.measure(cell.rig, cell.target, [f.left for f in cell], [f.right for f in cell])
    >>> len(armsight.teach(poses=seen.poses).taught)
    4
    """
    with Given(out) as given:
        values = locals()
        job = given.job(TeachJob, values)
        if poses is not None:
            placed = None if world is None else given.file("world", world)
            done = teach_poses(job, given.file("poses", poses), world=placed)
        elif rig is None or target is None:
            raise UsageError("rig and target are needed", consequence="Nothing is taught", cure="Give them, or poses")
        elif robot is None:
            done = teach_standing(job, given.job(StandingJob, values), progress)
        elif handeye is None:
            raise UsageError("handeye is needed", consequence="Nothing is taught", cure="Give it with the robot")
        else:
            following, devices = _servo_job(given, values)
            done = teach_following(job, following, as_question(confirm), progress=progress, devices=devices)
        parent = done.parent if done.parent in ("world", "base") else "world"
        return extended(done, TeachResult, taught=read_path(given.out / PATH, parent=parent))


@speaks_python(PlayJob)
def play(
    robot: RobotLike,
    path: TaughtPath | PathText,
    *,
    confirm: Confirm = False,
    arm: ArmLike | None = None,
    tip: PoseLike | None = None,
    limits: Limits | PathText | None = None,
    override: float = PlayJob.override,
    weave: str = PlayJob.weave,
    path_speed_m_s: float = PlayJob.path_speed_m_s,
    blend_m: float = PlayJob.blend_m,
    approach_speed_m_s: float = PlayJob.approach_speed_m_s,
    retract_m: float = PlayJob.retract_m,
    keep_rotation: bool = False,
    frame: Literal["world", "base"] = "world",
    speed: float = PlayJob.speed,
    rig: RigLike | None = None,
    target: TargetLike | None = None,
    handeye: PoseLike | None = None,
    left: str | None = None,
    right: str | None = None,
    image: str | None = None,
    latency_s: float = PlayJob.latency_s,
    exposure_s: float | None = None,
    stop_m: float = STOP_M,
    out: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> PlayOutput:
    """Run a path with the tip of an arm's tool, through the guard, and return what it came to.

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
    rig, target, handeye, left, right, image
        Cameras that watch.
    stop_m
        How far the tip may be seen from where it was told to be.
    out
        A folder for play.json and the recording.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        A path that the arm cannot run; nothing was moved, or the arm was brought to rest.
    """
    with Given(out) as given:
        job = given.job(PlayJob, locals(), robot=name_of(robot, robot_settings, rsi_config))
        if isinstance(robot, str):
            return run_play(job, as_question(confirm), progress=progress)
        if job.watched:
            return run_play(job, as_question(confirm), progress=progress, devices=_devices(robot, job.cameras()))
        return run_play(job, as_question(confirm), progress=progress, opened=Opened(robot, SystemClock()))


def _servo_job(given: Given, values: dict[str, Any]) -> tuple[ServoJob, ServoDevices | None]:
    robot = values["robot"]
    job = given.job(ServoJob, values, robot=name_of(robot, values["robot_settings"], values["rsi_config"]))
    return job, None if isinstance(robot, str) else _devices(robot, job)


def _devices(robot: Robot, job: ServoJob) -> ServoDevices:
    clock, settings = SystemClock(), CameraSettings(exposure_s=job.exposure_s)
    if job.image is None:
        pairs = open_pairs(job.left, job.right, settings=settings)
        return ServoDevices(robot=robot, pairs=pairs, clock=clock)
    source = partial(open_source, job.image, settings=settings, clock=clock)
    both, overlaid = complex_pairs(source, read_rig(job.rig))
    return ServoDevices(robot=robot, pairs=both, clock=clock, overlaid=overlaid)
