"""Clocks: the manual one is exact, the system's never returns early."""

from __future__ import annotations

import pytest

from armsight.clock import ManualClock, SystemClock


def test_the_manual_clock_moves_only_when_told() -> None:
    clock = ManualClock(5.0)
    clock.advance(0.25)
    clock.sleep_until(5.1)
    assert clock.now_s() == 5.25
    clock.sleep_until(7.0)
    assert clock.now_s() == 7.0
    with pytest.raises(ValueError, match="backwards"):
        clock.advance(-1e-9)


def test_the_system_clock_never_returns_early() -> None:
    clock = SystemClock()
    for wait_s in (0.0, 1e-4, 2e-3):
        due = clock.now_s() + wait_s
        clock.sleep_until(due)
        assert clock.now_s() >= due
