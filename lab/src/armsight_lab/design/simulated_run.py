"""One simulated run of a plan: the board is seen, the rig calibrated, the target measured; errors against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.cameras import BoardOptions, calibrate_stereo
from armsight.calibrate.handeye import PosePairs, calibrate_eye_to_hand
from armsight.calibrate.mirrors.calibration import calibrate_mirrors
from armsight.drivers import CELLS, load
from armsight.errors import NotEnoughData
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.measure.poses.board_pose import pose_of_views
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup, rig_slack_px
from armsight.optics import SIDES, Rig, RigKind
from armsight.records import BoardView, PoseStatus, Spots, Target, TargetPose
from armsight.store import parse_board, rig_from_mapping, target_from_mapping
from armsight_lab.batch.jobs import Ended, Job
from armsight_lab.design.planned_handeye import RobotNoise

Rows = Sequence[Sequence[float]]
"""Poses: x, y, z in m, and the quaternion, scalar last."""

HAND_M, HAND_RAD = 0.01, 0.03
"""How far from where it was planned the board is held, each axis: nobody holds it just there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmSpec:
    """An arm as a run is told of it; poses: T_rig_target that tell the rig's place, and their spots' noise."""

    T_base_rig: RigidTransform
    T_flange_target: RigidTransform
    T_flange_tool: RigidTransform
    poses: Rows
    spot_px: Array
    noise: RobotNoise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spec:
    """What a run is told of a plan, and no deviation.

    rig, target: as their files have them. views: T_rig_board. places: T_rig_target; spot_px (m, n, 2): the noise of
    each light there, left and right. lights_m2: covariance of the target's places, None where they are exact.
    """

    rig: Mapping[str, object]
    target: Mapping[str, object]
    board: str
    views: Rows
    corner_px: float
    places: Rows
    spot_px: Array
    relative: bool
    lights_m2: Array | None
    arm: ArmSpec | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """Errors (k, 6) of the poses of one run, in m and rad; NaN where there was none."""

    values: Array

    @classmethod
    def of(cls, rows: Sequence[Sequence[float | None]]) -> Errors:
        """Return those of a run's figures."""
        known = [[np.nan if value is None else value for value in row] for row in rows]
        return cls(values=np.array(known, dtype=np.float64))


def simulate_run(spec: Spec, job: Job, folder: Path) -> Ended:
    """Run a plan once. Raises DataRefused where the calibration does."""
    seed, run = (int(str(job.arguments[name])) for name in ("seed", "run"))
    rng = np.random.default_rng([seed, run])
    truth, target = rig_from_mapping(spec.rig), target_from_mapping(spec.target)
    rig = _calibrated(spec, truth, rng)
    setup = Setup(rig=rig, target=target, overlaid=truth.kind is RigKind.MIRROR, slack_px=rig_slack_px(rig))
    made = _as_made(spec, target, rng)
    measured = _measured(setup, spec, made, spec.places, spec.spot_px, rng)
    if spec.arm is not None:
        errors = _at_tool(setup, spec, spec.arm, made, measured, rng)
    else:
        errors = _in_left(rig, truth, spec.places, measured, made.mean(axis=0))
        if spec.relative:
            errors = _aligned(errors, np.array(spec.places)[:, :3])
    rows = [[float(value) if np.isfinite(value) else None for value in row] for row in errors]
    return Ended(figures={"errors": rows, "lost": int(np.isnan(errors[:, 0]).sum())})


def _seen(
    rig: Mapping[str, object], names: Sequence[str], xyz_m: Array, diameter_m: float | None, poses: Rows
) -> Array:
    """Return the true pixels (frames, n, 2, 2) of points on a body at poses, by the simulation; NaN where not seen."""
    spots = {name: xyz.tolist() for name, xyz in zip(names, xyz_m, strict=True)}
    target: dict[str, object] = {"spots_m": spots, "diameter_m": diameter_m}
    given = {"rig": rig, "target": target, "poses": poses}
    cell = load(CELLS, "led-cell")(seed=0, frames=len(poses), room="dark", pipeline="ideal", given=given)
    out = np.full((len(poses), len(names), 2, 2), np.nan)
    for k in range(len(poses)):
        for s, side in enumerate(SIDES):
            at = cell.centres_px(k, side)
            out[k, :, s] = [at.get(name, (np.nan, np.nan)) for name in names]
    return out


def _calibrated(spec: Spec, truth: Rig, rng: np.random.Generator) -> Rig:
    """Return the rig as armsight calibrates it from the board's corners."""
    board = parse_board(spec.board)
    held = [_held(pose_from_quat(row[:3], row[3:]), rng) for row in spec.views]
    uv = _seen(spec.rig, board.names, board.xyz_m, None, [np.concatenate(xyz_quat(pose)).tolist() for pose in held])
    views: tuple[list[BoardView], list[BoardView]] = ([], [])
    for k, seen in enumerate(uv):
        noisy = seen + rng.normal(0.0, spec.corner_px, seen.shape)
        if all(_inside(truth, noisy[:, s], side) for s, side in enumerate(SIDES)):
            for s, side in enumerate(SIDES):
                views[s].append(_view(truth, noisy[:, s], side, f"view {k + 1}", spec.corner_px))
    if not views[0]:
        raise NotEnoughData("the board is seen whole in none of the simulated views")
    # the rig is the same without the error on pictures left out
    options = BoardOptions(folds=0, lens=truth.left.lens, right_lens=truth.right.lens)
    if truth.kind is RigKind.MIRROR:
        plate = truth.left.plate
        thickness, index = (0.0, 1.5) if plate is None else (plate.thickness_m, plate.index)
        return calibrate_mirrors(*views, board, thickness_m=thickness, index=index, options=options).rig
    return calibrate_stereo(*views, board, options).rig


def _held(pose: RigidTransform, rng: np.random.Generator) -> RigidTransform:
    turn = Rotation.from_rotvec(rng.normal(0.0, HAND_RAD, 3))
    return RigidTransform.from_components(pose.translation + rng.normal(0.0, HAND_M, 3), turn * pose.rotation)


def _inside(rig: Rig, uv: Array, side: str) -> bool:
    camera = rig.camera(side)
    return bool(((uv >= 0.0) & (uv <= np.array([camera.width, camera.height]) - 1.0)).all())


def _view(rig: Rig, uv: Array, side: str, source: str, sigma_px: float) -> BoardView:
    camera = rig.camera(side)
    return BoardView(
        uv_px=uv,
        index=np.arange(len(uv), dtype=np.intp),
        sigma_px=sigma_px,
        width=camera.width,
        height=camera.height,
        source=source,
    )


def _as_made(spec: Spec, target: Target, rng: np.random.Generator) -> Array:
    """Return the target's true points (n, 3): off by their covariance where they were measured."""
    if spec.lights_m2 is None:
        return np.array(target.xyz_m)
    off = rng.multivariate_normal(np.zeros(3 * len(target.names)), spec.lights_m2)
    return np.asarray(target.xyz_m + off.reshape(-1, 3))


def _measured(
    setup: Setup, spec: Spec, made: Array, poses: Rows, sigma: Array, rng: np.random.Generator
) -> list[TargetPose]:
    """Return what armsight measures at poses; sigma (m, n, 2) px of each light and side."""
    target, rig = setup.target, setup.rig
    uv = _seen(spec.rig, target.names, made, target.diameter_m, poses)
    noisy = uv + rng.normal(0.0, 1.0, uv.shape) * sigma[..., None]
    out = []
    for k, seen in enumerate(noisy):
        if target.is_board:
            views = [_view(rig, seen[:, s], side, side, float(sigma[k, 0, s])) for s, side in enumerate(SIDES)]
            out.append(pose_of_views(setup, views[0], views[1], float(k)).pose)
            continue
        inside = [np.isfinite(seen[:, s]).all(axis=1) for s in range(2)]
        spots = [_spots(seen[use, s], sigma[k, use, s]) for s, use in enumerate(inside)]
        if setup.overlaid:
            both = np.concatenate([seen[use, s] for s, use in enumerate(inside)])
            spots = [_spots(both, np.concatenate([sigma[k, use, s] for s, use in enumerate(inside)]))] * 2
        out.append(measure_spots(setup, float(k), spots[0], spots[1]).pose)
    return out


def _spots(uv: Array, sigma: Array) -> Spots:
    return Spots.of_centres(uv, sigma[:, None, None] ** 2 * np.eye(2))


def _in_left(rig: Rig, truth: Rig, poses: Rows, measured: Sequence[TargetPose], middle_m: Array) -> Array:
    """Return the errors (m, 6) in the axes of the left camera; middle_m (3,): of the lights, in target axes."""
    out = np.full((len(measured), 6), np.nan)
    for k, (row, pose) in enumerate(zip(poses, measured, strict=True)):
        true = truth.T_rig_left.inv() * pose_from_quat(row[:3], row[3:])
        out[k] = _error(pose, rig.T_rig_left.inv(), true, middle_m)
    return out


def _error(pose: TargetPose, T_frame_rig: RigidTransform, true: RigidTransform, middle_m: Array) -> Array:
    """Return translation and rotation vector (6,) from a true pose to the measured one; NaN for what is not measured.

    Of a position alone: of the lights' middle.
    """
    out = np.full(6, np.nan)
    if pose.T_parent_target is None or pose.status is PoseStatus.LOST:
        return out
    seen = T_frame_rig * RigidTransform.from_matrix(pose.T_parent_target)
    if pose.status is PoseStatus.OK:
        out[:3] = seen.translation - true.translation
        out[3:] = (seen.rotation * true.rotation.inv()).as_rotvec()
    elif pose.status is PoseStatus.POSITION_ONLY:
        out[:3] = seen.translation - true.apply(middle_m)
    return out


def _aligned(errors: Array, places: Array) -> Array:
    """Return errors (m, 6) without the rigid motion that fits those of the positions best."""
    known = np.isfinite(errors[:, 0])
    off = places - places[known].mean(axis=0)
    G = np.zeros((len(errors), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = np.eye(3)
    for i, (x, y, z) in enumerate(off):
        G[i, :3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    common = np.linalg.lstsq(G[known, :3].reshape(-1, 6), errors[known, :3].ravel(), rcond=None)[0]
    return np.asarray(errors - G @ common)


def _at_tool(
    setup: Setup, spec: Spec, arm: ArmSpec, made: Array, measured: Sequence[TargetPose], rng: np.random.Generator
) -> Array:
    """Return the errors (m, 6) of the tool in the arm's base, the rig's place found from the arm's poses."""
    T_base_rig, T_flange_target, T_flange_tool = arm.T_base_rig, arm.T_flange_target, arm.T_flange_tool
    seen = _measured(setup, spec, made, arm.poses, arm.spot_px, rng)
    said, camera, covariances = [], [], []
    for row, pose in zip(arm.poses, seen, strict=True):
        if pose.status is not PoseStatus.OK or pose.covariance is None or pose.T_parent_target is None:
            continue
        flange = T_base_rig * pose_from_quat(row[:3], row[3:]) * T_flange_target.inv()
        turn = Rotation.from_rotvec(rng.normal(0.0, arm.noise.orientation_rad, 3))
        moved = flange.translation + rng.normal(0.0, arm.noise.position_m, 3)
        said.append(RigidTransform.from_components(moved, turn * flange.rotation))
        camera.append(RigidTransform.from_matrix(pose.T_parent_target))
        shared = pose.systematic_covariance
        covariances.append(pose.covariance if shared is None else pose.covariance - shared)
    found = calibrate_eye_to_hand(PosePairs.of(said, camera, camera_covariance=np.array(covariances)))
    out = np.full((len(measured), 6), np.nan)
    T_target_tool = found.T_parent_target.inv() * T_flange_tool
    for k, (row, pose) in enumerate(zip(spec.places, measured, strict=True)):
        if pose.status is not PoseStatus.OK or pose.T_parent_target is None:
            continue
        true = T_base_rig * pose_from_quat(row[:3], row[3:]) * T_flange_target.inv() * T_flange_tool
        tool = found.T_parent_camera * RigidTransform.from_matrix(pose.T_parent_target) * T_target_tool
        out[k, :3] = tool.translation - true.translation
        out[k, 3:] = (tool.rotation * true.rotation.inv()).as_rotvec()
    return out
