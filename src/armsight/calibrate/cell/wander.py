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

from armsight.calibrate.cell.model import BlockNormals

Array = NDArray[np.float64]

RANGES = ((1e-7, 1e-2), (0.5, 60.0))
"""Of the standard deviation in rad and the time in s that are looked for."""
START = (2e-5, 4.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wander:
    """How far each joint strays: std (n,) in rad or m, forgotten after time_s. columns (n,): of the joints' variables
    among the parameters; t_s (b,): middles of the stretches."""

    std: Array
    time_s: float
    columns: NDArray[np.intp]
    t_s: Array

    def take(self, blocks: NDArray[np.intp]) -> Wander:
        """Return it for some of the stretches."""
        return replace(self, t_s=self.t_s[blocks])

    def reduced(self, normals: BlockNormals) -> Reduced:
        """Return the normal equations with the straying eliminated."""
        C, M, right = self.system(normals)
        factor = scipy.linalg.cho_factor(M, lower=True, check_finite=False)
        solved = scipy.linalg.cho_solve(factor, np.concatenate([C, right[:, None]], axis=1), check_finite=False)
        logdet = 2.0 * float(np.log(np.diag(factor[0])).sum()) - self._log_precision()
        return Reduced(
            A=normals.A.sum(axis=0) - C.T @ solved[:, :-1],
            g=normals.g.sum(axis=0) - C.T @ solved[:, -1],
            square=float(normals.chi2.sum() - right @ solved[:, -1]),
            logdet=logdet,
        )

    def system(self, normals: BlockNormals) -> tuple[Array, Array, Array]:
        """Return the mixed terms (b n, P), the information (b n, b n) of the straying, and its gradient (b n,)."""
        n, b = len(self.columns), len(self.t_s)
        at = self.columns
        M = np.zeros((b, n, b, n))
        rows = np.arange(b)
        M[rows, :, rows, :] = normals.A[:, at][:, :, at]
        M += np.einsum("ac,jk->ajck", self._precision(), np.diag(1.0 / self.std**2))
        return (
            normals.A[:, at].reshape(b * n, -1),
            M.reshape(b * n, b * n),
            normals.g[:, at].ravel(),
        )

    def _precision(self) -> Array:
        """Return the precision (b, b) of a process of unit variance at the stretches."""
        r = np.exp(-np.diff(self.t_s) / self.time_s)
        w = 1.0 / (1.0 - r**2)
        b = len(self.t_s)
        Q = np.zeros((b, b))
        at = np.arange(b)
        Q[at, at] = 1.0
        Q[at[:-1], at[:-1]] += r**2 * w
        Q[at[1:], at[1:]] += r**2 * w
        Q[at[:-1], at[1:]] = Q[at[1:], at[:-1]] = -r * w
        return Q

    def _log_precision(self) -> float:
        r = np.exp(-np.diff(self.t_s) / self.time_s)
        of_time = -float(np.log1p(-(r**2)).sum()) * len(self.std)
        return of_time - 2.0 * len(self.t_s) * float(np.log(self.std).sum())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reduced:
    """Normal equations A (P, P), g (P,) without the straying; square: of the residuals that remain in its units."""

    A: Array
    g: Array
    square: float
    logdet: float


def learned_wander(
    normals: BlockNormals, t_s: Array, columns: NDArray[np.intp], unit: Array, free: NDArray[np.intp], known: Array
) -> Wander:
    """Return the straying that explains the residuals best.

    unit (n,): 1 of a turning joint, of a sliding one the lever by which a turn is compared with it, m. free (F,): the
    parameters that are fitted, known (F, F) what is known of them beforehand.
    """

    def cost(p: Array) -> float:
        wander = Wander(std=np.exp(p[0]) * unit, time_s=float(np.exp(p[1])), columns=columns, t_s=t_s)
        return restricted_cost(wander, normals, free, known)

    bounds = [tuple(np.log(each)) for each in RANGES]
    found = scipy.optimize.minimize(
        cost, np.log(START), method="Nelder-Mead", bounds=bounds, options={"xatol": 0.05, "fatol": 0.05, "maxfev": 60}
    )
    return Wander(std=np.exp(found.x[0]) * unit, time_s=float(np.exp(found.x[1])), columns=columns, t_s=t_s)


def restricted_cost(wander: Wander, normals: BlockNormals, free: NDArray[np.intp], known: Array) -> float:
    """Return minus the logarithm of a straying's restricted likelihood, but for a constant; free, known as above."""
    reduced = wander.reduced(normals)
    H = reduced.A[np.ix_(free, free)] + known
    size = 1.0 / np.sqrt(np.diag(H))
    factor = scipy.linalg.cho_factor(H * np.outer(size, size), lower=True, check_finite=False)
    g = reduced.g[free] * size
    square = reduced.square - float(g @ scipy.linalg.cho_solve(factor, g, check_finite=False))
    of_free = 2.0 * float(np.log(np.diag(factor[0])).sum() - np.log(size).sum())
    return 0.5 * (square + reduced.logdet + of_free)
