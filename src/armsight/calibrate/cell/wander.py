"""How an arm strays from its readings, slowly: the errors that do not average out over the frames of a recording.

Gears, friction and heat let each joint stray by some hundredths of a millimetre at the tool, for seconds at a time.
They are taken as an Ornstein-Uhlenbeck process of each joint, constant within a stretch; standard deviation and time
are those of the greatest restricted likelihood (Patterson, Thompson 1971). With the process eliminated the normal
equations of the stretches become those of generalised least squares; no spot is looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cell.model import BlockNormals

RANGES = ((1e-7, 1e-2), (0.5, 60.0))
"""Of the standard deviation in rad and the time in s that are looked for."""
START = (2e-5, 4.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointDrift:
    """How far each joint strays: std (n,) in rad or m, forgotten after time_s. columns (n,): of the joints' variables
    among the parameters; t_s (b,): middles of the stretches."""

    std: Array
    time_s: float
    columns: NDArray[np.intp]
    t_s: Array

    def take(self, blocks: NDArray[np.intp]) -> JointDrift:
        """Return it for some of the stretches."""
        return replace(self, t_s=self.t_s[blocks])

    def reduced(self, normals: BlockNormals) -> Reduced:
        """Return the normal equations with the straying eliminated."""
        C, chol, right = self.system(normals)
        half = half_solved(chol, np.column_stack([C, right]))
        # the Schur complement: the straying goes as the boards' poses go from a bundle adjustment
        logdet = 2.0 * float(np.log(chol[0]).sum()) - self._log_precision()
        return Reduced(
            A=normals.A.sum(axis=0) - half[:, :-1].T @ half[:, :-1],
            g=normals.g.sum(axis=0) - half[:, :-1].T @ half[:, -1],
            square=float(normals.chi2.sum() - half[:, -1] @ half[:, -1]),
            logdet=logdet,
        )

    def system(self, normals: BlockNormals) -> tuple[Array, Array, Array]:
        """Return the mixed terms (b n, P), the information's Cholesky factor (n + 1, b n), and the gradient (b n,).

        A stretch hangs on the one before and the one behind it alone: the factor is banded, and kept as LAPACK does,
        its diagonal first.
        """
        n, b = len(self.columns), len(self.t_s)
        at = self.columns
        own, diagonal, beside = normals.A[:, at][:, :, at], *self._precision()
        band = np.zeros((n + 1, b, n))
        for below in range(n):
            band[below, :, : n - below] = np.diagonal(own, -below, axis1=1, axis2=2)
        band[0] += diagonal[:, None] / self.std**2
        band[n, :-1] = beside[:, None] / self.std**2
        chol = scipy.linalg.cholesky_banded(band.reshape(n + 1, b * n), lower=True, check_finite=False)
        return normals.A[:, at].reshape(b * n, -1), np.asarray(chol), normals.g[:, at].ravel()

    def left_of(self, normals: BlockNormals, g: Array) -> Array:
        """Return what of gradients g (b, P, k) by stretches remains (P, k) with the straying eliminated."""
        C, chol, _ = self.system(normals)
        right = g[:, self.columns].reshape(len(C), -1)
        solved = scipy.linalg.cho_solve_banded((chol, True), right, check_finite=False)
        return np.asarray(g.sum(axis=0) - C.T @ solved)

    def _precision(self) -> tuple[Array, Array]:
        """Return diagonal (b,) and what is beside it (b - 1,) of the precision of a process of unit variance."""
        # x_k = r x_(k-1) + noise of variance 1 - r^2 (Ornstein and Uhlenbeck): the precision is tridiagonal
        r = np.exp(-np.diff(self.t_s) / self.time_s)
        w = 1.0 / (1.0 - r**2)
        diagonal = np.ones(len(self.t_s))
        diagonal[:-1] += r**2 * w
        diagonal[1:] += r**2 * w
        return diagonal, -r * w

    def _log_precision(self) -> float:
        r = np.exp(-np.diff(self.t_s) / self.time_s)
        # the covariance's determinant is the product of the steps' variances
        of_time = -float(np.log1p(-(r**2)).sum()) * len(self.std)
        return of_time - 2.0 * len(self.t_s) * float(np.log(self.std).sum())


def half_solved(chol: Array, right: Array) -> Array:
    """Return L^-1 right (m, k) for a banded factor L (n + 1, m) as `JointDrift.system` gives it."""
    return np.asarray(scipy.linalg.lapack.dtbtrs(chol, right, uplo="L")[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reduced:
    """Normal equations A (P, P), g (P,) without the straying; square: of the residuals that remain in its units."""

    A: Array
    g: Array
    square: float
    logdet: float


def learned_wander(
    normals: BlockNormals, t_s: Array, columns: NDArray[np.intp], unit: Array, free: NDArray[np.intp], known: Array
) -> JointDrift:
    """Return the straying that explains the residuals best.

    unit (n,): 1 of a turning joint, of a sliding one the lever by which a turn is compared with it, m. free (F,): the
    parameters that are fitted, known (F, F) what is known of them beforehand.
    """

    def cost(p: Array) -> float:
        wander = JointDrift(std=np.exp(p[0]) * unit, time_s=float(np.exp(p[1])), columns=columns, t_s=t_s)
        return restricted_cost(wander, normals, free, known)

    bounds = [tuple(np.log(each)) for each in RANGES]
    found = scipy.optimize.minimize(
        cost, np.log(START), method="Nelder-Mead", bounds=bounds, options={"xatol": 0.05, "fatol": 0.05, "maxfev": 60}
    )
    return JointDrift(std=np.exp(found.x[0]) * unit, time_s=float(np.exp(found.x[1])), columns=columns, t_s=t_s)


def restricted_cost(wander: JointDrift, normals: BlockNormals, free: NDArray[np.intp], known: Array) -> float:
    """Return minus the logarithm of a straying's restricted likelihood, but for a constant; free, known as above."""
    reduced = wander.reduced(normals)
    H = reduced.A[np.ix_(free, free)] + known
    size = 1.0 / np.sqrt(np.diag(H))
    factor = scipy.linalg.cho_factor(H * np.outer(size, size), lower=True, check_finite=False)
    g = reduced.g[free] * size
    square = reduced.square - float(g @ scipy.linalg.cho_solve(factor, g, check_finite=False))
    # the fitted parameters are integrated out, which leaves their information's determinant (Harville 1977)
    of_free = 2.0 * float(np.log(np.diag(factor[0])).sum() - np.log(size).sum())
    return 0.5 * (square + reduced.logdet + of_free)
