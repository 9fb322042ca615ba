"""Which rows are readings of one place."""

import numpy as np
import pytest

from armsight.fitting.groups import means, repeats

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
