"""Twins: a process of their own from Python, the controllers' tolerance, and why they fell silent."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import armsight
from armsight.ops.robot import twin as twins
from armsight_sim.twins.base import BEHIND_S, note_silence, small_arm, twin_drive, twin_home
from armsight_sim.twins.rsi import LATE_LIMIT, RsiController


def test_a_twin_from_python_runs_in_another_process_and_ends_with_the_block() -> None:
    before = threading.active_count()
    with armsight.twin("alter") as address:
        line = Path(address.partition(":")[2])
        assert threading.active_count() == before, "no loop beside the driver's, under one interpreter's lock"
        owners = [int(p.parent.name) for p in Path("/proc").glob("[0-9]*/fd") if _holds(p, "/dev/ptmx")]
        assert line.exists()
        assert os.getpid() not in owners
    assert not line.exists()


def _holds(folder: Path, name: str) -> bool:
    try:
        return any(str(one.readlink()) == name for one in folder.iterdir())
    except OSError:
        return False


class _Quiet:
    """A twin that has something to say in its first cycle."""

    def __init__(self, **_: object) -> None:
        self.address = "quiet:"
        self.messages: list[str] = []

    def __enter__(self) -> _Quiet:
        return self

    def __exit__(self, *_: object) -> None:
        self.messages.append("gone")

    def run(self, on: Callable[[], bool]) -> None:
        self.messages.append("the arm was stopped")
        assert not on()


def test_why_it_fell_silent_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twins, "load", lambda group, name: _Quiet)
    told: list[str] = []
    warned: list[str] = []
    given = dict.fromkeys(("port", "connect", "arm", "cycle_s"))
    twins.run_twin("quiet", **given, on=lambda: False, ready=told.append, warn=warned.append)  # type: ignore[arg-type]
    assert (told, warned) == (["quiet:"], ["quiet twin: the arm was stopped"])
    messages: list[str] = []
    note_silence(messages, BEHIND_S)
    assert not messages
    note_silence(messages, 2 * BEHIND_S)
    assert len(messages) == 1


def test_rsi_ends_after_late_answers_in_a_row_and_not_after_as_many_in_all() -> None:
    arm = small_arm()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver:
        driver.bind(("127.0.0.1", 0))
        twin = RsiController(driver.getsockname(), arm=arm, drive=twin_drive(arm, 0.004), home=twin_home(arm))
        try:
            for late in (0, LATE_LIMIT - 1, LATE_LIMIT - 1, LATE_LIMIT - 1):
                for _ in range(late + 1):
                    twin.cycle()
                    state, controller = driver.recvfrom(4096)
                ipoc = state.partition(b"<IPOC>")[2].partition(b"<")[0].decode()
                driver.sendto(f'<Sen Type="ImFree"><IPOC>{ipoc}</IPOC></Sen>'.encode(), controller)
            twin.cycle()
            assert (twin.counts.taken, twin.counts.late, twin.counts.ended) == (4, 3 * (LATE_LIMIT - 1), 0)
            for _ in range(LATE_LIMIT):
                twin.cycle()
            assert twin.counts.ended == 1
            assert str(LATE_LIMIT) in twin.messages[-1]
        finally:
            twin.close()
