"""The EGM driver against its twin: the contract of robots, faults of the link, and garbage. Both step on one clock."""

from __future__ import annotations

import contextlib
import math
import select
import socket
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
from armsight.drivers.egm import EgmRobot
from armsight.drivers.egm.packets import parse
from armsight.errors import DataRefused, DeviceFailed, DeviceLost, DeviceNotFound, StaleData, UsageError
from armsight.testing import RobotCase, RobotContract
from armsight_sim.arms import Drive, SimArm, SimJoint
from armsight_sim.twins.egm import EgmController

CYCLE_S = 0.004
HOME = np.array([0.1, -0.4, 0.5, -0.8, 0.9, 0.4])
TABLE = (
    (0.0, -1, 0.29, 0),
    (0.27, 0, 0.0, -1),
    (0.07, -1, 0.0, 0),
    (0.0, 1, 0.302, 0),
    (0.0, -1, 0.0, 0),
    (0, 0, 0.072, 0),
)


EXACT = {"bind": "127.0.0.1", "stale_s": 3.5 * CYCLE_S, "silent_s": 9.0 * CYCLE_S}
"""No time of the machine counts here, so that the limits may be tight."""


def arm() -> SimArm:
    half = math.pi / 2
    return SimArm(
        joints=tuple(
            SimJoint(name=f"j{i}", a_m=a, alpha_rad=k * half, d_m=d, theta_rad=t * half, lower=-3.0, upper=3.0)
            for i, (a, k, d, t) in enumerate(TABLE, 1)
        )
    )


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Pair:
    """A driver and its twin on real sockets, one cycle after the other, by a clock that moves only when told."""

    def __init__(self, **more: object) -> None:
        self.clock = ManualClock(100.0)
        port = free_port()
        self.robot = EgmRobot(str(port), settings={**EXACT, **more}, clock=self.clock)
        drive = Drive(cycle_s=CYCLE_S, lag_s=0.02, max_speed=np.full(6, 3.0), encoder_step=np.full(6, 1e-5))
        self.twin = EgmController(
            ("127.0.0.1", port), arm=arm(), drive=drive, home=HOME, clock=self.clock, own="127.0.0.1"
        )
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
                before, heard = self._takes, self.robot.counts.heard
                self.twin.cycle()
                self._wait(before, heard)

    def _drain(self) -> None:
        """Let the driver take what was sent while it opened."""
        for _ in range(0 if self._drained else 20_000):
            if self._newest == self.twin._last_packet:
                break
            time.sleep(0.0001)
        self._drained = True

    def _wait(self, before: int, heard: int) -> None:
        """Wait until the driver has taken what the twin sent, and an answer has come where it gave one."""
        asked = "silent" not in self.twin._faults
        for _ in range(20_000 if asked else 0):
            if self._takes > before or self.robot.state is RobotState.LOST:
                answered = self.robot.counts.heard > heard and not self.robot._lost
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


def case(pair: Pair) -> RobotCase:
    return RobotCase(
        robot=pair.robot,
        advance=pair.advance,
        lose_link=lambda: pair.twin.fault("silent"),
        freeze=lambda: pair.twin.fault("frozen"),
        tolerance=1e-4,
    )


class TestEgm(RobotContract):
    def make(self) -> RobotCase:
        return case(make_pair())


def test_nothing_moves_by_opening_and_holding() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        late = pair.twin.counts.late  # while the driver opens, the controller does not wait for its answers
        pair.advance(0.4)
        assert robot.state is RobotState.READY
        assert np.abs(pair.twin.q - HOME).max() <= 1e-5
        assert pair.twin.counts.taken >= 100
        assert pair.twin.counts.refused == pair.twin.counts.late - late == 0


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


def test_the_range_and_the_lag_of_the_arm_limit_a_goal() -> None:
    pair = make_pair(upper_rad=(HOME + 0.003).tolist(), lower_rad=[-3.0] * 6)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        robot.step_joints(np.full(6, 0.002))
        pair.advance(CYCLE_S)
        sent = robot.step_joints(np.full(6, 0.002))
        assert "range of joint 1" in sent.limited
        assert sent.q.max() <= (HOME + 0.003).max() + 1e-12
        pair.twin.fault("blocked")
        for _ in range(400):
            sent = robot.step_joints(np.full(6, -1.0))
            pair.advance(CYCLE_S)
        assert "lag of joint 1" in sent.limited
        assert np.abs(sent.q - HOME).max() < 0.6


@pytest.mark.parametrize("fault", ["motors_off", "egm_stopped"])
def test_a_controller_that_takes_no_motion_is_told_and_not_pulled_back(fault: str) -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin.fault(fault)
        pair.advance(2 * CYCLE_S)
        assert robot.state is RobotState.STOPPED
        with pytest.raises(DeviceFailed, match=r"motors are off|EGM is stopped"):
            robot.step_joints(np.zeros(6))
        with pytest.raises(DeviceFailed, match="stays stopped"):
            robot.reset()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(2 * CYCLE_S)
        pair.twin.fault(fault, on=False)
        pair.advance(2 * CYCLE_S)
        with pytest.raises(DeviceFailed, match="goes on now"):
            robot.step_joints(np.zeros(6))
        robot.reset()
        pair.advance(0.4)
    assert np.abs(pair.twin.q - HOME - 0.1).max() < 2e-5


def test_a_controller_that_starts_anew_is_lost_and_can_be_opened_again() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(0.4)
        pair.twin.restart()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(0.1)
        assert robot.state is RobotState.LOST
        with pytest.raises(DeviceLost, match="started anew"):
            robot.read()
    with robot:
        pair.advance(0.1)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - HOME - 0.1).max() < 2e-5


def test_a_silent_link_stays_lost_even_when_it_speaks_again() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin.fault("silent")
        pair.advance(20 * CYCLE_S)
        for _ in range(2000):
            if robot._lost:
                break
            time.sleep(0.001)
        pair.twin.fault("silent", on=False)
        pair.advance(5 * CYCLE_S)
        assert robot.state is RobotState.LOST
        assert "silent" in robot.why


def test_a_second_program_and_a_second_controller_are_refused() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        second = EgmRobot(str(robot.port), settings={"bind": "127.0.0.1"})
        with pytest.raises(DeviceFailed, match="cannot be taken"), second:
            pass
        stranger = EgmController(
            ("127.0.0.1", robot.port), arm=arm(), drive=pair.twin._drive, home=HOME + 1.0, clock=pair.clock
        )
        with contextlib.closing(stranger):
            for _ in range(5):
                stranger.cycle()
            pair.advance(3 * CYCLE_S)
            assert robot.counts.foreign == 5
            assert stranger.counts.taken == 0
        assert np.abs(robot.read().q - HOME).max() < 2e-5


def test_no_controller_is_told() -> None:
    robot = EgmRobot(str(free_port()), settings={"open_s": 0.05})
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
        ("6510", {"lower_rad": [0.0]}, "1 joint limits"),
    ],
)
def test_wrong_settings_are_refused(device: str, more: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        EgmRobot(device, settings=more)


def test_poses_are_followed_in_pose_guidance() -> None:
    pair = make_pair(guidance="pose")
    start = arm().flange(HOME)
    goal = RigidTransform.from_components(
        start.translation + np.array([0.004, -0.003, 0.002]), Rotation.from_rotvec([0.0, 0.02, 0.01]) * start.rotation
    )
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        first = robot.move_pose(goal)
        assert first.limited
        pair.advance(CYCLE_S)
        for _ in range(60):
            last = robot.move_pose(goal)
            pair.advance(CYCLE_S)
        pair.advance(0.4)
        assert last.limited == ()
        reached = arm().flange(pair.twin.q)
        assert np.linalg.norm(reached.translation - goal.translation) < 2e-5
        assert (reached.rotation * goal.rotation.inv()).magnitude() < 5e-5
        assert robot.state is RobotState.READY
        with pytest.raises(UsageError, match="guided by poses"):
            robot.step_joints(np.full(6, 0.001))
        with pytest.raises(DataRefused, match="not finite"):
            robot.move_pose(RigidTransform.from_translation([np.nan, 0.0, 0.0]))


def state_packet(pair: Pair) -> bytes:
    return pair.twin._packet()


@given(st.binary(max_size=600))
@settings(max_examples=200, deadline=None)
def test_garbage_is_refused_by_the_parser(data: bytes) -> None:
    with contextlib.suppress(DataRefused):
        packet = parse(data, 6)
        assert np.isfinite(packet.q).all()


def test_garbage_on_the_wire_is_counted_and_moves_nothing() -> None:
    pair = make_pair()
    rng = np.random.default_rng(7)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        good = state_packet(pair)
        for i in range(300):
            bad = bytearray(good)
            if i % 3 == 0:
                bad = bytearray(rng.bytes(int(rng.integers(0, 900))))
            elif i % 3 == 1:
                bad = bad[: int(rng.integers(0, len(bad)))]
            else:
                for place in rng.integers(0, len(bad), 8):
                    bad[place] = int(rng.integers(0, 256))
            pair.twin.link.sendto(bytes(bad), ("127.0.0.1", robot.port))
        for _ in range(2000):
            counts = robot.counts
            if counts.refused + counts.repeated + counts.heard >= 300:
                break
            time.sleep(0.001)
        assert robot.counts.refused > 100
        pair.advance(10 * CYCLE_S)
    assert np.abs(pair.twin.q - HOME).max() < 0.25  # what a packet says of the arm is no goal


def test_the_twin_takes_no_guidance_from_garbage() -> None:
    pair = make_pair()
    rng = np.random.default_rng(8)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        robot.stop()
        sensor = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with sensor:
            for _ in range(200):
                sensor.sendto(rng.bytes(int(rng.integers(0, 300))), pair.twin.link.getsockname())
        pair.advance(5 * CYCLE_S)
        pair.twin._guide(rng.bytes(100))
        assert pair.twin.counts.refused >= 100
    assert np.abs(pair.twin.q - HOME).max() < 2e-5


def test_a_reading_where_the_arm_cannot_be_is_refused() -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin.push(np.full(6, 1.0))
        pair.advance(2 * CYCLE_S)
        assert robot.counts.refused == 2
        pair.advance(20 * CYCLE_S)
        with pytest.raises((StaleData, DeviceLost)):
            robot.read()
