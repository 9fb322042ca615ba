"""The simulated arm, its servos and its motions against closed forms and against the product's own kinematics."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import pose
from armsight.store.arm_file import arm_from_mapping
from armsight_sim.arms import Drive, FlangeLimits, Servo, SimArm, covering
from armsight_sim.scenario_builder import robotics
from armsight_sim.scenario_schema import Scenario

NAMES = ("korayem2018-circle", "kapucu2005-rrp", "webcam-cell", "pachidis2005-static")


def arm_of(name: str) -> SimArm:
    text = (files("armsight_sim") / "scenarios" / f"{name}.yaml").read_text()
    return robotics(Scenario.model_validate(yaml.safe_load(text)), 3).true


@pytest.mark.parametrize("name", NAMES)
def test_two_kinematics_written_apart_agree(name: str) -> None:
    """The simulator's products of matrices and the product's kernels put the tool in the same place."""
    arm = arm_of(name)
    tool = RigidTransform.from_components([0.01, -0.02, 0.03], Rotation.from_rotvec([0.1, 0.2, -0.3]))
    product = arm_from_mapping({"format": "armsight/arm", "version": 1, **arm.mapping(tool)})
    rng = np.random.default_rng(1)
    for q in rng.uniform(-3.0, 3.0, (20, arm.n)):
        ours = arm.T_world_base * arm.flange(q) * tool
        theirs = pose(product, q)
        assert np.abs(ours.as_matrix() - np.asarray(theirs.as_matrix())).max() < 1e-12
    many = rng.uniform(-3.0, 3.0, (5, arm.n))
    assert np.abs(arm.flanges(many) - np.array([arm.frames(q)[-1] for q in many])).max() < 1e-15


@pytest.mark.parametrize("name", NAMES)
def test_the_jacobian_is_the_derivative(name: str) -> None:
    arm = arm_of(name)
    q, h = np.random.default_rng(2).uniform(0.2, 1.0, arm.n), 1e-6
    J = arm.jacobian(arm.frames(q))
    for i in range(arm.n):
        step = h * np.eye(arm.n)[i]
        ahead, behind = arm.frames(q + step)[-1], arm.frames(q - step)[-1]
        assert np.abs(J[:3, i] - (ahead - behind)[:3, 3] / (2 * h)).max() < 1e-8
        turn = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec() / (2 * h)
        assert np.abs(J[3:, i] - turn).max() < 1e-8


def test_a_flange_is_cut_to_its_speed_and_turning_rate() -> None:
    here = np.eye(4)
    goal = np.eye(4)
    goal[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix()
    goal[0, 3] = 0.5
    end, limited = FlangeLimits(speed_m_s=0.1, speed_rad_s=10.0).cut(here, goal, 1.0)
    assert end[0, 3] == pytest.approx(0.1)
    assert Rotation.from_matrix(end[:3, :3]).as_rotvec()[2] == pytest.approx(0.2)
    assert len(limited) == 1
    assert "speed" in limited[0]
    same, none = FlangeLimits(speed_m_s=1.0, speed_rad_s=2.0).cut(here, goal, 1.0)
    assert (same == goal).all()
    assert none == ()


@pytest.mark.parametrize(
    ("eye", "light", "hides"),
    [
        ((2.0, 0.0, 0.5), (-2.0, 0.0, 0.5), True),
        ((2.0, 0.11, 0.5), (-2.0, 0.11, 0.5), False),
        ((2.0, 0.0, 1.09), (-2.0, 0.0, 1.09), True),
        ((2.0, 0.0, 1.11), (-2.0, 0.0, 1.11), False),
        ((2.0, 0.0, 0.5), (1.0, 0.0, 0.5), False),
        ((2.0, 0.0, 0.5), (0.05, 0.0, 0.5), False),
    ],
    ids=["through the middle", "past the side", "through the round end", "over the end", "before it", "carried by it"],
)
def test_a_link_is_a_capsule_before_the_light(eye: tuple, light: tuple, hides: bool) -> None:
    frames = np.array([np.eye(4), np.eye(4)])
    frames[1, 2, 3] = 1.0
    assert covering(frames, [0.1], np.array(eye), np.array(light)) == (0 if hides else None)


def drive(lag_s: float = 0.1, speed: float = 100.0, step: float = 0.0) -> Drive:
    return Drive(cycle_s=0.02, lag_s=lag_s, max_speed=np.array([speed]), encoder_step=np.array([step]))


def test_a_servo_lags_exponentially() -> None:
    servo = Servo(drive(), [0.0])
    servo.command(0.0, np.array([1.0]))
    servo.advance(1.0)
    t_s = np.arange(0.0, 1.0, 0.004)
    assert np.abs(servo.at(t_s)[:, 0] - (1.0 - np.exp(-t_s / 0.1))).max() < 1e-12


def test_a_servo_keeps_its_speed_limit_and_holds_commands_for_their_time() -> None:
    servo = Servo(drive(lag_s=0.0, speed=0.5), [0.0])
    servo.command(0.1, np.array([1.0]))
    servo.advance(3.0)
    assert servo.at(0.1)[0, 0] == 0.0
    assert servo.at(1.1)[0, 0] == pytest.approx(0.5, abs=1e-9)
    assert servo.at(2.9)[0, 0] == 1.0
