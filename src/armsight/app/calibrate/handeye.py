"""Pose pairs, images or streams in, where the camera is on the arm out; poses of a pivoting tool in, its tip out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.calibrate.board_images import in_parallel, see_board
from armsight.app.calibrate.cameras import report_path
from armsight.calibrate.handeye import (
    HandEye,
    HandEyeOptions,
    Noise,
    PosePairs,
    Setup,
    TimeOffset,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    calibrate_from_views,
    pairs_of_streams,
    propose,
    verdict,
)
from armsight.calibrate.tooltip import MeasuredPoint, TipCalibration, calibrate_tooltip
from armsight.drivers import list_images, open_source
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.records import BoardView, PoseStatus, Progress, Silent, TargetPose
from armsight.report.handeye_report import handeye_report
from armsight.store import parse_board, read_camera, read_poses, write_text
from armsight.store.handeye_file import (
    named_poses,
    read_pairs,
    read_robot_poses,
    write_handeye,
    write_tip,
)
from armsight.store.schema import pose_mapping


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEyeJob:
    """One of: pairs; images with camera, board and robot; robot_stream with camera_stream (poses.csv files).

    free_camera: fit the intrinsics along with images. propose: how many further poses to propose.
    """

    out: Path
    setup: Setup = Setup.EYE_IN_HAND
    pairs: Path | None = None
    images: str = ""
    camera: Path | None = None
    board: str = ""
    robot: Path | None = None
    robot_stream: Path | None = None
    camera_stream: Path | None = None
    free_camera: bool = False
    propose: int = 0
    workers: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solved:
    result: HandEye
    inputs: Sequence[Path]
    unseen: Sequence[tuple[str, str]] = ()
    offset: TimeOffset | None = None


def calibrate_handeye(job: HandEyeJob, progress: Progress | None = None) -> dict[str, Any]:
    """Calibrate, write handeye.yaml and its report; return the figures as --json gives them.

    Raises UsageError for a call with none or several kinds of input, DataRefused for data that cannot carry the answer,
    Cancelled.
    """
    progress = progress or Silent()
    kinds = [job.pairs is not None, bool(job.images), job.robot_stream is not None]
    if sum(kinds) != 1:
        raise UsageError(
            "give --pairs, or --images (with --camera, --board and --robot), or --robot-stream with --camera-stream"
        )
    if job.pairs is not None:
        solved = _Solved(result=_solve(read_pairs(job.pairs), job.setup), inputs=[job.pairs])
    elif job.images:
        solved = _from_images(job, progress)
    else:
        solved = _from_streams(job)
    content = handeye_content(solved.result, solved.unseen)
    if solved.offset is not None:
        content["time_offset_s"], content["time_offset_std_s"] = solved.offset.offset_s, solved.offset.std_s
    if job.propose:
        content["proposals"] = [
            {"T_base_flange": pose_mapping(p.T_base_flange), "expected_std_m": p.expected_std_m}
            for p in propose(solved.result, job.propose)
        ]
    write_handeye(job.out, solved.result, verdict(solved.result), inputs=solved.inputs)
    files = [("file", item.name) for item in solved.inputs[:20]]
    write_text(report_path(job.out), handeye_report(solved.result, inputs=files))
    return content


def handeye_content(result: HandEye, unseen: Sequence[tuple[str, str]] = ()) -> dict[str, Any]:
    """Return a hand-eye calibration as --json gives it; unseen: images and poses that made no pair, with the reason."""
    row = {name: i + 1 for i, name in enumerate(result.pairs.names)}
    rejected = [{"row": row[name], "name": name, "why": why} for name, why in result.rejected]
    rejected += [{"row": None, "name": name, "why": why} for name, why in unseen]
    content: dict[str, Any] = {
        "setup": str(result.setup),
        **{name: pose_mapping(pose) for name, pose in named_poses(result).items()},
        "std": result.std("camera"),
        "std_target": result.std("target"),
        "n_pairs": len(result.pairs) + len(unseen),
        "n_used": result.n_used,
        "rejected": rejected,
        "residual_rms_m": result.residual_rms_m,
        "residual_rms_rad": result.residual_rms_rad,
        "loo_rms_m": result.loo_rms_m,
        "loo_rms_rad": result.loo_rms_rad,
        "noise": noise_content(result.noise),
        "turning_rms_rad": result.rotation_excitation.rms_rad.tolist(),
        "verdict": verdict(result),
        "advice": list(result.advice),
    }
    if result.scale is not None:
        content["target_scale"] = {"factor": result.scale.factor, "std": result.scale.std, "p": result.scale.p}
    if result.reprojection_rms_px is not None:
        content["reprojection_rms_px"] = result.reprojection_rms_px
    return content


def noise_content(noise: Noise) -> dict[str, Any]:
    """Return the noises with their deviations; null where the data cannot tell them apart."""
    names = ("translation_m", "robot_m", "camera_m", "robot_rad", "camera_rad")
    parts = {name: getattr(noise, name) for name in names}
    return {
        name: {"value": part.value, "std": part.std} if part.known else {"value": None, "at_most": part.value}
        for name, part in parts.items()
    }


def calibrate_tip(
    poses: Path, out: Path, *, point: Sequence[float] | None = None, sigma_m: float = 0.0
) -> dict[str, Any]:
    """Find the tip from a poses.csv, write tip.yaml; return the figures as --json gives them.

    point (3,) in m, sigma_m: where it rests, if measured, and how well. Raises DataRefused.
    """
    read = [pose for pose in read_poses(poses, parent="world") if pose.status is PoseStatus.OK]
    if not read:
        raise NotEnoughData(
            f"{poses}: no pose of status ok", consequence="No tip is given", cure="Record the target again"
        )
    measured = None if point is None else MeasuredPoint(xyz_m=np.asarray(point, float), sigma_m=sigma_m)
    result = calibrate_tooltip([p.pose for p in read if p.pose is not None], _covariances(read), measured)
    write_tip(out, result, inputs=[poses])
    return tip_content(result)


def tip_content(result: TipCalibration) -> dict[str, Any]:
    """Return a tool-tip calibration as --json gives it."""
    content: dict[str, Any] = {
        "tip_m": result.tip_m.tolist(),
        "point_m": result.point_m.tolist(),
        "std": result.std(),
        "residual_rms_m": result.residual_rms_m,
        "n_used": result.n_used,
        "rejected": [{"row": row + 1, "why": why} for row, why in result.rejected],
        "turning_rms_rad": result.turn_rms_rad.tolist(),
    }
    if result.paper_tip_m is not None:
        content["mean_tip_m"] = result.paper_tip_m.tolist()
    return content


def _solve(pairs: PosePairs, setup: Setup, options: HandEyeOptions | None = None) -> HandEye:
    calibrate = calibrate_eye_in_hand if setup is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    return calibrate(pairs, options)


def _from_images(job: HandEyeJob, progress: Progress) -> _Solved:
    if job.camera is None or job.robot is None or not job.board:
        raise UsageError("--images needs --camera camera.yaml, --board BOARD and --robot robot_poses.csv")
    board, camera, robot = parse_board(job.board), read_camera(job.camera), read_robot_poses(job.robot)
    views: list[BoardView] = []
    poses: list[RigidTransform] = []
    unseen: list[tuple[str, str]] = []
    met: set[str] = set()
    with open_source(job.images) as source:
        total = source.total or 0
        for frame, seen in in_parallel(lambda frame: (frame, see_board(frame, board)), source, workers=job.workers):
            name = Path(frame.source).name
            met.add(name)
            if name not in robot:
                unseen.append((name, f"no row of {job.robot.name} names this image"))
            elif isinstance(seen, str):
                unseen.append((name, seen))
            else:
                views.append(seen)
                poses.append(robot[name])
            progress.update(len(met), total, "finding the board")
            if progress.cancelled():
                raise Cancelled(f"stopped after {len(met)} images", consequence="Nothing was written")
    if not met & set(robot):
        raise Inconsistent(
            f"none of the images is named in {job.robot}, which begins with {next(iter(robot), 'nothing')!r}",
            consequence="No image has a robot pose",
            cure="Write the images' file names into the column file",
        )
    unseen += [(name, "there is no such image") for name in robot if name not in met]
    if not views:
        raise NotEnoughData(
            f"the board {job.board} was found in none of the images; {unseen[0][0]}: {unseen[0][1]}",
            consequence="Nothing was calibrated",
            cure="Check the number of inner corners or circles in --board",
        )
    progress.update(0, 0, "solving")
    done = calibrate_from_views(views, poses, camera, board, job.setup, free_camera=job.free_camera)
    return _Solved(result=done.result, inputs=[job.camera, job.robot, *list_images(job.images)], unseen=unseen)


def _from_streams(job: HandEyeJob) -> _Solved:
    if job.robot_stream is None or job.camera_stream is None:
        raise UsageError("--robot-stream needs --camera-stream, both as poses.csv")
    times, poses = [], []
    for path in (job.robot_stream, job.camera_stream):
        read = [p for p in read_poses(path) if p.status is PoseStatus.OK]
        if len(read) < 2:
            raise NotEnoughData(f"{path}: fewer than two poses of status ok", cure="Record the streams again")
        times.append(np.array([p.t_s for p in read]))
        poses.append(RigidTransform.from_matrix(np.stack([p.pose.as_matrix() for p in read if p.pose is not None])))
    pairs, offset = pairs_of_streams(times[0], poses[0], times[1], poses[1])
    return _Solved(result=_solve(pairs, job.setup), inputs=[job.robot_stream, job.camera_stream], offset=offset)


def _covariances(poses: Sequence[TargetPose]) -> np.ndarray | None:
    """Return (n, 6, 6), or None where not every pose brings deviations."""
    found = [p.covariance for p in poses if p.covariance is not None and (np.diag(p.covariance) > 0.0).all()]
    return np.stack(found) if len(found) == len(poses) else None
