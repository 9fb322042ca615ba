"""The RSI driver against its twin, beside what all by UDP do: sessions, files and garbage. Both step on one clock."""

from __future__ import annotations

import contextlib
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.contracts.conftest import until

from armsight.clock import ManualClock
from armsight.drivers import PROVING, RobotState
from armsight.drivers.rsi import RsiRobot, read_tags
from armsight.errors import BadFile, DeviceFailed, UsageError
from refusals import refuses

CYCLE_S = 0.004


def test_nothing_moves_by_opening_and_holding_and_no_answer_is_late(make_rsi: Any) -> None:
    pair = make_rsi()
    with pair.robot as robot:
        pair.advance(5 * CYCLE_S)
        # while the driver opens, the controller does not wait for its answers
        mismatched, late = pair.twin.counts.mismatched, robot.counts.late
        pair.advance(0.4)
        assert robot.state is RobotState.READY
        assert robot.counts.missed == robot.counts.late - late == 0
        assert np.abs(pair.twin.q - pair.home).max() <= 1e-5
        assert pair.twin.counts.taken >= 99
        assert pair.twin.counts.refused == pair.twin.counts.mismatched - mismatched == 0


def test_after_closing_it_is_opened_only_where_the_corrections_begin_anew(make_rsi: Any) -> None:
    """A session that was left for a while is left to end; then it opens where the arm stands, and nothing moves."""
    pair = make_rsi()
    with pair.robot as robot:
        pair.prove()
        for _ in range(30):
            robot.step_joints(np.full(6, 0.004))
            pair.advance(CYCLE_S)
        pair.advance(0.4)
    pair.advance(20 * CYCLE_S)
    there = pair.twin.q
    assert np.abs(there - pair.home).max() > 0.1
    with robot:
        pair.advance(0.4)
        assert pair.twin.counts.ended == 1
    assert np.abs(pair.twin.q - there).max() < 2e-5


def test_another_programs_correction_is_not_taken_over(make_rsi: Any) -> None:
    pair = make_rsi(open_s=0.1)
    pair.twin._start = pair.home - 0.01
    pair.twin._servo.command(0.0, pair.home)
    with refuses(DeviceFailed, "program's"), pair.robot:
        pass
    assert np.abs(pair.twin.q - pair.home).max() < 2e-5


@pytest.mark.parametrize("rule", [True, False])
def test_a_session_that_begins_in_the_middle_of_a_motion_is_not_the_one_that_was_enabled(
    make_rsi: Any, monkeypatch: pytest.MonkeyPatch, rule: bool
) -> None:
    """RSI ends by itself and begins anew where the arm stands, its numbers going on as if nothing had been."""
    pair = make_rsi(silent_s=0.4)
    if not rule:  # taken out, the old correction is asked for in the new session
        monkeypatch.setattr(RsiRobot, "_check_session", lambda *_: None)
    with pair.robot as robot:
        pair.prove()
        for _ in range(40):
            robot.step_joints(np.full(6, 0.002))
            pair.advance(CYCLE_S)
        with pair.lock:
            pair.twin._end("a fault of its own")
        pair.advance(0.4)
        there = pair.twin.q
        assert (pair.twin.counts.ended == 1) is rule
        if not rule:
            return
        assert robot.state is RobotState.STOPPED and "anew" in robot.why
        pair.advance(0.4)
        assert np.abs(pair.twin.q - there).max() < 2e-5
        robot.reset()
        pair.prove()
        sent = robot.step_joints(np.full(6, 0.002))
        pair.advance(0.4)
        assert np.abs(sent.q - there).max() < 0.0021
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5


def config(taken: str, *, sent: str = "DEF_AIPos DEF_Delay", sen_type: str = "Cell7", only: str = "FALSE") -> str:
    rows = ["".join(f'<ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="1"/>' for tag in tags.split()) for tags in (sent, taken)]
    return (
        f"<ROOT><CONFIG><PORT>49152</PORT><SENTYPE>{sen_type}</SENTYPE><ONLYSEND>{only}</ONLYSEND></CONFIG>"
        f"<SEND><ELEMENTS>{rows[0]}</ELEMENTS></SEND><RECEIVE><ELEMENTS>{rows[1]}</ELEMENTS></RECEIVE></ROOT>"
    )


AXES = " ".join(f"Axis.A{i}" for i in range(1, 7))


def test_type_and_tags_come_from_the_persons_own_file(tmp_path: Path) -> None:
    path = tmp_path / "ethernet.xml"
    path.write_text(config(f"Out.01 {AXES}"))
    robot = RsiRobot("49152", settings={"rsi_config": path})
    assert (robot.tags.sen_type, robot.tags.joint, robot.tags.pose) == ("Cell7", "Axis", "")
    assert not robot.takes_poses
    with refuses(UsageError, "corrections"):
        RsiRobot("49152", settings={"rsi_config": path, "guidance": "pose"})


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("no xml", "no XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ROOT/>', "RSI Ethernet"),
        ("<ROOT/>", "SENTYPE"),
        (config("AK.A1 AK.A2"), "neither joint"),
        (config(AXES, only="TRUE"), "ONLYSEND"),
        (config(AXES, sent="DEF_RIst"), "DEF_AIPos"),
    ],
)
def test_files_that_do_not_serve_are_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "ethernet.xml"
    path.write_text(text)
    with refuses(BadFile, match):
        read_tags(path)


def test_the_open_simulator_is_understood(free_port: int) -> None:
    """Its message as kuka_experimental's simulator builds it: TYPE, zeros for poses, and it waits for each answer."""
    port = free_port
    robot = RsiRobot(str(port), settings={"bind": "127.0.0.1"}, clock=ManualClock(1.0))
    zeros, q = 'X="0.0" Y="0.0" Z="0.0" A="0.0" B="0.0" C="0.0"', [0.0, -90.0, 90.0, 0.0, 90.0, 0.0]

    def message(ipoc: int, q_deg: list[float]) -> bytes:
        now, set_point = (" ".join(f'A{i}="{v}"' for i, v in enumerate(row, 1)) for row in (q_deg, q))
        return (
            f'<Rob TYPE="KUKA"><RIst {zeros} /><RSol {zeros} /><AIPos {now} /><ASPos {set_point} />'
            f'<Delay D="3" /><IPOC>{ipoc}</IPOC></Rob>'
        ).encode()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as simulator:
        simulator.settimeout(2.0)
        simulator.connect(("127.0.0.1", port))
        opened = threading.Thread(target=robot.__enter__)
        opened.start()
        simulator.settimeout(0.02)
        answers: list[bytes] = []

        def asked() -> bool:
            with contextlib.suppress(OSError):  # refused at once while nobody listens yet
                simulator.send(message(4 * len(answers), q))
                answers.append(simulator.recv(1024))
            return len(answers) > 12

        until(asked)
        opened.join()
        answer = answers[0]
        assert answer.startswith(b'<Sen Type="ImFree"><AK A1="0.000000"')
        assert answer.endswith(b"<IPOC>0</IPOC></Sen>")
        assert PROVING in robot.step_joints(np.full(6, 0.001)).limited
        simulator.settimeout(2.0)
        simulator.send(message(100, q))
        assert b'A1="0.001000"' in simulator.recv(1024)
        simulator.send(message(100, q))
        assert simulator.recv(1024).endswith(b"<IPOC>100</IPOC></Sen>")
        until(lambda: robot.counts.repeated == 1)
        robot.__exit__(None, None, None)


def test_garbage_on_the_wire_is_counted_and_moves_nothing(make_rsi: Any) -> None:
    pair = make_rsi()
    rng = np.random.default_rng(7)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        good = pair.twin._packet()
        for i in range(200):
            bad = good[: int(rng.integers(0, len(good)))] if i % 2 else rng.bytes(int(rng.integers(0, 900)))
            pair.twin.link.sendto(bad, ("127.0.0.1", robot.port))
            until(lambda heard=i + 1: robot.counts.refused == heard)  # one by one: a full socket drops what comes
        assert robot.counts.refused == 200
        pair.advance(10 * CYCLE_S)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - pair.home).max() < 2e-5


def test_answers_with_another_ipoc_or_type_move_nothing(make_rsi: Any) -> None:
    pair = make_rsi()
    pair.twin._ipoc = 1000
    far = " ".join(f'A{i}="5.0"' for i in range(1, 7))
    for text in (
        f'<Sen Type="ImFree"><AK {far}/><IPOC>996</IPOC></Sen>',
        f'<Sen Type="Other"><AK {far}/><IPOC>1000</IPOC></Sen>',
        f'<Sen Type="ImFree"><AK {far.replace("5.0", "nan")}/><IPOC>1000</IPOC></Sen>',
        f'<Sen Type="ImFree"><AK {far.replace("5.0", "1e99")}/><IPOC>1000</IPOC></Sen>',
    ):
        with pair.lock:
            pair.twin._ipoc = 1000
            assert not pair.twin._take(text.encode())
    assert pair.twin.counts.mismatched == 1
    assert pair.twin.counts.refused == 3
    assert np.abs(pair.twin.q - pair.home).max() < 2e-5
