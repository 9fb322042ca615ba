"""Who drives, what is done of what they ask, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.control.session.authority import SILENT_S, EnableLost
from armsight.control.setpoints import FlangePose, Heartbeat, JointGoal, JointStep, JointVelocity, Reset, ToolTwist
from armsight.drivers import RobotState
from armsight.errors import DeviceFailed, DeviceLost, Inconsistent, UsageError
from refusals import refuses


@pytest.fixture
def authority(service):
    return service.authority


@pytest.fixture
def lease(authority):
    lease = authority.take("anna")
    authority.perform(lease, Heartbeat(enable=True))
    return lease


def posts(host):
    return [what[1] for what in host.told if what[0] == "post"]


def test_one_drives_at_a_time(authority, host):
    anna = authority.take("anna")
    host.tick(50)
    authority.perform(anna, Heartbeat(enable=False))
    with refuses(DeviceFailed, "anna", "fake", "5 s"):
        authority.take("bert")
    authority.leave(anna, "done")
    assert authority.take("bert").who == "bert"
    assert ("release", "done") in host.told


def test_who_has_driven_for_long_and_still_does_is_not_replaced(authority, host):
    anna = authority.take("anna")
    for _ in range(3):
        host.t_s += 0.9 * SILENT_S
        authority.perform(anna, Heartbeat(enable=False))
    host.t_s += 0.9 * SILENT_S
    with refuses(DeviceFailed, "anna"):
        authority.take("bert")


def test_a_silent_driver_is_replaced_and_then_refused(authority, host):
    anna = authority.take("anna")
    host.t_s += SILENT_S
    bert = authority.take("bert")
    assert host.told[-1][0] == "release"
    with refuses(DeviceFailed, "anna", "no longer"):
        authority.perform(anna, Heartbeat(enable=True))
    authority.leave(anna, "late")
    assert authority.driver is bert, "who was replaced takes nothing from who drives now"


def test_without_a_live_enable_nothing_moves(authority, host):
    lease = authority.take("anna")
    goal = JointGoal(q=[0.1, 0.2])
    with refuses(EnableLost, "off"):
        authority.perform(lease, goal)
    authority.perform(lease, Heartbeat(enable=False))
    with refuses(EnableLost, "off"):
        authority.perform(lease, goal)
    authority.perform(lease, Heartbeat(enable=True))
    host.t_s += 1.1 * host.enable_age_s
    for message in (goal, JointStep(step=[0.1, 0.1]), JointVelocity(qd=[0.1, 0.1])):
        with refuses(EnableLost, "newest"):
            authority.perform(lease, message)
    assert not posts(host)


def test_an_enable_that_lapsed_in_the_loop_is_to_be_given_anew(authority, host, lease):
    host.tick(5)
    host.lapsed = "the web server stood still"
    authority.perform(lease, Heartbeat(enable=True))
    with refuses(EnableLost, "stood still", "anew"):
        authority.perform(lease, JointGoal(q=np.array([0.1, 0.1])))
    authority.perform(lease, Heartbeat(enable=False))
    authority.perform(lease, Heartbeat(enable=True))
    authority.perform(lease, JointGoal(q=np.array([0.1, 0.1])))  # the loop has not told yet that it was let go of
    host.tick(5)
    authority.perform(lease, Heartbeat(enable=True))
    with refuses(EnableLost, "stood still"):
        authority.perform(lease, JointGoal(q=np.array([0.1, 0.1])))


def test_a_new_driver_begins_without_the_enable_of_the_last(authority, host, lease):
    authority.leave(lease, "done")
    bert = authority.take("bert")
    with refuses(EnableLost, "off"):
        authority.perform(bert, JointGoal(q=[0.1, 0.2]))


@pytest.mark.parametrize(
    ("command", "error"),
    [
        (JointGoal(q=[0.0, 2.1]), Inconsistent),
        (JointGoal(q=[0.0]), UsageError),
        (JointStep(step=[0.0] * 3), UsageError),
        (ToolTwist(velocity_m_s=[0.1, 0.0, 0.0], angular_rad_s=[0.0] * 3), UsageError),
        (FlangePose(T_base_flange=RigidTransform.identity()), UsageError),
    ],
)
def test_what_the_robot_cannot_do_is_refused(authority, host, lease, command, error):
    with pytest.raises(error):
        authority.perform(lease, command)
    assert not posts(host)


def test_steps_are_cut_to_a_cycle_all_joints_alike(authority, lease):
    answer = authority.perform(lease, JointStep(step=[0.4, -0.2]))
    assert answer.q == pytest.approx([0.1, -0.05])  # 1 rad/s for 0.1 s
    assert answer.limited == ("speed of j1", "speed of j2")


def test_steps_of_one_cycle_lead_no_further_than_a_cycle_allows(authority, host, lease):
    led = [authority.perform(lease, JointStep(step=[0.04, 0.0])) for _ in range(4)]
    assert [answer.q[0] for answer in led] == pytest.approx([0.04, 0.08, 0.1, 0.1])
    assert [bool(answer.limited) for answer in led] == [False, False, True, True]
    host.tick()
    assert authority.perform(lease, JointStep(step=[0.05, 0.0])).q == pytest.approx([0.15, 0.0])


def test_steps_lead_the_robot_by_so_much_only(authority, host, lease):
    for _ in range(20):
        host.tick()
        authority.perform(lease, Heartbeat(enable=True))
        with_lead = host.q.copy()
        answer = authority.perform(lease, JointStep(step=[0.1, 0.0]))
        host.q = np.array([0.0, 0.0])  # it does not come along
    assert with_lead[0] == 0.0
    assert answer.q[0] == pytest.approx(0.2)
    assert "lead of j1" in answer.limited


def test_steps_begin_where_the_robot_is_once_the_loop_forgot_the_last(authority, host, lease):
    authority.perform(lease, JointStep(step=[0.05, 0.0]))
    host.q = np.array([0.02, 0.0])  # held on the way
    host.dropped += 1
    host.tick()
    assert authority.perform(lease, JointStep(step=[0.01, 0.0])).q == pytest.approx([0.03, 0.0])


def test_a_stop_of_anyone_lasts_until_a_reset(authority, host, lease):
    authority.stop("bert")
    assert host.told[-1] == ("stop", "stopped by bert")
    assert authority.status().robot == "stopped", "told before the loop has told so"
    host.guard = "stopped"
    host.tick()
    with pytest.raises(DeviceFailed, match="stopped"):
        authority.perform(lease, JointGoal(q=[0.1, 0.2]))
    authority.perform(lease, Reset())
    assert authority.status().robot == "ready"
    host.guard = "running"
    host.tick(3)
    authority.perform(lease, Heartbeat(enable=True))
    with refuses(EnableLost, "let go"):
        authority.perform(lease, JointGoal(q=[0.1, 0.2]))
    authority.perform(lease, Heartbeat(enable=False))
    authority.perform(lease, Heartbeat(enable=True))
    authority.perform(lease, JointGoal(q=[0.1, 0.2]))


def test_a_stop_of_the_guard_itself_is_told(authority, host, lease):
    host.guard = "stopped"
    assert authority.status().robot == "stopped"
    with pytest.raises(DeviceFailed, match="stopped"):
        authority.perform(lease, JointGoal(q=[0.1, 0.2]))


def test_a_reset_does_not_hide_a_later_stop(authority, host, lease):
    authority.perform(lease, Reset())
    host.guard = "stopped"
    host.tick(2)
    assert authority.status().robot == "stopped"


def test_a_lost_link_is_told_and_refused(authority, host, lease):
    host.robot = RobotState.LOST
    assert authority.status().robot == "lost"
    with pytest.raises(DeviceFailed, match="lost"):
        authority.perform(lease, JointGoal(q=[0.1, 0.2]))


def test_an_ended_loop_is_told_and_may_be_stopped(authority, host, lease):
    host.ended = True
    with pytest.raises(DeviceLost):
        authority.status()
    with pytest.raises(DeviceLost):
        authority.perform(lease, JointGoal(q=[0.1, 0.2]))
    authority.stop("bert")
    authority.leave(lease, "gone")


def test_every_command_is_logged(authority, log, lease):
    authority.perform(lease, JointGoal(q=[0.1, 0.2]))
    with pytest.raises(Inconsistent):
        authority.perform(lease, JointGoal(q=[9.0, 0.2]))
    authority.stop("bert")
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
