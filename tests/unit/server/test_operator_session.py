"""Who drives from a page: the enable that is held, what is stale, what is lost, and work that moves with it."""

import numpy as np
import pytest

from armsight.app.operator.job_runner import SessionRobot
from armsight.control.session.operator_session import FRESH_S, LOST_S, OperatorSession, Person, Push
from armsight.control.setpoints import Hold, JointGoal, JointVelocity
from armsight.drivers import RobotState
from armsight.errors import DeviceFailed, StaleData, UsageError
from refusals import refuses

ANN, BEN = Person(who="ann"), Person(who="ben")


@pytest.fixture
def session(service):
    return OperatorSession(service)


def told(host, kind):
    return [what[1] for what in host.told if what[0] == kind]


def held(session, host, browser="a", person=ANN):
    session.beat(browser, person, enable=True, seen_s=host.t_s)


def test_nobody_drives_before_the_enable_is_held(session, host):
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    assert session.browser == "" and host.told == []


def test_the_one_who_holds_the_enable_drives(session, host):
    held(session, host)
    assert told(host, "beat") == [True] and session.enabled("a") and not session.enabled("b")
    assert (session.status().driver, session.drives("a"), session.enabled("a")) == ("ann", True, True)
    assert not session.drives("b")


def test_a_second_operator_is_told_who_drives(session, host):
    held(session, host)
    with refuses(DeviceFailed, "ann drives"):
        held(session, host, "b", BEN)
    assert session.browser == "a"


def test_a_second_operator_drives_once_the_first_has_left(session, host):
    held(session, host)
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    session.leave("a")
    assert told(host, "stop") == [] and len(told(host, "release")) == 1
    held(session, host, "b", BEN)
    assert session.status().driver == "ben"


def test_an_enable_held_in_vain_does_not_count_once_the_other_has_left(session, host):
    held(session, host)
    with refuses(DeviceFailed, "ann drives"):
        held(session, host, "b", BEN)
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    session.leave("a")
    with refuses(DeviceFailed, "drove"):
        held(session, host, "b", BEN)
    assert session.browser == "" and not session.enabled("b")
    session.beat("b", BEN, enable=False, seen_s=host.t_s)
    held(session, host, "b", BEN)
    assert session.enabled("b")


def test_after_a_stop_is_released_the_enable_counts_once_it_is_pressed(session, host):
    held(session, host)
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    session.stop(BEN)
    session.reset("a", ANN)
    held(session, host)
    session.step("a", np.full(2, 1e-4))
    assert len(told(host, "post")) == 1


def test_an_enable_held_on_through_stop_and_reset_does_not_count_until_it_was_let_go_of(session, host):
    held(session, host)
    session.stop(BEN)
    held(session, host)
    session.reset("a", ANN)
    for _ in range(2):  # said for as long as it is held on
        with refuses(DeviceFailed, "held on"):
            held(session, host)
    assert not session.enabled("a")
    with pytest.raises(DeviceFailed):
        session.step("a", np.full(2, 1e-4))
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    held(session, host)
    assert session.enabled("a")


def test_who_may_watch_does_not_drive_and_may_stop(session, host):
    watcher = Person(who="eve", role="watch")
    with refuses(UsageError, "may watch"):
        session.beat("e", watcher, enable=True, seen_s=host.t_s)
    with refuses(UsageError, "may watch"):
        session.reset("e", watcher)
    session.stop(watcher)
    assert told(host, "stop") == ["stopped by eve"]


def test_an_enable_that_lapsed_in_the_loop_does_not_count_until_it_was_let_go_of(session, host):
    held(session, host)
    host.tick(5)
    host.lapsed = "the line for stops stood still"
    with refuses(DeviceFailed, "stood still", "anew"):
        held(session, host)
    host.lapsed = ""
    with refuses(DeviceFailed, "held on"):
        held(session, host)
    assert told(host, "beat") == [True, False, False] and not session.enabled("a")
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    held(session, host)
    assert session.enabled("a")


def test_an_enable_out_of_a_buffer_does_not_count_until_it_was_let_go_of(session, host):
    old_s = host.t_s
    held(session, host)
    host.t_s += FRESH_S + 0.1
    with pytest.raises(DeviceFailed, match="slow"):
        session.beat("a", ANN, enable=True, seen_s=old_s)
    with refuses(DeviceFailed, "held on"):
        held(session, host)  # fresh again, and still held down: not enough
    assert told(host, "beat") == [True, False, False] and not session.enabled("a")
    session.beat("a", ANN, enable=False, seen_s=host.t_s)
    held(session, host)
    assert session.enabled("a")


def test_a_browser_that_says_nothing_while_it_holds_the_enable_stops_the_robot(session, host):
    held(session, host)
    host.t_s += LOST_S + 0.1
    session.look()
    assert len(told(host, "stop")) == 1
    session.look()
    assert len(told(host, "stop")) == 1, "once"
    with refuses(DeviceFailed, "was lost"):
        held(session, host)  # it is there again, and its key still down
    session.reset("b", BEN)
    assert session.status().driver == "ben", "somebody else releases the stop, without waiting for who is lost"


def test_a_lost_connection_stops_where_the_enable_was_held(session, host):
    held(session, host)
    session.leave("a")
    assert len(told(host, "stop")) == 1 and len(told(host, "release")) == 1
    assert session.status().robot == "stopped"


def test_a_jog_key_moves_at_the_override_and_rests_once_it_is_let_go(session, host):
    session.override = 0.25
    key = Push(frame="joints", axis=1, sense=-1.0)
    session.beat("a", ANN, enable=True, seen_s=host.t_s, push=key)
    asked = told(host, "post")[-1]
    assert isinstance(asked, JointVelocity) and asked.qd[0] == 0.0
    quarter = asked.qd[1]
    session.override = 0.5
    session.beat("a", ANN, enable=True, seen_s=host.t_s, push=key)
    assert told(host, "post")[-1].qd[1] == pytest.approx(2.0 * quarter) and quarter < 0.0
    held(session, host)
    assert isinstance(told(host, "post")[-1], Hold)


@pytest.mark.parametrize("key", [Push(frame="joints", axis=2, sense=1.0), Push(frame="base", axis=0, sense=1.0)])
def test_a_key_of_no_axis_moves_nothing(session, host, key):
    with pytest.raises(UsageError):
        session.beat("a", ANN, enable=True, seen_s=host.t_s, push=key)
    assert told(host, "post") == []


@pytest.mark.parametrize(("asked", "kept"), [(2.0, 1.0), (0.0, 0.01), (float("nan"), 0.01), (0.3, 0.3)])
def test_the_override_stays_a_share(session, asked, kept):
    session.override = asked
    assert session.override == kept


class HostClock:
    """The host's time, which passes where somebody sleeps."""

    def __init__(self, host) -> None:
        self._host = host

    def now_s(self) -> float:
        return self._host.t_s

    def sleep_until(self, t_s: float) -> None:
        self._host.t_s = t_s


def robot_of(session, host, *, waits, cancelled=lambda: False, browser="a"):
    return SessionRobot(session, lambda: browser, HostClock(host), waits=waits, cancelled=cancelled)


def test_work_moves_only_while_its_browser_holds_the_enable(session, host):
    with robot_of(session, host, waits=False) as robot:
        still = robot.step_joints(np.array([0.05, 0.0]))
        assert still.limited and told(host, "post") == []
        held(session, host, "b", BEN)
        assert robot.step_joints(np.array([0.05, 0.0])).limited, "another one's enable moves no work of ours"
        session.leave("b")
    held_host = [what for what in told(host, "post") if isinstance(what, JointGoal)]
    assert held_host == []


def test_work_moves_with_the_enable(session, host):
    held(session, host)
    with robot_of(session, host, waits=False) as robot:
        sent = robot.step_joints(np.array([0.05, 0.0]))
        assert sent.q == pytest.approx([0.05, 0.0]) and sent.limited == ()
        assert robot.state is RobotState.READY and robot.read().q == pytest.approx([0.05, 0.0])
    assert isinstance(told(host, "post")[-1], Hold), "closing it holds the robot"


def test_a_reading_of_before_is_none(session, host, monkeypatch):
    with robot_of(session, host, waits=False) as robot:
        robot.read()
        now = session.status()
        monkeypatch.setattr(session, "status", lambda: now)
        host.t_s += 0.5  # the robot fell silent
        with refuses(StaleData, "fresh"):
            robot.read()


@pytest.mark.parametrize("waits", [False, True])
def test_work_waits_where_the_enable_falls_silent_between_a_look_and_the_step(session, host, monkeypatch, waits):
    """It is no failure of the work: it holds, and goes on with the next beat."""
    held(session, host)
    enabled, looks = session.enabled, iter([True])

    def look(browser):
        if next(looks, False):
            host.t_s += 0.3  # this is how long the thread then slept
            return True
        if waits and not enabled(browser):
            held(session, host)
        return enabled(browser)

    with robot_of(session, host, waits=waits) as robot:
        monkeypatch.setattr(session, "enabled", look)
        sent = robot.step_joints(np.array([0.05, 0.0]))
        assert bool(sent.limited) is not waits
        held(session, host)
        assert robot.step_joints(np.array([0.05, 0.0])).limited == ()


def test_work_goes_on_where_it_was_told_to_go_after_the_loop_held_on_the_way(session, host):
    """A late cycle makes the loop forget its goal: the first joint rests short of it, and nobody let the enable go."""
    held(session, host)
    with robot_of(session, host, waits=True) as robot:
        robot.step_joints(np.array([0.05, 0.0]))
        host.q, host.dropped = np.array([0.03, 0.0]), 1
        host.tick()
        sent = robot.step_joints(np.array([0.0, 0.02]))
        assert sent.q == pytest.approx([0.05, 0.02])
        host.q, host.dropped = np.array([0.05, 0.01]), 2
        host.tick()
        assert robot.read().q == pytest.approx([0.05, 0.02]), "also while it is only looked at"


def test_work_does_not_go_back_after_the_robot_was_led_away_by_keys(session, host):
    held(session, host)
    with robot_of(session, host, waits=True) as robot:
        robot.step_joints(np.array([0.05, 0.0]))
        session.beat("a", ANN, enable=True, seen_s=host.t_s, push=Push(frame="joints", axis=0, sense=1.0))
        host.q, host.dropped = np.array([0.06, 0.0]), 1
        held(session, host)
        assert robot.step_joints(np.array([0.0, 0.02])).q == pytest.approx([0.06, 0.02])


def test_work_that_waits_gives_up_where_it_is_cancelled(session, host):
    looks = iter([False, False, True])
    with robot_of(session, host, waits=True, cancelled=lambda: next(looks)) as robot:
        assert robot.step_joints(np.array([0.05, 0.0])).limited
    assert told(host, "post") == []


def test_work_that_waits_ends_where_the_robot_is_stopped(session, host):
    session.stop(ANN)
    with robot_of(session, host, waits=True) as robot, pytest.raises(DeviceFailed, match="stopped"):
        robot.step_joints(np.array([0.05, 0.0]))


def test_work_does_not_release_a_stop(session, host):
    with robot_of(session, host, waits=True) as robot, refuses(DeviceFailed, "Reset"):
        robot.reset()
