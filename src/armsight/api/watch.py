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
from armsight.app.robot.robot_run import as_question
from armsight.control.joint_sweep import Pace
from armsight.drivers import CameraSettings
from armsight.kinematics import Arm
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, PoseLike, RigLike, TargetLike
from armsight.ops.kinds import Confirm
from armsight.records import Progress, checked_array, require_count, require_kind
from armsight.records.output import extended, output
from armsight.store.arm_file import read_arm


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


def as_numbers(name: str, values: Sequence[int]) -> Sequence[int]:
    """Return whole numbers from 1. Raises UsageError for anything else."""
    require_kind(name, values, list, tuple, cure="Give the numbers of joints, from 1")
    for value in values:
        require_count(f"an entry of {name}", value, least=1)
    return values
