"""Kinds of model from poor to rich, each fitted to all rows, and their errors at joint positions not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import Choice, choose, orthonormal_basis
from armsight.calibrate.arm.fit import ArmFit, Tolerance, estimate_noise, fit_arm, start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate, NotConverged, NotEnoughData
from armsight.fields import Doc
from armsight.fitting.groups import without
from armsight.fitting.quantiles import t_ppf


class CoupledReading(NamedTuple):
    """A joint whose reading another joint's moves along."""

    joint: Annotated[str, Doc("The joint.")]
    by: Annotated[str, Doc("The joint that moves it along.")]
    share: Annotated[float, Doc("How much of that joint's reading.")]


Couplings = tuple[CoupledReading, ...]

FOLDS = 5
PROVED = 2.0
"""A model is taken where left-out errors fall by this many of the fall's own standard errors: by chance once in 44."""
FEW = 10
"""Groups of rows, up to which the fall's standard error is itself so poorly known that Student's factor is taken."""
FEWEST_JUDGED = 3
"""Joint positions below which the spread of a fall says nothing."""
PASSES = 6
"""Choices of what to free: where a fit lessens the noise, more can be told; two or three are the rule."""
RIDGE = 1e-12
"""Keeps directions that no row tells (a tool on the last axis) where they are, in scaled information."""
COUPLED = 0.5
"""A coupling of one is believed where it takes the error below this share of what it is without."""
COUPLING_MISS = 0.2
"""A coupling of one leaves errors of about what it does beside base and tool; where the error is below this share of
that, there is none, and it is not tried."""
EXACT_M = 1e-7
"""An error below this is rounding, of which half is no gain: no tracker sees a tenth of a micrometre. With the tool on
the last axis that joint's coupling moves nothing, and exact rows were called coupled."""
COUPLING_RANGE_RAD = 0.2
"""A joint that moved less cannot tell whether the next one's reading holds its own."""
REPLACED = "the axes before and behind are parallel: the next joint's d_m says the same, and beta_rad their tilt"

UNPROVED = "no gain is proved by correcting it"
RISING = "the measurements want the joint to rise against its load, which no spring does"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """A kind of model: its name, fit and choice, the errors (m,) at rows left out as one step tells them (left_out),
    couplings it holds."""

    name: str
    fitted: ArmFit
    choice: Choice
    left_m: Array
    couplings: Couplings = ()


def candidates(model: ArmModel, *, scale: bool) -> list[tuple[str, tuple[str, ...]]]:
    """Return the kinds of model and the parameters that each offers."""
    joints = model.arm.joints
    zeros = tuple(f"{j.name}.{'theta_rad' if r else 'd_m'}" for j, r in zip(joints, model.arm.revolute, strict=True))
    found = [
        ("joint zeros", zeros),
        ("joint zeros and sag", (*zeros, *model.sags)),
        ("geometry", model.geometry),
        ("geometry and sag", (*model.geometry, *model.sags)),
    ]
    if scale:
        found.append(("geometry and joint scales", (*model.geometry, *(f"{j.name}.scale" for j in joints))))
    return found


def coupled(model: ArmModel, points: ArmPoints, nominal: Array) -> tuple[Array, Couplings]:
    """Return the parameters with those couplings of one that halve the error, and the couplings."""
    p = nominal
    joints = model.arm.joints
    found: Couplings = ()
    size = _robust(model, p, points)
    effect = _coupling_effects(model, p, points)
    for i in range(1, model.arm.n):
        turn = model.arm.revolute[i] and model.arm.revolute[i - 1]
        small = max(COUPLING_MISS * effect[i - 1], EXACT_M)
        if not turn or np.ptp(points.q[:, i - 1]) < COUPLING_RANGE_RAD or size < small:
            continue
        for share in (1.0, -1.0):
            driven = points.q.copy()
            driven[:, i] += share * driven[:, i - 1]
            other = start(model, replace(points, q=driven), like=p)
            if _robust(model, other, replace(points, q=driven)) < COUPLED * size:
                p = other.copy()
                p[6 * model.arm.n + i - 1] = share
                size = _robust(model, p, points)
                found = (CoupledReading(joints[i].name, joints[i - 1].name, share),)
    return p, found


def _coupling_effects(model: ArmModel, p: Array, points: ArmPoints) -> Array:
    """Return (n - 1,): the median error in m that each coupling of one makes beside base and tool, to first order."""
    n = model.arm.n
    J = model.predict(p, points)[1][:, :3].reshape(-1, len(p))
    Q = orthonormal_basis(J[:, model.n_geometry :])
    own = J[:, 6 * n : 7 * n - 1]
    own = own - Q @ (Q.T @ own)
    return np.asarray(np.median(np.linalg.norm(own.reshape(len(points), 3, n - 1), axis=1), axis=0))


def _robust(model: ArmModel, p: Array, points: ArmPoints) -> float:
    return float(np.median(np.linalg.norm(model.errors(p, points)[0], axis=1)))


def plain_level(model: ArmModel, points: ArmPoints, fitted: ArmFit, name: str, couplings: Couplings = ()) -> Level:
    """Return the level of a fit of base and tool alone."""
    choice = Choice(free=(), fixed=(), condition=1.0)
    left = left_out(model, points, fitted)
    return Level(name=name, fitted=fitted, choice=choice, left_m=left, couplings=couplings)


def fit_levels(
    model: ArmModel, points: ArmPoints, guess: Array, tolerance: Tolerance, *, scale: bool, like: Sequence[Level] = ()
) -> list[Level]:
    """Return the fits of all kinds of model, the nominal one first; richer ones that did not converge are left out.

    like: levels of other rows of the same arm, to begin at; the answer does not hang on them. Raises NotConverged for
    the nominal one.
    """
    begun = {x.name: x.fitted for x in like}
    p, couplings = coupled(model, points, guess)
    levels = [plain_level(model, points, fit_arm(model, points, guess, (), tolerance), "nominal")]
    if couplings:
        fitted = fit_arm(model, points, p, (), tolerance)
        levels.append(plain_level(model, points, fitted, "coupled readings", couplings))
    plain = levels[-1]
    for name, offered in candidates(model, scale=scale):
        told = f"{plain.name} and {name}" if couplings else name
        try:
            levels.append(level(model, points, plain, told, offered, tolerance, begun.get(told)))
        except NotConverged:
            continue
    return levels


def best_level(levels: Sequence[Level], group: NDArray[np.intp], *, proved: float = PROVED) -> Level:
    """Return the richest level with a significant gain over the one before it that has one; group (m,) of rows."""
    best = levels[0]
    for richer in levels[1:]:
        if significant_gain(best.left_m, richer.left_m, group, proved=proved):
            best = richer
    return best


def level(
    model: ArmModel,
    points: ArmPoints,
    first: Level,
    name: str,
    offered: Sequence[str],
    tolerance: Tolerance,
    like: ArmFit | None = None,
) -> Level:
    """Fit one kind of model, from a level without free geometry, or from where a fit to other rows ended.

    Raises NotConverged.
    """
    choice, fitted = first.choice, first.fitted
    p, noise = fitted.p, (fitted.sigma_m, fitted.sigma_rad)
    risen: tuple[tuple[str, str], ...] = ()
    if like is not None:
        p, noise = like.p, estimate_noise(model, like.p, points, len(like.free))
    for _ in range(PASSES):  # first with the noise where it begins, then with that of the fit
        before = choice.free
        choice = choose(model, points, p, offered, tolerance, noise)
        if set(choice.free) == set(before):
            break
        # What an earlier pass had freed and this one does not goes back to nominal: fixed means unchanged.
        kept = [name in choice.free or k >= model.n_geometry for k, name in enumerate(model.names)]
        fitted = fit_arm(model, points, np.where(kept, p, first.fitted.p), choice.free, tolerance)
        p, noise = fitted.p, (fitted.sigma_m, fitted.sigma_rad)
        rising = {name for name in choice.free if name.endswith(".sag") and p[model.names.index(name)] < 0.0}
        offered = tuple(name for name in offered if name not in rising)
        risen += tuple((name, RISING) for name in rising)
    told = tuple((d, REPLACED) for d in model.replaced if "geometry" in name)
    choice = replace(choice, fixed=(*choice.fixed, *risen, *told))
    left = left_out(model, points, fitted)
    return Level(name=name, fitted=fitted, choice=choice, left_m=left, couplings=first.couplings)


def left_out(model: ArmModel, points: ArmPoints, fitted: ArmFit) -> Array:
    """Return the error (m,) in m at each row, predicted without its joint position and every FOLDS-th beside it, by a
    step from the fit: what levels are compared by. What is claimed comes from full refits (cross_validation).

    All rows of one joint position, or of one block of time, are left out together: what one of them has wrong the
    others have too.
    """
    evaluation = model.evaluate(fitted.p, points, fitted.sigma_m, fitted.sigma_rad)
    index = [model.names.index(name) for name in fitted.free]
    m = len(points)
    root = np.sqrt(fitted.fit.weights.reshape(m, -1))
    J = evaluation.shared[0][:, index].reshape(m, -1, len(index)) * root[:, :, None]
    r = evaluation.residuals.reshape(m, -1) * root
    H = np.einsum("mki,mkj->ij", J, J) + np.diag(fitted.prior_weight)
    out = np.empty(m)
    none = np.zeros((1, 0))
    fold = points.group % FOLDS
    for k in range(fold.max() + 1):
        rows = np.flatnonzero(fold == k)
        flat = J[rows].reshape(-1, len(index))
        step = np.zeros(len(fitted.p))
        step[index] = without(H, flat.T @ flat, flat.T @ r[rows].ravel(), RIDGE)
        moved, _ = model.retract(fitted.p, none, step, none)
        out[rows] = np.linalg.norm(model.errors(moved, points.take(rows))[0], axis=1)
    return out


def significant_gain(before_m: Array, after_m: Array, group: NDArray[np.intp], *, proved: float = PROVED) -> bool:
    """Whether errors (m,) fall beyond their own uncertainty, group by group, whose rows hang together: those of one
    joint position, or of one block of time.

    Gross rows are levelled so that none decides alone. Rows that are not judged (NaN) are left out. proved: how many of
    the fall's standard errors it must be.
    """
    judged = np.isfinite(before_m) & np.isfinite(after_m)
    before_m, after_m = before_m[judged], after_m[judged]
    which = np.unique(group[judged], return_inverse=True)[1]
    if not len(which) or which.max() + 1 < FEWEST_JUDGED:
        return False
    cap = 5.0 * float(np.median(before_m))
    fall = np.minimum(before_m, cap) - np.minimum(after_m, cap)
    fall = np.bincount(which, fall) / np.bincount(which)
    uncertainty = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    if len(fall) <= FEW:
        proved = float(-t_ppf(ndtr(-proved), len(fall) - 1))
    return bool(fall.mean() > proved * uncertainty and fall.mean() > 1e-3 * before_m.mean())


# Errors at joint positions left out, with all that looked at the measurements done again without them (nested folds).
#
# Noise, weights, the choice of parameters, coupled readings and the kind of model are found afresh in each fold, and
# the fit runs to its end (Varma and Simon 2006: what is chosen with the rows left out flatters itself on them).


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOut:
    """Errors (m,) in m at rows left out; NaN where the other rows do not tell where a row's tool point is.

    nominal_m: with the nominal geometry. chosen_m: with what each fold chose. by_level: with each kind of model.
    """

    nominal_m: Array
    chosen_m: Array
    by_level: Mapping[str, Array]

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Which rows (m,) are judged."""
        return np.asarray(np.isfinite(self.nominal_m))


def cross_validate(
    model: ArmModel, points: ArmPoints, levels: Sequence[Level], tolerance: Tolerance, *, scale: bool
) -> LeftOut:
    """Return the errors at each row, calibrated without its joint position and every FOLDS-th beside it, or without its
    block of time, every FOLDS-th beside it and what is near them in time.

    levels: of all rows; the folds begin where they ended. A fold takes a kind of model as all rows do, by one step
    (left_out); with fewer rows the same fall is fewer of its standard errors, by the root of their share. Raises
    NotEnoughData where no fold can be judged.
    """
    m = len(points)
    nominal, chosen = np.full(m, np.nan), np.full(m, np.nan)
    by_level = {x.name: np.full(m, np.nan) for x in levels}
    fold = points.group % FOLDS
    for k in range(int(fold.max()) + 1):
        rest = points.take(np.flatnonzero(points.away(fold == k)))
        known = np.array([label in rest.labels for label in points.point])
        rows = np.flatnonzero((fold == k) & known)
        if not len(rows):
            continue
        try:
            guess = start(model, rest, like=levels[0].fitted.p)
            refitted = fit_levels(model, rest, guess, tolerance, scale=scale, like=levels)
        except (NotConverged, Degenerate):
            continue
        there = points.take(rows)
        sizes = {x.name: np.linalg.norm(model.errors(x.fitted.p, there)[0], axis=1) for x in refitted}
        nominal[rows] = sizes[refitted[0].name]
        fewer = PROVED * float(np.sqrt(len(rest) / m))
        taken = best_level(refitted, rest.group, proved=fewer)
        chosen[rows] = sizes[taken.name]
        for name, errors in by_level.items():
            errors[rows] = sizes.get(name, nominal[rows])
    if not np.isfinite(nominal).any():
        raise NotEnoughData(
            "no row can be predicted from the rows of other joint positions",
            consequence="Whether a correction is worth it cannot be judged",
            cure="Measure every point of the tool at several joint positions, and more of them",
        )
    return LeftOut(nominal_m=nominal, chosen_m=chosen, by_level=by_level)
