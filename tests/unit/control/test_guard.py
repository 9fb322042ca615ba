"""The guard by itself: limits, states, set points of every kind, and what it refuses."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control import Hold, JointGoal, JointVelocity, SetPoint, ToolPose, ToolTwist
from armsight.control.guard import (
    Box,
    Decision,
    Guard,
    GuardState,
    Inputs,
    JointLimit,
    Limits,
    TargetState,
    joint_bounds,
)
from armsight.drivers import RobotState
from armsight.kinematics import Coupling, preset
from armsight.records import JointReading

CYCLE_S = 0.008
ARM = preset("ur10")
HOME = np.radians([10.0, -60.0, 90.0, -30.0, 80.0, 20.0])


class Bench:
    """A guard and a robot that goes exactly where it is sent."""

    def __init__(self, limits: Limits | None = None, arm=ARM, q=HOME) -> None:
        self.guard = Guard(arm, limits or Limits(), CYCLE_S)
        self.guard.begin(q, 0.0)
        self.k = 0
        self.q = [np.array(q)]
        self.decisions: list[Decision] = []

    def cycle(self, wanted: SetPoint, **inputs: object) -> Decision:
        self.k += 1
        told = {"now_s": self.k * CYCLE_S, "enabled": True, **inputs}
        reading = JointReading(q=self.q[-1], t_s=self.k * CYCLE_S, sequence=self.k, source="robot")
        decision = self.guard.step(wanted, reading, Inputs(**told))
        if decision.step is not None:
            self.q.append(self.q[-1] + decision.step)
            self.guard.acknowledge(self.q[-1])
        self.decisions.append(decision)
        return decision

    def run(self, wanted: SetPoint, n: int, **inputs: object) -> Decision:
        for _ in range(n):
            decision = self.cycle(wanted, **inputs)
        return decision

    def tool(self) -> np.ndarray:
        return ARM.fk(np.array(self.q))


def test_a_joint_goal_is_reached_within_all_limits() -> None:
    bench = Bench()
    bench.run(JointGoal(q=HOME + 0.05), 300)
    assert np.abs(bench.q[-1] - HOME - 0.05).max() < 1e-9
    q = np.array(bench.q)
    p = bench.tool()[:, :3, 3]
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() / CYCLE_S <= 0.1
    assert np.linalg.norm(np.diff(p, 2, axis=0), axis=1).max() / CYCLE_S**2 <= 2.0
    assert np.linalg.norm(np.diff(p, 3, axis=0), axis=1).max() / CYCLE_S**3 <= 100.0
    assert np.abs(np.diff(q, 2, axis=0)).max() / CYCLE_S**2 <= 5.0
    assert np.abs(np.diff(q, 3, axis=0)).max() / CYCLE_S**3 <= 250.0


def test_a_twist_moves_the_tool_along_it() -> None:
    bench = Bench()
    bench.run(ToolTwist(velocity_m_s=[0.0, 0.03, 0.0], angular_rad_s=[0.0, 0.0, 0.1]), 250)
    T = bench.tool()
    assert (T[-1, :3, 3] - T[-2, :3, 3]) / CYCLE_S == pytest.approx([0.0, 0.03, 0.0], abs=1e-4)
    turned = RigidTransform.from_matrix(T[-1]) * RigidTransform.from_matrix(T[-2]).inv()
    assert turned.rotation.as_rotvec() / CYCLE_S == pytest.approx([0.0, 0.0, 0.1], abs=1e-3)


def test_a_timed_path_within_the_limits_is_followed_exactly() -> None:
    bench = Bench()
    start = RigidTransform.from_matrix(ARM.fk(HOME))
    poses = [RigidTransform.from_translation([0.0, 0.02 * (1.0 - math.cos(0.01 * k)), 0.0]) * start for k in range(300)]
    for pose in poses[1:]:
        bench.cycle(ToolPose(T_base_tool=pose))
    wanted = np.array([pose.translation for pose in poses])
    assert np.abs(bench.tool()[:, :3, 3] - wanted).max() < 1e-6
    assert not any(decision.limited for decision in bench.decisions)


def test_a_path_that_is_too_fast_is_a_stop() -> None:
    bench = Bench()
    start = RigidTransform.from_matrix(ARM.fk(HOME))
    for k in range(200):
        bench.cycle(ToolPose(T_base_tool=RigidTransform.from_translation([0.0, 0.2 * CYCLE_S * k, 0.0]) * start))
    assert bench.decisions[-1].state is GuardState.STOPPED
    assert "faster" in bench.decisions[-1].why


def test_a_reason_to_hold_is_a_state_and_an_event() -> None:
    bench = Bench()
    bench.run(JointVelocity(qd=np.full(6, 0.05)), 20)
    decision = bench.cycle(Hold(why="no spot in the left view"))
    assert decision.state is GuardState.HOLDING
    assert [event.message for event in decision.events] == ["holding: no spot in the left view"]


def test_a_source_is_told_whether_it_was_refused_for_its_own_sake() -> None:
    bench = Bench()
    bench.run(JointGoal(q=HOME), 2, enabled=False)
    state = bench.guard.cycle_state(0.0, None)
    assert not state.running and not state.refused
    bench.run(JointGoal(q=HOME + 9.0), 2)
    state = bench.guard.cycle_state(0.0, None)
    assert not state.running and state.refused
    bench.run(JointGoal(q=HOME), 1, enabled=False)
    assert not bench.guard.cycle_state(0.0, None).refused


@pytest.mark.parametrize("state", [RobotState.LOST, RobotState.STOPPED, RobotState.CLOSED])
def test_nothing_is_sent_to_a_robot_that_takes_nothing(state: RobotState) -> None:
    bench = Bench()
    bench.run(JointVelocity(qd=np.full(6, 0.05)), 20)
    decision = bench.cycle(JointVelocity(qd=np.full(6, 0.05)), robot=state)
    assert decision.state is GuardState.STOPPED
    assert decision.step is None
    assert decision.stop_robot


def test_a_stop_lasts_until_the_reset_and_needs_a_new_enable() -> None:
    bench = Bench()
    motion = JointVelocity(qd=np.full(6, 0.05))
    bench.run(motion, 20)
    assert bench.cycle(motion, stop="enough").state is GuardState.STOPPED
    assert sum(bench.cycle(motion).stop_robot for _ in range(100)) == 1
    assert bench.decisions[-1].state is GuardState.STOPPED
    assert bench.decisions[-1].step is None
    bench.guard.reset(bench.q[-1], bench.k * CYCLE_S)
    assert bench.run(motion, 5).state is GuardState.DISABLED
    bench.cycle(motion, enabled=False)
    assert bench.cycle(motion).state is GuardState.RUNNING


def test_a_command_that_the_robot_cut_is_a_stop() -> None:
    bench = Bench()
    bench.run(JointVelocity(qd=np.full(6, 0.05)), 20)
    bench.guard.acknowledge(bench.q[-1] - 0.01, ("range of j1",))
    decision = bench.cycle(Hold())
    assert decision.state is GuardState.STOPPED
    assert "range of j1" in decision.why


def test_it_retreats_slowly_when_the_target_is_away_for_long() -> None:
    bench = Bench(Limits(retreat=HOME + 0.02, retreat_after_s=0.1, retreat_speed=0.25))
    states = [bench.cycle(Hold(), target=TargetState.LOST).state for _ in range(450)]
    assert states[0] is GuardState.HOLDING
    assert states[-1] is GuardState.RETREATING
    assert np.abs(bench.q[-1] - HOME - 0.02).max() < 1e-6
    p = bench.tool()[:, :3, 3]
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() / CYCLE_S <= 0.025
    assert bench.cycle(Hold(), target=TargetState.FRESH, target_age_s=0.01).state is GuardState.RUNNING


def test_from_beyond_a_limit_it_may_only_come_back() -> None:
    at = ARM.fk(HOME)[:3, 3]
    pillar = Box(lower_m=at - 0.3, upper_m=at + np.array([0.3, 0.02, 0.3]), name="pillar")
    bench = Bench(Limits(forbidden=(pillar,)))
    decision = bench.run(ToolTwist(velocity_m_s=[0.0, -0.05, 0.0], angular_rad_s=np.zeros(3)), 5)
    assert decision.state is GuardState.HOLDING
    assert "pillar" in decision.why
    assert np.array_equal(bench.q[-1], HOME)
    out = ToolTwist(velocity_m_s=[0.0, 0.05, 0.0], angular_rad_s=np.zeros(3))
    assert bench.run(out, 100).state is GuardState.RUNNING
    assert bench.tool()[-1, 1, 3] > at[1] + 0.025
    assert bench.run(JointGoal(q=HOME), 20).state is GuardState.HOLDING  # and not in again


def test_outside_it_does_not_move_along_the_limit() -> None:
    bench = Bench(Limits(joints=(JointLimit(lower=HOME[0] + 0.2), *(JointLimit(),) * 5)))
    decision = bench.run(JointVelocity(qd=0.1 * LAST), 5)
    assert decision.state is GuardState.HOLDING and "joint 1 (lower) by 0.2" in decision.why
    assert np.array_equal(bench.q[-1], HOME)


def test_goals_beyond_a_joints_range_are_not_begun() -> None:
    bench = Bench(Limits(joints=tuple(JointLimit(lower=q - 0.2, upper=q + 0.2) for q in HOME)))
    decision = bench.run(JointGoal(q=HOME + 0.3), 10)
    assert decision.state is GuardState.HOLDING
    assert np.array_equal(bench.q[-1], HOME)


@pytest.mark.parametrize("seed", range(8))
def test_a_pose_beside_a_singularity_is_followed_or_a_hold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bench = Bench(q=[0.3, -1.0, 10.0 ** rng.uniform(-7, -1), -0.5, 10.0 ** rng.uniform(-8, -1), 0.0])
    off = RigidTransform.from_components(rng.normal(0.0, 0.003, 3), Rotation.from_rotvec(rng.normal(0.0, 0.02, 3)))
    T_base_tool = RigidTransform.from_matrix(ARM.fk(bench.q[0]))
    decision = bench.cycle(ToolPose(T_base_tool=T_base_tool * off))
    assert decision.state in (GuardState.HOLDING, GuardState.RUNNING)
    assert np.abs(bench.q[-1] - bench.q[0]).max() < 1e-3


def test_a_coupled_arm_is_guarded_in_its_own_values() -> None:
    coupled = dataclasses.replace(ARM, couplings=(Coupling(joint=ARM.joints[2].name, by=ARM.joints[1].name),))
    readings = coupled.readings(HOME)
    bench = Bench(arm=coupled, q=readings)
    bench.run(ToolTwist(velocity_m_s=[0.0, 0.0, 0.03], angular_rad_s=np.zeros(3)), 150)
    p = coupled.fk(coupled.values(np.array(bench.q)))[:, :3, 3]
    assert (p[-1] - p[-2]) / CYCLE_S == pytest.approx([0.0, 0.0, 0.03], abs=1e-4)


def test_limits_narrow_the_arms_own_and_never_widen_them() -> None:
    wide = joint_bounds(ARM, Limits(joints=tuple(JointLimit(lower=-9.0, upper=9.0, speed=9.0) for _ in HOME)))
    assert (wide.lower >= ARM.lower).all() and (wide.upper <= ARM.upper).all()
    assert wide.speed.tolist() == [joint.max_speed for joint in ARM.joints]


LAST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""The joint that turns the tool about itself: its motion is the tool's turning."""


@pytest.mark.parametrize(
    ("limits", "order", "most"),
    [
        (Limits(turn_rad_s=0.2), 1, 0.2),
        (Limits(turn_acceleration_rad_s2=1.0), 2, 1.0),
        (Limits(turn_jerk_rad_s3=20.0), 3, 20.0),
        (Limits(joints=(*(JointLimit(),) * 5, JointLimit(speed=0.2))), 1, 0.2),
        (Limits(joints=(*(JointLimit(),) * 5, JointLimit(acceleration=1.0))), 2, 1.0),
        (Limits(joints=(*(JointLimit(),) * 5, JointLimit(jerk=20.0))), 3, 20.0),
    ],
)
def test_turning_keeps_each_limit_and_uses_it(limits: Limits, order: int, most: float) -> None:
    bench = Bench(limits)
    bench.run(JointVelocity(qd=0.9 * LAST), 120)
    found = np.abs(np.diff(np.array(bench.q)[:, 5], order)).max() / CYCLE_S**order
    assert 0.5 * most < found <= most * (1.0 + 1e-9)


@pytest.mark.parametrize("margin_m", [0.0, 0.02])
@pytest.mark.parametrize("inside", [True, False], ids=["workspace", "forbidden box"])
def test_the_tool_stops_its_margin_before_a_wall(margin_m: float, inside: bool) -> None:
    at = ARM.fk(HOME)[:3, 3]
    wall = at + np.array([2.0, 0.05, 2.0])
    if inside:
        limits = Limits(workspace=Box(lower_m=at - 2.0, upper_m=wall), margin_m=margin_m)
    else:
        box = Box(lower_m=at + np.array([-2.0, 0.05, -2.0]), upper_m=at + 2.0)
        limits = Limits(forbidden=(box,), margin_m=margin_m)
    bench = Bench(limits)
    last = bench.run(ToolTwist(velocity_m_s=[0.0, 0.05, 0.0], angular_rad_s=np.zeros(3)), 300)
    y = bench.tool()[:, 1, 3] - at[1]
    assert 0.05 - margin_m - 2e-3 < y.max() <= 0.05 - margin_m + 1e-9
    assert last.state is GuardState.HOLDING


def test_the_flange_keeps_the_walls_as_the_tool_does() -> None:
    arm = dataclasses.replace(ARM, T_flange_tool=RigidTransform.from_translation([0.0, 0.3, 0.0]))
    T = RigidTransform.from_matrix(arm.fk(HOME))
    flange = (T * arm.T_flange_tool.inv()).translation
    way = np.sign(flange - T.translation) * np.eye(3)[np.argmax(np.abs(flange - T.translation))]
    face = float(way @ flange) + 0.03  # which the flange meets before the tool
    lower, upper = np.minimum(flange, T.translation) - 1.0, np.maximum(flange, T.translation) + 1.0
    axis = int(np.argmax(np.abs(way)))
    (upper if way[axis] > 0 else lower)[axis] = face * way[axis]
    bench = Bench(Limits(workspace=Box(lower_m=lower, upper_m=upper)), arm=arm)
    last = bench.run(ToolTwist(velocity_m_s=0.05 * way, angular_rad_s=np.zeros(3)), 300)
    poses = [RigidTransform.from_matrix(arm.fk(q)) * arm.T_flange_tool.inv() for q in bench.q]
    assert max(float(way @ pose.translation) for pose in poses) <= face - 0.005 + 1e-9
    assert "flange" in last.why


def test_motion_in_space_keeps_its_distance_to_singularities() -> None:
    bench = Bench(Limits(singularity=0.1))
    outwards = ARM.fk(HOME)[:3, 3] * [1.0, 1.0, 0.0]
    velocity = 0.09 * outwards / np.linalg.norm(outwards)
    last = bench.run(ToolTwist(velocity_m_s=velocity, angular_rad_s=np.zeros(3)), 1500)
    J = np.array([ARM.jacobian(q) for q in bench.q])
    J[:, :3] /= ARM.length_m
    assert np.linalg.svd(J, compute_uv=False)[:, -1].min() >= 0.1 - 1e-9
    assert last.state is GuardState.HOLDING and "singularity" in last.why


@pytest.mark.parametrize(
    ("inputs", "state", "word"),
    [
        ({"enabled": False}, GuardState.DISABLED, "enable"),
        ({"target": TargetState.LOST}, GuardState.HOLDING, "lost"),
        ({"target": TargetState.JUMPED}, GuardState.HOLDING, "jumped"),
        ({"target": TargetState.FRESH, "target_age_s": 0.2}, GuardState.HOLDING, "stale"),
        ({"late_s": 0.6 * CYCLE_S}, GuardState.HOLDING, "late"),
        ({"now_s": 20 * CYCLE_S + 0.1}, GuardState.STOPPED, "stood still"),
        ({"stop": "enough"}, GuardState.STOPPED, "enough"),
        ({"robot": RobotState.LOST}, GuardState.STOPPED, "lost"),
    ],
)
def test_each_fault_leads_to_its_state_and_the_arm_comes_to_rest(inputs: dict, state: GuardState, word: str) -> None:
    bench = Bench()
    motion = JointVelocity(qd=np.full(6, 0.05))
    assert bench.run(motion, 20).state is GuardState.RUNNING
    decision = bench.cycle(motion, **inputs)
    assert decision.state is state and word in decision.why
    assert bench.run(motion, 60, **inputs).at_rest


def test_motion_goes_on_after_five_cycles_in_time() -> None:
    bench = Bench()
    motion = JointVelocity(qd=np.full(6, 0.05))
    bench.cycle(motion, late_s=0.6 * CYCLE_S)
    states = [bench.cycle(motion).state for _ in range(5)]
    assert states == [GuardState.HOLDING] * 4 + [GuardState.RUNNING]


def test_readings_that_stay_away_hold_and_then_stop() -> None:
    guard = Guard(ARM, Limits(), CYCLE_S)
    guard.begin(HOME, 0.0)
    states = [guard.step(Hold(), None, Inputs(now_s=k * CYCLE_S, enabled=True)).state for k in range(1, 70)]
    assert [states[k] for k in (2, 3, 61, 62)] == [
        GuardState.RUNNING,
        GuardState.HOLDING,
        GuardState.HOLDING,
        GuardState.STOPPED,
    ]


def test_a_robot_that_is_elsewhere_than_sent_is_stopped() -> None:
    bench = Bench()
    bench.q[-1] = HOME + 0.03
    decision = bench.cycle(Hold())
    assert decision.state is GuardState.STOPPED and "was sent" in decision.why


@pytest.mark.parametrize(
    "wanted",
    [
        JointGoal(q=HOME[:5]),
        JointVelocity(qd=np.zeros(7)),
        ToolPose(T_base_tool=RigidTransform.from_translation([math.nan, 0.0, 0.0])),
    ],
)
def test_a_set_point_of_another_arm_or_without_numbers_is_a_stop(wanted: SetPoint) -> None:
    assert Bench().cycle(wanted).state is GuardState.STOPPED
