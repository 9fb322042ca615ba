"""Few images: the result from the corners is kept only where images left out prove it better; held against truth."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from armsight.calibrate.handeye import (
    ImageHandEye,
    ObservationModel,
    Setup,
    calibrate_eye_in_hand,
    calibrate_from_views,
)
from armsight.calibrate.handeye.image_comparison import ImageErrors, compare
from armsight.calibrate.handeye.image_model import ImageModel, camera_of, poses_of, poses_of_views
from armsight.calibrate.handeye.images import turned_views
from armsight.calibrate.handeye.pairs import pose
from armsight.records import TargetKind, board_target
from armsight.records.views import symmetries

sys.path.insert(0, str(Path(__file__).parent))
from handeye_scenes import BOARD, CAMERA, CELLS, Scene, error_mm, scene


def calibrated(s: Scene, *, free_camera: bool) -> ImageHandEye:
    return calibrate_from_views(s.views, list(s.robot), CAMERA, BOARD, Setup.EYE_IN_HAND, free_camera=free_camera)


def errors_mm(s: Scene, done: ImageHandEye, *, free_camera: bool) -> tuple[float, float, float]:
    """Errors against truth: from the poses, of the bundle adjustment, of what is kept."""
    model = ImageModel.of(done.from_poses, poses_of_views(s.views, CAMERA, BOARD))
    fit = model.reproject(model.variances().V[done.from_poses.used], CAMERA, free_camera)
    at, camera = poses_of(fit), camera_of(fit, CAMERA) if free_camera else CAMERA
    return (
        error_mm(done.from_poses.T_parent_camera, CAMERA, s),
        error_mm(pose(at[0], at[1]), camera, s),
        error_mm(done.result.T_parent_camera, done.camera, s),
    )


def test_of_few_images_the_kept_result_is_no_worse_than_that_of_the_poses() -> None:
    found = []
    for cell in (CELLS["good robot, noisy corners"], CELLS["noisy robot"]):
        for seed, free in ((0, True), (1, True)):
            s = scene(cell, 6, seed)
            found.append(errors_mm(s, calibrated(s, free_camera=free), free_camera=free))
    poses, bundle, kept = np.array(found).T
    assert (bundle > 1.2 * poses).sum() >= 2  # the control: a bundle that is always kept overfits
    assert (kept <= 1.05 * poses).all()


def test_what_the_corners_know_weighs_the_poses_too_also_of_few_images() -> None:
    gains = []
    for n, seed in ((16, 0), (8, 0)):
        s = scene(CELLS["good robot, noisy corners"], n, seed)
        done = calibrated(s, free_camera=False)
        poses, bundle, kept = errors_mm(s, done, free_camera=False)
        assert kept <= 1.05 * poses
        assert poses < 1.5 * bundle
        pairs = replace(done.from_poses.pairs, camera_covariance=None)
        gains.append(poses / error_mm(calibrate_eye_in_hand(pairs).T_parent_camera, CAMERA, s))
    assert np.median(gains) < 0.8


def test_images_that_no_turn_of_the_board_brings_to_the_robots_poses_are_left_as_they_are() -> None:
    s, board = scene(CELLS["noisy robot"], 8, 0), board_target(TargetKind.CHECKERBOARD, 8, 6, 0.025)
    kept, half = np.flatnonzero(np.arange(54) % 9 < 8), symmetries(board)[1]
    plain = [replace(view, uv_px=view.uv_px[kept], index=np.arange(48)) for view in s.views]
    views = [replace(view, index=half) if k in (1, 4) else view for k, view in enumerate(plain)]
    told, turned = turned_views(views, list(s.robot), CAMERA, board, Setup.EYE_IN_HAND)
    assert turned == 2
    assert all(np.array_equal(view.index, np.arange(48)) for view in told)
    of_others = [s.robot[k] for k in (3, 6, 0, 5, 7, 1, 4, 2)]
    told, turned = turned_views(views, of_others, CAMERA, board, Setup.EYE_IN_HAND)
    assert turned == 0
    assert all(np.array_equal(view.index, given.index) for view, given in zip(told, views, strict=True))


def errors(points_m: np.ndarray, px: np.ndarray) -> ImageErrors:
    return ImageErrors(residuals=np.tile(points_m[:, None], (1, 6)), points_m=points_m, reprojection_px=px)


def test_what_is_kept_by_errors_left_out() -> None:
    rng = np.random.default_rng(0)
    before = rng.uniform(1.0, 2.0, 8)

    def kept(points: np.ndarray, px: np.ndarray, n: int = 8) -> ObservationModel:
        poses, corners = errors(before[:n], before[:n]), errors(points[:n], px[:n])
        return compare({ObservationModel.POSES: poses, ObservationModel.CORNERS: corners}).kept

    assert kept(0.7 * before, 0.7 * before) is ObservationModel.CORNERS
    assert kept(0.7 * before, 1.01 * before) is ObservationModel.POSES  # worse in the image
    assert kept(0.97 * before, 0.97 * before) is ObservationModel.POSES  # better, but by too little of so few
    assert kept(0.7 * before, 0.7 * before, 3) is ObservationModel.POSES  # too few to judge by
    assert (
        kept(np.where(np.arange(8) == 2, np.nan, 0.7 * before), 0.7 * before) is ObservationModel.POSES
    )  # one fold has no fit
    lucky = np.where(np.arange(8) == 0, 0.01, before)  # one image alone is better
    assert kept(lucky, lucky) is ObservationModel.POSES
    many = np.tile(before, 2)
    both = {ObservationModel.POSES: errors(many, many), ObservationModel.CORNERS: errors(0.97 * many, 0.97 * many)}
    assert compare(both).kept is ObservationModel.CORNERS
    freed = compare(both | {ObservationModel.CORNERS_AND_CAMERA: errors(0.95 * many, 0.95 * many)})
    assert freed.kept is ObservationModel.CORNERS
    assert "stays as given" in freed.why


def test_four_images_are_calibrated_from_poses_and_say_so() -> None:
    s = scene(CELLS["noisy robot"], 4, 1)
    done = calibrated(s, free_camera=True)
    assert done.result.comparison is not None
    assert done.result.comparison.kept is ObservationModel.POSES
    assert done.camera is CAMERA
