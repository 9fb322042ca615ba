"""Teaching a path by showing: to standing cameras, or while the arm follows the target."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.measure.run import target_of
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.motion import ServoJob, StandingJob, TeachJob
from armsight.app.robot.robot_run import Confirm
from armsight.app.servo.run_servo import ServoOutput, Show, run_servo
from armsight.app.servo.vision import ServoDevices
from armsight.clock import Clock
from armsight.control.servo import Mount, ServoSource
from armsight.control.status import QueueSink
from armsight.control.teach import CarriedRig, PathRecorder, RigPose, StandingRig
from armsight.drivers import CameraSettings, PairSource
from armsight.errors import StaleData, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup, TargetTracker
from armsight.measure.settings import SpotSettings
from armsight.ops.sources.frames import complex_pairs, open_pairs, open_source
from armsight.ops.sources.pace import pace_of
from armsight.optics import Rig
from armsight.records import Frame, Progress, Silent, Target, TargetPose
from armsight.records.output import Output, output
from armsight.store import World, read_poses, read_rig, read_world, write_poses
from armsight.store.atomic import write_json
from armsight.store.path_file import write_path

PATH, TARGETS, SUMMARY = "path.csv", "targets.csv", "teach.json"

Begun = Callable[[PathRecorder], None]
"""Is given the recorder once it is there, so that a key or a page may start, pause, undo and tag."""


@output
class TeachOutput(Output):
    """armsight teach."""

    state: Annotated[str | None, Doc("The guard's last state; null: no robot took part.")]
    n_cycles: Annotated[int, Doc("Cycles of the control loop; 0 without a robot.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    stopped_by: Annotated[str, Doc("Why it ended: time, operator, end (of the frames), or the guard's words.")]
    path: Annotated[str, Doc("The path's file.")]
    parent: Annotated[str, Doc("The frame of its poses: world, base, or as measured: that of poses.csv.")]
    n_rows: Annotated[int, Doc("Poses of the path.")]
    n_stretches: Annotated[int, Doc("Stretches between a start and a pause.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    n_ok: Annotated[int, Doc("Frames whose pose was taken.")]
    n_doubtful: Annotated[int, Doc("Frames whose pose does not fit the claims: not recorded.")]
    n_position_only: Annotated[int, Doc("Frames that told only where the target is: not recorded.")]
    n_lost: Annotated[int, Doc("Frames without the target: not recorded.")]
    n_unplaced: Annotated[int, Doc("Frames at whose exposure the arm's place was not known: not recorded.")]
    servo: Annotated[ServoOutput | None, Doc("How the arm followed; null: none did.")]


def save(job: TeachJob, recorder: PathRecorder) -> None:
    """Write path.csv and targets.csv. Raises NotEnoughData for less than two poses."""
    speed = np.nan if job.path_speed_m_s is None else job.path_speed_m_s
    path = recorder.path(speed_m_s=speed)
    job.out.mkdir(parents=True, exist_ok=True)
    write_path(job.out / PATH, path)
    write_poses(job.out / TARGETS, recorder.targets())


def saved(job: TeachJob, recorder: PathRecorder, stopped_by: str, servo: ServoOutput | None = None) -> TeachOutput:
    """Write the files and return the figures. Raises NotEnoughData for less than two poses."""
    save(job, recorder)
    path, counts = recorder.path(), recorder.counts
    done = TeachOutput(
        state=None if servo is None else servo.state,
        n_cycles=0 if servo is None else servo.n_cycles,
        late=0 if servo is None else servo.late,
        stopped_by=stopped_by,
        path=str(job.out / PATH),
        parent=path.parent,
        n_rows=len(path),
        n_stretches=recorder.stretches,
        length_m=float(path.length_m[-1]),
        n_ok=counts.ok,
        n_doubtful=counts.doubtful,
        n_position_only=counts.position_only,
        n_lost=counts.lost,
        n_unplaced=counts.unplaced,
        servo=servo,
    )
    write_json(job.out / SUMMARY, done.to_dict())
    return done


AS_MEASURED = "as measured"
"""The frame of a poses.csv: world where it was measured with a world.yaml, else the cameras' own."""
Pair = tuple[Frame, Frame]
Seen = Callable[[TargetPose], None]
"""Is told of each pose as it is measured, in rig axes."""


def teach_standing(
    job: TeachJob,
    seen_by: StandingJob,
    progress: Progress | None = None,
    *,
    pairs: PairSource | None = None,
    begun: Begun = lambda _: None,
    seen: Seen = lambda _: None,
) -> TeachOutput:
    """Measure frame after frame until they end or progress is cancelled, and record the tip's path; write job.out.

    pairs: in place of the sources the job names. What was taught before a failure is in the files when the error is
    raised. Raises UsageError, also where the rig's position is not told, DataRefused, DeviceFailed; NotEnoughData for
    less than two poses.
    """
    progress = progress or Silent()
    if seen_by.world is None:
        raise UsageError(
            "where the cameras stand is not said",
            consequence="The path would be in their own axes, where no arm can run it, and nothing is taught",
            cure="Give --world world.yaml, made with: armsight calibrate robot-world",
        )
    rig, target = read_rig(seen_by.rig), target_of(seen_by.target)
    recorder = _recorder(job, read_world(seen_by.world))
    overlaid = False
    if pairs is None:
        pairs, overlaid = _pairs(seen_by, rig, target)
    pace = pace_of(seen_by.left, seen_by.right, seen_by.image)
    setup = Setup(rig=rig, target=target, settings=SpotSettings(colour=target.colour), overlaid=overlaid, pace=pace)
    prepare(progress)
    if not job.wait:
        recorder.start()
    begun(recorder)
    with _kept(job, recorder), pairs:
        stopped_by = _taught(recorder, setup, pairs, seen_by.seconds_s, progress, seen)
    return saved(job, recorder, stopped_by)


@contextmanager
def _kept(job: TeachJob, recorder: PathRecorder) -> Iterator[None]:
    try:
        yield
    except BaseException:
        if len(recorder) > 1:
            save(job, recorder)
        raise


def teach_poses(job: TeachJob, poses: Path, *, world: Path | None = None) -> TeachOutput:
    """Make a path of a poses.csv that was measured; write job.out. Raises BadFile, NotEnoughData.

    world: where the rig stood; None: the path is in the frame of the file, which the file does not tell.
    """
    recorder = _recorder(job, None if world is None else read_world(world))
    recorder.start()
    for pose in read_poses(poses):
        recorder.observe(pose, pose.t_s)
    return saved(job, recorder, "end")


def _recorder(job: TeachJob, world: World | None) -> PathRecorder:
    T = RigidTransform.identity() if world is None else world.T_parent_rig
    parent = AS_MEASURED if world is None else world.parent
    return PathRecorder(StandingRig(T_world_rig=T), job.T_target_tip(), every=job.every, mean=job.mean, parent=parent)


def _pairs(job: StandingJob, rig: Rig, target: Target) -> tuple[PairSource, bool]:
    """Return the pairs of the sources, not yet open, and whether one image holds both views."""
    colour, settings = target.colour is not None, CameraSettings(exposure_s=job.exposure_s)
    if job.image is not None and job.left is job.right is None:
        return complex_pairs(partial(open_source, job.image, colour=colour, settings=settings), rig)
    if job.image is not None or job.left is None or job.right is None:
        raise UsageError(
            "which cameras see the target is not said",
            consequence="Nothing is taught",
            cure="Give --left and --right, --image for a mirror rig, or --from poses.csv",
        )
    return open_pairs(job.left, job.right, colour=colour, settings=settings), False


def _taught(
    recorder: PathRecorder,
    setup: Setup,
    pairs: Iterable[Pair],
    seconds_s: float | None,
    progress: Progress,
    seen: Seen,
) -> str:
    """Give every pair's pose to the recorder; return why it ended."""
    tracker = TargetTracker(setup)
    first_s: float | None = None
    shown_s = -1.0
    for pair in pairs:
        pose = tracker.take(*pair).pose
        recorder.observe(pose, pose.t_s)
        seen(pose)
        first_s = pose.t_s if first_s is None else first_s
        if time.monotonic() - shown_s > 0.2:
            shown_s = time.monotonic()
            progress.update(pose.t_s - first_s, 0.0 if seconds_s is None else seconds_s, f"{len(recorder)} poses")
        if progress.cancelled():
            return "operator"
        if seconds_s is not None and pose.t_s - first_s >= seconds_s:
            return "time"
    return "end"


class TaughtBeside:
    """A recorder beside a servo: is told of each frame, and tells its events to the recording."""

    def __init__(self, job: TeachJob) -> None:
        self._rig_pose: RigPose | None = None
        self._clock: Clock | None = None
        self._sink: QueueSink | None = None
        T_target_tip = job.T_target_tip()
        self.recorder = PathRecorder(self._placed, T_target_tip, every=job.every, mean=job.mean, notify=self._note)

    def begin(self, source: ServoSource, arm: Arm, clock: Clock, sink: QueueSink) -> None:
        """Take the readings that the servo gathers, and what takes events."""
        settings = source.settings
        self._clock, self._sink = clock, sink
        self._rig_pose = (
            CarriedRig(arm=arm, history=source.history, T_flange_rig=settings.T_parent_camera)
            if settings.mount is Mount.EYE_IN_HAND
            else StandingRig(T_world_rig=arm.T_world_base * settings.T_parent_camera)
        )

    def observe(self, pose: TargetPose, exposed_s: float) -> None:
        """Take what a frame shows."""
        self.recorder.observe(pose, exposed_s)

    def _placed(self, t_s: float) -> RigidTransform:
        """Return where the rig is, once the servo knows."""
        if self._rig_pose is None:
            raise StaleData("the servo has not begun", consequence="Where the cameras are is not known")
        return self._rig_pose(t_s)

    def _note(self, text: str) -> None:
        if self._sink is not None and self._clock is not None:
            self._sink.event(self._clock.now_s(), text, "info", "teach")


def teach_following(
    job: TeachJob,
    servo: ServoJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    begun: Begun = lambda _: None,
) -> TeachOutput:
    """Follow the target as run_servo does, and record the path of the tip in world; write job.out.

    What was taught before a failure is in the files when the error is raised. Raises as run_servo; NotEnoughData where
    less than two poses were taught.
    """
    beside = TaughtBeside(job)
    if not job.wait:
        beside.recorder.start()
    begun(beside.recorder)
    with _kept(job, beside.recorder):
        done = run_servo(servo, confirm, show, progress, devices=devices, beside=beside)
    return saved(job, beside.recorder, done.stopped_by, done)
