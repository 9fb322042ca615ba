"""A nominal arm and measurements in, the corrected arm out, or the nominal one where nothing better is proved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from armsight.calibrate.arm.fit import ArmFit, Tolerance, fit_arm
from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import (
    Couplings,
    Level,
    candidates,
    coupled,
    level,
    plain_level,
    significant_gain,
)
from armsight.calibrate.arm.one_place import check_one_place
from armsight.calibrate.arm.other_arm import OtherArm, other_arm
from armsight.calibrate.arm.parameter_selection import still
from armsight.calibrate.arm.plausibility import check_fit, exceeded
from armsight.calibrate.arm.points import ArmPoints, check_points
from armsight.calibrate.arm.tool_points import tool_points
from armsight.errors import Inconsistent, NotConverged
from armsight.kinematics import Arm
from armsight.records import NamedCovariance

Array = NDArray[np.float64]

GROSS = float(np.sqrt(chi2.ppf(0.99999, 3)))
"""Errors of place beyond so many standard deviations are gross."""
UNPROVED = "no gain is proved by correcting it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Errors at the tool's point in m."""

    mean_m: float
    rms_m: float
    max_m: float

    @classmethod
    def of(cls, size_m: Array) -> Errors:
        """Return the figures of errors (m,)."""
        return cls(mean_m=float(size_m.mean()), rms_m=float(np.sqrt(np.mean(size_m**2))), max_m=float(size_m.max()))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmCalibration:
    """What came out.

    arm: corrected where gain, else nominal; base and tool fitted in both. before, after: errors on the rows used, with
    the nominal arm and the one kept; cross_before, cross_after: on rows left out by cross-validation; left_before,
    left_after: on the holdout where one was given (held), else the same. free, condition: see Choice. fixed: (name,
    why) of what is as in the nominal arm. model, fitted: names and values of the parameters (changes to the nominal
    arm), noise. outliers: (row from 0, error in m). couplings: (joint, by which, share). level: which kind of model was
    taken. still: joints that did not move. before_m, error_m: (m,) before and after, by row. other_arm: why the nominal
    arm is that of another one; nothing is corrected then.
    """

    arm: Arm
    nominal: Arm
    model: ArmModel
    fitted: ArmFit
    gain: bool
    level: str
    before: Errors
    after: Errors
    cross_before: Errors
    cross_after: Errors
    left_before: Errors
    left_after: Errors
    held: bool
    free: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    condition: float
    covariance: NamedCovariance | None
    outliers: tuple[tuple[int, float], ...]
    couplings: Couplings
    still: tuple[str, ...]
    verdict: str
    error_m: Array
    before_m: Array
    other_arm: OtherArm | None = None

    def std(self) -> dict[str, float]:
        """Return the standard deviations of the freed parameters, base and tool."""
        return {} if self.covariance is None else self.covariance.std()

    def change(self, name: str) -> float:
        """Return the change of a parameter to the nominal arm."""
        return float(self.fitted.p[self.model.names.index(name)])


def calibrate_arm(
    nominal: Arm,
    points: ArmPoints,
    *,
    holdout: ArmPoints | None = None,
    tolerance: Tolerance | None = None,
    scale: bool = True,
) -> ArmCalibration:
    """Return the arm whose left-out errors are smallest: nominal, or with zeros, geometry, joint scales corrected.

    Each richer model is taken only where left-out errors fall beyond their own uncertainty, in cross-validation
    and, where a holdout is given, there too. Base and tool points are fitted always. Couplings of one (an elbow's
    reading that is absolute) are a kind of model of their own, tried where they halve the error. Raises
    NotEnoughData, Inconsistent for measurements that cannot be of this arm.
    """
    tolerance = tolerance or Tolerance()
    check_points(nominal, points)
    check_one_place(nominal, points)
    model = ArmModel(arm=nominal, labels=points.labels, turned=points.rotation is not None)
    if holdout is not None:
        check_points(nominal, holdout)
        _check_labels(model, holdout)
    levels = _levels(model, points, tolerance, scale=scale)
    errors = [_size(model, x, points) for x in levels]
    check_fit(model, points, min(errors, key=exceeded))
    best = levels[0]
    for richer in levels[1:]:
        if significant_gain(best.left_m, richer.left_m, points.position):
            best = richer
    other = other_arm(model, points, _plain(levels, best), best, tolerance)
    if other is not None:
        kept = _result(model, points, holdout, levels, levels[0])
        return replace(kept, verdict=other.text(), other_arm=other)
    return _result(model, points, holdout, levels, best)


def _levels(model: ArmModel, points: ArmPoints, tolerance: Tolerance, *, scale: bool) -> list[Level]:
    """Return the fits of all kinds of model, the nominal one first; those that did not converge are left out."""
    guess = start(model, points)
    p, couplings = coupled(model, points, guess)
    try:
        levels = [plain_level(model, points, fit_arm(model, points, guess, (), tolerance), "nominal")]
    except NotConverged:
        check_fit(model, points, np.linalg.norm(model.errors(p, points)[0], axis=1))
        raise
    if couplings:
        fitted = fit_arm(model, points, p, (), tolerance)
        levels.append(plain_level(model, points, fitted, "coupled readings", couplings))
    plain = levels[-1]
    for name, offered in candidates(model, scale=scale):
        try:
            told = f"{plain.name} and {name}" if couplings else name
            levels.append(level(model, points, plain, told, offered, tolerance))
        except NotConverged:
            continue
    return levels


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
    """Return the errors of place (m,) in m."""
    return np.asarray(np.linalg.norm(model.errors(x.fitted.p, points)[0], axis=1))


def _result(
    model: ArmModel, points: ArmPoints, holdout: ArmPoints | None, levels: Sequence[Level], chosen: Level
) -> ArmCalibration:
    first, best = levels[0], chosen
    held: tuple[Array, Array] | None = None
    if holdout is not None:
        held = _size(model, first, holdout), _size(model, chosen, holdout)
        if chosen is not first and not significant_gain(*held, holdout.position):
            best = first
    gain = best is not first
    cross = Errors.of(first.left_m), Errors.of(best.left_m)
    left = cross if held is None else (Errors.of(held[0]), Errors.of(held[1 if gain else 0]))
    before_m, after_m = _size(model, first, points), _size(model, best, points)
    limit = GROSS * best.fitted.sigma_m
    return ArmCalibration(
        arm=_arm(model, best),
        nominal=model.arm,
        model=model,
        fitted=best.fitted,
        gain=gain,
        level=best.name,
        before=Errors.of(before_m),
        after=Errors.of(after_m),
        cross_before=cross[0],
        cross_after=cross[1],
        left_before=left[0],
        left_after=left[1],
        held=held is not None,
        free=best.choice.free,
        fixed=_fixed(best, levels[-1]),
        condition=best.choice.condition,
        covariance=best.fitted.fit.covariance,
        outliers=tuple((int(i), float(after_m[i])) for i in np.flatnonzero(after_m > limit)),
        couplings=best.couplings,
        still=still(model, points),
        verdict=_verdict(levels, chosen, best, held),
        error_m=after_m,
        before_m=before_m,
    )


def _arm(model: ArmModel, best: Level) -> Arm:
    """Return the arm of a level, with the covariance of its links and the places of its tool's points."""
    arm, covariance = model.arm_at(best.fitted.p), best.fitted.fit.covariance
    arm = replace(arm, tool_points=tool_points(model, best.fitted))
    if covariance is not None:
        links = tuple(name for name in covariance.names if name in model.names[: 5 * model.arm.n])
        if links:
            return replace(arm, covariance=NamedCovariance(names=links, matrix=covariance.block(links)))
    return arm


def _fixed(best: Level, richest: Level) -> tuple[tuple[str, str], ...]:
    """Return (name, why) of every parameter that the kept or the richest model offered and that was not corrected."""
    why = dict.fromkeys(richest.choice.free, UNPROVED) | dict(richest.choice.fixed) | dict(best.choice.fixed)
    return tuple((name, reason) for name, reason in why.items() if name not in best.choice.free)


def _verdict(levels: Sequence[Level], chosen: Level, best: Level, held: tuple[Array, Array] | None) -> str:
    """Return what to think of it, in a sentence or two. chosen: by cross-validation; best: what was kept."""
    first = levels[0]
    cross = f"{_mm(first.left_m)} to {_mm(chosen.left_m)} mm"
    there = "" if held is None else f"{_mm(held[0])} to {_mm(held[1])} mm"
    if chosen is first:
        tried = ", ".join(f"{x.name} {_mm(x.left_m)} mm" for x in levels[1:])
        return (
            f"No gain is proved: rows left out by cross-validation miss by {_mm(first.left_m)} mm with the nominal "
            f"arm, and not reliably less with any correction ({tried}). "
            "The nominal geometry is kept; measure more, or better."
        )
    if best is first:
        return (
            f"No gain is proved: correcting {chosen.name} takes the error of rows left out by cross-validation from "
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
    return f"{1e3 * float(size_m.mean()):.3g}"
