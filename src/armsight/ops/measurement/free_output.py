"""The files and the report of a target measured by cameras that run free."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from armsight.arrays import Array
from armsight.errors import NotEnoughData, Unseen
from armsight.file_names import MEASURE, REPORT
from armsight.measure.poses.setup import Setup
from armsight.measure.results import CameraPart, FrameTime, FreeRunning, MeasureResult, believed, grounds_of
from armsight.ops.measurement.collector import Zoomed
from armsight.ops.measurement.free_poses import KINDS, MovingPose
from armsight.ops.measurement.free_running import FreeRun, measure_free_running
from armsight.ops.measurement.outputs import Outputs, Velocity, moved_to
from armsight.ops.measurement.run import zooms_of
from armsight.ops.measurement.streams import FrameSources
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.sources.frames import recordings_in
from armsight.records import Points, PoseStatus, Progress, Spots, TargetPose
from armsight.records.result_parts import BothSeconds
from armsight.report.measure import measure_report
from armsight.report.residuals import distance_rms
from armsight.report.run import MeasureRun
from armsight.store import World, write_text
from armsight.store.atomic import write_json
from armsight.units import MM, MS

OWN_TIME = "each view at its own time"


def measure_free(
    setup: Setup,
    frames: FrameSources,
    out: Path | None,
    *,
    when: Array | float | None,
    progress: Progress,
    world: World | None = None,
    facts: Sequence[tuple[str, str]] = (),
    zoomed: Zoomed,
) -> MeasureResult:
    """Measure a moving target from views at their own times, into the folder out where there is one. See run.

    when: times (k,), or how many poses a second; None: at the first camera's frames.
    """
    streams = frames.streams(setup.rig, colour=setup.target.colour is not None)
    prepare(progress)
    start_s = time.perf_counter()
    at_s, rate_hz = (None, when) if isinstance(when, int | float) else (when, None)
    done = measure_free_running(setup, streams, at_s, rate_hz, progress)
    ms = (time.perf_counter() - start_s) / MS / sum(len(stream.t_s) for stream in streams)
    poses = tuple(moved_to(one.pose, world) for one in done.poses)
    if all(pose.status is PoseStatus.LOST for pose in poses):
        cure = f"Check that the times of --at are those of the {setup.rig.names[0]} camera's stamps"
        raise NotEnoughData("none of the times asked for is near a view", consequence="There is no pose", cure=cure)
    outputs = _written(out, setup, poses, done, world)
    left_over = np.vstack(list(done.residuals.values()))[:, 1:] if done.residuals else np.empty((0, 2))
    rms_px = float(np.sqrt(np.mean(np.sum(left_over**2, axis=1)))) if len(left_over) else None
    found = outputs.summary(
        setup,
        poses,
        done.consistency,
        grounds_of(poses),
        (rms_px, FrameTime(median=ms, p99=None), done.n_aside),
        timing=done.figures,
        zoom=zooms_of(zoomed),
        by_camera=None if setup.rig.is_pair else _by_camera(setup, done, [len(stream.t_s) for stream in streams]),
    )
    if out is not None:
        progress.update(0, 0, "writing the report")
        write_text(out / REPORT, measure_report(_report(setup, frames, world, done, found, facts)))
        write_json(out / MEASURE, found.to_dict())
    return found


def _by_camera(setup: Setup, done: FreeRun, n_frames: Sequence[int]) -> dict[str, CameraPart]:
    """Return what each camera had of the run."""
    why = {name: one.words for one in done.consistency.left_out for name in one.names}
    return {
        name: CameraPart(
            n_frames=n,
            n_used=sum(view.side == side for view in done.views),
            rms_px=distance_rms([rows[:, 1:]]) if len(rows := done.residuals[name]) else None,
            left_out=why.get(name),
        )
        for side, (name, n) in enumerate(zip(setup.rig.names, n_frames, strict=True))
    }


def _written(
    out: Path | None, setup: Setup, poses: Sequence[TargetPose], done: FreeRun, world: World | None
) -> Outputs:
    """Write the rows of poses in the world's frame, and of the views that they come from."""
    with Outputs(out, world=world, moving=True) as outputs:
        for pose, one in zip(poses, done.poses, strict=True):
            points = _points(setup, one.pose) if pose.status.size == 6 else None
            outputs.row(pose, points, KINDS.get(pose.why, Unseen.OTHER), _velocity(one, world))
        for view in done.views:
            names = [setup.model.names[k] for k in view.lights.tolist()]
            outputs.spots(view.t_s, setup.rig.names[view.side], names, Spots.of_centres(view.uv_px, view.cov_px2))
    return outputs


def _velocity(one: MovingPose, world: World | None) -> Velocity:
    """Return the velocity of a pose of rig axes and its standard deviations in the world's; None where not known."""
    if world is None or one.velocity is None or one.velocity_std is None:
        return one.velocity, one.velocity_std
    R = world.T_parent_rig.rotation.as_matrix()
    velocity = np.concatenate([R @ one.velocity[:3], R @ one.velocity[3:]])
    variances = np.concatenate([R**2 @ one.velocity_std[:3] ** 2, R**2 @ one.velocity_std[3:] ** 2])
    return velocity, np.sqrt(variances)


def _points(setup: Setup, pose: TargetPose) -> Points:
    """Return where a pose puts the lights, in rig axes."""
    T, C = np.asarray(pose.T_parent_target), np.asarray(pose.covariance)
    arm = setup.model.xyz_m @ T[:3, :3].T
    covariance = []
    for x, y, z in arm.tolist():
        J = np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])
        covariance.append(J @ C @ J.T)
    return Points(names=setup.model.names, xyz_m=arm + T[:3, 3], covariance_m2=np.array(covariance))


def _report(
    setup: Setup,
    frames: FrameSources,
    world: World | None,
    done: FreeRun,
    found: MeasureResult,
    given: Sequence[tuple[str, str]],
) -> MeasureRun:
    figures, poses = done.figures, found.poses.poses
    given_names = [str(one) for one in (*frames.named, frames.left_spots, frames.right_spots) if one is not None]
    facts = [("frames", f"{' and '.join(given_names)}, {OWN_TIME}"), *given, *_clock_facts(figures)]
    if figures.chi2_per_dof is not None:
        facts.append(("spots about the motion", f"chi-square {figures.chi2_per_dof:.2f} per degree of freedom"))
    if figures.speed_m_s is not None and figures.nearest_pairs_m is not None:
        facts.append(("speed", f"{figures.speed_m_s / MM:.0f} mm/s RMS"))
        cost = f"the target moves {figures.nearest_pairs_m / MM:.2f} mm (RMS) between the frames nearest in time"
        facts.append(("frames in pairs", cost))
    return MeasureRun(
        poses=poses,
        rig=setup.rig,
        target=setup.target,
        residuals=done.residuals,
        n_aside=done.n_aside,
        median_ms=found.ms_per_frame.median,
        parent="rig" if world is None else world.parent,
        subtitle=f"{len(poses)} poses over {poses[-1].t_s - poses[0].t_s:.1f} s, from "
        f"{_counted(_views(figures))} views, each at its own time",
        facts=facts,
        recordings=recordings_in(*frames.named),
        consistency=believed(found),
        verdict=found.verdict_,
    )


def _views(figures: FreeRunning) -> dict[str, int]:
    """Return the views of each camera."""
    if figures.n_views is not None:
        return figures.n_views._asdict()
    return {name: one.n_views for name, one in (figures.by_camera or {}).items()}


def _counted(views: dict[str, int]) -> str:
    """Return numbers with what they are of: 3 left, 4 top and 5 right."""
    *most, last = [f"{n} {name}" for name, n in views.items()]
    return f"{', '.join(most)} and {last}" if most else last


def _clock_facts(figures: FreeRunning) -> list[tuple[str, str]]:
    """Return when each camera exposed, and how many views there are."""
    views = ("views", f"{_counted(_views(figures))}; found anew {figures.n_starts} times")
    if figures.by_camera is None:
        delay_s, readout_s = figures.delay_s or 0.0, figures.readout_s or BothSeconds(0.0, 0.0)
        late = f"{delay_s / MS:+.2f} ms and {figures.drift_ppm:+.1f} ppm on the left one's"
        read = f"{readout_s.left / MS:.2f} ms left, {readout_s.right / MS:.2f} ms right"
        return [("right camera's stamps", late), ("read-out", read), views]
    first = next(iter(figures.by_camera))
    late_of = [
        (f"{name} camera's stamps", f"{one.delay_s / MS:+.2f} ms and {one.drift_ppm:+.1f} ppm on the {first} one's")
        for name, one in figures.by_camera.items()
        if name != first
    ]
    read = ", ".join(f"{one.readout_s / MS:.2f} ms {name}" for name, one in figures.by_camera.items())
    return [*late_of, ("read-out", read), views]
