"""No limit excuses another: whatever is asked of an arm, wherever it stands, no violation grows and none is new."""

from __future__ import annotations

import numpy as np
import pytest
from tests.truth.guard_histories import Found, depths, history

from armsight.control import JointVelocity, ToolTwist
from armsight.control.guard import Box, Guard, GuardState, Inputs, JointLimit, Limits
from armsight.control.guard.space import Breach
from armsight.kinematics import preset
from armsight.records import JointReading

HISTORIES = 16
ARM = preset("ur10")
HOME = np.radians([10.0, -60.0, 90.0, -30.0, 80.0, 20.0])
FREE = JointLimit(lower=-6.0, upper=6.0)


def run(guard: Guard, wanted, cycles: int) -> list:
    decisions = []
    for k in range(1, cycles + 1):
        reading = JointReading(q=guard.q_sent, t_s=0.008 * k, sequence=k, source="robot")
        decisions.append(guard.step(wanted, reading, Inputs(now_s=0.008 * k, enabled=True)))
        guard.acknowledge(decisions[-1].q)
    return decisions


def test_no_violation_grows_and_none_is_new() -> None:
    found = Found()
    for seed in range(HISTORIES):
        history(seed, found)
    assert found.outside > HISTORIES / 3
    assert found.moved > 0.2 * found.cycles
    assert not found.grown, found.worst


def test_one_violation_that_excuses_others_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: ends of joints, and walls, are compared by the worst of their kind, as one number each."""
    told = Breach.worse_than

    def merged(self: Breach, allowed):
        place = self.limits.of_position
        return told(self, np.where(place, max(0.0, float(allowed[place].max())), allowed))

    monkeypatch.setattr(Breach, "worse_than", merged)
    monkeypatch.setattr(Breach, "lessens", lambda *_: True)
    found = Found()
    for seed in range(HISTORIES):
        history(seed, found)
        if found.grown:
            return
    pytest.fail("nothing grew")


def beyond_joint_1() -> Guard:
    """An arm 0.3 rad above joint 1's range, 0.1 below the upper end of joint 6."""
    joints = (JointLimit(lower=-6.0, upper=HOME[0] - 0.3), *[FREE] * 4, JointLimit(lower=-6.0, upper=HOME[5] + 0.1))
    guard = Guard(ARM, Limits(joints=joints), 0.008)
    guard.begin(HOME, 0.0)
    return guard


def test_beyond_one_joints_range_another_joint_does_not_move() -> None:
    guard = beyond_joint_1()
    first, *_, last = run(guard, JointVelocity(qd=[0, 0, 0, 0, 0, 0.4]), 200)
    assert last.q == pytest.approx(HOME)
    assert last.state is GuardState.HOLDING
    assert "joint 1 (upper) by 0.3" in last.why
    assert any("joint 1 (upper)" in event.message for event in first.events)


def test_on_the_way_back_another_joint_keeps_its_own_limit() -> None:
    guard = beyond_joint_1()
    run(guard, JointVelocity(qd=[-0.2, 0, 0, 0, 0, 0.4]), 400)
    assert guard.q_sent[0] < HOME[0] - 0.02, "until joint 6 is at its end"
    assert guard.q_sent[5] <= HOME[5] + 0.1 + 1e-9


def test_above_the_workspace_no_wall_is_passed() -> None:
    p = ARM.fk(HOME)[:3, 3]
    space = Box(lower_m=p - 2.0, upper_m=p + np.array([0.03, 2.0, -0.2]), name="cell")
    limits = Limits(joints=(FREE,) * 6, workspace=space)
    guard = Guard(ARM, limits, 0.008)
    guard.begin(HOME, 0.0)
    before = depths(ARM, limits, HOME)
    run(guard, ToolTwist(velocity_m_s=[0.08, 0.0, 0.0], angular_rad_s=np.zeros(3)), 400)
    assert guard.q_sent == pytest.approx(HOME), "along the wall is no way back"
    run(guard, ToolTwist(velocity_m_s=[0.06, 0.0, -0.04], angular_rad_s=np.zeros(3)), 400)
    after = depths(ARM, limits, guard.q_sent)
    assert after["wall tool 2 upper"] < before["wall tool 2 upper"] - 0.01
    assert all(after[name] <= before[name] + 1e-9 for name in after)


@pytest.mark.parametrize("rule", ["lessens", "worse_than"])
def test_each_rule_is_needed(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Breach, rule, {"lessens": lambda *_: True, "worse_than": lambda *_: ()}[rule])
    guard = beyond_joint_1()
    run(guard, JointVelocity(qd=[-0.2 * (rule == "worse_than"), 0, 0, 0, 0, 0.4]), 400)
    assert guard.q_sent[5] > HOME[5] + (0.1 if rule == "worse_than" else 0.05)
