"""One camera, or a pair of them, from views of a printed board that both see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cameras.board_shape import board_shape, doubtful, refuse_misfit, refuse_other_board
from armsight.calibrate.cameras.bundle_adjustment import (
    Bundle,
    adjust,
    bundle_of,
    poses_of_boards,
    residuals_px,
    side_by_side,
)
from armsight.calibrate.cameras.lens_choice import chosen, refuse_other_lens, start_of, with_hint
from armsight.calibrate.cameras.observations import BoardOptions, Observations, pack
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_tilted, fixed_names, left_out, metric_of
from armsight.calibrate.cameras.pair_effects import pair_effects
from armsight.calibrate.cameras.pairing import Paired, baseline_std, camera_of, of_one_lens, pair_views, rig_of
from armsight.calibrate.cameras.preconditions import LEAST_VIEWS, check_count, check_spread, check_tilt, different_views
from armsight.calibrate.cameras.result import CameraCalibration, StereoCalibration
from armsight.errors import Degenerate, Inconsistent, NotConverged, NotEnoughData, Undetermined
from armsight.fitting import Fit
from armsight.optics import SIDES, LensKind
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
    NotConverged, Cancelled.
    """
    options = options or BoardOptions()
    require_views(views, board)
    options, on_lens = chosen({"the camera": views}, board, options)
    require_points(board, options.lens)
    observations = pack([views], board, (options.lens,))
    kept, repeated = different_views(observations)
    observations = observations.take(kept)
    advice = [*on_lens, *check_count(len(kept)), *check_spread(observations, 0, "the camera")]
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
    residual, seen = residuals_px(robust_fit.observations, robust_fit.fit), robust_fit.observations.weight > 0.0
    shape = board_shape(robust_fit.observations, robust_fit.fit, required(robust_fit))
    covariance = shape.covariance
    return CameraCalibration(
        camera=camera_of(bundle_of(robust_fit.fit, 1).k[0], observations.sizes[0], options.lens),
        covariance=covariance,
        rms_px=rms(residual, seen),
        n_used=robust_fit.observations.n_views,
        rejected=tuple(map(RejectedFile._make, (*repeated, *robust_fit.rejected))),
        holdout_rms_px=getattr(left_out(robust_fit, options), "rms_px", None),
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


NO_PAIR = "the two images do not show the board at one moment: they are no pair, or it moved"


def calibrate_stereo(
    left: Sequence[BoardView],
    right: Sequence[BoardView],
    board: Target,
    options: BoardOptions | None = None,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Return the rig whose left and right camera saw the board in the views, paired by position.

    Raises Inconsistent (unequal numbers, unequal image sizes, images that do not belong together, left and right
    swapped or mirrored), NotEnoughData, Degenerate, Undetermined, NotConverged, Cancelled as calibrate_camera.
    """
    options = options or BoardOptions()
    robust_fit, rejected, advice = fit_pairs(left, right, board, options, progress)
    return judged(robust_fit, options, n_pairs=len(left), rejected=rejected, advice=advice)


def fit_pairs(
    left: Sequence[BoardView],
    right: Sequence[BoardView],
    board: Target,
    options: BoardOptions,
    progress: Progress | None = None,
) -> tuple[RobustFit, list[tuple[str, str]], list[str]]:
    """Return the fit of the pairs that agree, (source, why) of others, and advice; raises as calibrate_stereo."""
    for views in (left, right) if options.choose_lens else ():
        require_views(views, board)
    options, on_lens = chosen({"the left camera": left, "the right camera": right}, board, options)
    observations, rejected = _different_pairs(left, right, board, options.lenses)
    advice = [*on_lens, *check_count(observations.n_views)]
    starts = [start_of(observations.camera(c)) for c in range(2)]
    for c, side in enumerate(SIDES):
        advice += check_spread(observations, c, f"the {side} camera")
        if options.lenses[c] is not LensKind.FISHEYE:
            check_tilt(starts[c].poses, f"the {side} camera")
    observations, starts, paired = _paired(observations, starts, board, options)
    agree = np.flatnonzero(paired.agreeing)
    rejected += [(" / ".join(observations.sources[g]), NO_PAIR) for g in np.flatnonzero(~paired.agreeing)]
    if len(agree) < LEAST_VIEWS:
        raise NotEnoughData(
            f"{len(agree)} of {len(left)} pairs show the board at one moment, {LEAST_VIEWS} are needed",
            consequence="Nothing was calibrated",
            cure="Expose both cameras at once, or hold the board still",
        )
    start = Bundle(k=side_by_side([s.k[0] for s in starts]), sides=paired.side_pose[None], poses=starts[0].poses[agree])
    given = observations.take(agree)
    try:
        robust_fit, on_tilt = fit_tilted(given, start, options, "the pair", progress)
    except (Degenerate, NotConverged, NotEnoughData, Undetermined) as error:
        refuse_other_board(given.camera(0), board, options.of_camera(0), "the left camera")
        raise with_hint(error, given.camera(0), options.of_camera(0)) from error
    if in_doubt := doubtful(given, robust_fit):
        refuse_other_board(given.camera(0), board, options.of_camera(0), "the left camera")
    for c, side in enumerate(SIDES):
        advice += refuse_other_lens(given, robust_fit, options, c, f"the {side} camera")
        if in_doubt:
            refuse_misfit(given.camera(c), options.of_camera(c), f"the {side} camera")
    return robust_fit, rejected, [*advice, *on_tilt]


def _different_pairs(
    left: Sequence[BoardView], right: Sequence[BoardView], board: Target, lenses: tuple[LensKind, LensKind]
) -> tuple[Observations, list[tuple[str, str]]]:
    """Return the pairs that show something new, and (source, why) of the others."""
    if len(left) != len(right):
        raise Inconsistent(
            f"{len(left)} left and {len(right)} right views do not pair up",
            consequence="Nothing was calibrated",
            cure="Give a right image for every left one, in the same order",
        )
    require_views(left, board)
    for lens in lenses:
        require_points(board, lens)
    observations = pack([left, right], board, lenses)
    kept, rejected = different_views(observations)
    return observations.take(kept), rejected


def judged(
    robust_fit: RobustFit, options: BoardOptions, *, n_pairs: int, rejected: list[tuple[str, str]], advice: list[str]
) -> StereoCalibration:
    """Return the result with its errors, on the pairs of the fit and on left-out ones."""
    used = robust_fit.observations
    _refuse_swapped(bundle_of(robust_fit.fit, 2).sides[0])
    fit, covariance, told = _believed(robust_fit, options)
    state = bundle_of(fit, 2)
    residual, seen = residuals_px(used, fit), used.weight > 0.0
    overall = rms(residual, seen)
    rig = rig_of(state, used.sizes, covariance=covariance, rms_px=overall, lenses=used.lenses)
    out = left_out(robust_fit, options)
    metric = out.metric if out else metric_of([(used, rig)]) if options.folds else {}
    return StereoCalibration(
        rig=rig,
        baseline_std_m=baseline_std(rig),
        rms_px=overall,
        n_pairs=n_pairs,
        n_used=used.n_views,
        rejected=tuple(map(RejectedFile._make, (*rejected, *robust_fit.rejected))),
        holdout_rms_px=out.rms_px if out else None,
        holdout_epipolar_rms_px=out.epipolar_rms_px if out else None,
        metric=metric,
        metric_is_left_out=bool(out and out.metric),
        view_rms_px=view_rms(residual, seen),
        used=used,
        residual_px={side: residual[:, c][seen[:, c]] for c, side in enumerate(SIDES)},
        T_left_board=poses_of_boards(used, fit),
        doubts=not_square(robust_fit, covariance),
        advice=(*advice, *told, *caveats(covariance, robust_fit), *robust_fit.notes),
    )


def _believed(robust_fit: RobustFit, options: BoardOptions) -> tuple[Fit, NamedCovariance, list[str]]:
    """Return the fit and its covariance with what differs from pair to pair, and how far the board is off, in them; and
    advice on both."""
    used, fit, covariance = robust_fit.observations, robust_fit.fit, required(robust_fit)
    shape, effects = board_shape(used, fit, covariance), pair_effects(used, fit)
    if effects is None or effects.gain < shape.gain:  # what a board that is off leaves differs from pair to pair too
        return fit, of_one_lens(shape.covariance) if used.one_lens else shape.covariance, shape.advice
    # the board is asked for in what is left without the pairs' own part, and adds to what that leaves of doubt
    fixed = frozenset(fit.names) - frozenset(covariance.names)
    rigid = adjust(effects.freed, bundle_of(effects.fit, 2), fixed, max_iterations=options.max_iterations)
    shape = board_shape(effects.freed, rigid, required(replace(robust_fit, fit=rigid)))
    plain = required(replace(robust_fit, fit=rigid)).matrix
    matrix = effects.covariance.matrix + shape.covariance.matrix - plain
    noise_px = rms(residuals_px(effects.freed, rigid), used.weight > 0.0)
    return effects.fit, replace(effects.covariance, matrix=matrix), [effects.advice(noise_px), *shape.advice]


def _paired(
    observations: Observations, starts: list[Bundle], board: Target, options: BoardOptions
) -> tuple[Observations, list[Bundle], Paired]:
    """Return what the pairs agree on; where not all do at first sight, look again with each camera fitted by itself.

    The closed-form start knows no distortion and no principal point: good pairs may seem to disagree by it.
    """
    renumbered, paired = pair_views(observations, [start.poses for start in starts], board, final=False)
    if paired.agreeing.all():
        return renumbered, starts, paired
    fitted = []
    for c, start in enumerate(starts):
        alone = observations.camera(c)
        try:
            fit = adjust(alone, start, fixed_names(options, alone), max_iterations=options.max_iterations)
        except (NotConverged, Undetermined):
            fitted.append(start)  # its start is the best there is
        else:
            fitted.append(bundle_of(fit, 1))
    renumbered, paired = pair_views(observations, [start.poses for start in fitted], board)
    return renumbered, fitted, paired


def _refuse_swapped(side_pose: Array) -> None:
    """Raise Inconsistent where the right camera stands on the left one's left."""
    x, y, z = side_pose[:3].tolist()
    if x < 0.0 and abs(x) > max(abs(y), abs(z)):
        raise Inconsistent(
            f"left and right are swapped, or both cameras' images are mirrored: the right camera stands "
            f"{-x * 1e3:.1f} mm to the left of the left one",
            consequence="Nothing was calibrated: every later use would call the views by the wrong name",
            cure="Exchange the sources of --left and --right, or switch off the cameras' mirror mode",
        )
