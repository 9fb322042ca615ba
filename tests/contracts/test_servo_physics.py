"""Servos that MuJoCo moves: the arm they carry, how far they hang, and the driver and guard of an arm that hangs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.contracts.servo_pairs import ServoPair

from armsight.control.guard import Guard, GuardState, Inputs, Limits
from armsight.control.setpoints import JointVelocity
from armsight.drivers import RobotState
from armsight.kinematics import Arm, Joint
from armsight_sim.arms import SimArm, SimJoint
from armsight_sim.twins.base import small_arm
from armsight_sim.twins.servo_twins import bus_drive

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

KG, LEVER_M, GAIN, DRY = 0.4, 0.25, 17.8, 0.052


@pytest.fixture
def pair() -> Iterator[ServoPair]:
    one = ServoPair("feetech", weighed=True)
    with one.robot:
        yield one
    one.close()


def lever() -> SimArm:
    """One horizontal axis with a weight at the end of a lever."""
    joint = SimJoint(name="lift", alpha_rad=0.0, a_m=LEVER_M, mass_kg=KG, max_speed=3.0, lower=-3.0, upper=3.0)
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # its axis along -y of the base: up is +q
    return SimArm(joints=(joint,), T_base_frame0=turned)


def test_its_bodies_stand_where_the_arms_frames_are() -> None:
    from armsight_sim.twins.servo_physics import mjcf

    arm, rng = replace(small_arm(), T_base_frame0=lever().T_base_frame0), np.random.default_rng(1)
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    data = mujoco.MjData(model)
    for q in rng.uniform(-2.0, 2.0, (5, arm.n)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        frames = arm.frames(q)
        np.testing.assert_allclose(data.xpos[1:], frames[:-1, :3, 3], atol=1e-9)
        np.testing.assert_allclose(data.xmat[1:].reshape(-1, 3, 3)[:, :, 2], frames[:-1, :3, 2], atol=1e-9)


@pytest.mark.parametrize("q", [0.0, 0.7, -1.2])
def test_a_held_lever_hangs_by_its_weight_over_the_gain_within_what_friction_holds_and_a_limp_one_falls(
    q: float,
) -> None:
    from armsight_sim.twins.servo_physics import WeighedServo

    servo = WeighedServo(lever(), bus_drive(lever()), [q], 0.0, keep=4000)
    servo.command(0.0, np.array([q]))
    servo.advance(5.0)
    rests = float(servo.at(5.0)[0, 0])
    weight = KG * 9.81 * LEVER_M * math.cos(rests)
    assert GAIN * (q - rests) == pytest.approx(weight, abs=DRY + 0.02)
    servo.hold([False])
    servo.advance(8.0)
    assert servo.at(8.0)[0, 0] < rests - 0.2


def test_the_guard_follows_an_arm_that_hangs_and_still_stops_one_that_does_not_follow(pair: ServoPair) -> None:
    robot, bounded = pair.robot, Arm(name="small", joints=tuple(Joint(name=f"j{i + 1}") for i in range(6)))
    pair.enable()
    goal = np.array([joint.q(state.goal) for joint, state in zip(robot.joints, robot._believed.states, strict=True)])
    hangs = np.abs(robot.read().q - goal)
    assert 0.02 < hangs.max() < robot.hangs_rad  # more than the guard allows an arm that does not hang
    states = []
    for guard in (Guard(bounded, Limits(), robot.cycle_s), Guard.of(robot, bounded, Limits())):
        guard.begin(goal, 0.0)
        for k in range(40):
            t_s = k * robot.cycle_s
            reading = replace(robot.read(), t_s=t_s, sequence=k)
            on = Inputs(now_s=t_s, enabled=k > 2, robot=RobotState.READY)
            guard.step(JointVelocity(qd=np.zeros(6)), reading, on)
        states.append(guard.state)
        lost = replace(reading, q=goal + robot.hangs_rad + 0.03, sequence=99)
        guard.step(JointVelocity(qd=np.zeros(6)), lost, replace(on, now_s=t_s + robot.cycle_s))
        assert guard.state is GuardState.STOPPED
    assert states == [GuardState.STOPPED, GuardState.RUNNING]


def test_torque_that_is_taken_away_lets_the_arm_fall_and_stops_the_driver(pair: ServoPair) -> None:
    pair.enable()
    before = pair.twin.q
    for servo in pair.twin.servos:
        pair.twin.restart(servo)
    pair.advance(1.0)
    assert np.abs(pair.twin.q - before).max() > 0.1
    assert pair.robot.state is not RobotState.READY
    assert "torque" in pair.robot.why
