"""A pair of cameras from views of a printed board that both see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras.board_shape import board_shape
from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, poses_of_boards, residuals_px
from armsight.calibrate.cameras.cross_validation import left_out, metric_of
from armsight.calibrate.cameras.lens_choice import refuse_other_lens, start_of, with_hint
from armsight.calibrate.cameras.monocular import (
    caveats,
    not_square,
    require_points,
    require_views,
    required,
    rms,
    view_rms,
)
from armsight.calibrate.cameras.observations import BoardOptions, Observations, pack
from armsight.calibrate.cameras.other_board import doubtful, refuse_misfit, refuse_other_board
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_tilted, fixed_names
from armsight.calibrate.cameras.pair_effects import pair_effects
from armsight.calibrate.cameras.pairing import Paired, baseline_std, of_one_lens, pair_views, rig_of
from armsight.calibrate.cameras.preconditions import LEAST_VIEWS, check_count, check_spread, check_tilt, different_views
from armsight.calibrate.cameras.result import StereoCalibration
from armsight.errors import Degenerate, Inconsistent, NotConverged, NotEnoughData, Undetermined
from armsight.fitting import Fit
from armsight.optics import SIDES, LensKind
from armsight.records import BoardView, NamedCovariance, Progress, Target
from armsight.records.result_parts import RejectedFile

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
    observations, rejected = _different_pairs(left, right, board, options.lenses)
    advice = check_count(observations.n_views)
    starts = [start_of(observations.camera(c)) for c in range(2)]
    for c, side in enumerate(SIDES):
        advice += check_spread(observations, c, f"the {side} camera")
        if options.lenses[c] is LensKind.PINHOLE:
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
    start = Bundle(k=np.concatenate([s.k for s in starts]), side_pose=paired.side_pose, poses=starts[0].poses[agree])
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
    _refuse_swapped(bundle_of(robust_fit.fit, 2).side_pose)
    fit, covariance, told = _believed(robust_fit, options)
    state = bundle_of(fit, 2)
    residual, seen = residuals_px(used, fit), used.weight > 0.0
    overall = rms(residual, seen)
    rig = rig_of(state, used.sizes, covariance=covariance, rms_px=overall, lenses=used.lenses)
    out = left_out(robust_fit, options)
    metric = out.metric if out else metric_of([(used, rig)]) if options.folds else None
    return StereoCalibration(
        rig=rig,
        baseline_std_m=baseline_std(rig),
        rms_px=overall,
        n_pairs=n_pairs,
        n_used=used.n_views,
        rejected=tuple(map(RejectedFile._make, (*rejected, *robust_fit.rejected))),
        holdout_rms_px=out.rms_px if out else None,
        holdout_epipolar_rms_px=out.epipolar_rms_px if out else None,
        metric=metric.as_mapping() if metric else {},
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
        fixed = fixed_names(options.of_camera(c), 1)
        try:
            fit = adjust(observations.camera(c), start, fixed, max_iterations=options.max_iterations)
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
