"""Hand-eye calibration from images: of the target's poses in them, or of their corners where images left out prove that
better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cameras.pairing import turns_of
from armsight.calibrate.handeye.advice import advise
from armsight.calibrate.handeye.calibrate import calibrate_eye_in_hand, calibrate_eye_to_hand, places_of
from armsight.calibrate.handeye.consensus import LEAST_SHARE
from armsight.calibrate.handeye.image_comparison import ImageComparison, ImageErrors, ObservationModel, compare
from armsight.calibrate.handeye.image_model import ImageModel, ViewPoses, camera_of, poses_of, poses_of_views
from armsight.calibrate.handeye.kernels import closed_forms
from armsight.calibrate.handeye.known_noise import Restricted
from armsight.calibrate.handeye.noise import noise_beside
from armsight.calibrate.handeye.pairs import MIN_PAIRS, PosePairs, Poses, Setup, pose, stack
from armsight.calibrate.handeye.result import NAMES, HandEyeResult
from armsight.calibrate.handeye.solution import residuals, solve_pairs
from armsight.errors import DataRefused, Inconsistent
from armsight.fitting import Fit
from armsight.optics import Camera
from armsight.records import BoardView, NamedCovariance, Target
from armsight.records.views import symmetries
from armsight.units import DEG


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageHandEye:
    """The result; the camera: as given, or as fitted along where that was kept; and the result from the poses."""

    result: HandEyeResult
    camera: Camera
    from_poses: HandEyeResult


def calibrate_from_views(
    views: Sequence[BoardView],
    T_base_flange: Sequence[RigidTransform],
    camera: Camera,
    board: Target,
    setup: Setup,
    *,
    free_camera: bool = False,
) -> ImageHandEye:
    """Return the hand-eye calibration from board views and the robot's pose at each, same order.

    Both are computed: from the target's poses in the images, and from the corners by bundle adjustment with the robot's
    noise. That of the corners is kept where it is better by cross-validation, else that of the poses: see the result's
    comparison. free_camera: the same with the camera's intrinsics fitted along. Raises as calibrate_eye_in_hand, and
    Inconsistent for images of another size than the camera's.
    """
    if len(views) != len(T_base_flange):
        raise Inconsistent(f"{len(views)} views and {len(T_base_flange)} robot poses do not pair up")
    seen = poses_of_views(views, camera, board)
    pairs = PosePairs.of(
        T_base_flange,
        [seen.T_camera_target[i] for i in range(len(views))],
        [v.source for v in views],
        seen.covariance,
    )
    calibrate = calibrate_eye_in_hand if setup is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    by_poses = calibrate(pairs, target_pitch_m=board.pitch_m or None)
    images = ImageSet(views=views, camera=camera, board=board, seen=seen)
    comparison = cross_validate_images(by_poses, images, free_camera=free_camera)
    by_poses = replace(by_poses, reprojection_rms_px=seen.rms_px, comparison=comparison)
    if comparison.kept is ObservationModel.POSES:
        by_poses = advise(by_poses, board.pitch_m or None)
        return ImageHandEye(result=by_poses, camera=camera, from_poses=by_poses)
    refined, moved = _adjusted(by_poses, images, comparison)
    first = places_of(pairs.T_base_flange)
    if len(first) < len(pairs):  # images at one pose of the robot share its error there, as pairs do
        once = calibrate_from_views(
            [views[i] for i in first], [T_base_flange[i] for i in first], camera, board, setup, free_camera=free_camera
        )
        refined = replace(refined, covariance=once.result.covariance, dof=once.result.dof)
    return ImageHandEye(result=advise(refined, board.pitch_m or None), camera=moved, from_poses=by_poses)


def _adjusted(by_poses: HandEyeResult, images: ImageSet, comparison: ImageComparison) -> tuple[HandEyeResult, Camera]:
    """Return the result from all corners, and the camera, freed where that was proved better."""
    free_camera = comparison.kept is ObservationModel.CORNERS_AND_CAMERA
    model = ImageModel.of(by_poses, images.seen)
    restricted = model.variances()
    fit = model.reproject(restricted.V[by_poses.used], images.camera, free_camera)
    if not free_camera:
        return _refined(by_poses, images.seen, model, restricted, fit), images.camera
    moved = camera_of(fit, images.camera)
    seen = poses_of_views(images.views, moved, images.board)
    pairs = replace(by_poses.pairs, T_camera_target=seen.T_camera_target, camera_covariance=seen.covariance)
    model = replace(model, arrays=pairs.arrays(by_poses.setup), seen=seen)
    refined = _refined(replace(by_poses, pairs=pairs), seen, model, restricted, fit)
    # A freed camera has seen the image that one step leaves out: only folds without it tell its error.
    left_out = refined.left_out.copy()
    left_out[np.flatnonzero(by_poses.used)[comparison.judged]] = comparison.residuals[comparison.judged]
    return replace(refined, left_out=left_out), moved


def _refined(
    result: HandEyeResult, seen: ViewPoses, model: ImageModel, restricted: Restricted, fit: Fit
) -> HandEyeResult:
    """Return the result with the reprojection's answer in place of the pose fit's."""
    at = poses_of(fit)
    corners = np.einsum("nii->i", seen.covariance[result.used]) / result.n_used
    covariance = result.covariance.matrix if fit.covariance is None else fit.covariance.block(NAMES)
    return replace(
        result,
        T_parent_camera=pose(at[0], at[1]),
        T_parent_target=pose(at[2], at[3]),
        covariance=NamedCovariance(names=NAMES, matrix=covariance * result.coverage_factor**2),
        noise=noise_beside(restricted.variances, restricted.covariance, result.noise.lever_m, corners),
        residuals=residuals(model.arrays, *at),
        left_out=model.left_out(at, restricted.V + seen.covariance),
        reprojection_rms_px=seen.rms_px,
    )


# Images predicted by calibrations that never saw them: from poses, from corners, with the camera freed; same folds.

MOST_FOLDS = 12
"""Up to so many images each is left out alone; more are left out in so many groups."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageSet:
    """The views (n) of a board, the given camera, and the target's pose in each view."""

    views: Sequence[BoardView]
    camera: Camera
    board: Target
    seen: ViewPoses


def cross_validate_images(result: HandEyeResult, images: ImageSet, *, free_camera: bool) -> ImageComparison:
    """Return which calibration the images prove, by errors at the used images, each left out with its fold.

    All that looks at the images is done again without those of a fold: the fit to the poses with its noises, the noises
    beside the corners', the fit to the corners, the camera where it is freed (Varma and Simon 2006). result: from the
    poses seen. A fold that is not determined, or a fit without a minimum, gives no prediction of its images.
    """
    used = np.flatnonzero(result.used)
    bases = [
        ObservationModel.POSES,
        ObservationModel.CORNERS,
        *([ObservationModel.CORNERS_AND_CAMERA] if free_camera else []),
    ]
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


def _fitted(
    basis: ObservationModel, result: HandEyeResult, images: ImageSet, rest: NDArray[np.bool_]
) -> tuple[Poses, Camera]:
    """Return X and Z from the images of rest (n,), and the camera: as given, or freed with them."""
    arrays = result.pairs.arrays(result.setup)
    by_poses = solve_pairs(arrays, result.setup, keep=rest, known=result.pairs.camera_covariance)
    at = by_poses.poses
    if basis is ObservationModel.POSES:
        return at, images.camera
    model = ImageModel(setup=result.setup, arrays=arrays, used=rest, seen=images.seen, start=at)
    free = basis is ObservationModel.CORNERS_AND_CAMERA
    fit = model.reproject(model.variances().V[rest], images.camera, free)
    return poses_of(fit), camera_of(fit, images.camera) if free else images.camera


def _missed(at: Poses, camera: Camera, result: HandEyeResult, images: ImageSet, i: int) -> Array:
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


# Which way round a board that looks the same turned was in each image: the robot's poses tell.
#
# A checkerboard of 8x6 inner corners is half a turn off without a trace, and detectors number it by what is right in
# the image. All turns that leave the print unchanged are tried, in samples of pairs; what most images agree on counts.

SAMPLE, SAMPLES, SEED = 4, 30, 17
"""Images a sample, their number and the seed: a sample of four has one rotation to spare."""
ROUNDS = 5
"""Rounds of fitting all and choosing again."""
AGREE_RAD = 5.0 * DEG
"""Rotations of the right turns agree to a degree with the worst robots; a wrong one is off by 90 or 180 degrees."""


def turned_views(
    views: Sequence[BoardView], T_base_flange: Sequence[RigidTransform], camera: Camera, board: Target, setup: Setup
) -> tuple[list[BoardView], int]:
    """Return the views numbered the same way round, and how many were turned; as they are where nothing tells."""
    turns = symmetries(board)
    if len(turns) == 1 or len(views) < MIN_PAIRS:
        return list(views), 0
    F = stack(T_base_flange)
    RF = (F if setup is Setup.EYE_IN_HAND else F.inv()).rotation.as_matrix()
    RB = poses_of_views(views, camera, board).T_camera_target.rotation.as_matrix()
    # the board's rotation is multiplied by its inverse from the right where its points are renumbered so
    G = turns_of(board)[:, :3, :3].transpose(0, 2, 1)
    chosen = _chosen(RF, np.einsum("nij,sjk->nsik", RB, G))
    out = [
        view if s == 0 else replace(view, index=turns[s][view.index])
        for view, s in zip(views, chosen.tolist(), strict=True)
    ]
    return out, int(np.count_nonzero(chosen))


def _chosen(RF: Array, RB: Array) -> NDArray[np.intp]:
    """Return the turn (n,) of each image, RB (n, S, 3, 3) its rotation by each; all 0 where too few agree on any."""
    n, S = RB.shape[:2]
    rng = np.random.default_rng(SEED)
    best, chosen = np.inf, np.zeros(n, np.intp)
    for _ in range(SAMPLES):
        rows = np.argsort(rng.random(n))[:SAMPLE]
        for rest in product(range(S), repeat=SAMPLE - 1):
            errors = _errors(RF, RB, rows, np.array([0, *rest]))
            score = float((np.minimum(errors.min(axis=1), AGREE_RAD) ** 2).sum())
            if score < best:
                best, chosen = score, errors.argmin(axis=1)
    agree = np.ones(n, bool)
    for _ in range(ROUNDS):
        errors = _errors(RF, RB, np.flatnonzero(agree), chosen[agree])
        chosen, agree = errors.argmin(axis=1), errors.min(axis=1) < AGREE_RAD
        if np.count_nonzero(agree) < LEAST_SHARE * n:
            return np.zeros(n, np.intp)
    # the turns are a cycle: one turn more of all of them is the same answer with the board's axes turned
    return np.asarray((chosen - np.bincount(chosen, minlength=S).argmax()) % S)


def _errors(RF: Array, RB: Array, rows: NDArray[np.intp], turns: NDArray[np.intp]) -> Array:
    """Return the angle (n, S) that each turn of each image leaves to what some rows, turned so, agree on."""
    of = np.ascontiguousarray(RB[rows, turns])
    RX, RZ = closed_forms.shah_rotations(np.ascontiguousarray(RF[rows]), of, np.ones(len(rows), bool))
    trace = np.einsum("nij,jk,nskl,il->ns", RF, RX, RB, RZ, optimize=True)
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))
