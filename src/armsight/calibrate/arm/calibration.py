"""A nominal arm and measurements in, the corrected arm out, or the nominal one where nothing better is proved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from armsight.calibrate.arm.choose import Choice, choose
from armsight.calibrate.arm.fit import ArmFit, Tolerance, fit_arm
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints, check_points
from armsight.calibrate.arm.start import start
from armsight.errors import NotConverged
from armsight.kinematics import Arm
from armsight.records import NamedCovariance

Array = NDArray[np.float64]

FOLDS = 5
PROVED = 2.0
"""A model is taken where left-out errors fall by this many of the fall's own standard errors: by chance once in 44."""
RIDGE = 1e-12
"""Keeps directions that no row tells (a tool on the last axis) where they are, in scaled information."""
GROSS = float(np.sqrt(chi2.ppf(0.99999, 3)))
"""Errors of place beyond so many deviations are gross."""
COUPLED = 0.5
"""A coupling of one is believed where it takes the error below this share of what it is without."""


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

    arm: corrected where gain, else nominal; base and tool fitted in both. before, after: errors on the rows used;
    left_before, left_after: on rows left out, in turn (k-fold), or on the holdout where one was given (held). free,
    fixed, condition: see Choice. model, fitted: names and values of the parameters (changes to the nominal arm), noise.
    outliers: (row from 0, error in m). couplings: (joint, by which, share). level: which kind of model was taken.
    before_m, error_m: (m,) before and after, by row.
    """

    arm: Arm
    nominal: Arm
    model: ArmModel
    fitted: ArmFit
    gain: bool
    level: str
    before: Errors
    after: Errors
    left_before: Errors
    left_after: Errors
    held: bool
    free: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    condition: float
    covariance: NamedCovariance | None
    outliers: tuple[tuple[int, float], ...]
    couplings: tuple[tuple[str, str, float], ...]
    verdict: str
    error_m: Array
    before_m: Array

    def std(self) -> dict[str, float]:
        """Return the deviations of the freed parameters, base and tool."""
        return {} if self.covariance is None else self.covariance.std()

    def change(self, name: str) -> float:
        """Return the change of a parameter to the nominal arm."""
        return float(self.fitted.p[self.model.names.index(name)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Level:
    """A kind of model: its name, its fit to all rows, its choice, and the left-out errors (m,)."""

    name: str
    fitted: ArmFit
    choice: Choice
    left_m: Array


def calibrate_arm(
    nominal: Arm,
    points: ArmPoints,
    *,
    holdout: ArmPoints | None = None,
    tolerance: Tolerance | None = None,
    scale: bool = True,
) -> ArmCalibration:
    """Return the arm whose left-out errors are smallest: nominal, or with zeros, geometry, joint scales corrected.

    Each richer model is taken only where left-out errors fall beyond their own doubt. Base and tool points are fitted
    always. Couplings of one (an elbow's reading that is absolute) are tried and kept where they halve the error.
    Raises NotEnoughData, Inconsistent for measurements that cannot be of this arm.
    """
    tolerance = tolerance or Tolerance()
    check_points(nominal, points)
    if holdout is not None:
        check_points(nominal, holdout)
    model = ArmModel(arm=nominal, labels=points.labels, turned=points.rotation is not None)
    first, couplings = _coupled(model, points, tolerance)
    nominal_fit = fit_arm(model, points, first, (), tolerance)
    levels = [_level(model, points, nominal_fit, "nominal", (), tolerance)]
    for name, candidates in _candidates(model, scale=scale):
        try:
            levels.append(_level(model, points, nominal_fit, name, candidates, tolerance))
        except NotConverged:
            continue
    best = levels[0]
    for level in levels[1:]:
        if _proved(best.left_m, level.left_m):
            best = level
    return _result(model, points, holdout, levels, best, couplings)


def _candidates(model: ArmModel, *, scale: bool) -> list[tuple[str, tuple[str, ...]]]:
    joints = model.arm.joints
    zeros = tuple(f"{j.name}.{'theta_rad' if r else 'd_m'}" for j, r in zip(joints, model.arm.revolute, strict=True))
    links = model.names[: 5 * model.arm.n]
    found = [("joint zeros", zeros), ("geometry", links)]
    if scale:
        found.append(("geometry and joint scales", (*links, *(f"{j.name}.scale" for j in joints))))
    return found


def _coupled(
    model: ArmModel, points: ArmPoints, tolerance: Tolerance
) -> tuple[Array, tuple[tuple[str, str, float], ...]]:
    """Return the nominal arm's parameters, couplings of one included where they halve the error."""
    p = start(model, points)
    joints = model.arm.joints
    found: list[tuple[str, str, float]] = []
    size = _robust(model, p, points)
    for i in range(1, model.arm.n):
        if not (model.arm.revolute[i] and model.arm.revolute[i - 1]) or np.ptp(points.q[:, i - 1]) < 0.2:
            continue
        for share in (1.0, -1.0):
            driven = points.q.copy()
            driven[:, i] += share * driven[:, i - 1]
            other = start(model, replace(points, q=driven), like=p)
            if _robust(model, other, replace(points, q=driven)) < COUPLED * size:
                p = other.copy()
                p[6 * model.arm.n + i - 1] = share
                size = _robust(model, p, points)
                found = [(joints[i].name, joints[i - 1].name, share)]
    return p, tuple(found)


def _robust(model: ArmModel, p: Array, points: ArmPoints) -> float:
    return float(np.median(np.linalg.norm(model.errors(p, points)[0], axis=1)))


def _level(
    model: ArmModel,
    points: ArmPoints,
    nominal: ArmFit,
    name: str,
    candidates: Sequence[str],
    tolerance: Tolerance,
) -> _Level:
    """Fit one kind of model to all rows, and work out what it misses rows by that it has not seen."""
    choice = Choice(free=(), fixed=(), condition=1.0)
    fitted = nominal
    for _ in range(2 if candidates else 0):  # once with the nominal arm's noise, once with the calibrated one's
        before = choice.free
        noise = fitted.sigma_m, fitted.sigma_rad
        choice = choose(model, points, fitted.p, candidates, tolerance, noise)
        if set(choice.free) == set(before):
            break
        fitted = fit_arm(model, points, fitted.p, choice.free, tolerance)
    return _Level(name=name, fitted=fitted, choice=choice, left_m=left_out(model, points, fitted))


def left_out(model: ArmModel, points: ArmPoints, fitted: ArmFit) -> Array:
    """Return the error (m,) in m at each row, predicted without it and every FOLDS-th beside it.

    Leaving rows out moves the fit by (H - H_k)^-1 g_k, H the information and g_k the gradient of those rows: one
    Gauss-Newton step from the fit to all rows, which is at its minimum for the rest to second order.
    """
    evaluation = model.evaluate(fitted.p, points, fitted.sigma_m, fitted.sigma_rad)
    index = [model.names.index(name) for name in fitted.free]
    m = len(points)
    root = np.sqrt(fitted.fit.weights.reshape(m, -1))
    J = evaluation.shared[0][:, index].reshape(m, -1, len(index)) * root[:, :, None]
    r = evaluation.residuals.reshape(m, -1) * root
    H = np.einsum("mki,mkj->ij", J, J) + np.diag(fitted.prior_weight)
    scale = np.sqrt(np.diag(H))
    scale[scale == 0.0] = 1.0
    out = np.empty(m)
    none = np.zeros((1, 0))
    for k in range(min(FOLDS, m)):
        rows = np.arange(k, m, min(FOLDS, m))
        flat = J[rows].reshape(-1, len(index))
        rest = (H - flat.T @ flat) / np.outer(scale, scale) + RIDGE * np.eye(len(index))
        step = np.zeros(len(fitted.p))
        step[index] = np.linalg.solve(rest, (flat.T @ r[rows].ravel()) / scale) / scale
        moved, _ = model.retract(fitted.p, none, step, none)
        out[rows] = np.linalg.norm(model.errors(moved, points.take(rows))[0], axis=1)
    return out


def _proved(before_m: Array, after_m: Array) -> bool:
    """Whether errors fall beyond their own doubt, row by row; gross rows are levelled so that none decides alone."""
    cap = 5.0 * float(np.median(before_m))
    fall = np.minimum(before_m, cap) - np.minimum(after_m, cap)
    doubt = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    return bool(fall.mean() > PROVED * doubt and fall.mean() > 1e-3 * before_m.mean())


def _result(
    model: ArmModel,
    points: ArmPoints,
    holdout: ArmPoints | None,
    levels: Sequence[_Level],
    best: _Level,
    couplings: tuple[tuple[str, str, float], ...],
) -> ArmCalibration:
    first = levels[0]
    before_m = np.linalg.norm(model.errors(first.fitted.p, points)[0], axis=1)
    after_m = np.linalg.norm(model.errors(best.fitted.p, points)[0], axis=1)
    left = first.left_m, best.left_m
    if holdout is not None:
        there = [np.linalg.norm(model.errors(x.fitted.p, holdout)[0], axis=1) for x in (first, best)]
        left = there[0], there[1]
    richest = levels[-1].choice
    gain = best is not first
    limit = GROSS * best.fitted.sigma_m
    covariance = best.fitted.fit.covariance
    arm = model.arm_at(best.fitted.p)
    if covariance is not None:
        links = tuple(name for name in covariance.names if name in model.names[: 5 * model.arm.n])
        if links:
            arm = replace(arm, covariance=NamedCovariance(names=links, matrix=covariance.block(links)))
    return ArmCalibration(
        arm=arm,
        nominal=model.arm,
        model=model,
        fitted=best.fitted,
        gain=gain,
        level=best.name,
        before=Errors.of(before_m),
        after=Errors.of(after_m),
        left_before=Errors.of(left[0]),
        left_after=Errors.of(left[1]),
        held=holdout is not None,
        free=best.choice.free,
        fixed=best.choice.fixed if gain else richest.fixed,
        condition=best.choice.condition,
        covariance=covariance,
        outliers=tuple((int(i), float(after_m[i])) for i in np.flatnonzero(after_m > limit)),
        couplings=couplings,
        verdict=_verdict(first, best, levels, couplings),
        error_m=after_m,
        before_m=before_m,
    )


def _verdict(
    first: _Level, best: _Level, levels: Sequence[_Level], couplings: tuple[tuple[str, str, float], ...]
) -> str:
    """Return what to think of it, in a sentence or two."""
    told = "".join(
        f" The reading of {a} is absolute: its angle is {a} {'+' if share > 0 else '-'} {b}, and the arm file says so."
        for a, b, share in couplings
    )
    mean = 1e3 * float(first.left_m.mean())
    if best is first:
        tried = ", ".join(f"{level.name} {1e3 * level.left_m.mean():.3g} mm" for level in levels[1:])
        return (
            f"No gain is proved: rows left out of the fit miss by {mean:.3g} mm with the nominal arm, and not reliably "
            f"less with any correction ({tried}). The nominal geometry is kept; measure more, or better." + told
        )
    return (
        f"Correcting {best.name} ({len(best.choice.free)} parameters) takes the error of rows left out of the fit from "
        f"{mean:.3g} to {1e3 * best.left_m.mean():.3g} mm." + told
    )
