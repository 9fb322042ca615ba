"""armsight servo: the arm follows a target, through the guard, until the operator or the time ends it."""

from __future__ import annotations

import numpy as np

from armsight.app.arm_files import given_arm
from armsight.app.live.pace import live_pace
from armsight.app.measure.run import target_of
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.motion import ServoJob
from armsight.app.robot.recorder import require_new
from armsight.app.robot.robot_run import Confirm, RobotRun
from armsight.app.servo.servo_job import CAMERA, TOOL, ServoDevices
from armsight.app.servo.session import RECORDING, ServoOutput, ServoSession, Show
from armsight.app.servo.vision import Beside, open_servo
from armsight.control.servo import Mount, ServoSettings, Turning, on_axis
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.optics import Rig, RigKind
from armsight.records import Progress, Silent, Target
from armsight.store import read_rig
from armsight.store.atomic import write_json
from armsight.store.handeye_file import HandEyeFile, read_handeye

SUMMARY = "servo.json"
LAG_CYCLES = 2.0
"""Cycles from a command to the arm's motion where nobody says: one until it is taken, one for the drives."""


def run_servo(
    job: ServoJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    beside: Beside | None = None,
) -> ServoOutput:
    """Follow the target until the operator lets go, seconds_s have passed or the guard stopped; write job.out.

    confirm: asked once, with gain, limits and delay, before anything moves. progress: its cancelled() is the operator's
    enable, let go of. show: told of the newest cycle now and then. devices: in place of those the job names.
    beside: is told of each frame meanwhile. Raises UsageError, DataRefused (another arm's file, no hand-eye, a gain
    that is not stable), DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    _check(job)
    require_new(job.out, RECORDING)
    rig, target, handeye = read_rig(job.rig), target_of(job.target), _handeye(job)
    arm = given_arm(job.arm)
    devices = devices or open_servo(job, rig, target, arm=arm)
    run = RobotRun(job, devices.robot, arm, devices.clock, progress)
    run.require_lengths("Where its cameras are is not known, and nothing is moved")
    settings = _settings(job, handeye, run.guard.arm, devices.robot.cycle_s)
    prepare(progress)
    setup = measuring(rig, target, devices)
    done = ServoSession(job, devices, settings, setup, beside).run(run, confirm, show)
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def _check(job: ServoJob) -> None:
    """Raise UsageError for what cannot be meant."""
    if job.at not in (CAMERA, TOOL):
        raise UsageError(f"--at {job.at} is neither {CAMERA} nor {TOOL}", cure="Say whose axis the target is wanted on")
    positive = (
        ("--latency", job.latency_s),
        ("--arm-lag", job.arm_lag_s),
        ("--hand-speed", job.hand_speed_m_s),
        ("--resume-mm", job.resume_m),
        ("--resume-deg", job.resume_rad),
    )
    for name, value in positive:
        if value is not None and not (np.isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value:g} cannot be", cure="Give a number, zero or more")
    if job.seconds_s is not None and not job.seconds_s > 0.0:
        raise UsageError(f"--seconds {job.seconds_s:g} is no time", cure="Give seconds, more than zero")


def _handeye(job: ServoJob) -> HandEyeFile:
    """Return the hand-eye calibration. Raises BadFile where it is missing, Inconsistent where it does not fit."""
    if not job.handeye.exists():
        raise BadFile(
            f"the hand-eye calibration {job.handeye} is missing",
            consequence="Where the cameras are on the robot is not known, and nothing is moved",
            cure="Make it with: armsight calibrate handeye",
        )
    handeye = read_handeye(job.handeye)
    if handeye.setup.value == Mount.EYE_TO_HAND.value and job.at == CAMERA:
        raise Inconsistent(
            f"by {job.handeye} the cameras stand beside the robot, and the target is wanted on their axis",
            consequence="The robot cannot bring it there",
            cure="Give --at tool: the tool then goes where the target is, at --distance",
        )
    return handeye


def _settings(job: ServoJob, handeye: HandEyeFile, arm: Arm, cycle_s: float) -> ServoSettings:
    """Return how the target is followed, with a gain of zero: it waits for the delay."""
    T_flange_frame = handeye.T_parent_camera if job.at == CAMERA else arm.T_flange_tool
    return ServoSettings(
        mount=Mount(handeye.setup.value),
        T_parent_camera=handeye.T_parent_camera,
        T_flange_desired=on_axis(T_flange_frame, job.distance_m),
        gain_t=0.0,
        gain_r=0.0,
        arm_lag_s=LAG_CYCLES * cycle_s if job.arm_lag_s is None else job.arm_lag_s,
        predict=job.predict,
        turning=_turning(job.rotation),
        resume_m=job.resume_m,
        resume_rad=job.resume_rad,
    )


def _turning(name: str) -> Turning:
    try:
        return Turning(name)
    except ValueError as error:
        raise UsageError(
            f"{name!r} is no way to turn after a target",
            consequence="Nothing is moved",
            cure=f"Give {', '.join(Turning)} (--rotation)",
        ) from error


def measuring(rig: Rig, target: Target, devices: ServoDevices) -> Setup:
    """Return what measuring needs. Raises UsageError for a board, whose pose takes longer than a servo's cycle."""
    if target.is_board:
        raise UsageError("a board takes too long to find for a servo", cure="Give a target of lights (--target)")
    if rig.kind is RigKind.MIRROR and not devices.overlaid:
        raise UsageError("the rig has mirrors: both of its views are in one image", cure="Give --image")
    settings = SpotSettings(colour=target.colour)
    return Setup(rig=rig, target=target, settings=settings, overlaid=devices.overlaid, pace=live_pace())
