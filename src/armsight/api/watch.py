"""Before a robot that is there: identify it live, supervise it, check its zeros after a crash."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.app.identify.live import OperatorCallbacks, in_radians, read_limits, run_identify_live
from armsight.app.identify.results import IdentifyOutput, ProposedPlanOutput
from armsight.app.requests.identify import LiveJob, PaceFlags
from armsight.app.requests.motion import RobotSettings as Settings
from armsight.app.requests.verify import LiveVerifyJob, MasteringJob
from armsight.app.robot.robot_run import as_question
from armsight.app.verify.live import run_verify_live
from armsight.app.verify.mastering import propose_mastering, run_mastering
from armsight.control.joint_sweep import Pace
from armsight.drivers import CameraSettings
from armsight.kinematics import Arm
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, PoseLike, RigLike, TableLike, TargetLike
from armsight.ops.kinds import Confirm
from armsight.records import Progress, checked_array, require_count, require_kind
from armsight.records.output import extended, output
from armsight.store.arm_file import read_arm
from armsight.verify.results import MasteringOutput, MasteringPlanOutput, VerifyLiveOutput
from armsight.verify.supervision import Limits


@output
class LiveIdentification(IdentifyOutput):
    """What `identify_arm_live` found: its figures, and `arm`."""

    arm: Arm


@speaks_python(LiveJob)
def identify_arm_live(
    robot: str,
    rig: RigLike,
    target: TargetLike,
    left: str,
    right: str,
    limits: ArrayLike | PathText,
    *,
    confirm: Confirm = False,
    world: PoseLike | None = None,
    model: ArmLike | None = None,
    readings: int = LiveJob.readings,
    speed: float = PaceFlags.speed,
    sigma: float | None = None,
    method: Literal["ml", "paper"] = "ml",
    nominal: ArmLike | None = None,
    propose: bool = False,
    leave_out: Sequence[int] = (),
    mask: ArrayLike | PathText | None = None,
    camera_settings: CameraSettings | None = None,
    out: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> LiveIdentification | ProposedPlanOutput:
    """Move an unknown arm joint by joint before two cameras, and return its geometry; or propose the sweeps only.

    Parameters
    ----------
    robot, left, right
        DRIVER:DEVICE and 'camera:NAME'; or sim:SCENARIO and camera:sim:SCENARIO:left.
    robot_settings, rsi_config
        As `servo` takes them.
    limits
        (n, 2) least and largest reading of each joint in rad or m, never left; or limits.yaml.
    confirm
        True, or a function of the motion in words.
    model, world
        An arm that is roughly right, its tool the beacon, and where the rig stands: then nothing is probed.
    readings, speed
        Of a sweep; share of a joint's travel a second.
    propose
        Return the plan only.
    leave_out
        The last joints, from 1, which are held where they are.
    out
        arm.yaml to write.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        The beacon is lost, or the robot or a camera fails; the robot is stopped.
    """
    with Given(out, name="arm.yaml") as given:
        limits = _limits(limits)
        pace, left_out = Pace(speed=speed), tuple(as_numbers("leave_out", leave_out))
        job = given.job(LiveJob, locals(), out=given.out)
        done = run_identify_live(job, OperatorCallbacks(confirm=as_question(confirm)), progress)
        if isinstance(done, ProposedPlanOutput):
            return done
        return extended(done, LiveIdentification, arm=read_arm(given.out))


def _limits(limits: ArrayLike | PathText) -> NDArray[np.float64]:
    """Return limits (n, 2) of an array, a file, or a text as the command line takes it."""
    if isinstance(limits, str | PathLike):
        return read_limits(str(limits))
    return in_radians(checked_array("limits", limits, (None, 2)))


@speaks_python(LiveVerifyJob)
def supervise(
    robot: str,
    rig: RigLike,
    target: TargetLike,
    left: str,
    right: str,
    arm: ArmLike,
    world: PoseLike,
    *,
    warn_m: float | None = None,
    stop_m: float | None = None,
    warn_rad: float | None = None,
    stop_rad: float | None = None,
    blind_stop_s: float | None = None,
    joint_std: float = LiveVerifyJob.joint_std,
    latency_s: float = LiveVerifyJob.latency_s,
    latency_std_s: float = LiveVerifyJob.latency_std_s,
    seconds_s: float | None = None,
    frames: int | None = None,
    keep_frames: bool = False,
    play: bool = False,
    camera_settings: CameraSettings | None = None,
    out: PathText | None = None,
    robot_settings: Settings | None = None,
    rsi_config: PathText | None = None,
    progress: Progress | None = None,
) -> VerifyLiveOutput:
    """Watch a running arm with two cameras, stop it where it is not where it says, and return what was seen.

    Parameters
    ----------
    robot, left, right
        As identify_arm_live takes them, and robot_settings and rsi_config.
    arm, world
        Where the arm should be: its geometry, and where the rig stands (T_base_rig).
    warn_m, stop_m, warn_rad, stop_rad
        Errors that warn, and that stop the robot.
    blind_stop_s
        Stop where nothing was seen for so long.
    joint_std, latency_s, latency_std_s
        Of a reading (rad, m); from exposure to frame in memory, and how well that is known.
    seconds_s, frames
        When to end.
    keep_frames, out
        The images too; a folder for report and recording.
    play
        A simulated robot goes its scenario's way by itself.

    Raises
    ------
    UsageError, DataRefused, DeviceFailed
        Nothing could be compared, or a device failed.
    """
    with Given(out) as given:
        limits = Limits(warn_m=warn_m, stop_m=stop_m, warn_rad=warn_rad, stop_rad=stop_rad)
        job = given.job(LiveVerifyJob, locals(), limits=limits, limit=frames, frames=keep_frames)
        return run_verify_live(job, progress=progress)


@speaks_python(MasteringJob)
def propose_mastering_poses(
    arm: ArmLike,
    around: ArrayLike,
    *,
    span_rad: float = MasteringJob.span_rad,
    tool: Literal["fixed", "free"] | None = None,
    world: PoseLike | None = None,
    rig: RigLike | None = None,
    target: TargetLike | None = None,
    out: PathText | None = None,
) -> MasteringPlanOutput:
    """Return ten joint positions at which to measure an arm after a crash.

    around: readings (n,) about which they are, within span_rad. tool: whether it is known from before. rig, target,
    world: only poses that the cameras see. out: a folder for mastering.csv. Raises UsageError, DataRefused.

    Examples
    --------
    >>> len(armsight.propose_mastering_poses("ur10", [0.0, -1.0, 1.0, 1.0, 2.0, 0.0]).poses)
    10
    """
    with Given(out) as given:
        middle = ",".join(map(repr, checked_array("around", around, (None,)).tolist()))
        return propose_mastering(given.job(MasteringJob, locals(), around=middle))


@speaks_python(MasteringJob)
def check_mastering(
    measured: TableLike,
    joints: TableLike,
    arm: ArmLike,
    *,
    tool: Literal["fixed", "free"] | None = None,
    world: PoseLike | None = None,
    out: PathText | None = None,
) -> MasteringOutput:
    """Return which joint's zero moved in a crash, from poses measured at joint positions.

    measured, joints, arm, world: as `verify` takes them. tool: whether it is known from before. out: a folder for the
    report. Raises UsageError, DataRefused.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.array([pose.q for pose in armsight.propose_mastering_poses(arm, [0.0, -1.0, 1.0, 1.0, 2.0, 0.0]).poses])
    >>> armsight.check_mastering(arm.fk(q), q, arm, tool="fixed").cause
    'none'
    """
    with Given(out) as given:
        return run_mastering(given.job(MasteringJob, locals()))


def as_numbers(name: str, values: Sequence[int]) -> Sequence[int]:
    """Return whole numbers from 1. Raises UsageError for anything else."""
    require_kind(name, values, list, tuple, cure="Give the numbers of joints, from 1")
    for value in values:
        require_count(f"an entry of {name}", value, least=1)
    return values
