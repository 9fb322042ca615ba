"""Stamps of arrival: transport only delays, so that the clock is their lower edge."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.calibrate.timing.stamps import SteadyStamps, steady

PERIOD = 1.0 / 30.0


def clock(seed: int, *, jitter_s: float, late_s: float, n: int = 450) -> tuple[SteadyStamps, float]:
    """The clock found from stamps, and by how much it is late in their middle."""
    rng = np.random.default_rng(seed)
    k = np.flatnonzero(rng.random(n) > 0.02)
    taken = k * PERIOD * (1.0 + 3e-5)
    late = rng.exponential(late_s, len(k)) if late_s else 0.0
    found = steady(taken + rng.normal(0.0, jitter_s, len(k)) + late, "left")
    return found, float(np.mean(found.t_s - taken))


def test_late_stamps_give_the_clock_at_their_lower_edge() -> None:
    """Twenty recordings with 3 ms of lateness; the share within two deviations of 20 is below 16 once in a hundred."""
    runs = [clock(seed, jitter_s=2e-4, late_s=3e-3) for seed in range(20)]
    off = np.array([late for _, late in runs])
    claimed = np.array([np.sqrt(found.covariance[0, 0]) for found, _ in runs])
    assert np.sqrt(np.mean(off**2)) < 3e-4
    assert np.sum(np.abs(off) < 2.0 * claimed) >= 16
    assert all(found.late_s == pytest.approx(3e-3, rel=0.3) for found, _ in runs)


def test_even_jitter_is_not_taken_for_lateness() -> None:
    runs = [clock(seed, jitter_s=2e-3, late_s=0.0) for seed in range(20)]
    assert sum(found.late_s > 0.0 for found, _ in runs) <= 1
    off = np.array([late for _, late in runs])
    assert np.sqrt(np.mean(off**2)) < 2.0 * 2e-3 / np.sqrt(441)
