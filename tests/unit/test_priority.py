"""What runs before what: the loop's thread alone, within its bound, and a system that refuses changes nothing."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from armsight import priority
from armsight.ops.robot.recorder import run_with_progress

LINUX = pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="the system has no such order")
ENOUGH_S = 20.0
"""Of a processor's time: far more than a thread may take, also where who hears the signal waits for seconds."""


def first() -> bool:
    """Return whether the calling thread goes first."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


def in_a_thread(step: Callable[[], object]) -> object:
    out: list[object] = []
    thread = threading.Thread(target=lambda: out.append(step()))
    thread.start()
    thread.join()
    return out[0]


def allowed() -> bool:
    """Return whether the system lets a thread go first."""
    return priority.bound_control() and bool(in_a_thread(priority.control_first))


@pytest.fixture(autouse=True)
def kept(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave no handler behind, and no bound that ends the tests' own process."""
    before = signal.getsignal(signal.SIGXCPU)
    monkeypatch.setattr(priority, "HANGS_S", 3600.0)
    yield
    signal.signal(signal.SIGXCPU, before)


@LINUX
def test_the_loop_alone_goes_first_and_nothing_that_it_starts() -> None:
    if not allowed():
        pytest.skip("the system does not allow it")
    child = [sys.executable, "-S", "-c", "import os; print(os.sched_getscheduler(0))"]

    def loop() -> tuple[bool, object, str]:
        return first(), in_a_thread(first), subprocess.run(child, check=True, capture_output=True).stdout.decode()

    assert run_with_progress(loop, lambda: None) == (True, False, f"{os.SCHED_OTHER}\n")
    assert not first() and not in_a_thread(first)


@LINUX
def test_what_the_loop_starts_would_go_first_without_the_systems_word(monkeypatch: pytest.MonkeyPatch) -> None:
    if not allowed():
        pytest.skip("the system does not allow it")
    monkeypatch.setattr(os, "SCHED_RESET_ON_FORK", 0)  # a planted fault
    assert run_with_progress(lambda: in_a_thread(first), lambda: None)


def works(until: Callable[[], bool]) -> float:
    """Work without sleeping until something is so; return how much of a processor that took in s."""
    begun_s = time.thread_time()
    while not until() and time.thread_time() - begun_s < ENOUGH_S:
        pass
    return time.thread_time() - begun_s


@LINUX
def test_a_loop_that_does_not_sleep_goes_first_no_more_and_later_again(monkeypatch: pytest.MonkeyPatch) -> None:
    if not allowed():
        pytest.skip("the system does not allow it")
    later: list[tuple[float, Callable[..., None], tuple[list[int]]]] = []

    class Later(threading.Timer):
        def start(self) -> None:
            later.append((self.interval, self.function, tuple(self.args)))  # type: ignore[arg-type]

    monkeypatch.setattr(threading, "Timer", Later)

    def loop() -> tuple[float, bool]:
        took_s = works(lambda: not first() and bool(later))  # the handler plans the return last
        ((wait_s, act, threads),) = later
        assert wait_s == priority.BACK_S
        act(*threads)
        return took_s, first()

    took_s, again = run_with_progress(loop, lambda: None)
    assert took_s < ENOUGH_S and again
    assert resource.getrlimit(resource.RLIMIT_RTTIME)[0] == round(1e6 * priority.WORKS_S), "it counts anew"


@LINUX
def test_the_line_for_stops_goes_behind_a_loop_and_after_a_flood_there_again(monkeypatch: pytest.MonkeyPatch) -> None:
    if not allowed():
        pytest.skip("the system does not allow it")
    back: list[tuple[dict[int, int]]] = []

    class Later:
        def __init__(self, _: float, act: object, args: tuple[dict[int, int]]) -> None:
            back.append(args)

        def start(self) -> None:
            pass

    def line() -> tuple[int, int, int]:
        def place() -> int:
            thread = threading.get_native_id()
            usual = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO
            return 0 if usual else os.sched_getparam(thread).sched_priority

        assert priority.listen_first()
        listens = place()
        priority._put_back(0, None)
        flooded = place()
        priority._give_back(*back[0])
        return listens, flooded, place()

    monkeypatch.setattr(priority.threading, "Timer", Later)
    priority.bound_control()
    assert in_a_thread(line) == (priority.LISTENS, 0, priority.LISTENS)
    assert priority.LISTENS < priority.CONTROL


@LINUX
def test_a_loop_that_sleeps_stays_first() -> None:
    if not allowed():
        pytest.skip("the system does not allow it")

    def loop() -> bool:
        for _ in range(4):
            until_s = time.thread_time() + 0.6 * priority.WORKS_S
            works(lambda: time.thread_time() > until_s)  # noqa: B023 - it is called here and now
            time.sleep(1e-4)
        return first()

    assert run_with_progress(loop, lambda: None)


@LINUX
def test_no_thread_goes_first_where_the_main_one_has_not_bound_it() -> None:
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    assert in_a_thread(priority.control_first) is False


@LINUX
def test_compiled_code_that_hangs_is_ended_by_the_system() -> None:
    """The bound holds without the interpreter, which such code keeps for itself."""
    if not allowed():
        pytest.skip("the system does not allow it")
    program = "from armsight import priority; priority.HANGS_S = 0.2; priority.control_first(); sum(iter(int, 1))"
    done = subprocess.run([sys.executable, "-c", program], timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL


@LINUX
def test_what_gives_way_does_so_alone() -> None:
    def nice() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    before = nice()
    assert in_a_thread(lambda: (priority.give_way(), nice())[1]) == max(before, priority.BEHIND)
    assert nice() == before


@LINUX
def test_a_system_that_refuses_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert priority.control_first() is False
    assert not first()
