"""The same kinematics by other programs: Pinocchio reads our URDF, EAIK our Denavit-Hartenberg table.

Both are development tools only (`pip install armsight[dev]`); without them these tests are skipped and say so.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from armsight.errors import Inconsistent
from armsight.kinematics import Arm, JointType, fk, fk_jacobian, ik_many, parameter_names, preset
from armsight.kinematics.dynamics import inverse_dynamics, track_load
from armsight.kinematics.forward_kinematics import moved
from armsight.kinematics.presets import PRESETS
from armsight.records import Motion
from armsight.store.urdf import arm_from_urdf, urdf_text
from refusals import refuses

CLOSED = ("korayem6r", "puma761", "ur10", "ur5e", "irb120")


@pytest.fixture(scope="module")
def pin() -> ModuleType:
    return pytest.importorskip("pinocchio", reason="Pinocchio (pin) is not installed")


def configuration(model: Any, q: np.ndarray) -> np.ndarray:
    """Pinocchio keeps a joint without limits as its cosine and sine."""
    values: list[float] = []
    for joint, value in zip(list(model.joints)[1:], q, strict=True):
        values += [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
    return np.array(values)


def arms() -> list[Arm]:
    rng = np.random.default_rng(0)
    nominal = [preset(name) for name in sorted(PRESETS)]
    real = [moved(arm, {key: rng.normal() * 1e-2 for key in parameter_names(arm)}) for arm in nominal]
    return nominal + real


@pytest.mark.parametrize("index", range(2 * len(PRESETS)))
def test_poses_and_jacobians_are_pinocchios(pin: ModuleType, index: int) -> None:
    """All presets, as they are and with every parameter off by about 1 cm or 10 mrad; 1e-12 in m and rad."""
    arm = arms()[index]
    model = pin.buildModelFromXML(urdf_text(arm))
    data, tool = model.createData(), model.getFrameId("tool")
    rng = np.random.default_rng(index)
    for q in rng.uniform(np.maximum(arm.lower, -3), np.minimum(arm.upper, 3), (12, arm.n)):
        full = configuration(model, q)
        pin.framesForwardKinematics(model, data, full)
        T, J = fk_jacobian(arm, q)
        np.testing.assert_allclose(T, data.oMf[tool].homogeneous, atol=1e-12)
        theirs = pin.computeFrameJacobian(model, data, full, tool, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(J, theirs, atol=1e-12)
        local = pin.computeFrameJacobian(model, data, full, tool, pin.LOCAL)
        np.testing.assert_allclose(fk_jacobian(arm, q, axes="tool")[1], local, atol=1e-12)


@pytest.mark.parametrize("name", CLOSED)
def test_solution_sets_are_eaiks(name: str) -> None:
    eaik = pytest.importorskip("eaik.IK_DH", reason="EAIK is not installed")
    arm = preset(name)
    alpha, a, d = (np.array([getattr(j, key) for j in arm.joints]) for key in ("alpha_rad", "a_m", "d_m"))
    theirs = eaik.DhRobot(alpha, a, d)
    offset = np.array([joint.theta_rad for joint in arm.joints])
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (300, 6))
    T = fk(arm, q)
    Q, _, count = ik_many(arm, T)
    compared = 0
    for k in range(len(q)):
        answer = theirs.IK(T[k])
        theta = np.array([row for row, approximate in zip(answer.Q, answer.is_LS, strict=True) if not approximate])
        if not len(theta):
            continue
        ours = Q[k, : count[k]] + offset
        gaps = np.abs((ours[:, None] - theta[None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
        assert len(ours) == len(theta), f"row {k}: {len(ours)} of ours, {len(theta)} of theirs"
        assert gaps.min(axis=1).max() < 1e-6
        assert gaps.min(axis=0).max() < 1e-6
        compared += 1
    assert compared >= 295


URDF_WITH_MASSES = """
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="40"/></joint>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="10"/></joint>
</robot>
"""


def test_torques_of_a_two_link_arm_against_the_textbook(pin: ModuleType) -> None:
    """Point masses: static torque at level is g (m1 0.2 + m2 0.7) and g m2 0.3; motors as straight lines."""
    arm = arm_from_urdf(URDF_WITH_MASSES)
    assert [joint.type for joint in arm.joints] == [JointType.REVOLUTE] * 2
    g = 9.81
    still = np.zeros((1, 2))
    effort = inverse_dynamics(arm, URDF_WITH_MASSES, still, still, still)
    np.testing.assert_allclose(np.abs(effort), [[g * (2 * 0.2 + 0.7), g * 0.3]], rtol=1e-12)
    t = np.linspace(0, 1, 501)
    q = np.column_stack([0.3 * np.sin(2 * t), 0.2 * np.cos(3 * t)])
    load = track_load(arm, Motion(t_s=t, q=q), URDF_WITH_MASSES)
    np.testing.assert_allclose(load.speed[5:-5, 0], 0.6 * np.cos(2 * t[5:-5]), atol=1e-4)
    np.testing.assert_allclose(load.speed_share[:, 0], np.abs(load.speed[:, 0]) / 2.0)
    share = np.abs(load.effort[:, 1]) / (10.0 * (1 - np.abs(load.speed[:, 1]) / 2.0))
    np.testing.assert_allclose(load.effort_share[:, 1], share)
    assert load.drivable
    fast = track_load(arm, Motion(t_s=t / 8, q=q), URDF_WITH_MASSES)
    assert not fast.drivable
    assert np.isinf(fast.effort_share).any()


def test_dynamics_refuses_another_arm_and_an_arm_without_masses(pin: ModuleType) -> None:
    arm = arm_from_urdf(URDF_WITH_MASSES)
    still = np.zeros((1, 6))
    with refuses(Inconsistent, "j1, j2", "j1, j2, j3"):
        inverse_dynamics(preset("ur10"), URDF_WITH_MASSES, still, still, still)
    with refuses(Inconsistent, "masses"):
        inverse_dynamics(arm, urdf_text(arm), still[:, :2], still[:, :2], still[:, :2])
    with refuses(Inconsistent, "Pinocchio"):
        inverse_dynamics(arm, "<robot", still[:, :2], still[:, :2], still[:, :2])
