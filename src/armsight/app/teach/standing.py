"""A path taught before cameras that stand, without a robot; or taken from poses that were measured already."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from scipy.spatial.transform import RigidTransform

from armsight.app.measure.run import target_of
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.motion import StandingJob, TeachJob
from armsight.app.schemas.teach import TeachOutput
from armsight.app.sources.complex_images import complex_pairs
from armsight.app.sources.frames import open_pairs, open_source
from armsight.app.teach.job import Begun, save, saved
from armsight.control.teach import PathRecorder, StandingRig
from armsight.drivers import CameraSettings, PairSource
from armsight.errors import UsageError
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.measure.tracker import TargetTracker
from armsight.optics import Rig
from armsight.records import Frame, Progress, Silent, Target, TargetPose
from armsight.store import World, read_poses, read_rig, read_world

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
    raised. Raises UsageError, also where the rig's place is not told, DataRefused, DeviceFailed; NotEnoughData for less
    than two poses.
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
    setup = Setup(rig=rig, target=target, settings=SpotSettings(colour=target.colour), overlaid=overlaid)
    prepare(progress)
    if not job.wait:
        recorder.start()
    begun(recorder)
    try:
        with pairs:
            stopped_by = _taught(recorder, setup, pairs, seen_by.seconds_s, progress, seen)
    except BaseException:
        if len(recorder) > 1:
            save(job, recorder)
        raise
    return saved(job, recorder, stopped_by)


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
    told_s = -1.0
    for pair in pairs:
        pose = tracker.take(*pair).pose
        recorder.observe(pose, pose.t_s)
        seen(pose)
        first_s = pose.t_s if first_s is None else first_s
        if time.monotonic() - told_s > 0.2:
            told_s = time.monotonic()
            progress.update(pose.t_s - first_s, 0.0 if seconds_s is None else seconds_s, f"{len(recorder)} poses")
        if progress.cancelled():
            return "operator"
        if seconds_s is not None and pose.t_s - first_s >= seconds_s:
            return "time"
    return "end"
