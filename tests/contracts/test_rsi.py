"""The RSI driver against its twin: the contract of robots, faults of the link, and garbage. Both step on one clock."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.drivers.rsi import RsiRobot
from armsight.drivers.rsi.messages import parse
from armsight.drivers.rsi.settings import read_tags
from armsight.errors import BadFile, DataRefused, DeviceFailed, DeviceLost, DeviceNotFound, UsageError
from armsight.testing import RobotCase, RobotContract
from armsight_sim.twins.base import small_arm, twin_drive, twin_home
from armsight_sim.twins.rsi import RsiController

CYCLE_S = 0.004
HOME = twin_home(small_arm())
EXACT = {"bind": "127.0.0.1", "stale_s": 3.5 * CYCLE_S, "silent_s": 9.0 * CYCLE_S}
"""No time of the machine counts here, so that the limits may be tight."""


def until(holds: Callable[[], bool]) -> None:
    """Return when the driver's thread has done its part; fails where it never does."""
    pause = threading.Event()
    for _ in range(15_000):
        if holds():
            return
        pause.wait(0.002)
    raise AssertionError("it never came to be")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Pair:
    """A driver and its twin on real sockets, one cycle after the other, by a clock that moves only when told."""

    def __init__(self, **more: object) -> None:
        self.clock = ManualClock(100.0)
        port = free_port()
        self.robot = RsiRobot(str(port), settings={**EXACT, **more}, clock=self.clock)
        drive = twin_drive(small_arm(), CYCLE_S)
        self.twin = RsiController(("127.0.0.1", port), arm=small_arm(), drive=drive, home=HOME)
        self._takes, self._newest, self._drained = 0, None, True
        self._take, self.robot._take = self.robot._take, self._counted  # type: ignore[method-assign]
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._pump = threading.Thread(target=self._start_up, daemon=True)
        self._pump.start()

    def _counted(self, data: bytes, *args: Any, **more: Any) -> None:
        """Let the driver take what has come, and answer it; only then it counts."""
        self._take(data, *args, **more)
        self._newest = data
        self._takes += 1

    def _start_up(self) -> None:
        """Send while the driver is closed, so that it hears something when it opens."""
        while not self._done.wait(0.001):
            with self._lock:
                if self.robot.state is RobotState.CLOSED:
                    self.twin.cycle()
                    self._drained = False

    def advance(self, time_s: float) -> None:
        for _ in range(round(time_s / CYCLE_S)):
            with self._lock:
                self.clock.advance(CYCLE_S)
                if self.robot.state is RobotState.CLOSED:
                    self.twin.cycle()
                    continue
                self._drain()
                before = self._takes
                self.twin.cycle()
                self._wait(before)

    def _drain(self) -> None:
        """Let the driver take what was sent while it opened."""
        for _ in range(0 if self._drained else 20_000):
            if self._newest == self.twin._last_packet:
                break
            time.sleep(0.0001)
        self._drained = True

    def _wait(self, before: int) -> None:
        """Wait until the driver has taken what the twin sent, and an answer has come where it gave one."""
        asked = self.twin._asked and "silent" not in self.twin._faults
        for _ in range(20_000 if asked else 0):
            if self._takes > before or self.robot.state is RobotState.LOST:
                answered = self.robot._answered_ipoc == self.twin._ipoc
                select.select([self.twin.link], [], [], 0.5 if answered else 0.0)
                return
            time.sleep(0.0001)
        assert not asked, "the driver took nothing"

    def close(self) -> None:
        self._done.set()
        self._pump.join()
        self.robot.__exit__(None, None, None)
        self.twin.close()


PAIRS: list[Pair] = []


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while PAIRS:
        PAIRS.pop().close()


def make_pair(**more: object) -> Pair:
    PAIRS.append(Pair(**more))
    return PAIRS[-1]


class TestRsi(RobotContract):
    def make(self) -> RobotCase:
        pair = make_pair()
        return RobotCase(
            robot=pair.robot,
            advance=pair.advance,
            lose_link=lambda: pair.twin.fault("silent"),
            freeze=lambda: pair.twin.fault("frozen"),
            tolerance=1e-4,
        )


def test_nothing_moves_by_opening_and_holding_and_no_answer_is_late() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(5 * CYCLE_S)
        # while the driver opens, the controller does not wait for its answers
        mismatched, late = pair.twin.counts.mismatched, robot.counts.late
        pair.advance(0.4)
        assert robot.state is RobotState.READY
        assert robot.counts.missed == robot.counts.late - late == 0
        assert np.abs(pair.twin.q - HOME).max() <= 1e-5
        assert pair.twin.counts.taken >= 99
        assert pair.twin.counts.refused == pair.twin.counts.mismatched - mismatched == 0


def test_a_late_caller_leaves_the_arm_where_it_was_told_to_go() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        sent = robot.step_joints(np.full(6, 0.002))
        pair.advance(0.4)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert np.allclose(sent.q, HOME + 0.002, atol=2e-5)


def test_stop_holds_within_one_cycle_and_drops_what_was_asked() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        for _ in range(20):
            sent = robot.step_joints(np.full(6, 1.0))
            pair.advance(CYCLE_S)
        robot.step_joints(np.full(6, 1.0))
        robot.stop()
        pair.advance(1.0)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert robot.state is RobotState.STOPPED


def test_a_controller_that_reboots_is_lost_and_can_be_opened_again() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(0.1)
        robot.step_joints(np.full(6, 0.004))
        pair.advance(0.4)
        pair.twin.reboot()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(0.1)
        assert robot.state is RobotState.LOST
        with pytest.raises(DeviceLost, match="started anew"):
            robot.read()
    there = pair.twin.q
    with robot:
        pair.advance(0.1)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - there).max() < 2e-5


def test_after_closing_it_is_opened_only_where_the_corrections_begin_anew() -> None:
    """A session that was left for a while is left to end; then it opens where the arm stands, and nothing moves."""
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        for _ in range(30):
            robot.step_joints(np.full(6, 0.004))
            pair.advance(CYCLE_S)
        pair.advance(0.4)
    pair.advance(20 * CYCLE_S)
    there = pair.twin.q
    assert np.abs(there - HOME).max() > 0.1
    with robot:
        pair.advance(0.4)
        assert pair.twin.counts.ended == 1
    assert np.abs(pair.twin.q - there).max() < 2e-5


def test_another_programs_correction_is_not_taken_over() -> None:
    pair = make_pair(open_s=0.1)
    pair.twin._start = HOME - 0.01
    pair.twin._servo.command(0.0, HOME)
    with pytest.raises(DeviceFailed, match="another program's correction"), pair.robot:
        pass
    assert np.abs(pair.twin.q - HOME).max() < 2e-5


def test_a_second_program_and_a_second_controller_are_refused() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        second = RsiRobot(str(robot.port), settings={"bind": "127.0.0.1"})
        with pytest.raises(DeviceFailed, match="cannot be taken"), second:
            pass
        stranger = RsiController(
            ("127.0.0.1", robot.port), arm=small_arm(), drive=twin_drive(small_arm(), CYCLE_S), home=HOME + 1.0
        )
        with contextlib.closing(stranger):
            for _ in range(5):
                stranger.cycle()
            pair.advance(3 * CYCLE_S)
            assert robot.counts.foreign == 5
            assert stranger.counts.taken == 0
        assert np.abs(robot.read().q - HOME).max() < 2e-5


def test_no_controller_is_told() -> None:
    robot = RsiRobot(str(free_port()), settings={"open_s": 0.05})
    with pytest.raises(DeviceNotFound, match="no controller has sent"), robot:
        pass
    assert robot.state is RobotState.CLOSED


@pytest.mark.parametrize(
    ("device", "more", "match"),
    [
        ("abc", {}, "no UDP port"),
        ("99999", {}, "no UDP port"),
        ("6510", {"cycle": 4}, "cycle"),
        ("6510", {"cycle_s": -1}, "cycle_s"),
        ("6510", {"guidance": "both"}, "guidance"),
        ("6510", {"lower_rad": [0.0]}, "lower_rad"),
    ],
)
def test_wrong_settings_are_refused(device: str, more: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        RsiRobot(device, settings=more)


def test_poses_are_followed_by_cartesian_corrections() -> None:
    pair = make_pair(guidance="pose")
    start = small_arm().flange(HOME)
    goal = RigidTransform.from_components(
        start.translation + np.array([0.004, -0.003, 0.002]), Rotation.from_rotvec([0.01, 0.02, 0.01]) * start.rotation
    )
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        assert robot.move_pose(goal).limited
        for _ in range(60):
            pair.advance(CYCLE_S)
            last = robot.move_pose(goal)
        pair.advance(0.4)
        assert last.limited == ()
        reached = small_arm().flange(pair.twin.q)
        assert np.linalg.norm(reached.translation - goal.translation) < 2e-5
        assert (reached.rotation * goal.rotation.inv()).magnitude() < 5e-5
        assert robot.state is RobotState.READY
        with pytest.raises(UsageError, match="guided by poses"):
            robot.step_joints(np.full(6, 0.001))
        with pytest.raises(DataRefused, match="not finite"):
            robot.move_pose(RigidTransform.from_translation([np.nan, 0.0, 0.0]))


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
    with pytest.raises(UsageError, match="no pose corrections"):
        RsiRobot("49152", settings={"rsi_config": path, "guidance": "pose"})


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("no xml", "no XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ROOT/>', "no RSI Ethernet file"),
        ("<ROOT/>", "SENTYPE"),
        (config("AK.A1 AK.A2"), "neither joint"),
        (config(AXES, only="TRUE"), "ONLYSEND"),
        (config(AXES, sent="DEF_RIst"), "DEF_AIPos"),
    ],
)
def test_files_that_do_not_serve_are_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "ethernet.xml"
    path.write_text(text)
    with pytest.raises(BadFile, match=match):
        read_tags(path)


def test_the_open_simulator_is_understood() -> None:
    """Its message as kuka_experimental's simulator builds it: TYPE, zeros for poses, and it waits for each answer."""
    port = free_port()
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
        answers: list[bytes] = []
        simulator.settimeout(0.02)

        def asked() -> bool:
            with contextlib.suppress(OSError):  # refused at once while nobody listens yet
                simulator.send(message(0, q))
                answers.append(simulator.recv(1024))
            return bool(answers)

        until(asked)
        opened.join()
        answer = answers[0]
        assert answer.startswith(b'<Sen Type="ImFree"><AK A1="0.000000"')
        assert answer.endswith(b"<IPOC>0</IPOC></Sen>")
        robot.step_joints(np.full(6, 0.001))
        simulator.settimeout(2.0)
        simulator.send(message(4, q))
        assert b'A1="0.057296"' in simulator.recv(1024)
        simulator.send(message(4, q))
        assert simulator.recv(1024).endswith(b"<IPOC>4</IPOC></Sen>")
        until(lambda: robot.counts.repeated == 1)
        robot.__exit__(None, None, None)


@given(st.binary(max_size=300) | st.text(max_size=300).map(str.encode))
@settings(max_examples=200, deadline=None)
def test_garbage_is_refused_by_the_parser(data: bytes) -> None:
    with contextlib.suppress(DataRefused):
        assert np.isfinite(parse(data).q).all()


def test_garbage_on_the_wire_is_counted_and_moves_nothing() -> None:
    pair = make_pair()
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
    assert np.abs(pair.twin.q - HOME).max() < 2e-5


def test_answers_with_another_ipoc_or_type_move_nothing() -> None:
    pair = make_pair()
    pair.twin._ipoc = 1000
    far = " ".join(f'A{i}="5.0"' for i in range(1, 7))
    for text in (
        f'<Sen Type="ImFree"><AK {far}/><IPOC>996</IPOC></Sen>',
        f'<Sen Type="Other"><AK {far}/><IPOC>1000</IPOC></Sen>',
        f'<Sen Type="ImFree"><AK {far.replace("5.0", "nan")}/><IPOC>1000</IPOC></Sen>',
        f'<Sen Type="ImFree"><AK {far.replace("5.0", "1e99")}/><IPOC>1000</IPOC></Sen>',
    ):
        with pair._lock:
            pair.twin._ipoc = 1000
            assert not pair.twin._take(text.encode())
    assert pair.twin.counts.mismatched == 1
    assert pair.twin.counts.refused == 3
    assert np.abs(pair.twin.q - HOME).max() < 2e-5


def test_a_reading_where_the_arm_cannot_be_is_refused() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin._servo = type(pair.twin._servo)(pair.twin._drive, HOME + 1.0, pair.twin._servo.t_s, keep=1000)
        pair.twin._start = HOME + 1.0
        pair.advance(2 * CYCLE_S)
        assert robot.counts.refused == 2
