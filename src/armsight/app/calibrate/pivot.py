"""A tool's tip found while the operator pivots it: the standard deviation is told after every pose, until it is small
enough."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.app.live.pace import pace_of
from armsight.app.measure.run import target_of
from armsight.app.requests.calibrate_robot import PivotJob
from armsight.app.sources.frames import open_pairs
from armsight.calibrate.tooltip import MeasuredPoint, TipRecording
from armsight.calibrate.tooltip_result import TipCalibration
from armsight.drivers import PairSource
from armsight.errors import NotEnoughData
from armsight.fields import Doc
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.measure.tracker import TargetTracker
from armsight.records import PoseStatus, Progress, Silent, TargetPose
from armsight.records.output import extended, output
from armsight.store import read_rig, write_poses
from armsight.store.handeye_file import write_tip

APART_RAD = 0.03
"""Turn since the last pose taken: poses closer than 2 degrees tell nearly the same twice."""


@output
class PivotOutput(TipCalibration):
    """armsight calibrate pivot."""

    goal_m: Annotated[float, Doc("Standard deviation of the tip that was good enough, m.")]
    reached: Annotated[bool, Doc("Whether the tip is known so well.")]


def run_pivot(job: PivotJob, progress: Progress | None = None) -> PivotOutput:
    """Measure while the tool pivots; write tip.yaml, and the poses beside it; return the figures as --json gives them.

    Stops where every coordinate's standard deviation is below the goal, at the end of the frames, or when cancelled.
    Raises UsageError, DataRefused (also where the poses do not tell the tip), DeviceFailed.
    """
    recording, tip, taken = find_tip(job, progress)
    write_poses(job.out.with_suffix(".poses.csv"), taken)
    write_tip(job.out, tip, inputs=[job.rig])
    return extended(tip, PivotOutput, goal_m=job.goal_m, reached=recording.good_enough)


def find_tip(job: PivotJob, progress: Progress | None = None) -> tuple[TipRecording, TipCalibration, list[TargetPose]]:
    """Return the recording, the tip and the poses taken; write nothing. Raises as run_pivot."""
    target = target_of(job.target)
    settings, pace = SpotSettings(colour=target.colour), pace_of(job.left, job.right)
    setup = Setup(rig=read_rig(job.rig), target=target, settings=settings, pace=pace)
    pairs = open_pairs(job.left, job.right, colour=target.colour is not None, settings=job.camera_settings)
    point = None if job.point is None else MeasuredPoint(xyz_m=np.asarray(job.point), sigma_m=job.sigma_m)
    with pairs:
        recording, taken = pivoted(
            _poses(setup, pairs), TipRecording(point=point, good_m=job.goal_m), progress or Silent()
        )
    if recording.latest is None:
        raise NotEnoughData(
            f"the tip was not found from {len(taken)} poses: {recording.waiting}",
            consequence="No tip is given",
            cure="Rest the tool's end on one point, and turn the tool by 20 degrees and more to several sides",
        )
    return recording, recording.latest, taken


def _poses(setup: Setup, pairs: PairSource) -> Iterator[TargetPose]:
    tracker = TargetTracker(setup)
    for left, right in pairs:
        yield tracker.take(left, right).pose


def pivoted(
    poses: Iterable[TargetPose], recording: TipRecording, progress: Progress
) -> tuple[TipRecording, list[TargetPose]]:
    """Return the recording after a stream of poses, and those taken: until it is good enough, ends, or is cancelled."""
    taken: list[TargetPose] = []
    for pose in poses:
        if progress.cancelled() or recording.good_enough:
            break
        if pose.status is not PoseStatus.OK or pose.pose is None or not _is_new(pose, taken):
            continue
        taken.append(pose)
        recording = recording.with_pose(pose.pose, pose.t_s)
        progress.update(len(taken), 0, recording.progress())
    return recording, taken


def _is_new(pose: TargetPose, taken: list[TargetPose]) -> bool:
    if not taken or pose.pose is None or taken[-1].pose is None:
        return True
    turn: NDArray[np.float64] = (pose.pose.rotation * taken[-1].pose.rotation.inv()).as_rotvec()
    return float(np.linalg.norm(turn)) >= APART_RAD
