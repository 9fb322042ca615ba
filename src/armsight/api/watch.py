"""Before a robot that is there: supervise it, check its zeros after a crash."""

from __future__ import annotations

from typing import Literal

from numpy.typing import ArrayLike

from armsight.api.links import Settings
from armsight.app.requests.verify import LiveVerifyJob, MasteringJob
from armsight.app.verify.live import run_verify_live
from armsight.app.verify.mastering import propose_mastering, run_mastering
from armsight.drivers import CameraSettings
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, PoseLike, RigLike, TableLike, TargetLike
from armsight.records import Progress, checked_array
from armsight.verify.results import MasteringOutput, MasteringPlanOutput, VerifyLiveOutput
from armsight.verify.supervision import Limits


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
