"""Who drives, what is done of what they ask, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.app.robot.control_authority import SILENT_S
from armsight.control.setpoints import Hold, JointGoal, JointVelocity
from armsight.drivers import RobotState
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceFailed, DeviceLost, Inconsistent, UsageError

NUMBERS = iter(range(1, 10**9))


def make(kind, **fields):
    return kind(session="", seq=next(NUMBERS), **fields)


@pytest.fixture
def desk(service):
    return service.authority


@pytest.fixture
def lease(desk):
    lease = desk.take("anna")
    desk.perform(lease, make(say.Heartbeat, enable=True))
    return lease


def posts(host):
    return [what[1] for what in host.told if what[0] == "post"]


def test_one_drives_at_a_time(desk, host):
    anna = desk.take("anna")
    host.tick(50)
    desk.perform(anna, make(say.Heartbeat, enable=False))
    with pytest.raises(DeviceFailed, match="anna drives fake since 5 s"):
        desk.take("bert")
    desk.leave(anna, "done")
    assert desk.take("bert").who == "bert"
    assert ("release", "done") in host.told


def test_a_silent_driver_is_replaced_and_then_refused(desk, host):
    anna = desk.take("anna")
    host.t_s += SILENT_S
    bert = desk.take("bert")
    assert host.told[-1][0] == "release"
    with pytest.raises(DeviceFailed, match="anna no longer drives"):
        desk.perform(anna, make(say.Heartbeat, enable=True))
    desk.leave(anna, "late")
    assert desk.driver is bert, "who was replaced takes nothing from who drives now"


def test_without_a_live_enable_nothing_moves(desk, host):
    lease = desk.take("anna")
    goal = make(say.JointGoalMessage, q=[0.1, 0.2])
    with pytest.raises(DeviceFailed, match="enable is off"):
        desk.perform(lease, goal)
    desk.perform(lease, make(say.Heartbeat, enable=False))
    with pytest.raises(DeviceFailed, match="enable is off"):
        desk.perform(lease, goal)
    desk.perform(lease, make(say.Heartbeat, enable=True))
    host.t_s += 1.1 * host.enable_age_s
    for message in (goal, make(say.JointStepMessage, step=[0.1, 0.1]), make(say.JointVelocityMessage, qd=[0.1, 0.1])):
        with pytest.raises(DeviceFailed, match="newest enable"):
            desk.perform(lease, message)
    assert not posts(host)


def test_a_new_driver_begins_without_the_enable_of_the_last(desk, host, lease):
    desk.leave(lease, "done")
    bert = desk.take("bert")
    with pytest.raises(DeviceFailed, match="not enabled"):
        desk.perform(bert, make(say.JointGoalMessage, q=[0.1, 0.2]))


def test_goals_and_velocities_reach_the_loop(desk, host, lease):
    answer = desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))
    assert answer.q == [0.1, 0.2]
    desk.perform(lease, make(say.JointVelocityMessage, qd=[0.1, 0.0]))
    desk.perform(lease, make(say.HoldMessage))
    goal, velocity, hold = posts(host)
    assert isinstance(goal, JointGoal)
    assert isinstance(velocity, JointVelocity)
    assert isinstance(hold, Hold)


@pytest.mark.parametrize(
    ("kind", "fields", "error"),
    [
        (say.JointGoalMessage, {"q": [0.0, 2.1]}, Inconsistent),
        (say.JointGoalMessage, {"q": [0.0]}, UsageError),
        (say.JointStepMessage, {"step": [0.0] * 3}, UsageError),
        (say.ToolTwistMessage, {"velocity_m_s": [0.1, 0.0, 0.0], "angular_rad_s": [0.0] * 3}, UsageError),
        (say.FlangePoseMessage, {"T_base_flange": say.PoseMessage(xyz_m=[0] * 3, quat_xyzw=[0, 0, 0, 1])}, UsageError),
        (say.ReadMessage, {}, UsageError),
    ],
)
def test_what_the_robot_cannot_do_is_refused(desk, host, lease, kind, fields, error):
    with pytest.raises(error):
        desk.perform(lease, make(kind, **fields))
    assert not posts(host)


def test_steps_are_cut_to_a_cycle_all_joints_alike(desk, lease):
    answer = desk.perform(lease, make(say.JointStepMessage, step=[0.4, -0.2]))
    assert answer.q == pytest.approx([0.1, -0.05])  # 1 rad/s for 0.1 s
    assert answer.limited == ["speed of j1", "speed of j2"]


def test_steps_of_one_cycle_lead_no_further_than_a_cycle_allows(desk, host, lease):
    led = [desk.perform(lease, make(say.JointStepMessage, step=[0.04, 0.0])) for _ in range(4)]
    assert [answer.q[0] for answer in led] == pytest.approx([0.04, 0.08, 0.1, 0.1])
    assert [bool(answer.limited) for answer in led] == [False, False, True, True]
    host.tick()
    assert desk.perform(lease, make(say.JointStepMessage, step=[0.05, 0.0])).q == pytest.approx([0.15, 0.0])


def test_steps_lead_the_robot_by_so_much_only(desk, host, lease):
    for _ in range(20):
        host.tick()
        desk.perform(lease, make(say.Heartbeat, enable=True))
        with_lead = host.q.copy()
        answer = desk.perform(lease, make(say.JointStepMessage, step=[0.1, 0.0]))
        host.q = np.array([0.0, 0.0])  # it does not come along
    assert with_lead[0] == 0.0
    assert answer.q[0] == pytest.approx(0.2)
    assert "lead of j1" in answer.limited


def test_steps_stay_within_the_range(desk, host, lease):
    host.q = np.array([1.99, 0.0])
    answer = desk.perform(lease, make(say.JointStepMessage, step=[0.05, 0.0]))
    assert answer.q == [2.0, 0.0]
    assert answer.limited == ["range of j1"]


def test_steps_begin_where_the_robot_is_once_the_loop_forgot_the_last(desk, host, lease):
    desk.perform(lease, make(say.JointStepMessage, step=[0.05, 0.0]))
    host.q = np.array([0.02, 0.0])  # held on the way
    host.dropped += 1
    host.tick()
    assert desk.perform(lease, make(say.JointStepMessage, step=[0.01, 0.0])).q == pytest.approx([0.03, 0.0])


def test_a_stop_of_anyone_lasts_until_a_reset(desk, host, lease):
    desk.stop("bert")
    assert host.told[-1] == ("stop", "stopped by bert")
    assert desk.state().robot == "stopped", "told before the loop has told so"
    host.guard = "stopped"
    host.tick()
    with pytest.raises(DeviceFailed, match="stopped"):
        desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))
    desk.perform(lease, make(say.ResetMessage))
    assert desk.state().robot == "ready"
    host.guard = "running"
    host.tick(3)
    desk.perform(lease, make(say.Heartbeat, enable=True))
    with pytest.raises(DeviceFailed, match="let go of"):
        desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))
    desk.perform(lease, make(say.Heartbeat, enable=False))
    desk.perform(lease, make(say.Heartbeat, enable=True))
    desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))


def test_a_stop_of_the_guard_itself_is_told(desk, host, lease):
    host.guard = "stopped"
    assert desk.state().robot == "stopped"
    with pytest.raises(DeviceFailed, match="stopped"):
        desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))


def test_a_reset_does_not_hide_a_later_stop(desk, host, lease):
    desk.perform(lease, make(say.ResetMessage))
    host.guard = "stopped"
    host.tick(2)
    assert desk.state().robot == "stopped"


def test_a_lost_link_is_told_and_refused(desk, host, lease):
    host.robot = RobotState.LOST
    assert desk.state().robot == "lost"
    with pytest.raises(DeviceFailed, match="lost"):
        desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))


def test_an_ended_loop_is_told_and_may_be_stopped(desk, host, lease):
    host.ended = True
    with pytest.raises(DeviceLost):
        desk.state()
    with pytest.raises(DeviceLost):
        desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))
    desk.stop("bert")
    desk.leave(lease, "gone")


def test_every_command_is_logged(desk, log, lease):
    desk.perform(lease, make(say.JointGoalMessage, q=[0.1, 0.2]))
    with pytest.raises(Inconsistent):
        desk.perform(lease, make(say.JointGoalMessage, q=[9.0, 0.2]))
    desk.stop("bert")
    assert [(who, kind, values["q"]) for who, kind, values in log.commands] == [
        ("anna", "joint_goal", [0.1, 0.2]),
        ("anna", "joint_goal", [9.0, 0.2]),
    ]
    assert ("warning", "stopped by bert") in log.events


def test_a_flood_of_warnings_is_counted_not_kept(service, host, log):
    for _ in range(1000):
        service.event(host.now_s(), "warning", "a message was refused")
    host.t_s += 10.0
    service.event(host.now_s(), "info", "anna drives")
    assert len(log.events) < 110
    assert log.events[-2:] == [("warning", "900 more warnings were left out"), ("info", "anna drives")]
