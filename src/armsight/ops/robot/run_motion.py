"""A motion of the joints run by a robot through the guard, with its readings recorded, and both cameras beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.control.guard import Guard
from armsight.control.guard.space import Space
from armsight.control.play.path_source import JointMotionSource
from armsight.drivers import AUTOMATIC, CameraSettings, Robot
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.file_names import FRAMES, MOTION, MOTION_RECORDING, READINGS
from armsight.ops.recording.free_cameras import CameraRecorded, FreeCameras, FreeJob
from armsight.ops.robot.opening import standing
from armsight.ops.robot.robot_run import CycleTally, RobotRun, RunOutput
from armsight.ops.sources.cameras import cameras_of
from armsight.optics import SIDES
from armsight.records import Motion
from armsight.records.output import extended, output
from armsight.shown import Shown
from armsight.store.atomic import write_json
from armsight.store.recording import Recording
from armsight.store.tracks import write_joints
from armsight.units import DEG, MM

CHECKED_S = 0.02
"""Time of the motion between two of its rows that are checked before it is run."""
FEWEST_ROWS = 4


@output
class RunMotionOutput(RunOutput):
    """armsight robot run."""

    finished: Annotated[bool, Doc("Whether the motion was run to its end.")]
    share: Annotated[float, Doc("Share of the motion that was run, 0 to 1.")]
    took_s: Annotated[float, Doc("How long it took, with the way to its start, s.")]
    joints: Annotated[str, Doc("The readings by themselves, joints.csv, for a calibration.")]
    frames: Annotated[str, Doc("The recording of both cameras' frames; empty: none was asked for.")]
    cameras: Annotated[list[CameraRecorded], Doc("What was recorded of each camera.")]

    def summary(self) -> Iterator[Shown]:
        """Yield how far it was run, where it held, and what was recorded."""
        yield (
            f"{100.0 * self.share:.0f} % of the motion in {self.took_s:.1f} s; {self.n_cycles} cycles, "
            f"{self.late} late, {self.missed} missed; ended by: {self.stopped_by}"
        )
        yield from self.held()
        yield f"Recording: {self.recording}; readings: {self.joints}"
        for one in self.cameras:
            lost = f", {one.n_dropped} dropped" if one.n_dropped else ""
            yield f"{one.camera}: {one.n_frames} frames over {one.duration_s:.1f} s{lost}: {self.frames}"

    def write(self, folder: Path) -> None:
        """Write motion.json into a folder, and the readings of the recording as joints.csv, each time once."""
        with Recording(folder / MOTION_RECORDING) as recording:
            readings = list(recording.joints())
        if readings:
            t = np.array([reading.t_s for reading in readings])
            fresh = np.concatenate([[True], np.diff(np.maximum.accumulate(t)) > 0.0])
            q = np.array([reading.q for reading in readings])
            write_joints(folder / READINGS, Motion(t_s=t[fresh], q=q[fresh]))
        write_json(folder / MOTION, self.to_dict())


def recorded_cameras(cameras: Mapping[str, str], settings: CameraSettings | None, out: Path | None) -> FreeJob | None:
    """Return what the cameras are to record into a folder, None where none are given. Raises UsageError."""
    if not cameras:
        if settings not in (None, AUTOMATIC):
            raise UsageError(
                "settings of cameras are given, and no cameras",
                cure="Give them too: --left and --right, or --camera NAME=SRC",
            )
        return None
    if len(cameras) == 1 and next(iter(cameras)) in SIDES:
        cameras = cameras_of(SIDES, cameras)  # of a pair the other one was forgotten
    if out is None:
        raise UsageError("cameras are to be recorded, and no folder is given", cure="Give one (-o)")
    return FreeJob(cameras=cameras, out=out / FRAMES, settings=settings or AUTOMATIC)


class _Unseen:
    """Tells whether cameras failed while they were recorded, and remembers why."""

    def __init__(self, cameras: FreeCameras | None) -> None:
        self.why = ""
        self._cameras = cameras

    def __call__(self) -> bool:
        failed = None if self._cameras is None else self._cameras.failed
        if failed is not None and not self.why:  # moving on gains nothing
            self.why = f"the cameras are no longer recorded: {failed.cause}"
        return bool(self.why)


def run_joints(
    run: RobotRun,
    motion: Motion,
    frames: FreeJob | None,
    *,
    override: float,
    begun: Callable[[JointMotionSource], object],
    enabled: Callable[[], bool],
) -> RunMotionOutput:
    """Ask, run the loop, and record it, the cameras from before it until after it; return what came of it.

    Raises what a recorder failed of where the motion was run nevertheless, DeviceFailed for cameras that do not begin.
    """
    progress, source = run.progress, JointMotionSource(motion, override=override)
    cameras = None if frames is None else FreeCameras(frames, cancelled=progress.cancelled)
    tally, unseen = CycleTally(progress.cancelled), _Unseen(cameras)
    with ExitStack() as stack:
        stack.enter_context(run)
        with run.planning():
            asked = question(run.robot, run.guard, motion, standing(run.robot, run.guard.arm.n))
        run.ask(asked)
        if cameras is not None:
            progress.update(0.0, source.length_s, "waiting for the cameras")
            stack.enter_context(cameras)
        sink = stack.enter_context(run.recorded())
        begun(source)
        show = lambda _: progress.update(source.at_s, source.length_s, source.stage)  # noqa: E731
        over = lambda status: any((unseen(), tally(status)))  # noqa: E731
        timing = run.follow(source, sink, over, show, enabled=lambda: enabled() and not progress.cancelled())
    if cameras is not None and cameras.failed is not None and not unseen.why:
        raise cameras.failed  # after the end, while the rest was written
    finished = source.stage == "finished"
    return extended(
        run.output(tally, timing, unseen.why or tally.stopped_by(finished=finished)),
        RunMotionOutput,
        finished=finished,
        share=source.at_s / source.length_s,
        took_s=tally.took_s,
        joints="" if run.recording is None else str(run.recording.parent / READINGS),
        frames="" if frames is None else str(frames.out),
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


def checked_motion(motion: Motion, guard: Guard, where: str) -> Motion:
    """Return the motion of a file. Raises where it is none of this arm, or leaves a limit at any speed."""
    if motion.q.shape[1] != guard.arm.n:
        raise Inconsistent(
            f"{where} moves {motion.q.shape[1]} joints, {guard.arm.name} has {guard.arm.n}",
            consequence="Nothing is moved",
            cure="Plan a motion for this arm",
        )
    if len(motion.t_s) < FEWEST_ROWS:
        raise NotEnoughData(f"{where} holds {len(motion.t_s)} rows", consequence="Nothing is moved")
    space = Space(guard.arm, guard.limits, guard.bounds)
    still = np.zeros(guard.arm.n)
    for i in np.unique(np.searchsorted(motion.t_s, np.arange(motion.t_s[0], motion.t_s[-1], CHECKED_S))).tolist():
        found = space.at(motion.q[i], still, still, in_space=False)
        if found.outside().any():
            raise Inconsistent(
                f"{where}: at {motion.t_s[i]:.2f} s the arm would stand {found.describe()}",
                consequence="Nothing is moved",
                cure="Plan it with the limits that it is run with (--limits)",
            )
    return motion
