"""Teaching a path by showing: to standing cameras, or while the arm follows the target."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.servo import Mount, ServoSource
from armsight.control.status import QueueSink
from armsight.control.teach import CarriedRig, PathRecorder, RigPose, StandingRig
from armsight.drivers import MomentSource, Views
from armsight.errors import Inconsistent, StaleData, UsageError
from armsight.fields import Doc
from armsight.file_names import PATH, TARGETS, TEACH
from armsight.kinematics import Arm
from armsight.measure.consistency.live_cameras import WatchedTracker
from armsight.measure.poses.moments import require_rotation
from armsight.measure.poses.pipeline import Setup
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.servo.run_servo import ServoOutput
from armsight.optics import Rig
from armsight.records import Progress, Target, TargetPose, TaughtPath
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import World, write_poses
from armsight.store.atomic import write_json
from armsight.store.path_file import write_path
from armsight.units import MM

AS_MEASURED = "as measured"
"""The frame of a poses.csv: world where it was measured with a world.yaml, else the cameras' own."""
Seen = Callable[[TargetPose], object]
"""Is told of each pose as it is measured, in rig axes."""


@output
class TeachResult(Output):
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
    taught: TaughtPath

    def summary(self) -> Iterator[Shown]:
        """Yield how the arm followed, and what the path is."""
        if self.servo is not None:
            yield from self.servo.summary()
        yield (
            f"{self.n_rows} poses over {self.length_m / MM:.1f} mm in {self.n_stretches} stretches, frame: "
            f"{self.parent}; of the frames while recording {self.n_ok} were taken, {self.n_position_only} told the "
            f"place only, {self.n_lost} did not show the target, {self.n_unplaced} came when the arm's place was not "
            f"known; ended by: {self.stopped_by}. Path: {self.path}"
        )
        if self.parent == "base":
            yield "note: the path is in base axes: play it with --frame base"
        elif self.parent != "world":
            yield "note: without --world the path is in the axes of poses.csv: play it only if those are the world's"

    @property
    def exit_code(self) -> int:
        """As that of the servo."""
        return 0 if self.servo is None else self.servo.exit_code

    def write(self, folder: Path) -> None:
        """Write teach.json into a folder."""
        write_json(folder / TEACH, self.to_dict())


NOT_TAUGHT = "Nothing is taught"


def require_speed(path_speed_m_s: float | None) -> None:
    """Raise UsageError for what is no speed."""
    if path_speed_m_s is not None and not (math.isfinite(path_speed_m_s) and path_speed_m_s > 0.0):
        raise UsageError(
            f"--path-speed {path_speed_m_s:g} is no speed",
            consequence=NOT_TAUGHT,
            cure="Give m/s, more than zero",
        )


def require_eyes(rig: Rig | None, target: Target | None, robot: object, handeye: object) -> tuple[Rig, Target]:
    """Return rig and target; raise UsageError where one is missing, or the target shows no rotation."""
    if rig is None or target is None or (robot is not None and handeye is None):
        needed = "--rig, --target" + (" and --handeye" if robot is not None else "")
        raise UsageError(f"{needed} are needed", consequence=NOT_TAUGHT, cure="Give them, or --from poses.csv")
    require_rotation(target, NOT_TAUGHT)
    return rig, target


def refuse_beside(what: str, others: Mapping[str, object]) -> None:
    """Raise UsageError for options that mean nothing beside another."""
    given = ", ".join(f"--{name}" for name, value in others.items() if value is not None)
    if given:
        raise UsageError(f"with {what}, {given} means nothing", consequence=NOT_TAUGHT, cure="Leave it out")


def at_tip(tip_m: Array | None) -> RigidTransform:
    """Return T_target_tip of a tip (3,) in target axes, m; None: the target's origin."""
    return RigidTransform.identity() if tip_m is None else RigidTransform.from_translation(tip_m)


def standing_recorder(world: World | None, tip_m: Array | None, *, every: int, mean: bool) -> PathRecorder:
    """Return what records before cameras that stand; world: None: the path is in the axes of the poses."""
    T = RigidTransform.identity() if world is None else world.T_parent_rig
    parent = AS_MEASURED if world is None else world.parent
    return PathRecorder(StandingRig(T_world_rig=T), at_tip(tip_m), every=every, mean=mean, parent=parent)


class Lesson:
    """A path while it is taught; out: where its files go, None: nowhere. speed_m_s: written into it."""

    def __init__(self, recorder: PathRecorder, out: Path | None, speed_m_s: float | None = None) -> None:
        self.recorder = recorder
        self._out = out
        self._speed_m_s = np.nan if speed_m_s is None else speed_m_s

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Write the files of what was taught until a failure."""
        try:
            yield
        except BaseException:
            if len(self.recorder) > 1:
                self.save()
            raise

    def save(self) -> TaughtPath:
        """Write path.csv and targets.csv, and return the path. Raises NotEnoughData for less than two poses."""
        path = self.recorder.path(speed_m_s=self._speed_m_s)
        if self._out is not None:
            self._out.mkdir(parents=True, exist_ok=True)
            write_path(self._out / PATH, path)
            write_poses(self._out / TARGETS, self.recorder.targets())
        return path

    def result(self, stopped_by: str, servo: ServoOutput | None = None) -> TeachResult:
        """Write the files and return the figures. Raises NotEnoughData for less than two poses."""
        path, counts = self.save(), self.recorder.counts
        return TeachResult(
            state=None if servo is None else servo.state,
            n_cycles=0 if servo is None else servo.n_cycles,
            late=0 if servo is None else servo.late,
            stopped_by=stopped_by,
            path="" if self._out is None else str(self._out / PATH),
            parent=path.parent,
            n_rows=len(path),
            n_stretches=self.recorder.stretches,
            length_m=float(path.length_m[-1]),
            n_ok=counts.ok,
            n_doubtful=counts.doubtful,
            n_position_only=counts.position_only,
            n_lost=counts.lost,
            n_unplaced=counts.unplaced,
            servo=servo,
            taught=replace(path, parent="world") if path.parent == AS_MEASURED else path,
        )


def require_world(world: World | None) -> None:
    """Raise UsageError where nobody says where the cameras stand."""
    if world is None:
        raise UsageError(
            "where the cameras stand is not said",
            consequence="The path would be in their own axes, where no arm can run it, and nothing is taught",
            cure="Give --world world.yaml, made with: armsight calibrate robot-world",
        )


def require_moments(moments: tuple[MomentSource, bool] | None) -> tuple[MomentSource, bool]:
    """Return the moments. Raises UsageError where they are not said."""
    if moments is None:
        raise UsageError(
            "which cameras see the target is not said",
            consequence=NOT_TAUGHT,
            cure="Give --left and --right, --camera NAME=SRC for each of another rig, --image for a mirror rig, or "
            "--from poses.csv",
        )
    return moments


def teach_standing(
    lesson: Lesson,
    setup: Setup,
    moments: MomentSource,
    seconds_s: float | None,
    progress: Progress,
    *,
    seen: Seen = lambda _: None,
) -> TeachResult:
    """Measure frame after frame until they end or progress is cancelled, and record the tip's path.

    seconds_s: of the frames' own time. What was taught before a failure is in the files when the error is raised.
    Raises DataRefused, DeviceFailed; NotEnoughData for less than two poses.
    """
    prepare(progress, views=not setup.rig.is_pair)
    with lesson.kept(), moments:
        tracker = WatchedTracker(setup)
        stopped_by = _taught(lesson.recorder, tracker, moments, seconds_s, progress, seen)
        trusted_s = tracker.trusted_s
        try:
            tracker.finish("Teaching ends; the path holds what was taught before")
        except Inconsistent:
            lesson.recorder.forget_since(trusted_s)
            raise
    return lesson.result(stopped_by)


def _taught(
    recorder: PathRecorder,
    tracker: WatchedTracker,
    moments: Iterable[Views],
    seconds_s: float | None,
    progress: Progress,
    seen: Seen,
) -> str:
    """Give every moment's pose to the recorder, until a camera is wrong; return why it ended."""
    first_s: float | None = None
    shown_s = -1.0
    for moment in moments:
        pose = tracker.take(*moment).pose
        recorder.observe(pose, pose.t_s)
        seen(pose)
        if tracker.contradictions:
            break
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

    def __init__(self, tip_m: Array | None, *, every: int, mean: bool) -> None:
        self._rig_pose: RigPose | None = None
        self._clock: Clock | None = None
        self._sink: QueueSink | None = None
        self.recorder = PathRecorder(self._placed, at_tip(tip_m), every=every, mean=mean, notify=self._note)

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

    def forget_since(self, t_s: float) -> None:
        """Forget what was exposed after t_s."""
        self.recorder.forget_since(t_s)

    def _placed(self, t_s: float) -> RigidTransform:
        """Return where the rig is, once the servo knows."""
        if self._rig_pose is None:
            raise StaleData("the servo has not begun", consequence="Where the cameras are is not known")
        return self._rig_pose(t_s)

    def _note(self, text: str) -> None:
        if self._sink is not None and self._clock is not None:
            self._sink.event(self._clock.now_s(), text, "info", "teach")
