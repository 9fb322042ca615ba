"""MJCF as MuJoCo loads it: the same poses at the same readings, the same weight on the joints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

import armsight
from armsight.cli.commands import app
from armsight.kinematics import Arm, Coupling, Joint, ToolPoint, fk, in_convention, preset
from armsight.kinematics.rigid import as_rigid
from armsight.store.arm_file import write_arm
from armsight.store.mjcf import mjcf_text
from armsight.store.urdf import arm_from_urdf, urdf_text

mujoco = pytest.importorskip("mujoco")
PLACED = RigidTransform.from_components([0.3, -0.2, 0.7], Rotation.from_rotvec([0.4, -0.3, 1.1]))
HELD = RigidTransform.from_components([0.02, 0.01, 0.15], Rotation.from_rotvec([-0.2, 0.5, 0.3]))


def weighed(arm: Arm) -> Arm:
    """Return the arm on a slanted base, with a tool, weights, and one joint that counts the other way."""
    joints = [replace(j, mass_kg=1.5 + k, com_m=(0.03 * k, -0.02, 0.05)) for k, j in enumerate(arm.joints)]
    joints[1] = replace(joints[1], sign=-joints[1].sign)
    point = ToolPoint(name="A", xyz_m=np.array([0.01, 0.02, 0.03]))
    return replace(arm, joints=tuple(joints), T_world_base=PLACED, T_flange_tool=HELD, tool_points=(point,))


def slide_and_hinge() -> Arm:
    rows = {"x": ("prismatic", 0.1, 0.4), "a": ("revolute", 0.3, -1.2), "b": ("revolute", 0.2, 0.3)}
    joints = [
        Joint(
            name=name, type=kind, a_m=a, alpha_rad=alpha, d_m=0.05, theta_rad=0.2, beta_rad=0.01, lower=-1.0, upper=1.0
        )
        for name, (kind, a, alpha) in rows.items()
    ]
    return weighed(Arm(name="cart", joints=tuple(joints)))


@pytest.mark.parametrize("convention", ["standard", "craig"])
@pytest.mark.parametrize(
    "arm", [weighed(preset("ur10")), weighed(preset("panda")), slide_and_hinge()], ids=lambda a: a.name
)
def test_mujoco_has_the_same_poses_and_weights(arm: Arm, convention: str) -> None:
    arm = in_convention(arm, convention)
    model = mujoco.MjModel.from_xml_string(mjcf_text(arm))
    data = mujoco.MjData(model)
    assert model.jnt_range == pytest.approx(np.stack([arm.lower, arm.upper], axis=1))
    for q in np.random.default_rng(2).uniform(-1.0, 1.0, (20, arm.n)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        T = fk(arm, q)
        tool = data.site("tool")
        assert tool.xpos == pytest.approx(T[:3, 3], abs=1e-9)
        assert tool.xmat.reshape(3, 3) == pytest.approx(T[:3, :3], abs=1e-9)
        flange = T @ np.linalg.inv(arm.T_flange_tool.as_matrix())
        assert data.site("point_A").xpos == pytest.approx((flange @ [*arm.tool_points[0].xyz_m, 1.0])[:3], abs=1e-9)
        assert -data.qfrc_bias == pytest.approx(arm.gravity_torque(q), abs=1e-6)  # at rest it is gravity alone


def test_a_joint_without_a_drive_follows_in_both_formats() -> None:
    arm = preset("irb120")
    names = [joint.name for joint in arm.joints]
    joints = tuple(replace(joint, driven=joint.name != names[4]) for joint in arm.joints)
    arm = replace(arm, joints=joints, couplings=(Coupling(joint=names[4], by=names[1], share=-0.5),))
    again = arm_from_urdf(urdf_text(arm))
    q = np.array([0.1, 0.4, -0.3, 0.2, 0.0, 0.6])
    assert again.fk(again.values(q)) == pytest.approx(arm.fk(arm.values(q)), abs=1e-12)
    model = mujoco.MjModel.from_xml_string(mjcf_text(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = arm.values(q)
    mujoco.mj_forward(model, data)
    assert data.efc_pos[:1] == pytest.approx([0.0], abs=1e-12)
    data.qpos[4] += 0.01
    mujoco.mj_forward(model, data)
    assert abs(data.efc_pos[0]) == pytest.approx(0.01)


def test_an_arm_that_gives_way_is_written_as_the_nearest_rigid_one(tmp_path: Path) -> None:
    arm = preset("ur10")
    soft = replace(arm, joints=tuple(replace(j, compliance=3e-5, mass_kg=4.0, com_m=(0.05, 0, 0)) for j in arm.joints))
    write_arm(tmp_path / "soft.yaml", soft)
    for file in ("arm.mjcf", "arm.yaml"):
        words = ["convert", "arm", str(tmp_path / "soft.yaml"), "--rigid", "-o", str(tmp_path / file)]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0 and "mm RMS" in done.output
    rigid = armsight.read_arm(tmp_path / "arm.yaml")
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(tmp_path / "arm.mjcf")))
    data.qpos[:] = q = np.linspace(-1.0, 1.0, 6)
    mujoco.mj_forward(model, data)
    assert data.site("tool").xpos == pytest.approx(rigid.fk(q)[:3, 3], abs=1e-9)
    assert np.linalg.norm(rigid.fk(q)[:3, 3] - soft.fk(soft.values(q))[:3, 3]) < as_rigid(soft).most_m * 1.5
