"""Which rows are readings of one place, and fits without some of them."""

import numpy as np
import pytest

from armsight.fitting.groups import leave_one_out, means, repeats, whitener, without

NEAR = 0.01


@pytest.mark.parametrize("jitter", [0.0, 1e-6, 1e-3])
@pytest.mark.parametrize("mixed", [False, True])
def test_readings_of_one_place_are_found_wherever_they_stand(jitter, mixed):
    rng = np.random.default_rng(1)
    truth = np.repeat(np.arange(25), rng.integers(1, 9, 25))
    if mixed:
        rng.shuffle(truth)
    values = rng.uniform(-2, 2, (25, 6))[truth] + rng.uniform(-jitter, jitter, (len(truth), 6))
    of = repeats(values, NEAR)
    assert ((of[:, None] == of) == (truth[:, None] == truth)).all()
    assert of[0] == 0 and (np.diff(np.unique(of, return_index=True)[1]) > 0).all()
    middle = means(values, of)
    assert middle[of] == pytest.approx(values, abs=2 * max(jitter, 1e-15))


def test_rows_that_are_each_their_own_stay_so():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        for values in (
            rng.uniform(-2, 2, (40, 6)),
            np.cumsum(rng.normal(0, 0.004, (300, 6)), axis=0),  # a stream, whose rows are near each other
            np.concatenate([rng.uniform(-2, 2, (30, 6)), np.zeros((2, 6))]),  # once the same by chance
        ):
            assert (repeats(values, NEAR) == np.arange(len(values))).all()
    assert len(repeats(np.empty((0, 3)), NEAR)) == 0
    assert (repeats(np.ones((1, 3)), NEAR) == [0]).all()
    assert (repeats(np.ones((5, 3)), NEAR) == np.zeros(5)).all()


def test_fits_without_a_group_are_those_that_a_refit_gives():
    rng = np.random.default_rng(5)
    n, k, m = 12, 3, 4
    A = rng.normal(0, 1, (n, k, k))
    V = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(k)
    slopes, readings = rng.normal(0, 1, (n, k, m)), rng.normal(0, 1, (n, k))
    W = whitener(V)
    assert np.allclose(W @ V @ W.transpose(0, 2, 1), np.eye(k))
    J, y = W @ slopes, np.einsum("nij,nj->ni", W, readings)
    kept = np.arange(n) < 9

    def fit(rows):
        return np.linalg.lstsq(J[rows].reshape(-1, m), y[rows].ravel(), rcond=None)[0]

    x, C = fit(kept), np.linalg.inv(np.einsum("nka,nkb->ab", J[kept], J[kept]))
    e = np.einsum("nka,a->nk", J, x) - y
    refits = np.array([fit(kept & (np.arange(n) != i)) for i in range(n)])
    steps, q = leave_one_out(e, J, C, kept)
    assert steps == pytest.approx(refits - x, abs=1e-10)
    own = J[kept].transpose(0, 2, 1) @ J[kept]
    assert without(np.linalg.inv(C), own, np.einsum("nka,nk->na", J, e)[kept]) == pytest.approx(steps[kept], abs=1e-10)
    for i in range(n):
        off = np.einsum("ka,a->k", J[i], refits[i]) - y[i]
        others = J[kept & (np.arange(n) != i)]
        rest = np.linalg.inv(np.einsum("nka,nkb->ab", others, others))
        assert q[i] == pytest.approx(off @ np.linalg.solve(np.eye(k) + J[i] @ rest @ J[i].T, off))


def test_a_group_that_alone_fixes_an_unknown_has_no_error_without_it():
    J = np.array([[[1.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
    steps, q = leave_one_out(np.ones((3, 1)), J, np.diag([0.5, 1.0]), np.ones(3, bool))
    assert np.isfinite(steps[:2]).all() and np.isnan(steps[2]).all()
    assert np.isfinite(q[:2]).all() and np.isnan(q[2])
