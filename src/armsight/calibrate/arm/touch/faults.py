"""What touches tell: that they are not what they are called, which way joints count, and which parameters are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import STILL, WORTH, orthonormal_basis
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.senses import (
    FEWEST,
    FITS,
    FITS_ALIKE,
    MOST_JOINTS,
    ROWS,
    Senses,
    all_choices,
    fit_choices,
    judged,
    tool_points,
)
from armsight.calibrate.arm.touch.fit import FIRST_M, LEAST_JOINT, TouchFit, TouchNoise, fit_touches
from armsight.calibrate.arm.touch.model import TouchModel, start
from armsight.calibrate.arm.touch.touches import Kind, Touches
from armsight.errors import Inconsistent, NotConverged
from armsight.fitting.quantiles import chi2_ppf, f_isf
from armsight.kinematics import Arm, fk
from armsight.units import MM

GROSS = float(np.sqrt(chi2_ppf(0.99999, 3)))
"""Touches off by more standard deviations are gross."""
FALSE_ALARM = 1e-5
"""Chance that a feature of a good set is called moved."""
FEWEST_SIDE = 4
"""Touches before and behind a moment at which a feature may have been moved."""
LEAST_MOVE = 2.0
"""A feature that moved by less (of the touches' standard deviations) does not matter."""
LENGTH_OFF = 5.0
"""Standard deviations between a length that was measured and what the touches say of it."""


def gross_rows(model: TouchModel, fitted: TouchFit) -> list[tuple[int, float, str]]:
    """Return the touches that are off beyond chance: the row, from 0 of those fitted, by how much it misses its feature
    in m, and the feature that it fits, '' for none."""
    e, _, by_q = model.misses(fitted.p, model.touches)
    whiten = fitted.noise.whitener(model.touches, by_q)
    size = np.linalg.norm(np.einsum("mij,mj->mi", whiten, e), axis=1)
    spikes = [name for name, kind in model.touches.kinds.items() if kind is Kind.POINT]
    found = []
    for i in np.flatnonzero(size > GROSS).tolist():
        fits = ""
        if model.touches.kind[i] is Kind.POINT:
            tip = e[i] + fitted.p[model.first(model.touches.feature[i])]
            near = {name: float(np.linalg.norm(whiten[i] @ (tip - fitted.p[model.first(name)]))) for name in spikes}
            nearest = min(near, key=lambda name: near[name])
            fits = nearest if near[nearest] <= GROSS else ""
        found.append((i, float(np.linalg.norm(e[i])), fits))
    return found


def check_moved(model: TouchModel, fitted: TouchFit, tolerance: Tolerance) -> None:
    """Raise Inconsistent where a spike's touches are those of two places, one up to some row and one behind it.

    A place of its own for the rows behind is tried at each row of each spike: an F-test of what it takes off the
    squares, with all else free.
    """
    touches, which, m = model.touches, np.array(model.touches.feature), len(model.touches)
    root = np.sqrt(fitted.fit.weights.reshape(-1, 3))[:m, :1]
    r, Q = _squares(model, fitted, tolerance)
    dof, rest = max(fitted.fit.dof, 1), float(r @ r)
    best: tuple[float, str, int, Array] = (0.0, "", 0, np.zeros(3))
    tries = 0
    for name, kind in touches.kinds.items():
        rows = np.flatnonzero(which == name)
        if kind is not Kind.POINT:
            continue
        for first in range(FEWEST_SIDE, len(rows) - FEWEST_SIDE + 1):
            tries += 1
            # a place of its own for the rows behind, beside what was fitted
            behind = np.zeros((m, 3, 3))
            behind[rows[first:]] = -fitted.whiten[rows[first:]]
            S = np.zeros((len(r), 3))
            S[: 3 * m] = np.reshape(behind * root[..., None], (3 * m, 3))
            S = S - Q @ (Q.T @ S)
            step = np.asarray(np.linalg.lstsq(S, -r, rcond=1e-6)[0], dtype=float)
            gain = rest - float(((r + S @ step) ** 2).sum())
            if gain > best[0]:
                best = (gain, name, int(rows[first]), step)
    gain, name, row, step = best
    moved_m = float(np.linalg.norm(step))
    if not tries or dof <= 3:
        return
    share = (gain / 3.0) / max((rest - gain) / (dof - 3), 1e-300)
    limit = float(f_isf(FALSE_ALARM / tries, 3, dof - 3))
    if share > limit and moved_m > LEAST_MOVE * fitted.noise.touch_m[Kind.POINT]:
        raise Inconsistent(
            f"the touches of {name} are of two places {moved_m / MM:.2g} mm apart: up to row {touches.row[row]}, and "
            f"from row {touches.row[row] + 1} on",
            consequence=f"{name} (or the tip) was moved there, and no arm is fitted to both",
            cure=f"Call {name} by another name from row {touches.row[row] + 1} on, or leave those rows out; where the "
            "tip was moved, give it another name from there on in a column tip",
        )


def _squares(model: TouchModel, fitted: TouchFit, tolerance: Tolerance) -> tuple[Array, Array]:
    """Return the weighted residuals of rows, lengths and priors (k,), and an orthonormal basis of what was fitted."""
    at = [model.names.index(name) for name in fitted.free]
    evaluation = model.evaluate(fitted.p, fitted.whiten)
    root = np.sqrt(fitted.fit.weights[0])
    known = np.array([0.0 if name in model.mounts else 1.0 / tolerance.of(name) for name in fitted.free])
    r = np.concatenate([evaluation.residuals[0] * root, known * fitted.p[at]])
    J = np.concatenate([evaluation.shared[0][:, at] * root[:, None], np.diag(known)])
    return r, orthonormal_basis(J)


def check_lengths(model: TouchModel, fitted: TouchFit, tolerance: Tolerance) -> None:
    """Raise Inconsistent where a length that was measured is not what the touches say of it without it."""
    for one in model.touches.lengths:
        others = tuple(known for known in model.touches.lengths if known is not one)
        # what the touches say of it must not rest on it
        alone = replace(model, touches=replace(model.touches, lengths=others))
        candidates = [name for name in fitted.free if name not in model.mounts]
        found = fit_touches(alone, fitted.p, candidates, tolerance, fitted.noise)
        r, by = model.lengths(found.p)
        k = model.touches.lengths.index(one)
        names = [] if found.fit.covariance is None else list(found.fit.covariance.names)
        at = [model.names.index(name) for name in names]
        spread = 0.0 if not names else float(by[k, at] @ found.fit.covariance.matrix @ by[k, at])  # type: ignore[union-attr]
        if abs(r[k]) <= LENGTH_OFF * np.sqrt(1.0 + spread):
            continue
        says = one.length_m + float(r[k]) * one.sigma_m
        raise Inconsistent(
            f"{one.words} is given as {one.length_m / MM:.5g} mm; the nominal arm's touches say "
            f"{says / MM:.5g} +- {np.sqrt(spread) * one.sigma_m / MM:.2g} mm",
            consequence="One of the two is of something else, and every length would follow it",
            cure="Measure it again, and look whether the names are those of the table; raise --tolerance-mm where the "
            "arm may be built so far off",
        )


# Joints that count the other way, or from elsewhere, told by touches alone: spikes scatter least with the right ones.
#
# A mirror image of an arm touches a mirror image of the spikes: of an arm with a plane of symmetry the joints that run
# the other way, and all others that turn about axes in that plane, are alike, and both are told.

ROUGH = TouchNoise(touch_m=dict.fromkeys(Kind, FIRST_M), joint=LEAST_JOINT)
"""Of touches whose scatter is not known yet."""
PULL = 3.0
"""Rows that a known distance is worth: enough that no choice shrinks the spikes to one."""


def other_senses(arm: Arm, touches: Touches) -> Senses | None:
    """Return the senses and zeros that explain the touches of spikes where the given ones do not; else None.

    Flats, balls and gauges say too little for it; of several tips the one that touched most spikes is taken.
    """
    turning = np.flatnonzero(arm.revolute)
    spikes = np.flatnonzero(~touches.scalar)
    spikes = spikes[touches.of_tip[spikes] == np.bincount(touches.of_tip[spikes], minlength=1).argmax()]
    if not 1 <= len(turning) <= MOST_JOINTS or len(spikes) < FEWEST or arm.couplings:
        return None
    used = touches.take(spikes[np.unique(np.linspace(0, len(spikes) - 1, ROWS).astype(np.intp))])
    there = set(used.feature)
    used = replace(used, lengths=tuple(one for one in used.lengths if one.b and {one.a, one.b} <= there))
    flange = fk(arm, used.q)[:, :3, 3]
    spread = float(np.sqrt(((flange - flange.mean(axis=0)) ** 2).sum(axis=1).mean()))
    # zeros and tip are free beside every choice
    left_of = partial(_left, arm, turning, used)
    choices = all_choices(len(turning))
    left, found = fit_choices(arm, turning, choices, used.q, left_of)
    if left.min() > FITS * spread:
        return None
    return judged(arm, turning, choices, left, found, FITS_ALIKE * spread, partial(_refined, used))


def _refined(touches: Touches, arm: Arm) -> float:
    """Return what an arm leaves of the touches once lengths and angles are fitted within tolerance, RMS in m."""
    model, guess = start(ArmModel(arm=arm, labels=touches.tips, turned=False), touches)
    try:
        fitted = fit_touches(model, guess, model.arm_model.geometry, Tolerance(), ROUGH)
    except NotConverged:
        return float("inf")
    return float(np.sqrt((fitted.misses_m(model, touches) ** 2).mean()))


def _left(arm: Arm, turning: NDArray[np.intp], touches: Touches, read: Array, x: Array) -> tuple[Array, Array]:
    """Return how far each touch is from the middle of its spike's, (c, 3 m + d), and by how much d known distances are
    off, with the derivatives by zeros and tool x (c, k + 3)."""
    there, by_x = tool_points(arm, turning, read, x)
    c, m, width = len(x), len(touches), x.shape[1]
    which = np.unique(touches.which, return_inverse=True)[1]
    # where a spike is goes with every choice: the mean of its touches
    share = np.equal.outer(np.arange(which.max() + 1), which) / np.bincount(which)[:, None]
    middle, by_middle = share @ there, (share @ by_x.reshape(c, m, -1)).reshape(c, -1, 3, width)
    off, by_off = there - middle[:, which], by_x - by_middle[:, which]
    r, J = [off.reshape(c, -1)], [by_off.reshape(c, -1, width)]
    names = list(dict.fromkeys(touches.feature))
    number = {name: int(which[touches.feature.index(name)]) for name in names}
    for one in touches.lengths:
        a, b = number[one.a], number[one.b]
        apart = middle[:, a] - middle[:, b]
        size = np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
        along = (apart / size)[:, None]
        r.append(PULL * (size - one.length_m))
        J.append(PULL * along @ (by_middle[:, a] - by_middle[:, b]))
    return np.concatenate(r, axis=1), np.concatenate(J, axis=1)


# Which of an arm's parameters touches tell, which are open whatever is touched, and what would make them known.

OPEN = 1e-3
"""Share of the parameters' effect that must be their own, not the tip's and the features': of open directions the
scatter of the touches leaves 3e-4 (0.1 mm at 0.3 m), of those that are told 1e-2."""
SCATTERS = 5.0
"""... and so many times the touches' scatter over the arm's length."""
NOTHING = 1e-9
"""Share of the largest effect that is none: of the weight on an axis that stands upright."""
PART = 0.1
"""Share of an open direction from which a parameter is in it."""
SCALE = 0.9
"""Alike (cosine) with the change of all lengths by one factor from which an open direction is that."""

BASE = (
    "where the arm stands takes that up, and what it touches moves with it: measure positions of the tool (--points) "
    "in a frame of the base"
)
TIP = "the tip's place takes that up: measure the tool's orientation too (--points with qx .. qw)"
LENGTHS = "no length was measured, and touches tell lengths by their ratios alone: measure one (--length A,B,270mm)"
SAG = "its load turns it too little, or alike in all postures: touch with the arm stretched out and drawn in"
WEAK = "the touches tell it no better than to half its tolerance: touch from more postures, further apart"


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """known: names that touches tell. fixed: (name, why) of the others, in words. hidden: of those the ones that no
    touch of these tells anything of. condition: of the known ones' own effects, each scaled by its tolerance."""

    known: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    hidden: frozenset[str]
    condition: float


def told(model: TouchModel, fitted: TouchFit, candidates: Sequence[str], tolerance: Tolerance) -> Told:
    """Return which candidates the touches tell: to half their tolerance, whatever they were believed to before.

    A direction in which tip and features can follow is open: its parameters get no number.
    """
    names = list(model.names)
    J = model.evaluate(fitted.p, fitted.whiten).shared[0]
    Q = orthonormal_basis(J[:, [names.index(name) for name in model.mounts]])
    sigma = np.array([tolerance.of(name) for name in candidates])
    C = J[:, [names.index(name) for name in candidates]] * sigma
    # what tip and features can follow is no sign of the arm
    own = C - Q @ (Q.T @ C)
    size = np.linalg.norm(C, axis=0)
    size = np.maximum(size, NOTHING * size.max())
    _, s, Vt = np.linalg.svd(own / size, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(Vt) - len(s))])
    scatter = fitted.scatter_m / model.arm_model.arm.length_m
    open_ = Vt[s < max(OPEN, SCATTERS * scatter)] / size  # (k, c) in tolerances
    open_ = np.linalg.qr(open_.T)[0].T if len(open_) else open_
    inside = np.linalg.norm(open_, axis=0) > PART
    # posterior deviations hold the priors of all
    std = fitted.fit.std()
    known, fixed, hidden = [], [], set()
    for k, name in enumerate(candidates):
        spread = std.get(name, np.inf)
        # what the rows say without what was believed of this one: 1 / s^2 = 1 / posterior - 1 / prior
        more = spread**-2 - sigma[k] ** -2
        if inside[k]:
            hidden.add(name)
            fixed.append((name, _why(model, name, k, open_, candidates, sigma)))
        elif more * sigma[k] ** 2 < WORTH**2:
            fixed.append((name, WEAK))
        else:
            known.append(name)
    at = [k for k, name in enumerate(candidates) if name in known]
    condition = float(np.linalg.cond(own[:, at])) if at else 1.0
    return Told(known=tuple(known), fixed=tuple(fixed), hidden=frozenset(hidden), condition=condition)


def _why(model: TouchModel, name: str, k: int, open_: Array, candidates: Sequence[str], sigma: Array) -> str:
    """Return what keeps a parameter open, and what would make it known."""
    arm = model.arm_model.arm
    joint, key = name.rsplit(".", 1)
    moved = np.ptp(model.touches.q, axis=0) > STILL * np.where(arm.revolute, 1.0, arm.length_m)
    resting = [one.name for one, moves in zip(arm.joints, moved, strict=True) if not moves]
    if joint in resting:
        return f"joint {joint} did not move: touch with it in other places"
    if key == "sag":
        return SAG
    if joint == arm.joints[0].name and key != "scale":
        return BASE
    if joint == arm.joints[-1].name and key != "scale":
        return TIP
    # all lengths by one factor, tip and features too, miss nothing
    scale = np.array([_length(model, one) for one in candidates]) / sigma
    along = open_ @ (scale / max(float(np.linalg.norm(scale)), 1e-300))
    if name.endswith("_m") and np.linalg.norm(along) > SCALE:
        return LENGTHS
    mine = open_.T @ open_[:, k]
    others = [one for one, part in zip(candidates, np.abs(mine), strict=True) if part > PART and one != name]
    beside = f" from {', '.join(others[:4])}" if others else ""
    return f"these touches do not tell it apart{beside}: touch more features, from more different postures"


def _length(model: TouchModel, name: str) -> float:
    """Return the nominal length that a parameter is, 0 for an angle."""
    joint, key = name.rsplit(".", 1)
    if not key.endswith("_m"):
        return 0.0
    return float(next(getattr(one, key) for one in model.arm_model.arm.joints if one.name == joint))
