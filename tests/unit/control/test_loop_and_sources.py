"""The control loop on a clock that is told the time, and the sources that it asks."""

from __future__ import annotations

import gc
import pickle
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import armsight.control.loop as loop_module
from armsight.clock import ManualClock
from armsight.control import CycleState, Hold, JointGoal, JointVelocity, SetPoint
from armsight.control.guard import Guard, GuardState, Limits
from armsight.control.loop import ControlLoop
from armsight.control.session.loop_side import Channels, OrderSource
from armsight.control.setpoints import ClientSource, Enable, GoalSource, JogSource
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.goals import JointLimits
from armsight.drivers.pace import LinkTimes
from armsight.errors import UsageError
from armsight.kinematics import Arm, Joint
from armsight.ops.robot.opening import guard_for, open_robot
from armsight.ops.robot.recorder import LoopRecorder
from armsight.store.recording import Recording
from armsight.testing.wrong_controllers import prove
from refusals import names_it


@pytest.fixture
def cell():
    clock = ManualClock()
    with open_robot("sim:webcam-cell", clock) as robot:
        clock.advance(0.04)
        yield robot, clock


def state(t_s: float = 0.0, T: RigidTransform | None = None, q=(0.0, 0.0)) -> CycleState:
    return CycleState(
        t_s=t_s,
        cycle_s=0.01,
        q=np.array(q),
        q_sent=np.array(q),
        qd_sent=np.zeros(len(q)),
        T_base_tool=RigidTransform.identity() if T is None else T,
    )


class Turning:
    name = "turning"

    def next(self, now: CycleState) -> SetPoint:
        assert not gc.isenabled()
        return JointVelocity(qd=np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]))


def test_a_goal_is_reached_and_the_loop_ends_at_rest(cell) -> None:
    robot, clock = cell
    goal = robot.read().q + 0.02
    loop = ControlLoop(robot, guard_for(robot), GoalSource(goal), clock, enabled=lambda: True)
    timing = loop.run(until=lambda now: now.finished, for_s=20.0)
    assert np.abs(loop.status.q_sent - goal).max() < 1e-6
    assert timing.missed == timing.late == 0
    assert timing.n_cycles == loop.status.cycle
    assert gc.isenabled()


def test_a_stop_is_taken_in_the_next_cycle_and_lasts_until_the_reset(cell) -> None:
    robot, clock = cell
    states = []

    def until(now) -> bool:
        states.append(now.guard)
        if len(states) == 20:
            loop.stop("enough")
        if len(states) == 120:
            loop.reset()
        return len(states) == 130

    loop = ControlLoop(robot, guard_for(robot), Turning(), clock, enabled=lambda: True)
    loop.run(until=until)
    assert states[19] is GuardState.RUNNING
    assert set(states[20:120]) == {GuardState.STOPPED}
    assert states[-1] is GuardState.DISABLED  # the enable was never let go of


class Failing(Turning):
    """Moves the arm, then meets something that it does not know."""

    name = "failing"

    def __init__(self) -> None:
        self.asked = 0

    def next(self, now: CycleState) -> SetPoint:
        self.asked += 1
        if self.asked == 20:
            raise ZeroDivisionError("division by zero")
        return super().next(now)


def test_a_source_that_fails_is_a_hold_and_the_loop_goes_on(cell) -> None:
    robot, clock = cell
    seen = []
    loop = ControlLoop(robot, guard_for(robot), Failing(), clock, enabled=lambda: True)
    loop.run(until=lambda now: bool(seen.append(now)) or len(seen) == 60)
    assert seen[19].guard is GuardState.HOLDING
    assert names_it(seen[19].why, "failing", "division by zero")
    assert seen[-1].guard is GuardState.RUNNING


@pytest.mark.parametrize(
    ("why", "reason"),
    [
        ("at a limit: the upper limit of joint 1, joint 6 too fast", None),
        ("the target is lost, last seen 0.734 s ago", "the target is lost"),
        ("no new reading from the robot for 340 ms", "no new reading from the robot"),
        ("no set point from the client for more than 100 ms", "no set point from the client"),
        ("the target jumped by 31 mm, or turned, and stays so: let the enable go", None),
    ],
)
def test_a_reason_is_the_same_in_each_cycle_and_names_all_limits(cell, why: str, reason: str | None) -> None:
    robot, clock = cell
    loop = ControlLoop(robot, guard_for(robot), Turning(), clock, enabled=lambda: True)
    loop.run(for_s=0.1)
    assert replace(loop.status, why=why).reason == (why if reason is None else reason)


def test_sources_are_exchanged_under_way(cell) -> None:
    robot, clock = cell
    seen = []
    loop = ControlLoop(robot, guard_for(robot), Turning(), clock, enabled=lambda: True)

    def until(now) -> bool:
        seen.append(now.source)
        if len(seen) == 10:
            loop.exchange(GoalSource(now.q_sent))
        return len(seen) == 100

    loop.run(until=until)
    assert seen == ["turning"] * 10 + ["goal"] * 90


def test_a_robot_of_poses_is_moved_by_poses(cell) -> None:
    robot, clock = cell
    goal = robot.read().q + 0.01
    loop = ControlLoop(robot, guard_for(robot), GoalSource(goal), clock, enabled=lambda: True, by_pose=True)
    loop.run(until=lambda now: now.finished, for_s=10.0)
    clock.advance(0.5)
    assert np.abs(robot.read().q - goal).max() < 1e-3


def test_what_it_does_is_in_the_recording(cell, tmp_path: Path) -> None:
    robot, clock = cell
    with LoopRecorder(tmp_path / "run.mcap", clock) as recorder:
        loop = ControlLoop(
            robot, guard_for(robot), Turning(), clock, enabled=lambda: clock.now_s() < 0.3, sink=recorder.sink
        )
        loop.run(for_s=0.6)
    with Recording(tmp_path / "run.mcap") as recording:
        events = [event.message for event in recording.events()]
        assert len(list(recording.commands())) == loop.status.cycle
    assert events[0] == "running"
    assert events[1].startswith("disabled: no enable")


def test_an_enable_lasts_only_while_it_is_kept() -> None:
    clock = ManualClock()
    enable = Enable(clock, timeout_s=0.2)
    assert not enable.alive()
    enable.keep()
    clock.advance(0.15)
    assert enable.alive()
    clock.advance(0.1)
    assert not enable.alive()
    enable.keep()
    enable.release()
    assert not enable.alive()


def test_jog_axes_count_only_while_they_are_fresh() -> None:
    jog = JogSource(2, joint_speed=0.2, timeout_s=0.25)
    assert isinstance(jog.next(state(0.0)), Hold)
    jog.push([0.5, -2.0], 1.0)
    wanted = jog.next(state(1.2))
    assert isinstance(wanted, JointVelocity)
    assert wanted.qd == pytest.approx([0.1, -0.2])
    assert isinstance(jog.next(state(1.3)), Hold)
    jog.push([0.02, float("nan")], 2.0)
    assert isinstance(jog.next(state(2.0)), Hold)
    with pytest.raises(UsageError, match="3 axes"):
        jog.push([0.0, 0.0, 0.0], 2.0)


def test_a_silent_client_is_a_hold() -> None:
    client = ClientSource(longest_s=0.2)
    assert isinstance(client.next(state(0.0)), Hold)
    wanted = JointGoal(q=np.zeros(2))
    client.post(wanted, 1.0)
    assert client.next(state(1.1)) is wanted
    late = client.next(state(1.3))
    assert isinstance(late, Hold) and "200 ms" in late.why
    client.clear()
    assert client.next(state(1.3)) == Hold()


def test_the_loop_may_be_stopped_from_another_thread(cell) -> None:
    robot, clock = cell
    loop = ControlLoop(robot, guard_for(robot), Turning(), clock, enabled=lambda: True)
    begun = threading.Event()

    def until(now) -> bool:
        begun.set()
        return now.guard is GuardState.STOPPED

    thread = threading.Thread(target=loop.run, kwargs={"until": until})
    thread.start()
    begun.wait()
    loop.stop()
    thread.join()
    assert loop.status.guard is GuardState.STOPPED and loop.status.at_rest


class Cyclic(CyclicRobot):
    """A controller without a wire: the test says when it asks, and whether it took what it was sent."""

    def __init__(self, clock: ManualClock) -> None:
        limits = JointLimits(lower=np.full(2, -1.0), upper=np.full(2, 1.0), max_speed=np.full(2, 2.0))
        times = LinkTimes(cycle_s=0.01, stale_s=9.0, silent_s=9.0)
        super().__init__("cyclic", limits=limits, times=times, clock=clock)
        self.goals: list[float] = []

    def _start(self) -> None:
        self.asks()

    def _finish(self) -> None: ...

    def asks(self, *, taken: bool = True, cycles: int = 1) -> None:
        self._heard(self._goals.sent, self._clock.now_s())
        self._hear_clock(self._clock.now_s(), 0)
        self._tick(cycles, taken=taken)
        self.goals.append(float(self._goals.sent[0]))


ARM = Arm(name="two", joints=(Joint(name="a"), Joint(name="b")))


class Steady:
    name = "steady"

    def next(self, now: CycleState) -> SetPoint:
        return JointVelocity(qd=np.array([0.1, 0.0]))


@pytest.fixture
def paced(monkeypatch: pytest.MonkeyPatch):
    """A loop whose robot sets the pace, and a way to do one of its cycles; nothing is waited for."""
    monkeypatch.setattr(loop_module, "PATIENCE", 0.0)
    clock = ManualClock(10.0)
    robot = Cyclic(clock)

    def ask(**how) -> None:
        clock.advance(0.01)
        robot.asks(**how)

    with robot:
        prove(robot, lambda time_s: ask())
        loop = ControlLoop(robot, Guard(ARM, Limits(), 0.01), Steady(), clock, enabled=lambda: True)
        loop._begin()

        def cycle() -> bool:
            waiting, _, due_s = loop._due(clock.now_s())
            loop._cycle(clock.now_s(), clock.now_s() - due_s, waiting=waiting)
            return waiting

        yield robot, loop, ask, cycle


def test_each_cycle_of_the_controller_takes_one_step_however_often_the_loop_runs(paced) -> None:
    robot, _, ask, cycle = paced
    for _ in range(60):
        ask()
        assert [cycle() for _ in range(3)] == [False, True, True]
    assert np.diff(robot.goals).max() == pytest.approx(0.001)


def test_a_controller_that_takes_no_more_steps_is_stopped_and_left_all_the_same(paced) -> None:
    _, loop, ask, cycle = paced
    channels = Channels()
    source = OrderSource(channels, loop._clock, None, 0.15)
    source.attach(loop)
    loop.exchange(source)
    loop._enabled = source.enabled
    ask()
    cycle()
    channels.orders.put(pickle.dumps(("stop", "by hand")))
    assert cycle() and loop.status.guard is GuardState.STOPPED, "no step is taken any more"
    channels.orders.put(pickle.dumps(("end", None)))
    assert cycle() and loop._ending


def test_a_step_that_was_not_taken_goes_out_again_and_none_is_added(paced) -> None:
    robot, loop, ask, cycle = paced
    for _ in range(60):
        ask()
        cycle()
    before = robot.goals[-1]
    for _ in range(2):
        ask(taken=False)
        assert cycle()
    assert robot.goals[-1] == before
    ask()
    cycle()
    assert robot.goals[-1] - before == pytest.approx(0.001)
    assert loop.status.guard is GuardState.RUNNING


def test_a_command_that_came_late_waits_for_a_cycle_of_its_own(paced) -> None:
    robot, _, ask, cycle = paced
    for _ in range(60):
        ask()
        cycle()
    step, sent = robot.step_joints, []

    def late(values):
        if not sent:
            ask()  # the controller asks while the loop still computes
        sent.append(values)
        return step(values)

    robot.step_joints = late
    ask()
    assert not cycle()
    assert cycle()
    assert len(sent) == 1


def test_after_a_pause_the_arm_sets_out_from_rest(paced) -> None:
    robot, loop, ask, cycle = paced
    for _ in range(60):
        ask()
        cycle()
    for _ in range(5):
        ask(taken=False)
        cycle()
    ask()
    cycle()
    ask()
    assert 0.0 <= robot.goals[-1] - robot.goals[-2] < 0.0005
    assert not loop.status.at_rest


def test_nobody_goes_faster_than_the_guard_allows_beside_the_loop(paced) -> None:
    robot, *_ = paced
    fastest = Guard(ARM, Limits(), 0.01).bounds.speed[0]
    sent = robot.step_joints(np.array([1.0, 0.0]))
    assert sent.q[0] - robot.goals[-1] == pytest.approx(0.01 * fastest)
    assert sent.limited
