"""Normal equations with an arrow shape, and their damped solution by the Schur complement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.fitting.kernels import schur_complement

PIVOT_FLOOR = 1e-15
"""Smallest pivot, squared, of a local block scaled to a unit diagonal: rounding leaves as much of a zero."""

FLOOR = 1e-30
"""Smallest diagonal used for scaling, so that a parameter without influence does not divide by zero."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalEquations:
    """J'J and J'r of whitened residuals, as the step and the covariance need them.

    A (S, S), b (S,): of shared parameters, all of them or the free ones. C (G, L, L), c (G, L): of each group's local
    ones. W (G, S, L): mixed.
    """

    A: Array
    b: Array
    C: Array
    c: Array
    W: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the damped Gauss-Newton step (F,), (G, L) (Marquardt's scaling by the diagonal)."""
        # The local parameters are eliminated group by group: (A - W C^-1 W') ds = -b + W C^-1 c, then dl = -C^-1 (c +
        # W' ds) (Triggs and others 1999, section 6.1). G systems of L unknowns and one of F are solved, not one of F +
        # G L
        C = _damped(self.C, damping)
        Ci_c, Ci_Wt = _solve_local(C, self.c, self.W)
        flat = self.W.transpose(1, 0, 2).reshape(len(self.b), self.c.size)  # (F, G L)
        S = _damped(self.A, damping) - flat @ Ci_Wt.reshape(self.c.size, len(self.b))
        rhs = -self.b + flat @ Ci_c.ravel()
        # px, m and rad differ by orders of magnitude in their influence: solved in units of that, rounding is alike for
        # all
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.A), FLOOR))
        ds = scale * np.linalg.solve(S * np.outer(scale, scale) + 1e-15 * np.eye(len(S)), scale * rhs)
        dl = -Ci_c - Ci_Wt @ ds
        return ds, dl

    def reduced_system(self) -> Array:
        """Return the information (F, F) of the shared parameters with the local ones eliminated."""
        _, Ci_Wt = _solve_local(_damped(self.C, 0.0), self.c, self.W)
        return np.asarray(self.A - np.einsum("gfl,glh->fh", self.W, Ci_Wt))

    def local_covariance(self, covariance: Array) -> Array:
        """Return the marginal covariance (G, L, L) of the local parameters, given that of the shared ones."""
        _, Ci_Wt = _solve_local(_damped(self.C, 0.0), self.c, self.W)
        # the inverse by blocks: what a group knows by itself, and what the shared parameters leave open of it
        inverse = np.linalg.inv(_damped(self.C, 0.0))
        return np.asarray(inverse + Ci_Wt @ covariance @ Ci_Wt.transpose(0, 2, 1))

    def predicted_decrease(self, ds: Array, dl: Array) -> float:
        """Return the fall of the cost that the linear model promises for the step."""
        # the undamped model, -g'x - x'H x / 2: the damping belongs to the step, not to the cost
        linear = self.b @ ds + np.vdot(self.c, dl)
        cross = np.einsum("gfl,f,gl->", self.W, ds, dl)
        quadratic = ds @ self.A @ ds + 2.0 * cross + np.einsum("gl,glk,gk->", dl, self.C, dl)
        return float(-linear - 0.5 * quadratic)


def _damped(M: Array, damping: float) -> Array:
    """Return M (..., n, n) with its diagonal raised by the factor 1 + damping and kept off zero."""
    out = M.copy()
    n = M.shape[-1]
    diagonal = np.einsum("...ii->...i", out)  # a view
    diagonal[...] = np.maximum(diagonal * (1.0 + damping), FLOOR) if n else diagonal
    return out


def _solve_local(C: Array, c: Array, W: Array) -> tuple[Array, Array]:
    """Return C^-1 c (G, L) and C^-1 W' (G, L, F)."""
    x, X = np.empty_like(c), np.empty((W.shape[0], W.shape[2], W.shape[1]))
    schur_complement(C, c, W, PIVOT_FLOOR, x, X)
    return x, X
