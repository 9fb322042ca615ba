"""One camera from views of a printed board."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cameras.board_shape import board_shape
from armsight.calibrate.cameras.bundle_adjustment import bundle_of, poses_of_boards, residuals_px
from armsight.calibrate.cameras.cross_validation import left_out
from armsight.calibrate.cameras.lens_choice import refuse_other_lens, start_of, with_hint
from armsight.calibrate.cameras.observations import BoardOptions, pack
from armsight.calibrate.cameras.other_board import doubtful, refuse_misfit, refuse_other_board
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_tilted
from armsight.calibrate.cameras.pairing import camera_of
from armsight.calibrate.cameras.preconditions import check_count, check_spread, different_views
from armsight.calibrate.cameras.result import CameraCalibration
from armsight.errors import Degenerate, Inconsistent, NotConverged, NotEnoughData, Undetermined
from armsight.optics import LensKind
from armsight.records import BoardView, NamedCovariance, Progress, Target, TargetKind
from armsight.records.result_parts import RejectedFile

NOT_SQUARE = 0.015
"""Share by which fx and fy of cameras do not differ, beyond SURE deviations of theirs."""
SURE = 2.0

DOUBTFUL_FOCAL = 0.02
"""A focal length less sure than this share of itself is worth a word."""


def calibrate_camera(
    views: Sequence[BoardView], board: Target, options: BoardOptions | None = None, progress: Progress | None = None
) -> CameraCalibration:
    """Return the camera that saw the board in the views (Zhang's start, then bundle adjustment).

    Raises NotEnoughData (too few different views), Degenerate (no tilt, board in one part of the image),
    Undetermined (parameters that cannot be told apart), Inconsistent (images of unequal size, the other kind of lens),
    NotConverged,
    Cancelled.
    """
    options = options or BoardOptions()
    require_views(views, board)
    require_points(board, options.lens)
    observations = pack([views], board, (options.lens,))
    kept, repeated = different_views(observations)
    observations = observations.take(kept)
    advice = check_count(len(kept)) + check_spread(observations, 0, "the camera")
    try:
        robust_fit, on_tilt = fit_tilted(observations, start_of(observations), options, "the camera", progress)
    except (Degenerate, NotConverged, NotEnoughData, Undetermined) as error:
        refuse_other_board(observations, board, options, "the camera")
        raise with_hint(error, observations, options) from error
    if in_doubt := doubtful(observations, robust_fit):
        refuse_other_board(observations, board, options, "the camera")
    advice += refuse_other_lens(observations, robust_fit, options, 0, "the camera")
    if in_doubt:
        refuse_misfit(observations, options, "the camera")
    out = left_out(robust_fit, options)
    residual, seen = residuals_px(robust_fit.observations, robust_fit.fit), robust_fit.observations.weight > 0.0
    shape = board_shape(robust_fit.observations, robust_fit.fit, required(robust_fit))
    covariance = shape.covariance
    return CameraCalibration(
        camera=camera_of(bundle_of(robust_fit.fit, 1).k[0], observations.sizes[0], options.lens),
        covariance=covariance,
        rms_px=rms(residual, seen),
        n_used=robust_fit.observations.n_views,
        rejected=tuple(map(RejectedFile._make, (*repeated, *robust_fit.rejected))),
        holdout_rms_px=None if out is None else out.rms_px,
        view_rms_px=view_rms(residual, seen),
        sources=tuple(names[0] for names in robust_fit.observations.sources),
        uv_px=robust_fit.observations.uv[seen],
        residual_px=residual[seen],
        used=robust_fit.observations,
        T_camera_board=poses_of_boards(robust_fit.observations, robust_fit.fit),
        doubts=not_square(robust_fit, covariance),
        advice=(*advice, *on_tilt, *shape.advice, *caveats(covariance, robust_fit), *robust_fit.notes),
    )


def require_views(views: Sequence[BoardView], board: Target) -> None:
    """Raise Inconsistent where the target is no board, NotEnoughData where there is no view at all."""
    if not board.is_board:
        raise Inconsistent("a camera is calibrated with a printed board, not with lights", cure="Give a board")
    if not views:
        raise NotEnoughData("the board was found in no image", consequence="Nothing was calibrated")


def require_points(board: Target, lens: LensKind) -> None:
    """Raise Inconsistent for printed circles before a fisheye lens: their images are no ellipses there."""
    if lens is LensKind.FISHEYE and board.kind in (TargetKind.CIRCLES, TargetKind.ACIRCLES):
        raise Inconsistent(
            "a fisheye lens bends a printed circle's image, and its middle is not the circle's",
            consequence="Nothing was calibrated: the error grows towards the image's edge",
            cure="Use a checkerboard or a ChArUco board",
        )


def required(robust_fit: RobustFit) -> NamedCovariance:
    """Return the fit's covariance; the engine has raised where there is none, unless nothing was free."""
    if robust_fit.fit.covariance is None:
        raise Inconsistent("every intrinsic is held fixed: there is nothing to calibrate", cure="Free one")
    return robust_fit.fit.covariance


def rms(residual: Array, seen: NDArray[np.bool_]) -> float:
    """Return the RMS norm in px of the residuals (..., 2) that exist."""
    return float(np.sqrt((residual**2).sum() / np.count_nonzero(seen)))


def view_rms(residual: Array, seen: NDArray[np.bool_]) -> tuple[float, ...]:
    """Return the RMS norm in px of each view's residuals (G, C, n, 2)."""
    squares = (residual**2).sum(axis=(1, 2, 3))
    return tuple(np.sqrt(squares / np.maximum(seen.sum(axis=(1, 2)), 1)).tolist())


def not_square(robust_fit: RobustFit, covariance: NamedCovariance) -> tuple[str, ...]:
    """Return where pixels would not be square: more often it is the board's squares."""
    fit, told = robust_fit.fit, []
    for name in (name for name in fit.names if name.split(".")[-1] == "fx"):
        other = name[:-1] + "y"
        ratio = fit.value(name) / fit.value(other)
        if not {name, other} <= set(covariance.names):
            continue
        each = np.array([1.0 / fit.value(name), -1.0 / fit.value(other)])
        doubt = float(np.sqrt(each @ covariance.block((name, other)) @ each))
        if abs(ratio - 1.0) > NOT_SQUARE + SURE * doubt:
            told.append(f"{name} and fy differ by {100 * abs(ratio - 1.0):.1f} %")
    return tuple(told)


def caveats(covariance: NamedCovariance, robust_fit: RobustFit) -> list[str]:
    """Return advice on focal lengths that are not well known."""
    std = covariance.std()
    unequal = [
        f"{text}: cameras have square pixels, so the images were stretched or the board's squares are none; measure "
        "the board along both sides with a calliper"
        for text in not_square(robust_fit, covariance)
    ]
    return unequal + [
        f"{name} is known to {100 * std[name] / robust_fit.fit.value(name):.1f} % only; "
        "tilt the board more, bring it closer"
        for name in robust_fit.fit.names
        if name.split(".")[-1] in ("fx", "fy") and std.get(name, 0.0) > DOUBTFUL_FOCAL * robust_fit.fit.value(name)
    ]
