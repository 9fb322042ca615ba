"""What runs before what: a thread's place in the system's order, and that a system which refuses changes nothing."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

import pytest

from armsight import priority

Place = tuple[int, int]
LINUX = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="the system has no such order")


def place() -> Place:
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority


def in_a_thread(*steps: Callable[[], object]) -> Place:
    """Return where a thread stands that has done this."""
    out: list[Place] = []

    def run() -> None:
        for step in steps:
            step()
        out.append(place())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return out[0]


@LINUX
def test_measuring_and_what_it_starts_come_before_usual_work() -> None:
    if not in_a_thread(priority.control_first)[1]:
        pytest.skip("the system does not allow it")
    started: list[Place] = []
    control = in_a_thread(priority.control_first)
    measuring = in_a_thread(priority.measure_first, lambda: started.append(in_a_thread()))
    pictures = in_a_thread(priority.measure_first, priority.beside_measuring)
    assert control[1] > measuring[1] > pictures[1] > 0
    assert started == [measuring]
    assert in_a_thread(priority.measure_first, priority.as_usual) == (os.SCHED_OTHER, 0)


@LINUX
def test_beside_what_measures_as_usual_is_as_usual() -> None:
    assert in_a_thread(priority.beside_measuring) == in_a_thread()


@LINUX
def test_measuring_leaves_a_single_processor_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert in_a_thread(priority.measure_first) == in_a_thread()


@LINUX
def test_a_system_that_refuses_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert priority.control_first() is False
    assert in_a_thread(priority.measure_first, priority.as_usual) == in_a_thread()
