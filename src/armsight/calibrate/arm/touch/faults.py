"""Touches that cannot be what they are called: of another feature, of one that was moved, or beside a wrong length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import orthonormal_basis
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.touch.fit import TouchFit, fit_touches
from armsight.calibrate.arm.touch.model import TouchModel
from armsight.calibrate.arm.touch.touches import Kind
from armsight.errors import Inconsistent
from armsight.fitting.quantiles import chi2_ppf, f_isf
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Gross:
    """A row (from 0 of those fitted) that misses its feature by so much, m, and the one that it fits, '' for none."""

    row: int
    miss_m: float
    fits: str


def gross_rows(model: TouchModel, fitted: TouchFit) -> tuple[Gross, ...]:
    """Return the touches that are off beyond chance; a wrong spike's with the name of the right one."""
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
        found.append(Gross(row=i, miss_m=float(np.linalg.norm(e[i])), fits=fits))
    return tuple(found)


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
            "tip was moved, take the rows of one side alone",
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
