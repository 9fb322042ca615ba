"""What zeros are worth beside links that are not nominal: lengths, axes and zeros as random effects.

A healthy arm differs from its table by a millimetre and a milliradian here and there, and over a small workspace a zero
does what a length does. So all geometry is drawn about nominal with deviations that are not known themselves: they are
averaged over a grid by restricted likelihood (Patterson, Thompson 1971; Hoeting and others 1999). Explanations are
compared by their evidence, the likelihood averaged over all that they leave open (MacKay 1992): what could explain
anything is believed less than what could explain just this.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array
from armsight.fitting.groups import inflation
from armsight.verify.effects import Effect, Kind
from armsight.verify.evidence import Case, Evidence
from armsight.verify.model import ModelFit, Noise, extra_noise

LENGTH_M, ANGLE_RAD = 1e-3, 1e-3
"""What nominal lengths are believed to, as in a cell from one recording, and axes and zeros of an arm that was
mastered: a UR10 from its factory lies 0.5 mm and 0.5 mrad beside its table, a worn one twice as far."""
SIZES = (0.03, 0.1, 0.3, 0.7, 1.5, 3.0)
"""Multiples of these that are weighed against each other, of lengths and of angles apart."""
SIZE_MIDDLE, SIZE_SPREAD = 0.5, 1.2
"""Middle and spread (natural logarithm) of what the multiples are believed to be before any row is looked at."""
SCALES = (0.7, 1.0, 1.4)
"""Multiples of the noise that are weighed against each other."""
KNOCKS = (1e-3, 1e-2)
"""Standard deviations (rad, RMS over the rows; of a slide as shares of the arm's length) of what a fault is believed to
be before any row is looked at: 0.06 and 0.6 deg."""
ROUNDS = 3
RIDGE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Account:
    """One explanation: its log evidence; the joints' zeros (n,) with standard deviations, and those of the fault's
    parameters (k,), means over the grid. off_m: how far the tool may be off for zeros and links, RMS over the rows, m:
    what base and tool take up counts with it."""

    log_evidence: float
    zeros: Array
    std: Array
    fault_std: Array
    off_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GeometryPrior:
    """The case's rows with the noise that geometry leaves of them; what `account` weighs explanations by.

    bare: the evidence at base and tool alone, in m and rad. weight (m,): square root of each row's weight: gross rows
    count less. inflation: rows worth one independent row.
    """

    case: Case
    bare: Evidence
    noise: Noise
    weight: Array
    inflation: float

    @classmethod
    def of(cls, case: Case, aligned: ModelFit) -> GeometryPrior:
        """Return the prior with the noise that remains where geometry and zeros are freed within it."""
        plain = Noise(measurement=np.zeros((len(case.q), 2)), extra=np.ones(2))
        bare = Evidence.at(case, aligned, None, plain)
        noise, rest = aligned.noise, bare.linear.residual
        variance = _wide(case, bare)
        for _ in range(ROUNDS):
            X = _stacked(*(noise.whiten(c) for c in (bare.linear.fixed, bare.joints, bare.geometry)))
            y = noise.whiten(bare.linear.residual).ravel()
            size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
            A = (X / size).T @ (X / size)
            H = A + np.diag(1.0 / (variance * size**2) + RIDGE)
            theta = np.linalg.solve(H, (X / size).T @ y) / size
            worn = float(np.trace(np.linalg.solve(H, A)))
            rest = bare.linear.residual - (_stacked(bare.linear.fixed, bare.joints, bare.geometry) @ theta).reshape(
                bare.linear.residual.shape
            )
            spent = min(worn, 0.9 * y.size)
            noise = Noise.of(case.measured, _spent(extra_noise(rest, noise.measurement, 0), rest, noise, spent))
        left = replace(bare.linear, residual=noise.whiten(rest))
        return cls(case=case, bare=bare, noise=noise, weight=left.weight, inflation=inflation(left.residual))

    def account(self, fitted: ModelFit, effect: Effect | None, loose: Iterable[int] = ()) -> Account:
        """Return the evidence of an explanation and the zeros that it believes.

        fitted: with the effect, where one is given: a fault of one joint. loose: joints (from 0) whose zeros may be
        off by as much as a fault.
        """
        found = Evidence.at(self.case, fitted, effect, self.noise)
        columns = [found.linear.fixed[:, :, : len(self.case.free)], found.joints, found.geometry]
        if effect is not None:
            columns.append(found.columns(effect))
        w = self.weight[:, None, None]
        X = _stacked(*(w * c for c in columns))
        y = (found.linear.residual * w[:, :, 0]).ravel()
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        X = X / size
        n = self.case.bare.n
        at = len(self.case.free) + np.arange(n)
        own = fitted.p[len(fitted.p) - (0 if effect is None else len(effect.names)) :]
        mean = np.zeros(X.shape[1])
        mean[X.shape[1] - len(own) :] = -own
        grid = self._grid(found, effect, tuple(loose))
        log, theta, covariance = _solved(X, y, mean * size, grid.precision / size**2, grid.scale**2, self.inflation)
        log = log + grid.log_prior
        top = float(log.max())
        weight = np.exp(log - top)
        evidence = top + float(np.log(weight.sum()))
        weight /= weight.sum()
        wanted = np.eye(X.shape[1])[[*at, *range(X.shape[1] - len(own), X.shape[1])]] / size  # zeros, then the fault
        start = np.append(np.zeros(n), own)
        if effect is not None and effect.kind is Kind.ZERO:  # the joint's own deviation and the fault are one zero
            wanted[[effect.joint, -1]] = wanted[effect.joint] + wanted[-1]
            start[effect.joint] = own[0]
        values = theta @ wanted.T  # (g, n + k)
        variance = np.einsum("ni,gij,nj->gn", wanted, covariance, wanted, optimize=True)
        middle = weight @ values
        std = np.sqrt(weight @ (variance + (values - middle) ** 2))
        return Account(
            log_evidence=evidence,
            zeros=(start + middle)[:n],
            std=std[:n],
            fault_std=std[n:],
            off_m=self._off_m(weight, theta / size, covariance / np.outer(size, size)),
        )

    def _off_m(self, weight: Array, theta: Array, covariance: Array) -> float:
        """Return how far zeros and links put the tool off (RMS, m), of values (g, K) with covariances, weighed (g,)."""
        moves = np.concatenate([self.bare.joints, self.bare.geometry], axis=2)[:, :3]  # (m, 3, n + g)
        arm = slice(len(self.case.free), len(self.case.free) + moves.shape[2])
        second = np.einsum("g,gij->ij", weight, covariance[:, arm, arm]) + (weight * theta[:, arm].T) @ theta[:, arm]
        return float(np.sqrt(np.einsum("mik,kl,mil->", moves, second, moves, optimize=True) / len(moves)))

    def _grid(self, found: Evidence, effect: Effect | None, loose: tuple[int, ...]) -> _Grid:
        """Return the precisions of all columns at each point of the grid."""
        bare, fixed = self.case.bare, len(self.case.free)
        faulty = effect is not None or bool(loose)
        axes = np.meshgrid(SIZES, SIZES, SCALES, KNOCKS if faulty else KNOCKS[:1], indexing="ij")
        lengths, angles, scale, knock = (a.ravel() for a in axes)
        turning, sliding = ANGLE_RAD * angles[:, None], LENGTH_M * lengths[:, None]
        joint = np.where(bare.revolute, turning, sliding)  # (g, n)
        per = np.where(bare.revolute, 1.0, bare.length_m)
        for j in loose:
            joint[:, j] = np.hypot(joint[:, j], knock * per[j])
        links = np.where(found.lengths, sliding, turning)
        parts = [np.zeros((len(scale), fixed)), joint**-2.0, links**-2.0]
        if effect is not None:
            rms = np.sqrt((effect.basis**2).mean(axis=0))
            parts.append((knock[:, None] * per[effect.joint] / np.maximum(rms, 1e-300)) ** -2.0)
        prior = sum(-0.5 * (np.log(a / SIZE_MIDDLE) / SIZE_SPREAD) ** 2 for a in (lengths, angles))
        prior = prior - np.log(np.exp(prior).sum())
        return _Grid(precision=np.concatenate(parts, axis=1), scale=scale, log_prior=np.asarray(prior))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """Points (g,): precisions (g, K) of the columns, 0 where free, the noise's scale, logarithm of the prior."""

    precision: Array
    scale: Array
    log_prior: Array


def _solved(X: Array, y: Array, mean: Array, precision: Array, scale2: Array, inflation: float) -> tuple[Array, ...]:
    """Return restricted log likelihoods (g,), values (g, K) and covariances (g, K, K) of unit columns X (rows, K)."""
    A, b, yy, n = X.T @ X / inflation, X.T @ y / inflation, float(y @ y) / inflation, y.size / inflation
    H = A / scale2[:, None, None] + np.eye(len(A)) * (precision + RIDGE)[:, None, :]
    right = b / scale2[:, None] + precision * mean
    covariance = np.linalg.inv(H)
    theta = np.einsum("gij,gj->gi", covariance, right)
    squares = yy / scale2 + (precision * mean**2).sum(axis=1) - (right * theta).sum(axis=1)
    random = np.where(precision > 0.0, np.log(np.maximum(precision, 1e-300)), 0.0).sum(axis=1)
    log = -0.5 * (n * np.log(scale2) + np.linalg.slogdet(H)[1] - random + squares)
    return np.asarray(log), np.asarray(theta), np.asarray(covariance)


def _stacked(*columns: Array) -> Array:
    """Return columns (m, rows, k) side by side, (m rows, K)."""
    each = np.concatenate(columns, axis=2)
    return np.asarray(each.reshape(-1, each.shape[2]))


def _wide(case: Case, found: Evidence) -> Array:
    """Return the variances (K,) of base and tool, zeros and geometry that the noise is estimated beside."""
    widest = SIZES[-1]
    zeros = np.where(case.bare.revolute, KNOCKS[-1], KNOCKS[-1] * case.bare.length_m)
    links = widest * np.where(found.lengths, LENGTH_M, ANGLE_RAD)
    return np.asarray(np.concatenate([np.full(len(case.free), np.inf), zeros, links]) ** 2)


def _spent(extra: Array, rest: Array, noise: Noise, spent: float) -> Array:
    """Return extra noise (2,) lifted by the freedom that was spent on residuals (m, rows)."""
    lift = rest.size / (rest.size - spent)
    own = np.median(noise.measurement**2, axis=0)
    return np.asarray(np.sqrt(np.maximum((extra**2 + own) * lift - own, 0.0)))
