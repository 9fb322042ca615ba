"""What is to be fitted: observations behind an evaluate function, a guess, priors, free parameters by name, a loss.

Every fit of the project has the same shape: shared parameters (a camera, a rig, an arm) and, where there are
many views, local parameters that each concern one group of residuals (a board's pose). Eliminating the local
ones view by view (the Schur complement) is what makes bundle adjustment fast; a problem without local
parameters is one group with no local block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent
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


class LossKind(StrEnum):
    """Plain squares, Huber (linear tails) or Cauchy (logarithmic tails)."""

    SQUARES = "squares"
    HUBER = "huber"
    CAUCHY = "cauchy"


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """How much a residual may pull.

    scale: in standard deviations, where the pull starts to fall. block: consecutive residuals that form one observation
    (2 for an image point): they are kept or held down together, by the norm of the block.
    """

    kind: LossKind = LossKind.SQUARES
    scale: float = 2.0
    block: int = 1

    def __post_init__(self) -> None:
        if not self.scale > 0.0 or self.block < 1:
            raise Inconsistent(f"a loss of scale {self.scale} over blocks of {self.block} is meaningless")

    def cost(self, residuals: Array) -> float:
        """Return half the sum of rho over all blocks of residuals (G, m)."""
        if self.kind is LossKind.SQUARES:
            return 0.5 * float(np.vdot(residuals, residuals))
        s = self._squares(residuals)
        k2 = self.scale**2
        # rho of a block's squared norm s: Huber's (1964) is s up to k^2 and then 2 k sqrt(s) - k^2, Cauchy's k^2 log(1
        # + s / k^2)
        if self.kind is LossKind.HUBER:
            rho = np.where(s <= k2, s, 2.0 * self.scale * np.sqrt(s) - k2)
        else:
            rho = k2 * np.log1p(s / k2)
        return 0.5 * float(rho.sum())

    def weights(self, residuals: Array) -> Array | None:
        """Return the weight (G, m) of each row in the normal equations, None where all are one."""
        if self.kind is LossKind.SQUARES:
            return None
        s = self._squares(residuals)
        # rho'(s): iteratively reweighted least squares. The second-order term of Triggs and others 1999, section 3.3,
        # is left out: where rho bends down it can make the normal equations indefinite
        if self.kind is LossKind.HUBER:
            w = np.minimum(1.0, self.scale / np.sqrt(np.maximum(s, 1e-300)))
        else:
            w = 1.0 / (1.0 + s / self.scale**2)
        return np.repeat(w, self.block, axis=1)

    def _squares(self, residuals: Array) -> Array:
        """Return the squared norm of each block, (G, m / block)."""
        groups, m = residuals.shape
        return np.asarray((residuals**2).reshape(groups, m // self.block, self.block).sum(axis=2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """Whitened residuals and their derivatives at one point.

    residuals: (G, m), each already divided by its standard deviation; rows that do not exist are zero, in the
    Jacobians too. shared: (G, m, S) derivative by the shared parameters. local: (G, m, L) derivative of group
    g by its own local parameters. Derivatives are by the tangent step that `retract` takes. condensed: a compiled
    model may give the normal equations of its squares instead, and leave shared and local empty; with plain
    squares only.
    """

    residuals: Array
    shared: Array
    local: Array
    condensed: NormalEquations | None = None

    @classmethod
    def of_one(cls, residuals: Array, slopes: Array) -> Evaluation:
        """Return residuals of any shape and their derivatives (..., S) by shared parameters alone, as one group."""
        m = residuals.size
        return cls(
            residuals=residuals.reshape(1, m), shared=slopes.reshape(1, m, slopes.shape[-1]), local=np.empty((1, m, 0))
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """A parameter is known beforehand as mean +- sigma, in its own unit."""

    mean: float
    sigma: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mean) and self.sigma > 0.0):
            raise Inconsistent(
                f"a prior of {self.mean} +- {self.sigma} says nothing",
                consequence="Nothing is fitted",
                cure="Give a standard deviation above zero",
            )


Evaluate = Callable[[Array, Array], Evaluation]
"""(shared (S,), local (G, L)) -> Evaluation. Non-finite residuals mean 'impossible here' and are stepped back from."""

Retract = Callable[[Array, Array, Array, Array], tuple[Array, Array]]
"""(shared, local, step_shared, step_local) -> moved (shared, local)."""


def add_step(shared: Array, local: Array, step_shared: Array, step_local: Array) -> tuple[Array, Array]:
    """Move by plain addition: the retraction of parameters that form a vector space."""
    return shared + step_shared, local + step_local


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A least-squares problem, complete and repeatable.

    names, guess (S,): the shared parameters. local_names (L), local_guess (G, L): one block per group.
    n_residuals: how many of the residual rows exist. fixed: names of shared parameters held at the guess.
    priors: by name of a shared parameter that moves by addition. loss: robust loss. retract: how a step is
    taken; poses move as Exp(dw) R, t + dt.
    """

    names: tuple[str, ...]
    guess: Array
    evaluate: Evaluate
    n_residuals: int
    local_names: tuple[str, ...] = ()
    local_guess: Array = field(default_factory=lambda: np.zeros((1, 0)))
    fixed: frozenset[str] = frozenset()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    loss: Loss = field(default_factory=Loss)
    retract: Retract = add_step

    def __post_init__(self) -> None:
        guess, local = np.array(self.guess, float), np.array(self.local_guess, float)
        if guess.shape != (len(self.names),) or local.ndim != 2 or local.shape[1] != len(self.local_names):
            raise Inconsistent(
                f"{len(self.names)} names with a guess of shape {guess.shape}, "
                f"{len(self.local_names)} local names with a guess of shape {local.shape}"
            )
        if not (np.isfinite(guess).all() and np.isfinite(local).all()):
            raise Inconsistent("the starting guess is not finite")
        unknown = (set(self.fixed) | set(self.priors)) - set(self.names)
        if unknown:
            raise Inconsistent(
                f"no parameter is called {', '.join(sorted(unknown))}; there are {', '.join(self.names)}"
            )
        for array in (guess, local):
            array.setflags(write=False)
        object.__setattr__(self, "guess", guess)
        object.__setattr__(self, "local_guess", local)

    def normal_equations(self, evaluation: Evaluation, shared: Array, free: Index) -> NormalEquations:
        """Return the normal equations of the free parameters, weighted by the loss, with the priors at shared (S,)."""
        every = self._all_equations(evaluation)
        A, b = every.A[np.ix_(free, free)], every.b[free]
        names = self.free
        for name, prior in self.priors.items():
            if name in self.fixed:
                continue
            k = names.index(name)
            A[k, k] += prior.sigma**-2
            b[k] += (shared[free[k]] - prior.mean) * prior.sigma**-2
        return NormalEquations(A=A, b=b, C=every.C, c=every.c, W=np.ascontiguousarray(every.W[:, free]))

    def _all_equations(self, evaluation: Evaluation) -> NormalEquations:
        """Return J'J and J'r by all parameters, weighted by the loss."""
        if evaluation.condensed is not None:
            if self.loss.kind is not LossKind.SQUARES:
                raise Inconsistent("a robust loss weighs single residuals, and the model gives only their sums")
            return evaluation.condensed
        r, Js, Jl = evaluation.residuals, evaluation.shared, evaluation.local
        weights = self.loss.weights(r)
        if weights is not None:
            root = np.sqrt(weights)  # (G, m)
            r, Js, Jl = r * root, Js * root[:, :, None], Jl * root[:, :, None]
        flat = Js.reshape(r.size, Js.shape[2])  # (G m, S)
        Jlt = Jl.transpose(0, 2, 1)  # (G, L, m)
        return NormalEquations(
            A=flat.T @ flat,
            b=flat.T @ r.reshape(-1),
            C=Jlt @ Jl,
            c=(Jlt @ r[:, :, None])[:, :, 0],
            W=Js.transpose(0, 2, 1) @ Jl,
        )

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the shared parameters that are fitted."""
        return tuple(name for name in self.names if name not in self.fixed)
