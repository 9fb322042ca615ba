"""The engine against closed forms, planted degeneracies, and its own claims of doubt."""

import numpy as np
import pytest

from armsight.errors import Inconsistent, NotConverged, Undetermined
from armsight.fitting import Evaluation, Loss, LossKind, Prior, Problem, Settings, StopReason, solve
from armsight.fitting.kernels import invert_spd, solve_damped
from refusals import refuses


def line_problem(x: np.ndarray, y: np.ndarray, sigma: float, **options: object) -> Problem:
    """y = offset + slope x, a linear problem with a known answer."""
    J = np.stack([np.ones_like(x), x], axis=1) / sigma

    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        r = (shared[0] + shared[1] * x - y) / sigma
        return Evaluation(residuals=r[None], shared=J[None], local=np.zeros((1, len(x), 0)))

    return Problem(names=("offset", "slope"), guess=np.zeros(2), evaluate=evaluate, n_residuals=len(x), **options)  # type: ignore[arg-type]


def test_a_line_has_the_textbook_answer_and_covariance() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 3, 40)
    y = 2.0 - 0.7 * x + rng.normal(0, 0.05, x.size)
    fit = solve(line_problem(x, y, 0.05))
    design = np.stack([np.ones_like(x), x], axis=1)
    answer, *_ = np.linalg.lstsq(design, y, rcond=None)
    assert np.allclose(fit.shared, answer, atol=1e-12)
    assert fit.covariance is not None
    assert np.allclose(fit.covariance.matrix, np.linalg.inv(design.T @ design) * 0.05**2, rtol=1e-10)
    assert fit.converged
    estimated = solve(line_problem(x, y, 1.0), Settings(estimate_noise=True))
    s2 = ((design @ answer - y) ** 2).sum() / (len(x) - 2)
    assert estimated.covariance is not None
    assert np.allclose(estimated.covariance.matrix, np.linalg.inv(design.T @ design) * s2, rtol=1e-10)
    assert estimated.scale == pytest.approx(np.sqrt(s2))


def test_priors_and_fixed_parameters() -> None:
    x = np.linspace(0, 1, 10)
    y = 1.0 + 2.0 * x
    fixed = solve(line_problem(x, y, 0.1, fixed=frozenset({"offset"})))
    assert fixed.value("offset") == 0.0
    assert set(fixed.std()) == {"slope"}
    tight = solve(line_problem(x, y, 0.1, priors={"slope": Prior(mean=5.0, sigma=1e-6)}))
    assert tight.value("slope") == pytest.approx(5.0, abs=1e-5)
    with refuses(Inconsistent, "hope"):
        line_problem(x, y, 0.1, fixed=frozenset({"hope"}))


def two_views(rng: np.random.Generator, sigma: float, guess_error: float) -> tuple[Problem, np.ndarray, np.ndarray]:
    """Groups of points y = a exp(-b x) + c_g: two shared parameters, one local offset per group."""
    x = np.linspace(0, 2, 15)
    a, b, c = 3.0, 0.8, rng.normal(size=6)
    y = a * np.exp(-b * x)[None, :] + c[:, None] + rng.normal(0, sigma, (6, x.size))

    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        e = np.exp(-shared[1] * x)
        r = (shared[0] * e + local - y) / sigma  # (G, m)
        js = np.stack([e, -shared[0] * x * e], axis=1) / sigma  # (m, 2)
        return Evaluation(
            residuals=r, shared=np.broadcast_to(js, (6, x.size, 2)), local=np.full((6, x.size, 1), 1 / sigma)
        )

    problem = Problem(
        names=("a", "b"),
        guess=np.array([a, b]) * (1 + guess_error),
        evaluate=evaluate,
        n_residuals=y.size,
        local_names=("c",),
        local_guess=np.zeros((6, 1)),
    )
    return problem, np.array([a, b]), c


def test_eliminating_local_parameters_changes_nothing() -> None:
    problem, _, _ = two_views(np.random.default_rng(4), 0.02, 0.3)
    fit = solve(problem)
    evaluation = problem.evaluate(fit.shared, fit.local)
    J = np.zeros((6 * 15, 2 + 6))  # the same problem, dense
    J[:, :2] = evaluation.shared.reshape(-1, 2)
    for g in range(6):
        J[15 * g : 15 * g + 15, 2 + g] = evaluation.local[g, :, 0]
    r = evaluation.residuals.reshape(-1)
    assert np.abs(J.T @ r).max() < 1e-5  # a minimum: its gradient is gone
    C = np.linalg.inv(J.T @ J)
    assert fit.covariance is not None
    assert np.allclose(fit.covariance.matrix, C[:2, :2], rtol=1e-8)
    assert np.allclose(fit.local_covariance[:, 0, 0], np.diag(C)[2:], rtol=1e-8)


def test_claimed_deviations_are_the_spread_of_repeats() -> None:
    rng = np.random.default_rng(11)
    z = []
    for _ in range(300):
        problem, truth, c = two_views(rng, 0.05, 0.1)
        fit = solve(problem)
        assert fit.covariance is not None
        z.append(
            np.concatenate(
                [
                    (fit.shared - truth) / np.sqrt(np.diag(fit.covariance.matrix)),
                    (fit.local[:, 0] - c) / np.sqrt(fit.local_covariance[:, 0, 0]),
                ]
            )
        )
    # the rms of n standard normals scatters by 1 / sqrt(2 n); five of those
    assert np.sqrt((np.array(z) ** 2).mean(axis=0)) == pytest.approx(1.0, abs=5 / np.sqrt(2 * 300))


def test_parameters_that_cannot_be_told_apart_are_named() -> None:
    x = np.linspace(0, 1, 20)

    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        r = (shared[0] + shared[1]) * x + shared[2] - (3.0 * x + 1.0)
        J = np.stack([x, x, np.ones_like(x), np.zeros_like(x)], axis=1)
        return Evaluation(residuals=r[None], shared=J[None], local=np.zeros((1, 20, 0)))

    problem = Problem(names=("p", "q", "offset", "idle"), guess=np.zeros(4), evaluate=evaluate, n_residuals=20)
    with pytest.raises(Undetermined) as caught:
        solve(problem)
    assert sorted(caught.value.groups) == [("idle",), ("p", "q")]
    fit = solve(problem, Settings(allow_undetermined=True))
    assert fit.value("offset") == pytest.approx(1.0, abs=1e-9)
    assert fit.value("p") + fit.value("q") == pytest.approx(3.0, abs=1e-9)
    assert np.isinf([fit.std()[name] for name in ("p", "q", "idle")]).all()
    assert np.isfinite(fit.std()["offset"])


@pytest.mark.parametrize("seed", range(3))
def test_they_are_named_to_whichever_side_of_zero_rounding_falls(seed: int) -> None:
    design = np.random.default_rng(seed).normal(size=(20, 2))
    J = np.column_stack([design, design @ [0.3, 1.7], np.ones(20)])  # the third is made of the first two

    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        return Evaluation(residuals=(J @ (shared - 1.0))[None], shared=J[None], local=np.zeros((1, 20, 0)))

    with pytest.raises(Undetermined) as caught:
        solve(Problem(names=("p", "q", "r", "offset"), guess=np.zeros(4), evaluate=evaluate, n_residuals=20))
    assert {"q", "r"} <= set(caught.value.groups[0]) <= {"p", "q", "r"}


@pytest.mark.parametrize("kind", [LossKind.HUBER, LossKind.CAUCHY])
def test_a_robust_loss_ignores_gross_errors(kind: LossKind) -> None:
    rng = np.random.default_rng(5)
    x = np.linspace(-1, 1, 60)
    y = 1.0 + 2.0 * x + rng.normal(0, 0.01, x.size)
    y[::10] += 5.0
    plain = solve(line_problem(x, y, 0.01))
    robust = solve(line_problem(x, y, 0.01, loss=Loss(kind=kind, scale=2.0)))
    assert abs(plain.value("offset") - 1.0) > 0.3  # negative control
    assert robust.value("offset") == pytest.approx(1.0, abs=0.02)
    assert robust.weights[0, ::10].max() < 0.01 < robust.weights[0, 1]


def test_why_it_stopped_is_told() -> None:
    x = np.linspace(0, 1, 10)
    problem = line_problem(x, 1.0 + 2.0 * x, 0.1)
    assert solve(problem).reason in (StopReason.COST_SETTLED, StopReason.STEP_SMALL, StopReason.GRADIENT_ZERO)
    hard, _, _ = two_views(np.random.default_rng(1), 0.02, 0.5)
    with refuses(NotConverged, "iteration"):
        solve(hard, Settings(max_iterations=1))

    def impossible(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        return Evaluation(residuals=np.full((1, 3), np.nan), shared=np.ones((1, 3, 1)), local=np.zeros((1, 3, 0)))

    with refuses(NotConverged, "evaluated", "starting guess"):
        solve(Problem(names=("p",), guess=np.zeros(1), evaluate=impossible, n_residuals=3))


def test_the_compiled_core_solves_what_numpy_solves() -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(6, 6))
    H, g = A @ A.T + np.eye(6), rng.normal(size=6)
    step, inverse = np.empty(6), np.empty((6, 6))
    assert solve_damped(H, g, 0.1, step)
    assert np.allclose((H + 0.1 * np.diag(np.diag(H))) @ step, -g, atol=1e-12)
    assert invert_spd(H, inverse)
    assert np.allclose(H @ inverse, np.eye(6), atol=1e-11)
    assert not solve_damped(-H, g, 0.0, step)
