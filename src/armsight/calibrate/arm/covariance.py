"""Which parameters measurements can tell, and how far a fit of an arm is to be believed.

Parameters are picked by pivoting in the order of what the measurements tell most. Rows of a stream hang together in
time, and held geometry is off too: of rows of one recording, how long their errors are alike, blocks of time, and wider
deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from armsight.arrays import Array
from armsight.calibrate.arm.fit import ArmFit, Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.correlation import Averaged, Correlation, fit_averaged, made_independent, score_covariance
from armsight.records import NamedCovariance

WORTH = 2.0
"""A parameter is freed where the measurements alone would know it to a half of its tolerance."""
STILL = 1e-3
"""A joint whose readings stay within so much (rad, or of the mean link) did not move."""
APART = 0.02
"""Share of a parameter's effect that must be its own, not that of base, tool and the parameters freed before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What of an arm's geometry is to be fitted, and why not the rest.

    free: names in the order of what the measurements tell. fixed: (name, why) of all other candidates. condition: of
    the freed columns, each scaled by its tolerance, beside base and tools.
    """

    free: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    condition: float


def choose(
    model: ArmModel,
    points: ArmPoints,
    p: Array,
    candidates: Sequence[str],
    tolerance: Tolerance,
    noise: tuple[float, float],
) -> Choice:
    """Return which candidates can be told from each other and from base and tools by these measurements."""
    J = model.evaluate(p, points, *noise).shared[0]
    mounts = J[:, model.n_geometry :]
    # What base and tools can take up is no sign of the geometry: only what is square to their columns counts
    Q = orthonormal_basis(mounts)
    index = [model.names.index(name) for name in candidates]
    # A whitened column times its tolerance is as long as the correction of one tolerance is in standard deviations: 1 /
    # length is what the measurements alone would know it to, in tolerances
    columns = J[:, index] * np.array([tolerance.of(name) for name in candidates])
    size_before = np.linalg.norm(columns, axis=0)
    left = columns - Q @ (Q.T @ columns)
    free: list[int] = []
    open_ = list(range(len(candidates)))
    # Gram-Schmidt with column pivoting (Golub, Van Loan, QR with column pivoting): free what has most of its own left,
    # take that out of all others, and go on until nothing has enough. The order so goes by what is told, not by the
    # joints' numbers
    while open_:
        size = np.linalg.norm(left[:, open_], axis=0)
        fit = (size >= WORTH) & (size >= APART * size_before[open_])
        if not fit.any():
            break
        best = open_[int(np.argmax(np.where(fit, size, -1.0)))]
        free.append(best)
        open_.remove(best)
        v = left[:, best] / np.linalg.norm(left[:, best])
        left = left - np.outer(v, v @ left)
    resting = still(model, points)
    fixed = tuple(
        (candidates[i], _why(candidates[i], resting, size_before[i], np.linalg.norm(left[:, i]))) for i in open_
    )
    own = columns[:, free] - Q @ (Q.T @ columns[:, free])
    condition = float(np.linalg.cond(own)) if free else 1.0
    return Choice(free=tuple(candidates[i] for i in free), fixed=fixed, condition=condition)


def orthonormal_basis(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span."""
    size = np.linalg.norm(columns, axis=0)
    U, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]])


def still(model: ArmModel, points: ArmPoints) -> tuple[str, ...]:
    """Return the names of the joints that did not move."""
    size = np.where(model.arm.revolute, 1.0, model.arm.length_m)
    moved = np.ptp(points.q, axis=0) > STILL * size
    return tuple(joint.name for joint, m in zip(model.arm.joints, moved, strict=True) if not m)


def _why(name: str, resting: Sequence[str], size_before: float, left: float | np.floating) -> str:
    joint = name.rsplit(".", 1)[0]
    if joint in resting:
        return f"joint {joint} did not move"
    if size_before < WORTH:
        return "the measurements tell less of it than its tolerance"
    if left < APART * size_before:
        return "cannot be told apart from base, tool and the parameters that were freed"
    return "what it does apart from the freed parameters is lost in the noise"


ALIKE = 0.1
"""Rows whose errors are alike by more than this from one moment to the next are samples of a stream."""
FEWEST_TIMED = 12
"""Joint positions below which nothing can be said of time."""
FORGOTTEN = 3.0
"""Blocks of time last so many correlation times: what is left of a drift from one to the next is 5 %."""
FEWEST_BLOCKS, MOST_BLOCKS = 5, 60


def drift_of(model: ArmModel, points: ArmPoints, fitted: ArmFit) -> Averaged | None:
    """Return how long the errors that a fit leaves are alike; None without times, or where they are too few."""
    if points.t_s is None or points.position.max() + 1 < FEWEST_TIMED or not np.ptp(points.t_s) > 0.0:
        return None
    r, J = weighted(model, points, fitted, fitted.free)
    basis = orthonormal_basis(J.reshape(-1, J.shape[2]))  # directions that are open, or told twice, are not there
    return fit_averaged(r, basis.reshape(*r.shape, -1), points.t_s)


def in_blocks(points: ArmPoints, correlation: Correlation | None) -> ArmPoints:
    """Return the rows with the block of time that each is of, where they are samples of a stream; else as they are."""
    if points.t_s is None or correlation is None:
        return points
    moments = np.unique(points.t_s)
    span = float(moments[-1] - moments[0])
    if not span > 0.0 or correlation.neighbours(float(np.median(np.diff(moments)))) < ALIKE:
        return points
    count = int(np.clip(span / (FORGOTTEN * correlation.time_s), FEWEST_BLOCKS, MOST_BLOCKS))
    block = np.minimum(((points.t_s - moments[0]) / span * count).astype(np.intp), count - 1)
    return replace(points, block=block, gap_s=min(correlation.time_s, 0.5 * span / count))


def believed(
    model: ArmModel, points: ArmPoints, fitted: ArmFit, tolerance: Tolerance
) -> tuple[ArmFit, Correlation | None, HeldGeometry | None]:
    """Return the fit as far as it is to be believed: with a covariance that says how far the geometry it holds is off,
    and, of rows in blocks of time, how long the errors are alike; that, and what is held."""
    held = held_geometry(model, points, fitted, tolerance)
    drift = None if points.block is None else drift_of(model, points, fitted)
    wide = fitted if drift is None else widened(model, points, fitted, drift)
    correlation = None if drift is None else replace(drift.correlation, counted=points.counted)
    covariance = wide.fit.covariance
    if covariance is None or held is None:
        return wide, correlation, held
    more = NamedCovariance(names=covariance.names, matrix=covariance.matrix + held.moved @ held.moved.T)
    return replace(wide, fit=replace(wide.fit, covariance=more)), correlation, held


def widened(model: ArmModel, points: ArmPoints, fitted: ArmFit, drift: Averaged) -> ArmFit:
    """Return the fit with the covariance that it has where the errors drift: of the gradient's true scatter (the
    sandwich of Huber 1967), not of as many independent rows."""
    covariance = fitted.fit.covariance
    if covariance is None or points.t_s is None:
        return fitted
    _, J = weighted(model, points, fitted, covariance.names)
    known = [fitted.free.index(name) for name in covariance.names]
    scatter = score_covariance(drift, J, points.t_s) + np.diag(fitted.prior_weight[known])
    C = covariance.matrix @ scatter @ covariance.matrix
    wide = NamedCovariance(names=covariance.names, matrix=0.5 * (C + C.T))
    return replace(fitted, fit=replace(fitted.fit, covariance=wide))


def weighted(model: ArmModel, points: ArmPoints, fitted: ArmFit, names: Sequence[str]) -> tuple[Array, Array]:
    """Return whitened residuals (m, k) and their derivative (m, k, N) by what is named, with the robust weights."""
    evaluation = model.evaluate(fitted.p, points, fitted.sigma_m, fitted.sigma_rad)
    index = [model.names.index(name) for name in names]
    root = np.sqrt(fitted.fit.weights.reshape(len(points), -1))
    r = evaluation.residuals.reshape(len(points), -1) * root
    return r, evaluation.shared[0][:, index].reshape(*r.shape, len(index)) * root[:, :, None]


# Geometry that a fit holds at its nominal figures is built to a tolerance, and what was fitted takes up its errors.
#
# A covariance that counts what is held as exact is too small: compliances of an arm built to 0.3 mm and 1 mrad, found
# beside joint zeros alone, were off by 1.2 of their standard deviations (RMS). How far lengths and angles that are held
# are off is told by the residuals they leave: two variances, by restricted maximum likelihood (Patterson, Thompson
# 1971, Biometrika 58, 545), none where the residuals are white.

OWN = 1e-6
"""Share of a parameter's effect that is not base's, tool's or a freed one's, below which it is the same parameter by
another name and has no error of its own."""
TOLD = 3.0
"""Standard deviations from which on a correction, or an error of what is held, is named."""
SMALLEST, LARGEST = 1e-4, 1.0
"""Shares of their tolerances that lengths and angles are looked for to be off by."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldGeometry:
    """Lengths and angles that a fit holds at nominal, and that are off by what its residuals say.

    names: of what is held. off (g,), std (g,): by how much it is likely off. moved (k, g): of what was fitted, by one
    deviation of what is held, as it is believed beforehand.
    """

    names: tuple[str, ...]
    off: Array
    std: Array
    moved: Array

    def doubt(self, fitted: ArmFit, corrected: Sequence[str]) -> str:
        """Return which corrections of a fit as it is to be believed are beyond TOLD of its deviations without what is
        held, and not with it; what of that would explain them. Empty where there are none."""
        covariance = fitted.fit.covariance
        if covariance is None:
            return ""
        variance, more = np.diag(covariance.matrix), (self.moved**2).sum(axis=1)
        size = np.array([fitted.fit.value(name) / TOLD for name in covariance.names]) ** 2
        between = (variance - more < size) & (size < variance)
        blurred = [name for name, one in zip(covariance.names, between, strict=True) if one and name in corrected]
        if not blurred:
            return ""
        rows = zip(self.names, self.off.tolist(), self.std.tolist(), strict=True)
        found = [f"{name} {_told(name, off, std)}" for name, off, std in rows if abs(off) > TOLD * std]
        what = f", such as {' and '.join(found)}, which would explain more" if found else ""
        return (
            f"Corrections of {', '.join(blurred)} cannot be told from errors of lengths and angles that are held{what}"
        )


def _told(name: str, off: float, std: float) -> str:
    scale, unit = (1e3, "mm") if name.endswith("_m") else (float(np.rad2deg(1.0)), "degrees")
    return f"off by {scale * off:+.3g} +- {scale * std:.2g} {unit}"


def held_geometry(model: ArmModel, points: ArmPoints, fitted: ArmFit, tolerance: Tolerance) -> HeldGeometry | None:
    """Return how far the geometry that a fit holds is off by its residuals; None where it holds none.

    Of rows in blocks of time residuals and effects are made independent first, by the drift that is left beside all
    geometry: a drift found in what a wrong length leaves would take that for its own.
    """
    covariance = fitted.fit.covariance
    if covariance is None:
        return None
    held = [name for name in model.geometry if name not in fitted.free]
    size = np.array([tolerance.of(name) for name in held])
    r = weighted(model, points, fitted, ())[0]
    free, known, G = (weighted(model, points, fitted, names)[1] for names in (fitted.free, covariance.names, held))
    # residuals, effects of what was fitted, and of what is held by a tolerance each: whitened alike below
    columns = np.concatenate([r[:, :, None], free, G * size], axis=2)
    effect = covariance.matrix @ np.einsum("mka,mkg->ag", known, columns[:, :, 1 + len(fitted.free) :])
    if points.block is not None and points.t_s is not None:
        basis = orthonormal_basis(columns[:, :, 1:].reshape(r.size, -1)).reshape(*r.shape, -1)
        drift = fit_averaged(r, basis, points.t_s)
        columns = made_independent(drift, columns.reshape(len(r), -1), points.t_s).reshape(columns.shape)
    y, free, G = np.split(columns.reshape(r.size, -1), [1, 1 + len(fitted.free)], axis=1)
    basis = orthonormal_basis(free)
    # what only a held length or angle explains, beside all that was fitted
    own, y = G - basis @ (basis.T @ G), (y - basis @ (basis.T @ y))[:, 0]
    there = np.linalg.norm(own, axis=0) > OWN * np.maximum(np.linalg.norm(G, axis=0), 1.0)
    if not there.any():
        return None
    own, names = own[:, there], np.array(held)[there]
    kinds = np.array([name.endswith("_m") for name in names])
    share = np.where(kinds, *_shares(own, y, kinds, len(y) - basis.shape[1]))
    # y = own share x + noise of variance 1, x of variance 1 beforehand: x is -spread (own share)' y by its sign here
    spread = np.linalg.inv((own * share).T @ (own * share) + np.eye(len(share)))
    std = size[there] * share
    return HeldGeometry(
        names=tuple(names.tolist()),
        off=-std * (spread @ (own * share).T @ y),
        std=std * np.sqrt(np.diag(spread)),
        moved=effect[:, there] * share,
    )


def _shares(own: Array, r: Array, lengths: NDArray[np.bool_], freedom: int) -> tuple[float, float]:
    """Return by what shares of their tolerances held lengths and angles are off: own (m, g) is their effect beside
    what was fitted, lengths (g,) which are lengths; r (m,) what is left of the residuals, with so many degrees."""
    Q = orthonormal_basis(own)
    R, y = Q.T @ own, Q.T @ r
    rest2, count = float(r @ r - y @ y), freedom - Q.shape[1]
    if count < 1:
        return 0.0, 0.0
    parts = [R[:, lengths] @ R[:, lengths].T, R[:, ~lengths] @ R[:, ~lengths].T]

    def neg2_log_likelihood(log: Array) -> float:
        noise, a, b = np.exp(2.0 * log)
        V = noise * np.eye(len(y)) + a * parts[0] + b * parts[1]
        return float(np.linalg.slogdet(V)[1] + y @ np.linalg.solve(V, y) + count * np.log(noise) + rest2 / noise)

    low, high = np.log(SMALLEST), np.log(LARGEST)
    box = [(-7.0, 7.0), (low, high), (low, high)]
    # restricted maximum likelihood: shares of 0 are at infinity in logarithms, so the least of them stands for none
    found = minimize(neg2_log_likelihood, [0.0, low / 4.0, low / 2.0], bounds=box, method="L-BFGS-B")
    _, length, angle = np.exp(found.x)
    return float(length), float(angle)
