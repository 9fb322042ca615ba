"""Images predicted by calibrations that never saw them: from poses, from corners, with the camera freed; same folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.handeye.image_comparison import Basis, ImageComparison, ImageErrors, compare
from armsight.calibrate.handeye.image_model import ImageModel, Poses, camera_of, poses_of
from armsight.calibrate.handeye.pairs import Array, Setup, pose
from armsight.calibrate.handeye.result import HandEye
from armsight.calibrate.handeye.solution import solve_pairs
from armsight.calibrate.handeye.target_views import ViewPoses, poses_of_views
from armsight.errors import DataRefused
from armsight.optics import Camera
from armsight.records import BoardView, Target

MOST_FOLDS = 12
"""Up to so many images each is left out alone; more are left out in so many groups."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageSet:
    """The views (n) of a board, the given camera, and the target's pose in each view."""

    views: Sequence[BoardView]
    camera: Camera
    board: Target
    seen: ViewPoses


def cross_validate_images(result: HandEye, images: ImageSet, *, free_camera: bool) -> ImageComparison:
    """Return which calibration the images prove, by errors at the used images, each left out with its fold.

    All that looks at the images is done again without those of a fold: the fit to the poses with its noises, the noises
    beside the corners', the fit to the corners, the camera where it is freed (Varma and Simon 2006). result: from the
    poses seen. A fold that is not determined, or a fit without a minimum, gives no prediction of its images.
    """
    used = np.flatnonzero(result.used)
    bases = [Basis.POSES, Basis.CORNERS, *([Basis.CORNERS_AND_CAMERA] if free_camera else [])]
    errors = {basis: np.full((len(used), 8), np.nan) for basis in bases}
    fold = np.arange(len(used)) % MOST_FOLDS
    for k in range(int(fold.max()) + 1):
        rows = np.flatnonzero(fold == k)
        rest = result.used.copy()
        rest[used[rows]] = False
        for basis in bases:
            try:
                at, camera = _fitted(basis, result, images, rest)
                errors[basis][rows] = [_missed(at, camera, result, images, i) for i in used[rows].tolist()]
            except (DataRefused, np.linalg.LinAlgError):
                errors[basis][rows] = np.nan
    return compare({basis: ImageErrors.of(rows) for basis, rows in errors.items()})


def _fitted(basis: Basis, result: HandEye, images: ImageSet, rest: NDArray[np.bool_]) -> tuple[Poses, Camera]:
    """Return X and Z from the images of rest (n,), and the camera: as given, or freed with them."""
    arrays = result.pairs.arrays(result.setup)
    by_poses = solve_pairs(arrays, result.setup, keep=rest, known=result.pairs.camera_covariance)
    at = (by_poses.R_X, by_poses.t_x, by_poses.R_Z, by_poses.t_z)
    if basis is Basis.POSES:
        return at, images.camera
    model = ImageModel(setup=result.setup, arrays=arrays, used=rest, seen=images.seen, start=at)
    free = basis is Basis.CORNERS_AND_CAMERA
    fit = model.reproject(model.variances().V[rest], images.camera, free)
    return poses_of(fit), camera_of(fit, images.camera) if free else images.camera


def _missed(at: Poses, camera: Camera, result: HandEye, images: ImageSet, i: int) -> Array:
    """Return the errors (8,) of image i, in the order of ImageErrors.

    The board is seen with the calibration's own camera: a freed camera is judged by where it then puts the board for
    the robot, which no choice of its axes can flatter.
    """
    RX, tX, RZ, tZ = at
    flange = result.pairs.T_base_flange[i]
    flange = flange if result.setup is Setup.EYE_IN_HAND else flange.inv()
    predicted = pose(RX, tX).inv() * flange.inv() * pose(RZ, tZ)
    seen = images.seen.T_camera_target[i]
    if camera is not images.camera:
        seen = poses_of_views([images.views[i]], camera, images.board).T_camera_target[0]
    apart = predicted.apply(images.board.xyz_m) - seen.apply(images.board.xyz_m)
    view = images.views[i]
    px = camera.project(predicted.apply(images.board.xyz_m[view.index])) - view.uv_px
    turn = seen.rotation * predicted.rotation.inv()
    sizes = [np.sqrt((each**2).sum(axis=1).mean()) for each in (apart, px)]
    return np.concatenate([seen.translation - predicted.translation, turn.as_rotvec(), sizes])
