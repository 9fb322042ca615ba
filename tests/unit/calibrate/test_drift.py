"""Control charts: limits against the exact chain, false alarms counted, drifts found, one wild run left out."""

import numpy as np
import pytest
from scipy.stats import norm

from armsight_lab.history import drift
from armsight_lab.history.drift import Kind, charted, judged, limits_for, run_length

WEEKS = 52


def exact_run_length(limit: float, slack: float, mean: float = 0.0, states: int = 400) -> float:
    """Average run length of a one-sided CUSUM by Brook and Evans, An approach to the probability distribution of CUSUM
    run length, Biometrika 59, 1972: a Markov chain over slices of the sum."""
    width = 2.0 * limit / (2 * states - 1)
    at = np.arange(states) * width
    upper = at[None, :] - at[:, None] + 0.5 * width + slack - mean
    chain = norm.cdf(upper) - norm.cdf(upper - width)
    chain[:, 0] = norm.cdf(upper[:, 0])
    return float(np.linalg.solve(np.eye(states) - chain, np.ones(states))[0])


@pytest.mark.parametrize(("limit", "slack"), [(3.0, 0.5), (5.0, 0.5), (2.5, 1.0), (4.0, 1.0), (5.5, 1.0)])
def test_siegmunds_run_length_is_that_of_the_markov_chain(limit, slack):
    assert run_length(limit, slack) == pytest.approx(exact_run_length(limit, slack), rel=0.07)
    assert run_length(limit, slack, 2.0 * slack) == pytest.approx(exact_run_length(limit, slack, 2.0 * slack), rel=0.03)


@pytest.mark.parametrize("too_small", [1.0, 1.5])
def test_false_alarms_come_no_more_often_than_said(too_small):
    """One in a tenth of the usual time, so that few cells count many: what counts is the ratio of said to found."""
    apart_years, figures, cells, years = 10.0, 16, 60, 5
    rng = np.random.default_rng(7)
    n = WEEKS * years
    x = rng.standard_normal((n, figures * cells)) * too_small
    jumps, drifts = charted(x, np.ones_like(x)).alarms(limits_for(apart_years, WEEKS, figures))
    alarms = int((jumps | drifts).any(axis=0).reshape(cells, figures).any(axis=1).sum())
    expected = cells * years / apart_years
    assert alarms <= expected + 2.0 * np.sqrt(expected)
    assert (charted(3.0 * x, np.ones_like(x)).alarms(drift.Limits(jump=3.0, drift=3.0))[0]).any()  # it can alarm


def test_a_drift_of_a_fiftieth_of_a_degree_a_week_is_found_within_four_weeks():
    rng = np.random.default_rng(1)
    std_deg, before = 0.0037, 12
    weeks = np.arange(before + 4) - before + 1.0
    x = np.maximum(weeks, 0.0)[:, None] * 0.02 + std_deg * rng.standard_normal((before + 4, 200))
    jumps, drifts = charted(x, np.full_like(x, std_deg)).alarms(limits_for(100.0, WEEKS, 16))
    assert (jumps | drifts).any(axis=0).mean() > 0.99
    assert not (jumps | drifts)[:before].any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lasting_change_that_no_run_shows_alone_is_found_by_the_sum(sign):
    rng = np.random.default_rng(4)
    x = rng.standard_normal((80, 200))
    x[60:] += sign * drift.SMALLEST_STEP
    jumps, drifts = charted(x, np.ones_like(x)).alarms(limits_for(100.0, WEEKS, 16))
    assert drifts.any(axis=0).mean() > 0.8
    assert drifts.any(axis=0).sum() > 2 * jumps.any(axis=0).sum()


def test_what_changed_since_when_and_by_how_much():
    rng = np.random.default_rng(5)
    n, start, std = 40, 30, 0.01
    x = std * rng.standard_normal(n)
    x[start:] += 0.05 + 0.004 * np.arange(n - start)
    found = judged(x, np.full(n, std), limits_for(100.0, WEEKS, 16))
    change = found.change
    assert change is not None
    assert abs(change.start - start) <= 1
    assert change.noticed >= change.start
    assert change.latest == pytest.approx(0.05 + 0.004 * 9, abs=4.0 * change.latest_std)
    assert change.size == pytest.approx(0.05 + 0.004 * 4.5, abs=4.0 * change.size_std)
    assert change.size_std < change.latest_std < 0.02


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_gone_wrong_is_no_change_and_a_step_is_one(sign):
    rng = np.random.default_rng(6)
    told = np.full(30, 1.0)
    wild = rng.standard_normal(30)
    wild[20] += sign * 15.0
    found = judged(wild, told, limits_for(100.0, WEEKS, 16))
    assert found.change is None
    assert found.apart == (20,)
    stepped = rng.standard_normal(30)
    stepped[20:] += sign * 15.0
    change = judged(stepped, told, limits_for(100.0, WEEKS, 16)).change
    assert change is not None
    assert (change.kind, change.start, change.noticed) == (Kind.JUMP, 20, 20)
    assert change.size == pytest.approx(sign * 15.0, abs=4.0 * change.size_std)


def test_deviations_that_nobody_tells_and_runs_without_the_figure():
    rng = np.random.default_rng(8)
    x = rng.standard_normal(40)
    x[[3, 11]] = np.nan
    x[30:] += 9.0
    found = judged(x, np.full(40, np.nan), limits_for(100.0, WEEKS, 1))
    assert found.change is not None
    assert found.change.start == 30
    assert np.isnan(found.chart.score[[0, 1, 3, 11], 0]).all()  # nothing before, one before, and none of its own
