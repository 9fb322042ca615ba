"""The files and the report of a target measured by cameras that run free."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armsight.app.measure.free_running import KINDS, FreeRun, MovingPose, measure_free_running
from armsight.app.measure.outputs import consistency_output, made_with, moved_pose
from armsight.app.measure.streams import streams_of
from armsight.app.measure.warm_up import prepare
from armsight.drivers import by_side, is_live
from armsight.errors import NotEnoughData
from armsight.file_names import MEASURE, POINTS, POSES, REPORT, SPOTS, TUM
from armsight.geometry import quat_of_matrix
from armsight.measure.poses.setup import Setup
from armsight.measure.results import FrameTime, MeasureOutput, believed, grounds_of
from armsight.ops.sources.bags import read_motion
from armsight.ops.sources.frames import recordings_in
from armsight.optics import SIDES
from armsight.records import Points, PoseStatus, Progress, Spots, TargetPose
from armsight.report import MeasureRun, measure_report
from armsight.store import MovingPosesWriter, PointsWriter, SpotsWriter, World, write_text
from armsight.store.atomic import RowFile, write_json
from armsight.units import MM, MS

if TYPE_CHECKING:
    from armsight.app.requests.measure import MeasureJob


def measure_free(job: MeasureJob, setup: Setup, world: World | None, progress: Progress) -> MeasureOutput:
    """Measure a moving target from views at their own times; write the files that measure writes. See measure."""
    _require_no_settings(job)
    colour = setup.target.colour is not None
    streams = streams_of(
        setup.rig, (job.left, job.right), (job.left_spots, job.right_spots), colour=colour, fps=job.fps
    )
    if job.limit is not None:
        streams = (streams[0].first(job.limit), streams[1].first(job.limit))
    at_s = None if job.at is None else read_motion(job.at, origin_of=job.left or job.right).t_s
    prepare(progress)
    start_s = time.perf_counter()
    done = measure_free_running(setup, streams, at_s, job.rate_hz, progress)
    ms = (time.perf_counter() - start_s) / MS / sum(len(stream.t_s) for stream in streams)
    moved = [_moved(one, world) for one in done.poses]
    if all(one.pose.status is PoseStatus.LOST for one in moved):
        raise NotEnoughData(
            "none of the times asked for is near a view of the target",
            consequence="There is no pose",
            cure="Check that the times of --at are those of the left camera's stamps",
        )
    _write(job.out, setup, moved, done)
    summary = _summary(done, [one.pose for one in moved], ms)
    summary = replace(summary, made_with=made_with(setup.rig, setup.target))
    progress.update(0, 0, "writing the report")
    write_text(job.out / REPORT, measure_report(_report(job, setup, world, done, moved, summary)))
    write_json(job.out / MEASURE, summary.to_dict())
    return summary


def _require_no_settings(job: MeasureJob) -> None:
    """Raise UsageError where something is asked of cameras that are none; live ones streams_of refuses."""
    sources = [text for text in (job.left, job.right) if text is not None]
    if not any(is_live(text) for text in sources):
        for asked in by_side(job.camera_settings):
            asked.require_none(sources[0] if sources else "a table of spots")


def _moved(one: MovingPose, world: World | None) -> MovingPose:
    """Return a moving pose of rig axes in the world's."""
    if world is None:
        return one
    pose = moved_pose(one.pose, world.T_parent_rig, world.parent)
    if one.velocity is None or one.velocity_std is None:
        return replace(one, pose=pose)
    R = world.T_parent_rig.rotation.as_matrix()
    velocity = np.concatenate([R @ one.velocity[:3], R @ one.velocity[3:]])
    variances = np.concatenate([R**2 @ one.velocity_std[:3] ** 2, R**2 @ one.velocity_std[3:] ** 2])
    return MovingPose(pose=pose, velocity=velocity, velocity_std=np.sqrt(variances))


def _write(out: Path, setup: Setup, moved: Sequence[MovingPose], done: FreeRun) -> None:
    with ExitStack() as stack:
        poses = stack.enter_context(MovingPosesWriter(out / POSES))
        points = stack.enter_context(PointsWriter(out / POINTS))
        spots = stack.enter_context(SpotsWriter(out / SPOTS))
        tum = stack.enter_context(RowFile(out / TUM, "# t_s x_m y_m z_m qx qy qz qw"))
        for one, rig_pose in zip(moved, done.poses, strict=True):
            pose, T = one.pose, one.pose.T_parent_target
            poses.write(pose, one.velocity, one.velocity_std)
            if pose.status.size == 6 and T is not None:
                points.write(pose.t_s, _points(setup, rig_pose.pose), status=pose.status)
            if pose.status is PoseStatus.OK and T is not None:
                tum.add(" ".join(repr(value) for value in (pose.t_s, *T[:3, 3].tolist(), *quat_of_matrix(T))))
        for view in done.views:
            names = [setup.model.names[k] for k in view.lights.tolist()]
            spots.write(view.t_s, SIDES[view.side], names, Spots.of_centres(view.uv_px, view.cov_px2))


def _points(setup: Setup, pose: TargetPose) -> Points:
    """Return where a pose puts the lights, in rig axes."""
    T, C = np.asarray(pose.T_parent_target), np.asarray(pose.covariance)
    arm = setup.model.xyz_m @ T[:3, :3].T
    covariance = []
    for x, y, z in arm.tolist():
        J = np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])
        covariance.append(J @ C @ J.T)
    return Points(names=setup.model.names, xyz_m=arm + T[:3, 3], covariance_m2=np.array(covariance))


def _summary(done: FreeRun, poses: Sequence[TargetPose], ms: float) -> MeasureOutput:
    counts = Counter(pose.status for pose in poses)
    left_over = np.vstack(list(done.residuals.values()))[:, 1:] if done.residuals else np.empty((0, 2))
    return MeasureOutput(
        n_frames=len(poses),
        n_ok=counts[PoseStatus.OK],
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
        reprojection_rms_px=float(np.sqrt(np.mean(np.sum(left_over**2, axis=1)))) if len(left_over) else None,
        ms_per_frame=FrameTime(median=ms, p99=None),
        reasons={kind.value: n for kind, n in Counter(KINDS[pose.why] for pose in poses if pose.why).most_common()},
        consistency=consistency_output(done.consistency),
        timing=done.figures,
        grounds=grounds_of(poses),
    )


def _report(
    job: MeasureJob,
    setup: Setup,
    world: World | None,
    done: FreeRun,
    moved: Sequence[MovingPose],
    summary: MeasureOutput,
) -> MeasureRun:
    figures = done.figures
    facts = [
        ("frames", f"{job.left or job.left_spots} and {job.right or job.right_spots}, each view at its own time"),
        ("rig's file", str(job.rig)),
        ("target's file", str(job.target)),
        ("right camera's stamps", f"{figures.delay_s / MS:+.2f} ms and {figures.drift_ppm:+.1f} ppm on the left one's"),
        ("read-out", f"{figures.readout_s.left / MS:.2f} ms left, {figures.readout_s.right / MS:.2f} ms right"),
        ("views", f"{figures.n_views.left} left, {figures.n_views.right} right; found anew {figures.n_starts} times"),
    ]
    if figures.chi2_per_dof is not None:
        facts.append(("spots about the motion", f"chi-square {figures.chi2_per_dof:.2f} per degree of freedom"))
    if figures.speed_m_s is not None and figures.nearest_pairs_m is not None:
        facts.append(("speed", f"{figures.speed_m_s / MM:.0f} mm/s RMS"))
        cost = f"the target moves {figures.nearest_pairs_m / MM:.2f} mm (RMS) between the frames nearest in time"
        facts.append(("frames in pairs", cost))
    return MeasureRun(
        poses=[one.pose for one in moved],
        rig=setup.rig,
        target=setup.target,
        residuals=done.residuals,
        median_ms=summary.ms_per_frame.median,
        parent="rig" if world is None else world.parent,
        subtitle=f"{len(moved)} poses over {moved[-1].pose.t_s - moved[0].pose.t_s:.1f} s, from "
        f"{figures.n_views.left} left and {figures.n_views.right} right views, each at its own time",
        facts=facts,
        recordings=recordings_in(job.left, job.right),
        consistency=believed(summary),
        verdict=summary.verdict_,
    )
