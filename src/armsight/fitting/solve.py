"""Levenberg-Marquardt with the local parameters eliminated, the covariance of its answer, and why it stopped."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from armsight.arrays import Array, Index
from armsight.defaults import ITERATIONS
from armsight.errors import Cancelled, NotConverged, Undetermined
from armsight.fitting.problem import FLOOR, Evaluation, NormalEquations, Problem
from armsight.records import NamedCovariance, Progress, Silent


class StopReason(StrEnum):
    """Why the solver stopped; the first three mean that it has an answer."""

    COST_SETTLED = "cost settled"
    STEP_SMALL = "step small"
    GRADIENT_ZERO = "gradient zero"
    ITERATION_LIMIT = "iteration limit"
    NO_DESCENT = "no descent"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The fitted parameters with their covariance.

    shared (S,), local (G, L): all parameters, fixed ones at their guess. covariance: of the free shared ones.
    local_covariance: (G, L, L). residuals: (G, m) whitened, without the robust weights. weights: (G, m) of
    the robust loss. cost: half the (robust) sum of squares with priors. scale: standard deviation of the
    whitened residuals, sqrt(2 cost / dof); covariances are already multiplied by scale^2 where the noise was
    estimated. undetermined: groups of names that the data cannot tell apart (their standard deviations are infinite).
    """

    names: tuple[str, ...]
    shared: Array
    local: Array
    covariance: NamedCovariance | None
    local_covariance: Array
    residuals: Array
    weights: Array
    cost: float
    scale: float
    dof: int
    n_residuals: int
    iterations: int
    reason: StopReason
    undetermined: tuple[tuple[str, ...], ...]

    @property
    def converged(self) -> bool:
        """Whether the solver stopped at a minimum."""
        return self.reason in (StopReason.COST_SETTLED, StopReason.STEP_SMALL, StopReason.GRADIENT_ZERO)

    def value(self, name: str) -> float:
        """Return the value of one shared parameter in its own unit."""
        return float(self.shared[self.names.index(name)])

    def std(self) -> dict[str, float]:
        """Return the standard deviations by name; infinite where the data cannot tell, absent for fixed ones."""
        known = {} if self.covariance is None else self.covariance.std()
        open_ = {name for group in self.undetermined for name in group}
        return {**known, **dict.fromkeys(open_, float("inf"))}

    def report(self) -> str:
        """Return a table of values and standard deviations with the reason for stopping, for people."""
        std = self.std()
        lines = [
            f"{self.n_residuals} residuals, {self.dof} degrees of freedom, scale {self.scale:.4g}, "
            f"{self.iterations} iterations, stopped: {self.reason.value}"
        ]
        for name, value in zip(self.names, self.shared, strict=True):
            uncertainty = f"+- {std[name]:.4g}" if name in std else "(fixed)"
            lines.append(f"  {name:<24} {value:>16.9g} {uncertainty}")
        return "\n".join(lines)


RANK_TOLERANCE = 1e-11
"""Eigenvalues of the scaled information below this mean 'not determined': rounding leaves 1e-14, the worst
honest correlation met in practice (k1, k2, k3 of a narrow lens) 1e-8."""

LEAST_SEEN = 1e-13
"""Ten times what rounding leaves."""

SHARE_OF_NULL = 0.1
"""A parameter belongs to an undetermined group where its share of the null vector exceeds this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How the solver works.

    estimate_noise: the residuals' common scale is unknown and estimated from them (else their given standard
    deviations are taken as true). allow_undetermined: report parameters that cannot be told apart instead of
    raising. loose: names of which combinations may be open, see inverse_information. cost_tolerance, step_tolerance:
    relative.
    """

    max_iterations: int = ITERATIONS
    cost_tolerance: float = 1e-10
    step_tolerance: float = 1e-10
    gradient_tolerance: float = 1e-12
    initial_damping: float = 1e-4
    estimate_noise: bool = False
    allow_undetermined: bool = False
    loose: frozenset[str] = frozenset()


@dataclass(slots=True)
class _State:
    """Where the iteration stands; private and the only thing here that changes."""

    shared: Array
    local: Array
    evaluation: Evaluation
    cost: float
    damping: float


def solve(problem: Problem, settings: Settings | None = None, progress: Progress | None = None) -> Fit:
    """Minimise the problem's cost and return the fit with its covariance.

    Raises NotConverged where the guess cannot be evaluated or no minimum is reached within max_iterations,
    Undetermined (with the names) where parameters cannot be told apart, Cancelled where progress says so.
    """
    settings = settings or Settings()
    progress = progress or Silent()
    free = np.array([i for i, name in enumerate(problem.names) if name not in problem.fixed], dtype=np.intp)
    state = _start(problem, settings)
    reason = StopReason.ITERATION_LIMIT
    iteration = 0
    for iteration in range(1, settings.max_iterations + 1):
        if progress.cancelled():
            raise Cancelled("the fit was stopped", consequence="No result was kept")
        progress.update(iteration, 0, "fitting, step")  # how many it takes is not known
        found = _iterate(problem, settings, state, free)
        if found is not None:
            reason = found
            break
    fit = _fit(problem, settings, state, free, iteration, reason)
    if not fit.converged:
        raise NotConverged(
            f"the fit stopped without an answer after {iteration} iterations ({reason.value})",
            consequence="Its parameters are not to be used",
            cure="Give a better starting guess, or check the observations for gross errors",
        )
    if fit.undetermined and not settings.allow_undetermined:
        raise Undetermined(fit.undetermined)
    return fit


def _start(problem: Problem, settings: Settings) -> _State:
    """Evaluate the guess."""
    evaluation = problem.evaluate(problem.guess, problem.local_guess)
    cost = _cost(problem, evaluation, problem.guess)
    if not np.isfinite(cost):
        raise NotConverged(
            "the model cannot be evaluated at the starting guess",
            consequence="Nothing was fitted",
            cure="Give a starting guess for which every observation is possible",
        )
    return _State(problem.guess, problem.local_guess, evaluation, cost, settings.initial_damping)


def _cost(problem: Problem, evaluation: Evaluation, shared: Array) -> float:
    """Return half the (robust) sum of squares, priors included; infinite where not finite."""
    if not np.isfinite(evaluation.residuals).all():
        return float("inf")
    cost = problem.loss.cost(evaluation.residuals)
    for name, prior in problem.priors.items():
        if name not in problem.fixed:
            cost += 0.5 * ((shared[problem.names.index(name)] - prior.mean) / prior.sigma) ** 2
    return float(cost)


def _iterate(problem: Problem, settings: Settings, state: _State, free: Index) -> StopReason | None:
    """Take one accepted step; return why to stop, or None to go on."""
    normal = problem.normal_equations(state.evaluation, state.shared, free)
    if _scaled_gradient(normal) <= settings.gradient_tolerance * max(1.0, np.sqrt(2.0 * state.cost)):
        return StopReason.GRADIENT_ZERO
    while True:
        try:
            ds, dl = normal.step(state.damping)
        except np.linalg.LinAlgError:
            ds, dl = np.full(len(free), np.nan), state.local * np.nan
        full = np.zeros(len(problem.names))
        full[free] = ds
        predicted = normal.predicted_decrease(ds, dl)
        cost = float("inf")
        if np.isfinite(full).all() and np.isfinite(dl).all():
            shared, local = problem.retract(state.shared, state.local, full, dl)
            evaluation = problem.evaluate(shared, local)
            cost = _cost(problem, evaluation, shared)
        if cost <= state.cost:
            settled = state.cost - cost <= settings.cost_tolerance * state.cost
            small = _relative_step(normal, ds, dl, state) <= settings.step_tolerance
            state.shared, state.local, state.evaluation, state.cost = shared, local, evaluation, cost
            # Marquardt 1963: tenfold nearer to Gauss-Newton after a step that helped, tenfold away after one that did
            # not
            state.damping = max(state.damping * 0.1, 1e-12)
            if small:
                return StopReason.STEP_SMALL
            # a heavily damped step falls little without being near the minimum
            return StopReason.COST_SETTLED if settled and state.damping < 1.0 else None
        if predicted <= 1e-14 * state.cost:  # the fall promised is below the rounding of the cost
            return StopReason.COST_SETTLED
        state.damping = max(state.damping, 1e-8) * 10.0
        if state.damping > 1e16:
            return StopReason.NO_DESCENT


def _influence(normal: NormalEquations) -> tuple[Array, Array]:
    """Return how much the residuals feel each shared (F,) and each local parameter (G, L)."""
    diagonals = np.diag(normal.A), np.einsum("gii->gi", normal.C)
    shared, local = (np.sqrt(np.maximum(diagonal, FLOOR)) for diagonal in diagonals)
    return shared, local


def _scaled_gradient(normal: NormalEquations) -> float:
    """Return the largest gradient entry in units of the parameter's own influence."""
    shared, local = _influence(normal)
    return float(np.maximum((np.abs(normal.b) / shared).max(initial=0.0), (np.abs(normal.c) / local).max(initial=0.0)))


def _relative_step(normal: NormalEquations, ds: Array, dl: Array, state: _State) -> float:
    """Return the step's size against the rounding floor, in residual units."""
    shared, local = _influence(normal)
    step = np.maximum((np.abs(ds) * shared).max(initial=0.0), (np.abs(dl) * local).max(initial=0.0))
    return float(step / (1.0 + np.sqrt(2.0 * state.cost)))


def _fit(
    problem: Problem,
    settings: Settings,
    state: _State,
    free: Index,
    iterations: int,
    reason: StopReason,
) -> Fit:
    """Form covariances, scale and rank verdict at the final point."""
    normal = problem.normal_equations(state.evaluation, state.shared, free)
    names = problem.free
    covariance, undetermined = inverse_information(normal.reduced_system(), np.diag(normal.A), names, settings.loose)
    n_priors = sum(name not in problem.fixed for name in problem.priors)
    dof = problem.n_residuals + n_priors - len(free) - state.local.size
    scale = float(np.sqrt(2.0 * state.cost / dof)) if dof > 0 else float("nan")
    factor = scale**2 if settings.estimate_noise and dof > 0 else 1.0
    open_ = {name for group in undetermined for name in group}
    known = [i for i, name in enumerate(names) if name not in open_]
    weights = problem.loss.weights(state.evaluation.residuals)
    return Fit(
        names=problem.names,
        shared=state.shared,
        local=state.local,
        covariance=NamedCovariance(
            names=tuple(names[i] for i in known), matrix=factor * covariance[np.ix_(known, known)]
        )
        if known
        else None,
        local_covariance=factor * normal.local_covariance(covariance),
        residuals=state.evaluation.residuals,
        weights=np.ones_like(state.evaluation.residuals) if weights is None else weights,
        cost=state.cost,
        scale=scale,
        dof=dof,
        n_residuals=problem.n_residuals,
        iterations=iterations,
        reason=reason,
        undetermined=undetermined,
    )


def inverse_information(
    information: Array, influence: Array, names: tuple[str, ...], loose: frozenset[str] = frozenset()
) -> tuple[Array, tuple[tuple[str, ...], ...]]:
    """Return the covariance (F, F) (pseudo-inverse where needed) and the groups that cannot be told apart.

    influence: how much the residuals feel each parameter by itself (F,), the diagonal before others are eliminated.
    loose: names of which a combination that cannot be told apart does no harm, as no residual feels it: it gets the
    least information that rounding lets one see, LEAST_SEEN.
    """
    silent = influence <= FLOOR  # no residual feels the parameter at all
    scale = 1.0 / np.sqrt(np.where(silent, 1.0, influence))
    # scaled by each parameter's own influence only correlation is left: an eigenvalue near zero is a combination that
    # no residual feels, and its vector names the parameters in it
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    null = values < RANK_TOLERANCE
    groups = []
    for k in np.flatnonzero(null):
        group = tuple(name for name, share in zip(names, np.abs(vectors[:, k]), strict=True) if share > SHARE_OF_NULL)
        if group and loose.issuperset(group):
            null[k], values[k] = False, max(values[k], LEAST_SEEN)
        else:
            groups.append(group)
    kept = vectors[:, ~null]
    inverse = (kept / values[~null]) @ kept.T
    return np.asarray(inverse * np.outer(scale, scale)), tuple(group for group in groups if group)
