"""A tool's tip found while the operator pivots it: the standard deviation is told after every pose, until it is small
enough."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.tooltip import TipRecording
from armsight.calibrate.tooltip_result import PivotCalibration
from armsight.drivers import MomentSource
from armsight.errors import NotEnoughData
from armsight.measure.poses.moments import TargetTracker
from armsight.measure.poses.pipeline import Setup
from armsight.records import PoseStatus, Progress, TargetPose
from armsight.records.output import extended

APART_RAD = 0.03
"""Turn since the last pose taken: poses closer than 2 degrees tell nearly the same twice."""


def pivot(setup: Setup, pairs: MomentSource, recording: TipRecording, progress: Progress) -> PivotCalibration:
    """Return the tip from frames while the tool pivots, as soon as it is known well enough.

    Stops where every coordinate's standard deviation is below the goal, at the end of the frames, or when cancelled.
    Raises NotEnoughData where the poses do not tell the tip, DeviceFailed.
    """
    tracker = TargetTracker(setup)
    with pairs:
        recording, taken = pivoted((tracker.take(*moment).pose for moment in pairs), recording, progress)
    if recording.latest is None:
        raise NotEnoughData(
            f"the tip was not found from {len(taken)} poses: {recording.waiting}",
            consequence="No tip is given",
            cure="Rest the tool's end on one point, and turn the tool by 20 degrees and more to several sides",
        )
    goal = {"goal_m": recording.good_m, "reached": recording.good_enough}
    return extended(recording.latest, PivotCalibration, **goal, taken=tuple(taken))


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
