"""A nominal arm and what it touched in, the corrected arm out: zeros and lengths as far as touches tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import still
from armsight.calibrate.arm.fit import ArmFit, Tolerance, limits_reached, tool_points
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import RISING, UNPROVED, candidates, significant_gain
from armsight.calibrate.arm.plausibility import ranges
from armsight.calibrate.arm.result import ArmResult, Errors, FixedParameter, TouchedFeature
from armsight.calibrate.arm.touch.faults import Told, check_lengths, check_moved, gross_rows, other_senses, told
from armsight.calibrate.arm.touch.fit import TouchFit, fit_touches
from armsight.calibrate.arm.touch.model import TouchModel, start
from armsight.calibrate.arm.touch.touches import Kind, Touches, check_touches, of_postures
from armsight.errors import Inconsistent, NotConverged
from armsight.fitting.quantiles import chi2_ppf
from armsight.kinematics import Arm
from armsight.records import NamedCovariance
from armsight.units import MM

FOLDS = 5
"""Of the touches, each left out in turn; every feature is in all of them."""
NOMINAL, CORRECTED = "nominal", "zeros and lengths"
MOST_SCATTER_M = 2e-3
"""Touches of a right arm scatter by less once it is corrected: by hand into a cone 0.1 mm, a slack home-made arm 1."""
REFITS = 3
"""Fits without the touches that are off beyond chance."""
MOST_GROSS = 0.2
"""Share of touches of wrong features that is borne, by name."""
HALVED = 0.5
"""Share of the scatter to which a richer kind takes it where what it adds is plain before touches are left out."""
SEEN = 0.95
"""Chance that what a richer kind adds is smaller if it is not there; below, it is not tried on touches left out."""
DOUBTED = 0.5
"""The same, from which deviations hold what an unproved kind would change: servos' scales of 1 % were hidden at 0.9."""


def calibrate_touched(
    nominal: Arm, touches: Touches, *, tolerance: Tolerance | None = None, scale: bool = True
) -> ArmResult:
    """Return the arm that what it touched tells, nominal where touches left out are not missed by less with it.

    Tips and features are fitted always. All lengths and angles are free within their tolerances, joints' sag or scales
    where touches left out prove them too; those that the touches tell are corrections, the others are named with what
    would make them known. Raises NotEnoughData, Degenerate, Inconsistent for touches that are not of this arm, of a
    feature that was moved, or against a length that was given.
    """
    tolerance = tolerance or Tolerance()
    check_touches(nominal, touches)
    given, touches = touches, of_postures(touches)
    arm_model = ArmModel(arm=nominal, labels=touches.tips, turned=False)
    model, guess = start(arm_model, touches)
    kinds = [(NOMINAL, ()), *(x for x in candidates(arm_model, scale=scale) if x[0].startswith("geometry"))]
    tried, later = kinds[:2], kinds[2:]
    levels = _levels(model, guess, tried, tolerance)
    if not _fits(model, levels[1].fitted):
        _refuse_senses(model, guess)
        tried, later = kinds, []
        levels = _levels(model, guess, kinds[2:], tolerance, levels)
    plain = _plain(levels).fitted
    _check_fit(model, plain)
    every, gross = model, gross_rows(model, plain)
    for _ in range(REFITS):  # a gross row's pull is bounded, but along what the others hardly tell it is far
        if not gross:
            break
        kept = np.setdiff1d(np.arange(len(touches)), [row for row, _, _ in gross])
        model = replace(every, touches=touches.take(kept))
        levels = _levels(model, levels[0].fitted.p, tried, tolerance)
        before, gross = gross, gross_rows(every, _plain(levels).fitted)
        if [row for row, _, _ in gross] == [row for row, _, _ in before]:
            break
    levels = _levels(model, levels[0].fitted.p, later, tolerance, levels)
    best = _chosen(model, levels, tolerance)
    full = best if best is not levels[0] else levels[1]
    check_moved(model, full.fitted, tolerance)
    check_lengths(model, full.fitted, tolerance)
    found = told(model, full.fitted, full.offered, tolerance)
    judged = _Judged(given=given, every=every, model=model, levels=levels, best=best, full=full, told=found)
    return _result(judged, tolerance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Level:
    """A kind of model, what it offers, its fit, and errors (m,) at touches left out, where it was tried on them."""

    name: str
    offered: tuple[str, ...]
    fitted: TouchFit
    risen: tuple[str, ...] = ()
    left_m: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judged:
    """All kinds of model, fitted to all touches but gross ones (model; every: to all), the one kept, the one that would
    be (full), and what it tells."""

    given: Touches
    every: TouchModel
    model: TouchModel
    levels: Sequence[_Level]
    best: _Level
    full: _Level
    told: Told

    @property
    def gain(self) -> bool:
        return self.best is self.full

    @property
    def free(self) -> tuple[str, ...]:
        return self.told.known if self.gain else ()


def _levels(
    model: TouchModel,
    guess: Array,
    kinds: Sequence[tuple[str, tuple[str, ...]]],
    tolerance: Tolerance,
    known: Sequence[_Level] = (),
) -> list[_Level]:
    """Return the known fits and those of further kinds of model, the nominal one first; richer ones than zeros and
    lengths that did not converge are left out. Raises Inconsistent for the first ones."""
    levels = [*known]
    for name, offered in kinds:
        risen: tuple[str, ...] = ()
        p = levels[min(len(levels), 2) - 1].fitted.p if levels else guess
        try:
            fitted = fit_touches(model, p, offered, tolerance)
            while up := tuple(x for x in offered if x.endswith(".sag") and fitted.p[model.names.index(x)] < 0.0):
                risen, offered = (*risen, *up), tuple(x for x in offered if x not in up)
                fitted = fit_touches(model, p, offered, tolerance)
        except (NotConverged, Inconsistent):  # such as a joint's scale far from one
            if len(levels) < len((NOMINAL, CORRECTED)):
                _refuse_senses(model, guess)
                raise _not_of_this_arm("with zeros and lengths corrected no arm fits the touches") from None
            continue
        told_name = name.replace("geometry and", "zeros, lengths and").replace("geometry", CORRECTED)
        levels.append(_Level(name=told_name, offered=offered, fitted=fitted, risen=risen))
    return levels


def _plain(levels: Sequence[_Level]) -> _Level:
    """Return the level of zeros and lengths; a richer one where what it adds is plain: it halves the scatter."""
    best = levels[1]
    for richer in levels[2:]:
        best = richer if richer.fitted.scatter_m < HALVED * best.fitted.scatter_m else best
    return best


def _chosen(model: TouchModel, levels: list[_Level], tolerance: Tolerance) -> _Level:
    """Return the richest level that misses touches left out by less than the one before it that does; tries them."""
    for k, one in enumerate(levels):
        if k < len((NOMINAL, CORRECTED)) or _seen(levels[1], one, SEEN):
            levels[k] = replace(one, left_m=_left_out(model, one, tolerance))
    best = levels[0]
    for richer in levels[1:]:
        # as of measured positions: only what predicts touches left out is taken
        if len(richer.left_m) and significant_gain(best.left_m, richer.left_m, np.arange(len(richer.left_m))):
            best = richer
    return best


def _seen(plain: _Level, richer: _Level, chance: float) -> bool:
    """Whether what a richer kind adds is not nothing: Wald's test of all of it."""
    fit = richer.fitted.fit
    more = set(richer.offered) - set(plain.offered)
    names = () if fit.covariance is None else tuple(x for x in fit.covariance.names if x in more)
    if fit.covariance is None or not names:
        return False
    added: Array = np.array([fit.value(x) for x in names])
    return float(added @ np.linalg.solve(fit.covariance.block(names), added)) > float(chi2_ppf(chance, len(names)))


def _fits(model: TouchModel, full: TouchFit) -> bool:
    most = MOST_GROSS * len(model.touches)
    return full.scatter_m <= MOST_SCATTER_M and len(gross_rows(model, full)) <= most


def _check_fit(model: TouchModel, full: TouchFit) -> None:
    """Raise Inconsistent where the touches are not of this arm, whichever way its joints count."""
    if _fits(model, full):
        return
    gross = gross_rows(model, full)
    rows = ranges([int(model.touches.row[row]) for row, _, _ in gross]) if gross else ""
    told_rows = f"; rows {rows} do not agree with the others" if gross else ""
    raise _not_of_this_arm(
        f"with zeros and lengths corrected the touches still scatter by {full.scatter_m / MM:.3g} mm{told_rows}"
    )


def _not_of_this_arm(what: str) -> Inconsistent:
    return Inconsistent(
        what,
        consequence="They are not of this arm at these readings, or of other features than they are called",
        cure="Give the file of this arm; look for exchanged columns, readings and features out of step, a tip or "
        "a feature that moved",
    )


def _refuse_senses(model: TouchModel, guess: Array) -> None:
    arm, touches = model.arm_model.arm, model.touches
    senses = other_senses(arm, touches)
    if senses is not None:
        spikes = ~touches.scalar
        missed_m = float(np.sqrt((model.misses(guess, touches)[0][spikes] ** 2).sum(axis=1).mean()))
        raise senses.refusal(arm, missed_m, "the touched points")


def _left_out(model: TouchModel, one: _Level, tolerance: Tolerance) -> Array:
    """Return the errors (m,) in m of a level at touches left out."""
    touches = model.touches
    # every feature's touches, and a tip's, are dealt out in turn, so that none is left without
    order = np.lexsort((touches.of_tip, touches.which))
    fold = np.empty(len(touches), dtype=np.intp)
    fold[order] = np.arange(len(touches)) % FOLDS
    errors = np.empty(len(touches))
    for k in range(FOLDS):
        held, rows = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        # the noises are those of all: a fold has too few rows for its own
        part = replace(model, touches=touches.take(rows))
        again = fit_touches(part, one.fitted.p, one.offered, tolerance, one.fitted.noise)
        errors[held] = again.misses_m(part, touches.take(held))
    return errors


def _result(judged: _Judged, tolerance: Tolerance) -> ArmResult:
    model, best = judged.model, judged.best.fitted
    touches, arm_model = model.touches, model.arm_model
    covariance, fitted = _covariance(judged), _fitted(arm_model, best, touches, tolerance)
    at_limit, touched = limits_reached(arm_model, fitted.p, judged.free, tolerance), judged.given.as_points()
    before_m, after_m = (one.fitted.misses_m(model, judged.given) for one in (judged.levels[0], judged.best))
    gross, cross = gross_rows(judged.every, best), [Errors.of(x.left_m) for x in (judged.levels[0], judged.best)]
    return ArmResult(
        arm=replace(_arm(arm_model, best, covariance), tool_points=tool_points(arm_model, fitted)),
        points=replace(touched, xyz_m=arm_model.predict(fitted.p, touched)[0][:, :3, 3]),
        tolerance=tolerance,
        model=arm_model,
        fitted=fitted,
        gain=judged.gain,
        level=judged.best.name,
        before=Errors.of(before_m),
        after=Errors.of(after_m),
        cross_before=cross[0],
        cross_after=cross[1],
        left_before=cross[0],
        left_after=cross[1],
        held=False,
        free=judged.free,
        fixed=_fixed(judged),
        condition=judged.told.condition if judged.gain else 1.0,
        covariance=covariance,
        outlier_rows=tuple((int(judged.every.touches.row[row]), miss_m) for row, miss_m, _ in gross),
        couplings=(),
        still=still(arm_model, touches.as_points()),
        at_limit=at_limit,
        notes=(*(x.sentence for x in at_limit), *_notes(judged, gross)),
        verdict=" ".join([_verdict(judged), *(f"{x.sentence}." for x in at_limit)]),
        error_m=after_m,
        before_m=before_m,
        position_noise_m=best.noise.touch_m[touches.kind[0]],
        n_places=len(touches),
        other_arm=None,
        urdf=None,
        features=tuple(_feature(model, best, name) for name in touches.kinds),
    )


def _fixed(judged: _Judged) -> tuple[FixedParameter, ...]:
    # of a nominal arm that is kept nothing is told but that
    why = dict(judged.told.fixed) if judged.gain else {}
    more = [x for one in judged.levels for x in one.offered if x not in judged.free and x not in judged.told.hidden]
    why |= {x: UNPROVED for x in more if x not in why}
    why |= {x: RISING for one in judged.levels for x in one.risen if x not in judged.free}
    return tuple(FixedParameter(*one) for one in why.items())


def _fitted(arm_model: ArmModel, best: TouchFit, touches: Touches, tolerance: Tolerance) -> ArmFit:
    """Return the arm's part of a fit."""
    ours = tuple(x for x in best.free if x in arm_model.names)
    return ArmFit(
        p=best.p[: len(arm_model.names)],
        fit=best.fit,
        sigma_m=best.noise.touch_m[touches.kind[0]],
        sigma_rad=1.0,
        free=ours,
        prior_weight=np.array([tolerance.of(x) ** -2 if x not in arm_model.mounts else 0.0 for x in ours]),
    )


def _covariance(judged: _Judged) -> NamedCovariance | None:
    """Return that of the arm's own parameters; of none that no touch tells anything of."""
    found = judged.best.fitted.fit.covariance
    if found is None:
        return None
    # a prior alone is no knowledge: what no touch tells is left out; and so is the tip, which takes up what is open
    # behind the last joint: alone it looks uncertain by all of that
    model = judged.model.arm_model
    ours = set(model.names[: model.n_geometry]) - judged.told.hidden
    names = tuple(name for name in found.names if name in ours)
    if not names:
        return None
    # scales or sag that are not proved may be there all the same: what they would change is not known better
    matrix, richer = found.block(names), judged.levels[judged.levels.index(judged.best) + 1 :]
    for one in richer if judged.gain else ():
        if _seen(judged.best, one, DOUBTED):
            off = np.array([one.fitted.fit.value(x) - judged.best.fitted.fit.value(x) for x in names])
            matrix = matrix + np.outer(off, off)
    return NamedCovariance(names=names, matrix=matrix)


def _arm(arm_model: ArmModel, best: TouchFit, covariance: NamedCovariance | None) -> Arm:
    """Return the arm with its links' covariance; base and the tool's orientation stay the nominal ones."""
    p = best.p[: len(arm_model.names)]
    arm, nominal = arm_model.arm_at(p), arm_model.arm
    links = () if covariance is None else tuple(x for x in covariance.names if x in arm_model.names[: 5 * nominal.n])
    heavy = any(joint.mass_kg for joint in arm.joints)  # which way is down is written for weights alone
    tip = RigidTransform.from_components(arm.T_flange_tool.translation, nominal.T_flange_tool.rotation)
    return replace(
        arm,
        T_flange_tool=tip,
        T_world_base=nominal.T_world_base,
        down_in_base=arm.down_in_base if heavy else nominal.down_in_base,
        covariance=NamedCovariance(names=links, matrix=covariance.block(links)) if covariance and links else None,
    )


def _feature(model: TouchModel, best: TouchFit, name: str) -> TouchedFeature:
    kind, p = model.touches.kinds[name], best.p
    mine = model.touches.take(np.flatnonzero(np.array(model.touches.feature) == name))
    flat = kind in (Kind.PLANE, Kind.GAUGE)
    normal, place = None, p[model.first(name)]
    if flat:
        normal, _ = model.normal(p, name)
        place = model.place[name] + normal * p[model.first(name).start]
    base = model.arm_model.arm.T_world_base.inv()
    return TouchedFeature(
        name=name,
        kind=kind.value,
        n=len(mine),
        rms_m=float(np.sqrt(np.mean(best.misses_m(model, mine) ** 2))),
        place_m=np.asarray(base.apply(place)).tolist(),
        normal=None if normal is None else np.asarray(base.rotation.apply(normal)).tolist(),
        radius_m=float(p[model.first(name).stop]) if kind is Kind.SPHERE else None,
    )


def _notes(judged: _Judged, gross: Sequence[tuple[int, float, str]]) -> tuple[str, ...]:
    """Return what to know: rows of other features, what is open and why, what the tool's frame is."""
    touches = judged.every.touches
    told_rows = [
        f"Row {touches.row[row] + 1} is called {touches.feature[row]} and fits {fits}: it is left out"
        for row, _, fits in gross
        if fits
    ]
    why: dict[str, list[str]] = {}
    for name, reason in judged.told.fixed:
        if name in judged.told.hidden:
            why.setdefault(reason, []).append(name)
    open_ = [f"Open: {', '.join(names)} ({reason})" for reason, names in why.items()]
    noise = judged.best.fitted.noise
    size = ", ".join(f"{kind} {noise.touch_m[kind] / MM:.2g} mm" for kind in sorted(set(touches.kind)))
    scatter = f"Touches scatter in one coordinate by: {size}; joint readings by {noise.joint:.2g} rad or m"
    n, places = len(judged.given), len(touches)
    repeated = [f"The {n} rows are touches in {places} postures, which share what the arm has wrong there: averaged"]
    frame = "Features are in base axes, where the first joint has its nominal zero; the tool keeps its orientation"
    return (*told_rows, *open_, scatter, *(repeated if n > places else ()), frame)


def _verdict(judged: _Judged) -> str:
    before, after = (f"{float(np.mean(size)) / MM:.3g}" for size in (judged.levels[0].left_m, judged.full.left_m))
    if not judged.gain:
        return (
            f"No gain is proved: touches left out by cross-validation miss by {before} mm with the nominal arm, and by "
            f"{after} mm with {judged.full.name} corrected, not reliably less. The nominal geometry is kept; touch "
            "from more postures, further apart."
        )
    told_by = f"{len(judged.free)} parameters told by {len(judged.model.touches)} touches"
    return (
        f"Correcting {judged.best.name} ({told_by}) takes the "
        f"error of touches left out by cross-validation from {before} to {after} mm."
    )
