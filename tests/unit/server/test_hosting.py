"""A robot's loop on its side of the shared memory: what it obeys, when it holds, what it tells."""

import pickle
import time
from contextlib import contextmanager

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.clock import ManualClock
from armsight.control.guard.limits import ENABLE_AGE_S
from armsight.control.session.channels import Newest, Queue, Serves, Turns, error_of, put_error
from armsight.control.session.loop_host import LoopCommand, LoopEvent
from armsight.control.session.loop_side import Channels, CountedClock, lateness_s
from armsight.control.setpoints import JointGoal, JointVelocity
from armsight.drivers import RobotState
from armsight.errors import DeviceFailed, DeviceLost, UsageError
from armsight.ops.robot.hosting import ProcessHost, RobotSpec, ThreadHost
from armsight.ops.robot.opening import arm_model
from armsight.records import JointReading
from armsight.store.arm_file import arm_from_mapping
from armsight.testing.clocks import GatedClock
from armsight_sim.arms import Drive, SimArm, SimJoint
from armsight_sim.robot import RobotFault, SimRobot
from refusals import refuses

CYCLE_S = 0.02
UP = np.array([0.2, 0.1])


class Loop:
    """A two-joint arm in a thread on a gated clock."""

    def __init__(self, robot_type=SimRobot):
        self.clock = GatedClock(10.0)
        nominal = SimArm(joints=(SimJoint(name="j1", a_m=0.3), SimJoint(name="j2", a_m=0.2)))
        drive = Drive(cycle_s=CYCLE_S, lag_s=0.02, max_speed=np.full(2, 2.0), encoder_step=np.full(2, 1e-6))
        self.robot = robot_type("sim", true=nominal, nominal=nominal, drive=drive, home=[0.0, 0.3], clock=self.clock)
        mapping = {"format": "armsight/arm", "version": 1, **nominal.mapping(RigidTransform.identity())}
        self.host = ThreadHost(self.robot, arm_from_mapping(mapping, "x"), self.clock, ended=self.clock.leave)

    def advance(self, seconds, *, beat=False):
        """Let time pass, with heartbeats or without."""
        while seconds > 1e-9:
            if beat:
                self.host.beat(enable=True)
            part = min(seconds, 0.1)
            self.clock.advance(part)
            seconds -= part

    @property
    def q(self):
        return self.host.status().q_sent


@contextmanager
def running(robot_type=SimRobot):
    loop = Loop(robot_type)
    loop.host.begin()
    loop.advance(2 * CYCLE_S)
    try:
        loop.host.wait()
        yield loop
    finally:
        loop.host.end(lambda: loop.clock.advance(0.1))


def test_a_goal_is_gone_to_while_the_driver_lives():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.post(JointGoal(q=UP))
        loop.advance(3.0, beat=True)
        assert pytest.approx(UP, abs=1e-9) == loop.q
        assert loop.host.status().guard == "running"


def test_without_enable_nothing_moves_then_or_later():
    with running() as loop:
        loop.host.post(JointGoal(q=UP))
        loop.advance(0.2)
        loop.advance(1.0, beat=True)
        assert loop.q.tolist() == [0.0, 0.3], "what was asked before the enable is not done after it"


@pytest.mark.parametrize("how", ["silent", "release", "disable"])
def test_a_driver_who_is_gone_is_a_hold(how):
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.post(JointGoal(q=np.array([2.0, 0.3])))
        loop.advance(0.4, beat=True)
        assert loop.host.status().guard == "running"
        if how == "silent":
            loop.advance(ENABLE_AGE_S + 2 * CYCLE_S)
        elif how == "release":
            loop.host.release("gone")
            loop.advance(CYCLE_S)
        else:
            loop.host.beat(enable=False)
            loop.advance(CYCLE_S)
        assert loop.host.status().guard == "disabled"
        loop.advance(1.0)
        rest = loop.q
        assert 0.0 < rest[0] < 2.0
        loop.advance(1.0, beat=True)
        assert loop.q.tolist() == rest.tolist(), "a new heartbeat does not bring back what was asked"


def held_by_the_line(loop, seconds, *, web=True, line=True):
    """Let time pass with enables by the line for stops, both processes alive or one of them standing still."""
    for _ in range(round(seconds / 0.05)):
        now_s = loop.clock.now_s()
        for who in [Serves.WEB] * web + [Serves.LINE] * line:
            loop.host.line.turns.turn(who, now_s)
        loop.host.line.orders.put(pickle.dumps(("beat", (True, None), now_s, 0, "key")))
        loop.clock.advance(0.05)


@pytest.mark.parametrize("rule", [True, False])
def test_a_web_server_that_stands_still_holds_the_arm_though_the_line_enables_it(rule, monkeypatch):
    if not rule:  # taken out, the arm goes on
        monkeypatch.setattr(Turns, "missed", lambda *_: "")
    with running() as loop:
        loop.host.grant(0, "key")
        held_by_the_line(loop, 0.1)
        loop.host.post(JointGoal(q=np.array([2.0, 0.3])))
        held_by_the_line(loop, 0.4)
        assert loop.host.status().guard == "running"
        held_by_the_line(loop, ENABLE_AGE_S + 0.3, web=False)
        rest, found = loop.q, loop.host.status()
        assert (found.guard == "disabled" and "web server" in found.lapsed) is rule
        held_by_the_line(loop, 0.5)
        assert (loop.q.tolist() == rest.tolist()) is rule, "it goes on only once the enable was given anew"
        assert loop.host.status().enabled is not rule


def test_a_stand_still_of_the_line_that_is_shorter_than_the_age_of_an_enable_ends_it_too():
    with running() as loop:
        loop.host.grant(0, "key")
        held_by_the_line(loop, 0.1)
        loop.host.post(JointGoal(q=np.array([2.0, 0.3])))
        held_by_the_line(loop, 0.4)
        held_by_the_line(loop, 0.05, line=False)  # its turns are 0.1 s apart
        assert loop.host.status().guard == "running"
        held_by_the_line(loop, 0.5)
        assert loop.host.status().guard == "disabled"
        loop.host.beat(enable=False)
        held_by_the_line(loop, 0.1)
        assert loop.host.status().guard != "disabled", "what was given anew counts"


@pytest.mark.parametrize("silent_s", [0.02, 0.3])
def test_an_enable_that_lapsed_counts_again_once_it_was_let_go_of(silent_s):
    with running() as loop:
        loop.advance(0.2, beat=True)
        loop.advance(silent_s)
        loop.advance(0.3, beat=True)
        lapsed = silent_s > ENABLE_AGE_S
        assert loop.host.status().enabled is not lapsed
        assert bool(loop.host.status().lapsed) is lapsed
        loop.host.beat(enable=False)
        loop.advance(0.3, beat=True)
        assert loop.host.status().enabled and not loop.host.status().lapsed
        told = [record.message for record in loop.host.records() if isinstance(record, LoopEvent)]
        assert any("enable ended" in message for message in told) is lapsed


def test_an_enable_that_comes_too_late_neither_counts_nor_lapses():
    with running() as loop:
        loop.host.beat(enable=True, age_s=1.0)
        loop.advance(0.1)
        assert not loop.host.status().enabled and not loop.host.status().lapsed


def test_a_velocity_ends_when_it_is_not_sent_again():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.post(JointVelocity(qd=np.array([0.1, 0.0])))
        loop.advance(2.0, beat=True)
        rest = loop.q
        loop.advance(0.5, beat=True)
        assert 0.01 < rest[0] < 0.05
        assert loop.q.tolist() == rest.tolist()


def test_a_stop_lasts_until_a_reset_and_a_new_enable():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.post(JointGoal(q=UP))
        loop.advance(0.2, beat=True)
        loop.host.stop("bert")
        loop.advance(2.0, beat=True)
        found = loop.host.status()
        assert (found.guard, found.robot) == ("stopped", RobotState.STOPPED)
        rest = loop.q
        loop.host.reset()
        loop.advance(0.5, beat=True)
        assert loop.host.status().guard == "disabled", "the enable was not let go of"
        loop.host.beat(enable=False)
        loop.host.beat(enable=True)
        loop.advance(0.5, beat=True)
        assert loop.host.status().guard == "running"
        assert loop.q == pytest.approx(rest, abs=1e-6), "what was asked before the stop is forgotten"
        loop.host.post(JointGoal(q=UP))
        loop.advance(2.0, beat=True)
        assert pytest.approx(UP, abs=1e-9) == loop.q


def test_stop_wins_over_what_is_asked_in_the_same_cycle():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.stop("bert")
        loop.host.post(JointGoal(q=UP))
        loop.advance(1.0, beat=True)
        assert loop.host.status().guard == "stopped"
        assert loop.q.tolist() == [0.0, 0.3]


def test_a_lost_robot_is_told():
    with running() as loop:
        loop.robot.fault(RobotFault.LINK_LOST)
        loop.advance(2 * CYCLE_S)
        found = loop.host.status()
        assert (found.guard, found.robot) == ("stopped", RobotState.LOST)


def test_records_hold_readings_commands_and_events():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.advance(0.2, beat=True)
        kinds = {type(record) for record in loop.host.records()}
        assert kinds == {JointReading, LoopCommand, LoopEvent}
        assert not loop.host.records()


def test_a_stop_is_not_lost_where_the_loop_takes_nothing():
    with running() as loop:
        loop.host.beat(enable=True)
        loop.host.post(JointGoal(q=UP))
        with pytest.raises(DeviceLost):
            for _ in range(5000):
                loop.host.beat(enable=True)
        loop.host.stop("bert")
        with pytest.raises(DeviceLost):
            loop.host.post(JointGoal(q=UP))
        loop.advance(CYCLE_S)
        loop.host.records()
        loop.advance(0.5)
        assert loop.host.status().guard == "stopped"


class DoesNotOpen(SimRobot):
    def __enter__(self):
        raise DeviceFailed("its controller does not answer")


def test_what_keeps_the_robot_from_opening_is_raised():
    with refuses(DeviceFailed, "answer"), running(DoesNotOpen):
        pass


class FailsLater(SimRobot):
    @property
    def state(self):
        if self._sent > 5:
            raise RuntimeError("a fault of the driver")
        return super().state


def test_an_ended_loop_is_lost_and_says_why():
    with running(FailsLater) as loop:
        loop.advance(0.5)
        messages = [record.message for record in loop.host.records() if isinstance(record, LoopEvent)]
        assert any("of the driver" in message for message in messages)
        for refused in (loop.host.status, loop.host.reset, lambda: loop.host.post(JointGoal(q=UP))):
            with pytest.raises(DeviceLost):
                refused()


def test_a_process_of_its_own_moves_the_robot_and_its_death_is_noticed():
    spec = RobotSpec(robot="sim:webcam-cell", arm=arm_model("sim:webcam-cell", None))
    with ProcessHost(spec) as host:
        begin, deadline_s = host.status().q_sent, time.monotonic() + 60.0
        assert host.description.n_joints == 6
        while np.array_equal(host.status().q_sent, begin):
            host.beat(enable=True)
            host.post(JointVelocity(qd=np.full(6, 0.05)))
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert host.lateness_counts().sum() > 0
        host._process.kill()
        host._process.join()
        with pytest.raises(DeviceLost):
            host.status()
        host.stop("anyone")
        host.release("anyone")


def test_other_robots_need_their_arm():
    with pytest.raises(UsageError, match="--arm"):
        arm_model("ws://127.0.0.1:1", None)
    assert arm_model("rtde:192.0.2.1", "ur10").n == 6


def test_a_queue_keeps_its_order_and_takes_no_more_than_it_holds():
    queue = Queue(slots=4, size=8)
    assert queue.get() is None
    for turn in range(10):
        assert all(queue.put(bytes([turn, k])) for k in range(4))
        assert not queue.put(b"one too many")
        assert [queue.get() for _ in range(5)] == [bytes([turn, k]) for k in range(4)] + [None]
    with refuses(UsageError, "fit"):
        queue.put(b"x" * 9)


def test_the_newest_replaces_what_was_there():
    newest = Newest(size=8)
    assert newest.read() is None
    for text in (b"a", b"", b"12345678", b"b"):
        newest.write(text)
        assert newest.read() == text
        assert newest.read() == text


def test_torn_messages_are_not_read():
    queue, newest = Queue(slots=4, size=8), Newest(size=8)
    queue.put(b"12345678")
    newest.write(b"12345678")
    for channel in (queue, newest):
        memory = memoryview(channel._slots._memory).cast("B")
        memory[16 + 16] ^= 1
    assert queue.get() is None
    assert newest.read() is None


def test_lateness_is_counted():
    channels = Channels()
    clock = ManualClock(1.0)
    counted = CountedClock(clock, channels.lateness)
    for late_s in (0.0, 1e-4, 1e-4, 2.0):
        clock.advance(0.1)
        counted.sleep_until(clock.now_s() - late_s)
    counts = np.frombuffer(channels.lateness, dtype=np.uint64)
    assert counts.sum() == 4
    assert lateness_s(counts, 0.5) == pytest.approx(1e-4, rel=0.03)
    assert lateness_s(counts, 1.0) >= 1.0
    assert lateness_s(np.zeros(640, dtype=np.uint64), 0.99) == 0.0


def test_an_enable_of_the_line_counts_only_while_its_key_is_granted():
    """An order that was under way while the key was taken back does not bring the enable back."""
    with running() as loop:
        for key, moves in (("old", False), ("", True), ("key", True)):  # the server's own way has no key
            loop.host.release("anew")
            loop.advance(3 * CYCLE_S)
            loop.host.grant(0, "key")
            for _ in range(4):
                loop.host.line.orders.put(pickle.dumps(("beat", (True, None), loop.clock.now_s(), 0, key)))
                loop.advance(CYCLE_S)
            assert loop.host.status().enabled is moves, key
            loop.host.line.orders.put(pickle.dumps(("beat", (False, None), loop.clock.now_s(), 0, "old")))
            loop.advance(2 * CYCLE_S)
            assert not loop.host.status().enabled, "letting go counts by whatever key"


@pytest.mark.parametrize("letter", ["x", "ä", "環"])
def test_an_error_fits_into_a_message_however_long_its_texts_are(letter):
    queue = Queue(4, 512)
    put_error(queue, DeviceLost(letter * 4000, consequence=letter * 4000, cure=letter * 4000))
    told = error_of(pickle.loads(queue.get()))
    assert type(told) is DeviceLost and told.cause.startswith(letter) and told.cure.startswith(letter)
    assert error_of(("described", {})) is None
