"""A motion of the joints run by a robot through the guard, with its readings recorded, and both cameras beside it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Annotated

import numpy as np

from armsight.app.arm_files import given_arm
from armsight.app.record.free_cameras import CameraRecorded, FreeCameras, FreeJob
from armsight.app.requests.run_motion import RunMotionJob
from armsight.app.robot.guarding import standing
from armsight.app.robot.opening import robot_of
from armsight.app.robot.recorder import require_new
from armsight.app.robot.robot_run import Confirm, CycleTally, RobotRun, RunOutput, run_output
from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.control.guard import Guard
from armsight.control.guard.space import Space
from armsight.control.play.joint_motion import JointMotionSource
from armsight.control.status import RobotStatus
from armsight.drivers import AUTOMATIC, Robot
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.records import Motion, Progress, Silent
from armsight.records.output import extended, output
from armsight.store.atomic import write_json
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints, write_joints
from armsight.units import DEG, MM

RECORDING, READINGS, SUMMARY, FRAMES = "motion.mcap", "joints.csv", "motion.json", "frames.mcap"
CHECKED_S = 0.02
"""Time of the motion between two of its rows that are checked before it is run."""
FEWEST_ROWS = 4

Begun = Callable[[JointMotionSource], None]
"""Is given the motion once it may move, so that a key may pause it and change its override."""


@output
class RunMotionOutput(RunOutput):
    """armsight robot run."""

    finished: Annotated[bool, Doc("Whether the motion was run to its end.")]
    share: Annotated[float, Doc("Share of the motion that was run, 0 to 1.")]
    took_s: Annotated[float, Doc("How long it took, with the way to its start, s.")]
    joints: Annotated[str, Doc("The readings by themselves, joints.csv, for a calibration.")]
    frames: Annotated[str, Doc("The recording of both cameras' frames; empty: none was asked for.")]
    cameras: Annotated[list[CameraRecorded], Doc("What was recorded of each camera.")]


def run_motion(
    job: RunMotionJob,
    confirm: Confirm,
    progress: Progress | None = None,
    *,
    clock: Clock | None = None,
    opened: Robot | None = None,
    begun: Begun = lambda _: None,
    enabled: Callable[[], bool] = lambda: True,
) -> RunMotionOutput:
    """Run a motion after asking: to its first reading, then along it; write recording and readings into job.out.

    The whole motion is checked first: ranges of the joints, boxes of tool and flange. opened: in place of the robot.
    begun: is given the motion once it may move. enabled: asked each cycle; while it is not the arm waits.
    Raises UsageError, DataRefused for a motion beyond a limit, DeviceFailed, Cancelled.
    """
    clock, progress = clock or SystemClock(), progress or Silent()
    cameras = _cameras(job)
    require_new(job.out, RECORDING, FRAMES)
    motion, model = read_joints(job.motion), given_arm(job.arm)
    run = RobotRun(job, opened or robot_of(job, clock, model), model, clock, progress)
    source = JointMotionSource(_checked(job, motion, run.guard), override=job.override)
    with run:
        with run.planning():
            asked = question(run.robot, run.guard, motion, standing(run.robot, run.guard.arm.n))
        run.ask(confirm, asked)
        done = _followed(run, job, source, cameras, begun, enabled)
    _write_readings(job)
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def _cameras(job: RunMotionJob) -> FreeJob | None:
    """Return what the cameras are to record, None where none are given. Raises UsageError."""
    if job.left is None and job.right is None:
        if job.camera_settings != AUTOMATIC:
            raise UsageError("settings of cameras are given, and no cameras", cure="Give --left and --right too")
        return None
    if job.left is None or job.right is None:
        raise UsageError(
            f"{'--left' if job.left is None else '--right'} is missing",
            consequence="Nothing is moved: a cell is calibrated from both cameras",
            cure="Give both cameras, or none of them",
        )
    return FreeJob(left=job.left, right=job.right, out=job.out / FRAMES, settings=job.camera_settings)


def _followed(
    run: RobotRun,
    job: RunMotionJob,
    source: JointMotionSource,
    frames: FreeJob | None,
    begun: Begun,
    enabled: Callable[[], bool],
) -> RunMotionOutput:
    """Run the loop, and record it, the cameras from before it until after it; return what came of it.

    Raises what a recorder failed of where the motion was run nevertheless, DeviceFailed for cameras that do not begin.
    """
    progress = run.progress
    cameras = None if frames is None else FreeCameras(frames, cancelled=progress.cancelled)
    tally = CycleTally(progress.cancelled)
    unseen: list[str] = []

    def over(status: RobotStatus) -> bool:
        failed = None if cameras is None else cameras.failed
        if failed is not None and not unseen:  # moving on gains nothing
            unseen.append(f"the cameras are no longer recorded: {failed.cause}")
        return tally(status) or bool(unseen)

    with ExitStack() as stack:
        if cameras is not None:
            progress.update(0.0, source.length_s, "waiting for the cameras")
            stack.enter_context(cameras)
        sink = stack.enter_context(run.recorded(job.out / RECORDING))
        begun(source)
        show = lambda _: progress.update(source.at_s, source.length_s, source.stage)  # noqa: E731
        timing = run.follow(source, sink, over, show, enabled=lambda: enabled() and not progress.cancelled())
    if cameras is not None and cameras.failed is not None and not unseen:
        raise cameras.failed  # after the end, while the rest was written
    finished = source.stage == "finished"
    return extended(
        run_output(tally, timing, (*unseen, tally.stopped_by(finished=finished))[0], job.out / RECORDING),
        RunMotionOutput,
        finished=finished,
        share=source.at_s / source.length_s,
        took_s=tally.took_s,
        joints=str(job.out / READINGS),
        frames="" if cameras is None else str(job.out / FRAMES),
        cameras=[] if cameras is None else list(cameras.recorded),
    )


def question(robot: Robot, guard: Guard, motion: Motion, stands: Array) -> str:
    """Return what is asked before anything moves: how far each joint goes first, and along the motion."""
    turns = guard.arm.revolute
    first, way = np.abs(motion.q[0] - stands), np.ptp(motion.q, axis=0)

    def told(values: Array) -> str:
        rows = zip(values.tolist(), turns.tolist(), strict=True)
        return ", ".join(f"{value / DEG:.0f} deg" if turn else f"{value / MM:.0f} mm" for value, turn in rows)

    return (
        f"{robot.name} moves its joints by {told(first)} to where the motion begins, then over {told(way)} in "
        f"{np.ptp(motion.t_s):.0f} s, the tool at up to {guard.limits.speed_m_s / MM:.0f} mm/s. Move?"
    )


def _checked(job: RunMotionJob, motion: Motion, guard: Guard) -> Motion:
    """Return the motion. Raises where it is none of this arm, or leaves a limit that a slower motion would not keep."""
    if motion.q.shape[1] != guard.arm.n:
        raise Inconsistent(
            f"{job.motion} moves {motion.q.shape[1]} joints, {guard.arm.name} has {guard.arm.n}",
            consequence="Nothing is moved",
            cure="Plan a motion for this arm",
        )
    if len(motion.t_s) < FEWEST_ROWS:
        raise NotEnoughData(f"{job.motion} holds {len(motion.t_s)} rows", consequence="Nothing is moved")
    space = Space(guard.arm, guard.limits, guard.bounds)
    still = np.zeros(guard.arm.n)
    for i in np.unique(np.searchsorted(motion.t_s, np.arange(motion.t_s[0], motion.t_s[-1], CHECKED_S))).tolist():
        found = space.at(motion.q[i], still, still, in_space=False)
        if found.outside().any():
            raise Inconsistent(
                f"{job.motion}: at {motion.t_s[i]:.2f} s the arm would stand {found.describe()}",
                consequence="Nothing is moved",
                cure="Plan it with the limits that it is run with (--limits)",
            )
    return motion


def _write_readings(job: RunMotionJob) -> None:
    """Write the readings of the recording as joints.csv, each time once."""
    with Recording(job.out / RECORDING) as recording:
        readings = list(recording.joints())
    if not readings:
        return
    t = np.array([reading.t_s for reading in readings])
    fresh = np.concatenate([[True], np.diff(np.maximum.accumulate(t)) > 0.0])
    q = np.array([reading.q for reading in readings])
    write_joints(job.out / READINGS, Motion(t_s=t[fresh], q=q[fresh]))
