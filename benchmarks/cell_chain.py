"""The chain of single calibrations in a simulated cell: board, lights, then the arm measured at rests.

tests/truth/cell_world.py makes the cell. What the chain is given is the best that the same cameras can hand out: boards
and arm stand still, nobody mixes up which spot is which, and every picture of a rest is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, ArmResult, calibrate_arm
from armsight.calibrate.cameras import calibrate_stereo
from armsight.calibrate.handeye import PosePairs, calibrate_eye_to_hand
from armsight.calibrate.light_target import LitFrame, calibrate_target
from armsight.kinematics import Arm, fk
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup
from armsight.optics import Rig
from armsight.records import BoardView, PoseStatus, Spots, TargetKind, board_target
from cell_records import Calibrated, arm_of, called_as_built, nominal_axes

Array = NDArray[np.float64]
BOARDS, PICTURES, PER_REST = 60, 3600, 30
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
PRINTED = 1e-3
"""Scale of a board from an office printer whose squares were measured with a ruler: 0.2 mm over 200 mm."""
CORNER_PX = 0.1
"""A good detector's corners are no worse than this, however large the spots' noise is."""


def board_views(rng: np.random.Generator, truth: Any, scale: float) -> tuple[list[BoardView], list[BoardView]]:
    """Return what both cameras see of a board that stands still in places all over their images.

    scale: of the board as it was printed, over what it is said to be.
    """
    cameras = (truth.left, truth.right)
    T = truth.left.T_base_camera
    centre = truth.tips(truth.samples).mean(axis=0)
    far = float(np.linalg.norm(centre - T[:3, 3]))
    X = scale * (BOARD.xyz_m - BOARD.xyz_m.mean(axis=0))
    out: tuple[list[BoardView], list[BoardView]] = ([], [])
    fx, fy, cx, cy = truth.left.intrinsics[:4]
    w, h = truth.left.size
    while len(out[0]) < BOARDS:
        u, v, z = rng.uniform([0.0, 0.0, 0.45 * far], [w, h, 1.1 * far])
        axis = rng.normal(size=2)
        tilt = np.array([*axis / np.linalg.norm(axis), 0.0]) * rng.uniform(0.0, np.deg2rad(45.0))
        turn = Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0.0, 0.0, rng.normal(0.0, 0.3)])
        middle = np.array([(u - cx) / fx * z, (v - cy) / fy * z, z])
        points = (turn.apply(X) + middle) @ T[:3, :3].T + T[:3, 3]
        normal = T[:3, :3] @ turn.apply([0.0, 0.0, -1.0])
        uv = [camera.project(points) for camera in cameras]
        if not all(
            camera.inside(one, 8.0).all() and camera.facing(points.mean(axis=0), normal) < np.deg2rad(60.0)
            for camera, one in zip(cameras, uv, strict=True)
        ):
            continue
        for side, camera in enumerate(cameras):
            sigma = min(camera.noise_px, CORNER_PX)
            out[side].append(
                BoardView(
                    uv_px=uv[side] + rng.normal(0.0, sigma, uv[side].shape),
                    index=np.arange(len(X)),
                    sigma_px=sigma * camera.claim,
                    width=camera.size[0],
                    height=camera.size[1],
                    source=f"{side}-{len(out[side])}",
                )
            )
    return out


@dataclass(frozen=True, kw_only=True)
class Rests:
    """Places (r, 6) of the joints and, of each, the spots of both cameras by light: uv (r, frames, 2, 4, 2), NaN where
    not seen, and their claimed standard deviations (2,)."""

    q: Array
    uv: Array
    sigma_px: Array


def rests_of(rng: np.random.Generator, truth: Any, encoder_rad: float, count: int, each: int) -> Rests:
    """Return pictures of the target at rests all over the work volume, with the detector's noise and its wild spots."""
    q = truth.places[rng.choice(len(truth.places), count, replace=len(truth.places) < count)]
    t = np.arange(count)[:, None] * 3.0 + np.arange(each) / 30.0
    joints = np.repeat(q, each, axis=0) + truth.wander(t.ravel())
    T = truth.arm.flange(joints)
    points = np.einsum("mij,lj->mli", T[:, :3, :3], truth.lights) + T[:, None, :3, 3]
    out = np.empty((count * each, 2, len(truth.lights), 2))
    for side, camera in enumerate((truth.left, truth.right)):
        uv = camera.project(points)
        uv += rng.normal(0.0, camera.noise_px, uv.shape)
        wild = rng.random(uv.shape[:2]) < 0.01
        uv[wild] += rng.uniform(-3.5, 3.5, (int(wild.sum()), 2))
        uv[~camera.inside(uv)] = np.nan
        out[:, side] = uv
    logged = q + rng.normal(0.0, encoder_rad / np.sqrt(each), q.shape)
    sigma = np.array([camera.noise_px * camera.claim for camera in (truth.left, truth.right)])
    return Rests(q=logged, uv=out.reshape(count, each, 2, -1, 2), sigma_px=sigma)


def lit_frames(rests: Rests) -> list[LitFrame]:
    """Return the first frame of each rest that shows all lights."""
    out = []
    for k, uv in enumerate(rests.uv[:, 0]):
        if np.isfinite(uv).all():
            left, right = (Spots.of_centres(uv[s], rests.sigma_px[s] ** 2 * np.eye(2)) for s in (0, 1))
            out.append(LitFrame(name=str(k), left=left, right=right))
    return out


@dataclass(frozen=True, kw_only=True)
class RestPoses:
    """Joints (r, 6), and the mean pose T_rig_target of each rest with its covariance (r, 6, 6)."""

    q: Array
    T: RigidTransform
    covariance: Array


def measured(rests: Rests, setup: Setup) -> RestPoses:
    """Return the mean of the poses of each rest's frames; the outer ones by position are left out."""
    q, places, turns, spreads = [], [], [], []
    for joints, frames in zip(rests.q, rests.uv, strict=True):
        poses = []
        for uv in frames:
            seen = [np.isfinite(uv[s]).all(axis=1) for s in (0, 1)]
            left, right = (Spots.of_centres(uv[s][seen[s]], rests.sigma_px[s] ** 2 * np.eye(2)) for s in (0, 1))
            pose = measure_spots(setup, 0.0, left, right).pose
            if pose.status is PoseStatus.OK:
                poses.append(pose)
        if len(poses) < 5:
            continue
        T = np.array([np.asarray(pose.T_parent_target) for pose in poses])
        off = np.linalg.norm(T[:, :3, 3] - np.median(T[:, :3, 3], axis=0), axis=1)
        kept = off <= 3.0 * np.median(off)
        q.append(joints)
        places.append(T[kept, :3, 3].mean(axis=0))
        turns.append(Rotation.from_matrix(T[kept, :3, :3]).mean())
        spreads.append(np.mean([np.asarray(pose.covariance) for pose in poses], axis=0) / kept.sum())
    T_rig_target = RigidTransform.from_components(np.array(places), Rotation.concatenate(turns))
    return RestPoses(q=np.array(q), T=T_rig_target, covariance=np.array(spreads))


def by_arm(nominal: Arm, poses: RestPoses) -> ArmResult:
    """Return the calibrated arm, base and tool; its world is the rig."""
    points = ArmPoints(
        q=poses.q,
        xyz_m=poses.T.translation,
        rotation=poses.T.rotation.as_matrix(),
        covariance=poses.covariance[:, :3, :3],
    )
    return calibrate_arm(nominal, points)


def by_hand_eye(arm: Arm, poses: RestPoses) -> RigidTransform:
    """Return T_base_rig by hand-eye calibration with the calibrated arm's poses."""
    bare = arm.based()
    flange = fk(bare, poses.q) @ np.linalg.inv(bare.T_flange_tool.as_matrix())
    pairs = PosePairs(
        T_base_flange=RigidTransform.from_matrix(flange),
        T_camera_target=poses.T,
        names=tuple(map(str, range(len(poses.q)))),
        camera_covariance=poses.covariance,
    )
    return calibrate_eye_to_hand(pairs).T_parent_camera


@dataclass(frozen=True, kw_only=True)
class Chain:
    """The chain's results: with T_base_rig of the arm's calibration, and of the hand-eye calibration."""

    by_arm: Calibrated
    by_hand_eye: Calibrated
    rig: Rig
    level: str
    rms_px: float


def chain(world: Any, made: ModuleType, *, printed: bool) -> Chain:
    """Calibrate the world's cell step by step, with PICTURES pairs of pictures in all; printed: by a printed board."""
    rng = np.random.default_rng([world.seed, 77])
    scale = 1.0 + (PRINTED * np.random.default_rng([world.seed, 78]).normal() if printed else 0.0)
    truth, nominal = world.truth, arm_of(world)
    stereo = calibrate_stereo(*board_views(rng, truth, scale), BOARD)
    rests = rests_of(rng, truth, made.ENCODER_RAD, (PICTURES - BOARDS) // PER_REST, PER_REST)
    target = called_as_built(calibrate_target(stereo.rig, lit_frames(rests), len(truth.lights)).target, world)
    poses = measured(rests, Setup(rig=stereo.rig, target=target))
    done = by_arm(nominal, poses)
    common = {
        "rig": stereo.rig,
        "target": target,
        "T_nominal": nominal_axes(target, world),
        "commanded": partial(fk, done.arm.based()),
    }
    return Chain(
        by_arm=Calibrated(**common, T_base_rig=done.arm.T_world_base.inv()),
        by_hand_eye=Calibrated(**common, T_base_rig=by_hand_eye(done.arm, poses)),
        rig=stereo.rig,
        level=done.level,
        rms_px=stereo.rms_px,
    )
