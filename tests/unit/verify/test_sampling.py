"""Stamps of deliveries against the steady clock that sampled the rows, made here row by row; angles within one turn."""

import numpy as np
import pytest

from armsight.calibrate.timing.sampling import sampling_times, without_seams

N, PERIOD_S = 3000, 0.01


def delivered(seed, apart_s):
    """Sampled every 10 ms; in 2 % of the time the line stands for 40 to 60 ms, and what waited comes at once."""
    rng = np.random.default_rng(seed)
    sampled = 5000.0 + PERIOD_S * np.arange(N)
    stamps, free_s = np.empty(N), 0.0
    for i in range(N):
        if rng.random() < 0.004:
            free_s = sampled[i] + rng.uniform(0.04, 0.06)
        stamps[i] = max(sampled[i] + rng.exponential(2e-4), free_s, stamps[i - 1] + apart_s if i else 0.0)
    return sampled, stamps


@pytest.mark.parametrize("apart_s", [0.0, 20e-6])
@pytest.mark.parametrize("seed", range(3))
def test_rows_that_came_at_once_are_put_back_where_they_were_sampled(seed, apart_s):
    sampled, stamps = delivered(seed, apart_s)
    assert (np.diff(stamps) < 1e-3).mean() > 0.01 and np.abs(stamps - sampled).max() > 0.03  # what is given is wrong
    found = sampling_times(stamps, "the log")
    assert found.bursts and found.sure.all() and "at once" in found.note
    assert np.abs(found.t_s - sampled).max() < 5e-4


def test_rows_that_came_at_once_are_left_out_where_no_steady_clock_sampled_them():
    rng = np.random.default_rng(1)
    sampled = np.cumsum(rng.uniform(0.005, 0.05, 400))
    stamps = sampled.copy()
    stamps[100:105] = sampled[105] - 1e-4 + 1e-5 * np.arange(5)
    found = sampling_times(stamps, "the log")
    assert not found.bursts and np.flatnonzero(~found.sure).tolist() == list(range(100, 106))
    assert (found.t_s == stamps).all()


def test_readings_within_one_turn_are_made_whole():
    t = np.linspace(0, 4, 200)
    q = np.column_stack([3.0 * t, np.sin(t), 0.4 * t])
    wrapped = q.copy()
    wrapped[:, 0] = np.mod(q[:, 0], 2 * np.pi)
    wrapped[:, 1] = np.mod(q[:, 1], 2 * np.pi)
    wrapped[50] = np.nan
    whole = without_seams(wrapped)
    assert np.isnan(whole[50]).all()
    rest = np.delete(np.arange(200), 50)
    np.testing.assert_allclose(whole[rest] - whole[0], q[rest] - q[0], atol=1e-12)
