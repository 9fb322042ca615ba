"""The driver of real-time path control against its twin on a pseudo terminal. Both step on one clock."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.drivers.alter import AlterRobot
from armsight.drivers.alter.frames import FrameSplitter, parse_state
from armsight.errors import DataRefused, DeviceFailed, DeviceLost, UsageError
from armsight.testing import RobotCase, RobotContract
from armsight_sim.twins.alter import AlterController
from armsight_sim.twins.base import small_arm, twin_drive, twin_home

CYCLE_S = 0.028
HOME = twin_home(small_arm())


class Model:
    """The arm's geometry as an application gives it; longer: by so much in m its last link is another arm's."""

    def __init__(self, longer: float = 0.0) -> None:
        self.longer = RigidTransform.from_translation([0.0, 0.0, longer])

    def fk(self, q: np.ndarray) -> RigidTransform:
        return small_arm().flange(q) * self.longer

    def ik(self, T_base_flange: RigidTransform, near: np.ndarray) -> np.ndarray:
        return small_arm().reach((T_base_flange * self.longer.inv()).as_matrix(), near)


class Pair:
    """A driver and its twin on a real line, one cycle after the other, by a clock that moves only when told."""

    def __init__(self, *, cumulative: bool = True, tool: bool = False, **more: object) -> None:
        self.clock = ManualClock(100.0)
        self.twin = AlterController(
            arm=small_arm(), drive=twin_drive(small_arm(), CYCLE_S), home=HOME, cumulative=cumulative, tool=tool
        )
        chosen = {"arm": Model(), "cumulative": cumulative, "axes": "tool" if tool else "world", **more}
        self.robot = AlterRobot(self.twin.path, settings=chosen, clock=self.clock)
        self._takes, self._newest, self._drained = 0, None, True
        self._take, self.robot._take = self.robot._take, self._counted  # type: ignore[method-assign]
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._pump = threading.Thread(target=self._start_up, daemon=True)
        self._pump.start()

    def _counted(self, state: Any, *args: Any, **more: Any) -> None:
        """Let the driver take what has come, and answer it; only then it counts."""
        self._take(state, *args, **more)
        self._newest = state.sequence
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
                before, heard = self._takes, self.robot.counts.heard
                self.twin.cycle()
                self._wait(before, heard)

    def _drain(self) -> None:
        """Let the driver take what was sent while it opened."""
        for _ in range(0 if self._drained else 20_000):
            if self._newest == self.twin._number:
                break
            time.sleep(0.0001)
        self._drained = True

    def _wait(self, before: int, heard: int) -> None:
        """Wait until the driver has taken what the twin sent, and an answer has come where it gave one."""
        asked = "silent" not in self.twin._faults
        for _ in range(20_000 if asked else 0):
            if self._takes > before or self.robot.state is RobotState.LOST:
                last = self.robot._last
                answered = self.robot.counts.heard > heard and last is not None and last.on and not self.robot._lost
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
    PAIRS.append(Pair(**more))  # type: ignore[arg-type]
    return PAIRS[-1]


def until(condition: object) -> None:
    for _ in range(2000):
        if condition():  # type: ignore[operator]
            return
        time.sleep(0.002)
    raise AssertionError("it did not come to that")


class TestAlter(RobotContract):
    def make(self) -> RobotCase:
        pair = make_pair()
        return RobotCase(
            robot=pair.robot,
            advance=pair.advance,
            lose_link=lambda: pair.twin.fault("silent"),
            freeze=lambda: pair.twin.fault("frozen"),
            tolerance=1e-4,
        )


@pytest.mark.parametrize("tool", [False, True])
@pytest.mark.parametrize("cumulative", [False, True])
def test_joints_and_poses_are_followed_in_every_mode(cumulative: bool, tool: bool) -> None:
    pair = make_pair(cumulative=cumulative, tool=tool)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        for _ in range(5):
            sent = robot.step_joints(np.array([1.0, -1.0, 1.0, 2.0, -2.0, 1.0]) * 1e-3)
            pair.advance(CYCLE_S)
        pair.advance(15 * CYCLE_S)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert sent.pose is not None
        goal = RigidTransform.from_components(
            sent.pose.translation + np.array([0.004, -0.003, 0.002]),
            Rotation.from_rotvec([0.01, 0.02, 0.01]) * sent.pose.rotation,
        )
        assert robot.move_pose(goal).limited
        for _ in range(6):
            pair.advance(CYCLE_S)
            last = robot.move_pose(goal)
        pair.advance(15 * CYCLE_S)
        assert last.limited == ()
        reached = RigidTransform.from_matrix(pair.twin.commanded)
        assert np.linalg.norm(reached.translation - goal.translation) < 2e-6
        assert (reached.rotation * goal.rotation.inv()).magnitude() < 5e-6
        assert pair.twin.counts.refused == 0


def test_opening_and_holding_moves_nothing_even_with_a_slightly_wrong_arm() -> None:
    pair = make_pair(arm=Model(longer=0.003))
    with pair.robot as robot:
        pair.advance(10 * CYCLE_S)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - HOME).max() <= 1e-5


def test_the_file_of_another_arm_is_refused() -> None:
    pair = make_pair(arm=Model(longer=0.05), open_s=0.1)
    with pytest.raises(DeviceFailed, match="another arm"), pair.robot:
        pass


def test_the_controllers_mode_must_be_the_one_that_is_set() -> None:
    pair = make_pair(axes="tool", open_s=0.1)
    with pytest.raises(DeviceFailed, match="set otherwise here"), pair.robot:
        pass
    assert np.abs(pair.twin.q - HOME).max() <= 1e-5


def test_without_the_arms_geometry_it_takes_poses_alone() -> None:
    pair = make_pair(arm=None)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        with pytest.raises(UsageError, match="geometry"):
            robot.step_joints(np.full(6, 1e-3))
        start = robot.step_joints(np.zeros(6)).pose
        assert start is not None
        sent = robot.move_pose(RigidTransform.from_translation([0.001, 0.0, 0.0]) * start)
        pair.advance(15 * CYCLE_S)
        assert np.allclose(pair.twin.commanded, sent.pose.as_matrix(), atol=2e-6)  # type: ignore[union-attr]


def test_a_late_caller_leaves_the_arm_where_it_was_told_to_go() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        sent = robot.step_joints(np.full(6, 0.001))
        pair.advance(20 * CYCLE_S)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5


def test_stop_holds_within_one_cycle_and_drops_what_was_asked() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        for _ in range(10):
            sent = robot.step_joints(np.full(6, 1.0))
            pair.advance(CYCLE_S)
        robot.step_joints(np.full(6, 1.0))
        robot.stop()
        pair.advance(20 * CYCLE_S)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert robot.state is RobotState.STOPPED


def test_no_command_is_faster_than_the_flange_may_be() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        before = pair.twin.commanded
        for _ in range(20):
            robot.step_joints(np.full(6, 1.0))
            pair.advance(CYCLE_S)
            assert np.linalg.norm(pair.twin.commanded[:3, 3] - before[:3, 3]) <= 0.1 * CYCLE_S * 1.02
            before = pair.twin.commanded


def test_a_controller_that_reboots_is_lost_and_can_be_opened_again() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(10 * CYCLE_S)
        robot.step_joints(np.full(6, 0.001))
        pair.advance(5 * CYCLE_S)
        pair.twin.reboot()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(6 * CYCLE_S)
        assert robot.state is RobotState.LOST
        with pytest.raises(DeviceLost, match="started anew"):
            robot.read()
    there = pair.twin.q
    with robot:
        pair.advance(5 * CYCLE_S)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - there).max() < 2e-5


def test_a_port_that_is_taken_away_is_told() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair._done.set()
        pair._pump.join()
        pair.twin.close()
        until(lambda: robot.state is RobotState.LOST)
        with pytest.raises(DeviceLost, match="port is gone"):
            robot.read()
        robot.stop()


def test_a_second_program_is_refused() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        with pytest.raises(DeviceFailed, match="one program at a time"), AlterRobot(robot.port):
            pass


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"baud": 19200, "cycle_s": 0.028}, "longer than a cycle"),
        ({"axes": "joint"}, "axes"),
        ({"arm": "arm.yaml"}, "arm"),
        ({"cycle": 0.028}, "cycle"),
        ({"upper_rad": [1.0]}, "upper_rad"),
    ],
)
def test_wrong_settings_are_refused(more: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        AlterRobot("/dev/null", settings=more)


def test_no_controller_and_no_port_are_told() -> None:
    with pytest.raises(DeviceFailed, match="cannot be opened"), AlterRobot("/dev/there-is-none"):
        pass
    master, slave = os.openpty()
    with pytest.raises(DeviceFailed, match="no controller"), AlterRobot(os.ttyname(slave), settings={"open_s": 0.05}):
        pass
    os.close(master)
    os.close(slave)


@given(st.lists(st.binary(max_size=120) | st.just(b"\xa5\x53\x2b"), max_size=8), st.integers(0, 10))
@settings(max_examples=200, deadline=None)
def test_garbage_makes_no_state_and_hides_none_behind_it(pieces: list[bytes], cut: int) -> None:
    pair_frame = GOOD
    splitter = FrameSplitter()
    for piece in pieces:
        for state in splitter.feed(piece):
            assert np.isfinite(state.q).all()
    found = splitter.feed(b"\x00" * 48 + pair_frame[:cut])
    found += splitter.feed(pair_frame[cut:])
    assert found[-1].sequence == parse_state(pair_frame).sequence


@given(st.integers(0, 47 * 8 + 7))
@settings(max_examples=100, deadline=None)
def test_no_state_with_a_wrong_bit_is_taken(bit: int) -> None:
    bad = bytearray(GOOD)
    bad[bit // 8] ^= 1 << bit % 8
    with pytest.raises(DataRefused):
        parse_state(bytes(bad))


def _good() -> bytes:
    twin = AlterController(arm=small_arm(), drive=twin_drive(small_arm(), CYCLE_S), home=HOME)
    with contextlib.closing(twin):
        twin.move()
        return twin._frame


GOOD = _good()


def test_garbage_on_the_line_is_counted_and_moves_nothing() -> None:
    pair = make_pair()
    rng = np.random.default_rng(7)
    with pair.robot as robot:
        for _ in range(20):
            with contextlib.suppress(BlockingIOError):
                os.write(pair.twin.link, rng.bytes(int(rng.integers(1, 90))) + b"\x00" * 48)
            pair.advance(CYCLE_S)
        assert robot.counts.garbage_bytes > 500
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - HOME).max() <= 1e-5


@given(st.binary(max_size=200))
@settings(max_examples=25, deadline=None)
def test_the_twin_takes_no_way_from_garbage(data: bytes) -> None:
    twin = AlterController(arm=small_arm(), drive=twin_drive(small_arm(), CYCLE_S), home=HOME)
    with contextlib.closing(twin):
        twin.cycle()
        twin._data = data
        twin.cycle()
        assert twin.counts.taken == 0
        assert np.abs(twin.q - HOME).max() <= 1e-5
