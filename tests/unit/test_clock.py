"""Clocks: the manual one is exact, the system's never returns early."""

import time

import pytest

from armsight.clock import STALL_S, ManualClock, StandStill, SystemClock, monotonic_s


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


@pytest.mark.parametrize(("cycle_s", "longest_s"), [(0.004, STALL_S), (0.1, 0.3)])
def test_a_gap_between_two_turns_is_a_stand_still(cycle_s: float, longest_s: float) -> None:
    turns = StandStill(cycle_s)
    assert turns.turn(5.0) == 0.0, "the first turn has none before it"
    assert turns.turn(5.0 + 0.99 * longest_s) == 0.0
    assert turns.turn(5.0 + 2.1 * longest_s) == pytest.approx(1.11 * longest_s)
    turns.begin()
    assert turns.turn(1000.0) == 0.0


def test_steps_of_the_systems_clock_change_nothing_and_sleep_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    turns, clock = StandStill(0.004), SystemClock()
    turns.turn(clock.now_s())
    monkeypatch.setattr(time, "time", lambda: 0.0)
    assert turns.turn(clock.now_s()) < 60.0
    before_s = clock.now_s()
    asleep = time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda which: asleep(which) + 3600.0 * (which == time.CLOCK_BOOTTIME))
    assert turns.turn(clock.now_s()) > 3000.0, "the machine slept for an hour, in which its monotonic clock stood"
    assert monotonic_s() - before_s > 3000.0
