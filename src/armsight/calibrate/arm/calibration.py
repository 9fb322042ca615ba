"""A nominal arm and measurements in, the corrected arm out, or the nominal one where nothing better is proved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import believed, drift_of, in_blocks, still
from armsight.calibrate.arm.fit import ArmFit, LimitReached, Tolerance, fit_arm, limits_reached, tool_points
from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import (
    UNPROVED,
    LeftOut,
    Level,
    best_level,
    coupled,
    cross_validate,
    fit_levels,
    left_out,
    significant_gain,
)
from armsight.calibrate.arm.other_arm import other_arm
from armsight.calibrate.arm.plausibility import (
    MOST_SHARE,
    check_apart,
    check_fit,
    check_one_position,
    exceeded,
    spread_m,
)
from armsight.calibrate.arm.points import ArmPoints, check_points, in_order, of_places
from armsight.calibrate.arm.result import ArmResult, Errors, FixedParameter
from armsight.calibrate.arm.rotations import check_rotations, rotation_notes, turn_note, without_computed
from armsight.calibrate.correlation import Correlation
from armsight.errors import Inconsistent, NotConverged
from armsight.fitting.quantiles import chi2_ppf
from armsight.kinematics import Arm
from armsight.kinematics.axes import links_told
from armsight.records import NamedCovariance

GROSS = float(np.sqrt(chi2_ppf(0.99999, 3)))
"""Errors of position beyond so many standard deviations are gross."""
CONFIRMED = 1.0
"""Standard errors by which errors must fall in nested folds too, after the kind of model was taken by two of them: the
folds have a fifth fewer rows, and some take a poorer kind."""
DOUBTED = (
    "correct the length in the nominal arm where it may be so far off and calibrate again, or measure over wider "
    "ranges of the joints"
)


def calibrate_arm(
    nominal: Arm,
    points: ArmPoints,
    *,
    holdout: ArmPoints | None = None,
    tolerance: Tolerance | None = None,
    scale: bool = True,
) -> ArmResult:
    """Return the arm whose left-out errors are smallest: nominal, or with zeros, geometry, joint scales corrected.

    Each richer model is taken only where left-out errors fall beyond their own uncertainty; the whole way there must
    show in nested cross-validation and, where a holdout is given, be proved there too. Base and tool points are fitted
    always. Couplings of one (an elbow's reading that is absolute) are a kind of model of their own, tried where they
    halve the error. Raises NotEnoughData, Inconsistent for measurements that cannot be of this arm.
    """
    tolerance = tolerance or Tolerance()
    check_points(nominal, points)
    check_one_position(nominal, points)
    model = ArmModel(arm=nominal, labels=points.labels, turned=points.rotation is not None)
    measured, told = without_computed(model, points)
    if told:
        done = calibrate_arm(nominal, measured, holdout=holdout, tolerance=tolerance, scale=scale)
        return replace(done, points=points, notes=(*told, *done.notes))
    check_rotations(model, points)
    if holdout is not None:
        check_points(nominal, holdout)
        _check_labels(model, holdout)
        check_apart(points, holdout)
        holdout = in_order(of_places(holdout))
    given, points = points, in_order(of_places(points))
    levels = _levels(model, points, tolerance, scale=scale)
    errors = [_size(model, x, given) for x in levels]
    check_fit(model, given, min(errors, key=exceeded))
    points, levels, correlation = _in_time(model, points, levels)
    holdout = None if holdout is None else in_blocks(holdout, correlation)
    left = cross_validate(model, points, levels, tolerance, scale=scale)
    chosen = best_level(levels, points.group)
    judged = _Judged(given=given, tolerance=tolerance, levels=levels, chosen=chosen, left=left)
    other = other_arm(model, points, _plain(levels, judged.chosen), judged.chosen, tolerance)
    if other is not None:
        kept = _result(model, points, holdout, replace(judged, chosen=levels[0]))
        return replace(kept, verdict=other.text(), other_arm=other)
    return _result(model, points, holdout, judged)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judged:
    """All kinds of model, the one chosen with all rows, and the errors at rows left out; given: the rows as they came,
    of which what was fitted to is one a place."""

    given: ArmPoints
    tolerance: Tolerance
    levels: Sequence[Level]
    chosen: Level
    left: LeftOut

    @property
    def first(self) -> Level:
        return self.levels[0]

    def proved(self, points: ArmPoints) -> Level:
        """Return the chosen level where the nested folds show its gain, else the nominal one."""
        shown = significant_gain(self.left.nominal_m, self.left.chosen_m, points.group, proved=CONFIRMED)
        return self.chosen if shown else self.first


def _levels(model: ArmModel, points: ArmPoints, tolerance: Tolerance, *, scale: bool) -> list[Level]:
    """Return the fits of all kinds of model to all rows, the nominal one first."""
    guess = start(model, points)
    try:
        return fit_levels(model, points, guess, tolerance, scale=scale)
    except NotConverged:
        p, _ = coupled(model, points, guess)
        check_fit(model, points, np.linalg.norm(model.errors(p, points)[0], axis=1))
        raise


def _in_time(
    model: ArmModel, points: ArmPoints, levels: list[Level]
) -> tuple[ArmPoints, list[Level], Correlation | None]:
    """Return rows and levels as they are; of samples of a stream the rows in blocks of time, the levels' left-out
    errors by them, and how long the errors that the richest level leaves are alike."""
    drift = drift_of(model, points, levels[-1].fitted)
    blocked = points if drift is None else in_blocks(points, drift.correlation)
    if drift is None or blocked.block is None:
        return points, levels, None
    again = [replace(x, left_m=left_out(model, blocked, x.fitted)) for x in levels]
    return blocked, again, drift.correlation


def _plain(levels: Sequence[Level], best: Level) -> Level:
    """Return the level of base and tool alone whose readings are coupled as the best one's."""
    return next(x for x in levels if x.couplings == best.couplings and not x.choice.free)


def _check_labels(model: ArmModel, holdout: ArmPoints) -> None:
    unknown = sorted(set(holdout.labels) - set(model.labels))
    if unknown:
        raise Inconsistent(
            f"the holdout has points {', '.join(map(repr, unknown))}, which the measurements have not",
            consequence="Where they are on the tool is not known, and nothing can be judged by them",
            cure="Measure the same points of the tool in both, under the same names",
        )


def _size(model: ArmModel, x: Level, points: ArmPoints) -> Array:
    """Return the errors of position (m,) in m."""
    return np.asarray(np.linalg.norm(model.errors(x.fitted.p, points)[0], axis=1))


def _result(model: ArmModel, points: ArmPoints, holdout: ArmPoints | None, judged: _Judged) -> ArmResult:
    first, proved, (best, held, cross, left) = judged.first, *_proved(model, points, holdout, judged)
    before_m, after_m = _size(model, first, judged.given), _size(model, best, judged.given)
    fitted, correlation, held_at = believed(model, points, best.fitted, judged.tolerance)
    at_limit = limits_reached(model, best.fitted.p, best.choice.free, judged.tolerance)
    doubt = "" if held_at is None else held_at.doubt(fitted, best.choice.free)
    return ArmResult(
        arm=_arm(model, fitted),
        points=judged.given,
        tolerance=judged.tolerance,
        model=model,
        fitted=fitted,
        gain=best is not first,
        level=best.name,
        before=Errors.of(before_m),
        after=Errors.of(after_m),
        cross_before=cross[0],
        cross_after=cross[1],
        left_before=left[0],
        left_after=left[1],
        held=held is not None,
        free=best.choice.free,
        fixed=_fixed(best, judged.levels[-1]),
        condition=best.choice.condition,
        covariance=fitted.fit.covariance,
        outlier_rows=_gross(model, judged.given, best.fitted, after_m),
        couplings=best.couplings,
        still=still(model, points),
        at_limit=at_limit,
        doubt=doubt,
        notes=(*_told(at_limit, doubt), *_notes_on_rows(model, points, holdout, judged, fitted, correlation)),
        verdict=" ".join([_verdict(judged, proved, best, held), *(f"{x}." for x in _told(at_limit, doubt))]),
        error_m=after_m,
        before_m=before_m,
        position_noise_m=points.typical_m(fitted.sigma_m),
        correlation=correlation,
        n_places=len(points),
        other_arm=None,
        urdf=None,
    )


def _proved(
    model: ArmModel, points: ArmPoints, holdout: ArmPoints | None, judged: _Judged
) -> tuple[Level, tuple[Level, tuple[Array, Array] | None, tuple[Errors, Errors], tuple[Errors, Errors]]]:
    """Return the level that left-out rows prove; the one that stays on the holdout, and its errors on both."""
    proved = judged.proved(points)
    best, held = _held(model, holdout, judged.first, proved)
    # the rows left out in turn chose the level: the holdout, which had no say in it, has the last word
    return proved, (best, held, *_left_out_errors(judged.left, held, gain=best is not judged.first))


def _told(at_limit: Sequence[LimitReached], doubt: str) -> list[str]:
    """Return what stands in the way of belief in the corrections."""
    return [*(x.sentence for x in at_limit), *([f"{doubt}: {DOUBTED}"] if doubt else [])]


def _left_out_errors(
    errors: LeftOut, held: tuple[Array, Array] | None, *, gain: bool
) -> tuple[tuple[Errors, Errors], tuple[Errors, Errors]]:
    """Return before and after on rows left out by cross-validation, and on the holdout where there is one."""
    rows = errors.judged
    kept_m = errors.chosen_m if gain else errors.nominal_m
    cross = Errors.of(errors.nominal_m[rows]), Errors.of(kept_m[rows])
    return cross, cross if held is None else (Errors.of(held[0]), Errors.of(held[1 if gain else 0]))


def _notes_on_rows(
    model: ArmModel,
    points: ArmPoints,
    holdout: ArmPoints | None,
    judged: _Judged,
    fitted: ArmFit,
    correlation: Correlation | None,
) -> tuple[str, ...]:
    return (
        *_of_places(judged.given, points),
        *links_told(model.arm),
        *turn_note(model, points),
        *rotation_notes(model, points, fitted),
        *points.weight_notes(fitted.sigma_m),
        *_in_another_frame(model, judged.first, holdout),
        *_unjudged(points, judged.left.judged),
        *_in_stream(points, correlation),
    )


def _gross(model: ArmModel, points: ArmPoints, fitted: ArmFit, after_m: Array) -> tuple[tuple[int, float], ...]:
    size = np.linalg.norm(points.whiten(model.errors(fitted.p, points)[0], fitted.sigma_m), axis=1)
    row = np.arange(len(size)) if points.row is None else points.row
    return tuple((int(row[i]), float(after_m[i])) for i in np.flatnonzero(size > GROSS))


def _held(
    model: ArmModel, holdout: ArmPoints | None, first: Level, proved: Level
) -> tuple[Level, tuple[Array, Array] | None]:
    """Return the level to keep, and errors on the holdout with the nominal and the proved one."""
    if holdout is None:
        return proved, None
    held = _size(model, first, holdout), _size(model, proved, holdout)
    if _elsewhere(holdout, held):
        held = (
            _size(model, _laid_anew(model, first, holdout), holdout),
            _size(model, _laid_anew(model, proved, holdout), holdout),
        )
        if _elsewhere(holdout, held):
            raise Inconsistent(
                f"the rows of the holdout miss by {_mm(np.minimum(*held))} mm, and the tool moved by "
                f"{1e3 * spread_m(holdout.xyz_m):.3g} mm, also with base and tool laid anew",
                consequence="They are not of this arm at these readings, and prove nothing",
                cure="Give rows of this arm, readings and positions row by row",
            )
    gain = proved is not first and significant_gain(*held, holdout.group)
    return proved if gain else first, held


def _elsewhere(holdout: ArmPoints, held: tuple[Array, Array]) -> bool:
    """Whether errors (m,) are those of another frame, not of an arm: a tracker set up anew for the holdout."""
    return bool(min(exceeded(size) for size in held) > MOST_SHARE * spread_m(holdout.xyz_m))


def _laid_anew(model: ArmModel, level: Level, holdout: ArmPoints) -> Level:
    """Return a level with base and tool laid where they fit the holdout best; its geometry stays."""
    p = level.fitted.p.copy()
    p[model.n_geometry :] = start(model, holdout, like=p)[model.n_geometry :]
    return replace(level, fitted=fit_arm(model, holdout, p, (), Tolerance()))


def _arm(model: ArmModel, fitted: ArmFit) -> Arm:
    """Return the arm of a fit, with the covariance of its links and the positions of its tool's points."""
    arm, covariance = model.arm_at(fitted.p), fitted.fit.covariance
    heavy = any(joint.mass_kg for joint in arm.joints)  # which way is down matters, and is written, for weights alone
    down = arm.down_in_base if heavy else model.arm.down_in_base
    arm = replace(arm, tool_points=tool_points(model, fitted), down_in_base=down)
    if covariance is not None:
        links = tuple(name for name in covariance.names if name in model.names[: 5 * model.arm.n])
        if links:
            return replace(arm, covariance=NamedCovariance(names=links, matrix=covariance.block(links)))
    return arm


def _fixed(best: Level, richest: Level) -> tuple[FixedParameter, ...]:
    """Return every parameter that the kept or the richest model offered and that was not corrected."""
    why = dict.fromkeys(richest.choice.free, UNPROVED) | dict(richest.choice.fixed) | dict(best.choice.fixed)
    return tuple(FixedParameter(name, reason) for name, reason in why.items() if name not in best.choice.free)


def _in_another_frame(model: ArmModel, first: Level, holdout: ArmPoints | None) -> list[str]:
    """Return a note of a holdout in which base and tool were laid anew."""
    if holdout is None or not _elsewhere(holdout, (_size(model, first, holdout),) * 2):
        return []
    return ["The holdout's rows are in another frame than the measurements: base and tool were laid anew in them"]


def _unjudged(points: ArmPoints, judged: NDArray[np.bool_]) -> list[str]:
    """Return a note of the rows that cross-validation cannot judge."""
    if judged.all():
        return []
    labels = sorted(
        {points.point[i] for i in np.flatnonzero(~judged)} - {points.point[i] for i in np.flatnonzero(judged)}
    )
    of = f" (points {', '.join(map(repr, labels))})" if any(labels) else ""
    return [
        f"{int((~judged).sum())} of {len(points)} rows{of} are not judged by cross-validation: rows of other joint "
        "positions do not tell where they should be"
    ]


def _of_places(given: ArmPoints, points: ArmPoints) -> list[str]:
    if len(points) == len(given):
        return []
    return [
        f"The {len(given)} rows are repeated readings at {len(points)} places, which share what the arm has wrong "
        f"there: they are averaged, and worth {len(points)} rows"
    ]


def _in_stream(points: ArmPoints, correlation: Correlation | None) -> list[str]:
    """Return a note of rows that are samples of a stream."""
    if correlation is None:
        return []
    # without times the order of the rows is all that is known of when they were taken
    told, unit = (" in their order", "rows") if points.counted else ("", "s")
    return [
        f"The rows are samples of a stream{told}, whose errors are alike for some {correlation.time_s:.2g} {unit}: the "
        f"{len(points)} rows are worth {correlation.n_effective:.0f} independent ones. Deviations are claimed "
        f"accordingly, and left out are blocks of time ({int(points.group.max()) + 1} in all), not rows"
    ]


def _verdict(judged: _Judged, proved: Level, best: Level, held: tuple[Array, Array] | None) -> str:
    """Return what to think of it, in a sentence or two. proved: by cross-validation; best: what was kept."""
    first, left = judged.first, judged.left
    cross = f"{_mm(left.nominal_m)} to {_mm(left.chosen_m)} mm"
    there = "" if held is None else f"{_mm(held[0])} to {_mm(held[1])} mm"
    if proved is first:
        tried = ", ".join(f"{x.name} {_mm(left.by_level[x.name])} mm" for x in judged.levels[1:])
        return (
            f"No gain is proved: rows left out by cross-validation miss by {_mm(left.nominal_m)} mm with the nominal "
            f"arm, and not reliably less with any correction ({tried}). "
            "The nominal geometry is kept; measure more, or better."
        )
    if best is first:
        return (
            f"No gain is proved: correcting {proved.name} takes the error of rows left out by cross-validation from "
            f"{cross}, but that of the rows of the holdout from {there}, not reliably less. "
            "The nominal geometry is kept; measure more joint positions."
        )
    count = f" ({len(best.choice.free)} parameters)" if best.choice.free else ""
    also = f", and of the rows of the holdout from {there}" if there else ""
    told = "".join(
        f" The reading of {a} is absolute: its angle is {a} {'+' if share > 0 else '-'} {b}, and the arm file says so."
        for a, b, share in best.couplings
    )
    return (
        f"Correcting {best.name}{count} takes the error of rows left out by cross-validation from {cross}{also}." + told
    )


def _mm(size_m: Array) -> str:
    return f"{1e3 * float(np.nanmean(size_m)):.3g}"
