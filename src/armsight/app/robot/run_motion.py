"""A motion of the joints run by a robot through the guard, with its readings recorded, and both cameras beside it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.app.arm_files import given_arm
from armsight.app.record.free_cameras import CameraRecorded, FreeCameras, FreeJob
from armsight.app.requests.run_motion import RunMotionJob
from armsight.app.robot.cycle_tally import CycleTally
from armsight.app.robot.guarding import beside_outside, guard_for, noted, standing, standing_outside
from armsight.app.robot.opening import robot_of
from armsight.app.robot.recorder import LoopRecorder, require_new
from armsight.app.robot.with_progress import run_with_progress
from armsight.clock import Clock, SystemClock
from armsight.control.guard import Guard
from armsight.control.guard.space import Space
from armsight.control.loop import ControlLoop
from armsight.control.play.joint_motion import JointMotionSource
from armsight.control.status import RobotStatus, Timing
from armsight.drivers import AUTOMATIC, Robot
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.records import Motion, Progress, Silent
from armsight.records.output import Output, output
from armsight.store.atomic import write_json
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints, write_joints
from armsight.units import DEG, MM

Array = NDArray[np.float64]

RECORDING, READINGS, SUMMARY, FRAMES = "motion.mcap", "joints.csv", "motion.json", "frames.mcap"
CHECKED_S = 0.02
"""Time of the motion between two of its rows that are checked before it is run."""
FEWEST_ROWS = 4

Begun = Callable[[JointMotionSource], None]
"""Is given the motion once it may move, so that a key may pause it and change its override."""


@output
class RunMotionOutput(Output):
    """armsight robot run."""

    n_cycles: Annotated[int, Doc("Cycles of the control loop.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began.")]
    stopped_by: Annotated[str, Doc("Why it ended: end (of the motion), operator, or in words what stopped it.")]
    finished: Annotated[bool, Doc("Whether the motion was run to its end.")]
    share: Annotated[float, Doc("Share of the motion that was run, 0 to 1.")]
    took_s: Annotated[float, Doc("How long it took, with the way to its start, s.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    recording: Annotated[str, Doc("The recording: commands, readings and events.")]
    joints: Annotated[str, Doc("The readings by themselves, joints.csv, for a calibration.")]
    frames: Annotated[str, Doc("The recording of both cameras' frames; empty: none was asked for.")]
    cameras: Annotated[list[CameraRecorded], Doc("What was recorded of each camera.")]


def run_motion(
    job: RunMotionJob,
    confirm: Callable[[str], bool],
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
    robot = opened or robot_of(job, clock, model)
    guard = guard_for(robot, model, job.limits, share=job.speed)
    source = JointMotionSource(_checked(job, motion, guard), override=job.override)
    with robot:
        outside = standing_outside(guard, robot)
        with beside_outside(outside):
            asked = question(robot, guard, motion, standing(robot, guard.arm.n)) + noted(
                outside, guard, job, job.limits
            )
        if not confirm(asked):
            raise Cancelled("not confirmed", consequence="Nothing was moved", cure="Give --yes to move unasked")
        run = _Run(job, robot, guard, source, clock, progress, cameras)
        timing = run.followed(begun, enabled)
    _write_readings(job)
    done = run.output(timing)
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


class _Run:
    """One run of a motion, recorded; both cameras beside it, where a job for them is given."""

    def __init__(
        self,
        job: RunMotionJob,
        robot: Robot,
        guard: Guard,
        source: JointMotionSource,
        clock: Clock,
        progress: Progress,
        frames: FreeJob | None,
    ) -> None:
        self._job, self._robot, self._guard, self._source = job, robot, guard, source
        self._clock, self._progress = clock, progress
        self._tally = CycleTally(progress.cancelled)
        self._cameras = None if frames is None else FreeCameras(frames, cancelled=progress.cancelled)
        self._unseen = ""

    def followed(self, begun: Begun, enabled: Callable[[], bool]) -> Timing:
        """Run the loop, and record it, the cameras from before it until after it.

        Raises what a recorder failed of where the motion was run nevertheless, DeviceFailed for cameras that do not
        begin.
        """
        job, progress, source = self._job, self._progress, self._source
        with ExitStack() as stack:
            if self._cameras is not None:
                progress.update(0.0, source.length_s, "waiting for the cameras")
                stack.enter_context(self._cameras)
            recorder = stack.enter_context(LoopRecorder(job.out / RECORDING, self._clock))
            alive = lambda: enabled() and not progress.cancelled()  # noqa: E731
            loop = ControlLoop(self._robot, self._guard, source, self._clock, enabled=alive, sink=recorder.sink)

            def show() -> None:
                progress.update(source.at_s, source.length_s, source.stage)

            begun(source)
            timing = run_with_progress(lambda: loop.run(until=self._over), show)
        if recorder.failed is not None:
            raise recorder.failed
        if self._cameras is not None and self._cameras.failed is not None and not self._unseen:
            raise self._cameras.failed  # after the end, while the rest was written
        return timing

    def _over(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last: also where a camera is lost, as moving on gains nothing."""
        failed = None if self._cameras is None else self._cameras.failed
        if failed is not None and not self._unseen:
            self._unseen = f"the cameras are no longer recorded: {failed.cause}"
        return self._tally(status) or bool(self._unseen)

    def output(self, timing: Timing) -> RunMotionOutput:
        """Return what came of it."""
        job, source, tally = self._job, self._source, self._tally
        finished = source.stage == "finished"
        return RunMotionOutput(
            n_cycles=timing.n_cycles,
            late=timing.late,
            missed=timing.missed,
            stopped_by=self._unseen or tally.stopped_by(finished=finished),
            finished=finished,
            share=source.at_s / source.length_s,
            took_s=tally.took_s,
            holds=tally.holds,
            recording=str(job.out / RECORDING),
            joints=str(job.out / READINGS),
            frames="" if self._cameras is None else str(job.out / FRAMES),
            cameras=[] if self._cameras is None else list(self._cameras.recorded),
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
