"""Masses and compliance of an arm: kept by its file, read from a URDF, and refused where they mean nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import Arm, in_convention, preset
from armsight.store.arm_file import read_arm, write_arm
from armsight.store.urdf import arm_from_urdf, urdf_text

URDF = """<robot name="two">
<link name="base"/>
<link name="a"><inertial><mass value="2"/><origin xyz="0.1 0.02 0.2" rpy="0.3 0 1"/>{inertia}</inertial></link>
<link name="box"><inertial><mass value="0.5"/><origin xyz="0 0.1 0"/>{inertia}</inertial></link>
<link name="b"><inertial><mass value="{mass}"/><origin xyz="0 0 0.15"/>{inertia}</inertial></link>
<link name="tool"><inertial><mass value="1.5"/><origin xyz="0.05 0 0.02"/>{inertia}</inertial></link>
<link name="finger"><inertial><mass value="0.2"/>{inertia}</inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3" rpy="0.1 1.2 0.3"/>
<axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="lid" type="fixed"><parent link="a"/><child link="box"/><origin xyz="0.1 0 0" rpy="0 0.4 0"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.05 0.1 0.4" rpy="0.2 0 -0.5"/>
<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="mount" type="fixed"><parent link="b"/><child link="tool"/><origin xyz="0 0 0.3" rpy="0 0.2 0"/></joint>
<joint name="grip" type="prismatic"><parent link="tool"/><child link="finger"/><origin xyz="0 0.03 0.05"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.02" effort="9" velocity="9"/></joint>
</robot>"""


INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'


def soft() -> Arm:
    arm = preset("ur10")
    joints = tuple(
        replace(j, compliance=1e-5, mass_kg=2.0 + k, com_m=(0.1, 0.2, 0.3)) for k, j in enumerate(arm.joints)
    )
    return replace(arm, joints=joints, down_in_base=np.array([0.0, 0.6, -0.8]))


def test_file_and_convention_keep_how_an_arm_sags(tmp_path: Path) -> None:
    arm, q = soft(), np.linspace(-1.0, 1.0, 6)
    write_arm(tmp_path / "arm.yaml", arm)
    expected = arm.values(q)
    assert np.abs(expected - q).max() > 1e-4
    assert read_arm(tmp_path / "arm.yaml").values(q) == pytest.approx(expected, abs=1e-15)
    assert in_convention(arm, "craig").values(q) == pytest.approx(expected, abs=1e-12)
    write_arm(tmp_path / "arm.yaml", preset("ur10"))
    assert "mass_kg" not in (tmp_path / "arm.yaml").read_text()  # older versions read a stiff arm's file
    assert read_arm(tmp_path / "arm.yaml").direct


def test_an_arm_that_hangs_sags_the_other_way() -> None:
    arm, q = replace(soft(), down_in_base=None), np.linspace(-1.0, 1.0, 6)
    hanging = replace(arm, down_in_base=np.array([0.0, 0.0, 1.0]))
    assert hanging.gravity_torque(q) == pytest.approx(-arm.gravity_torque(q))
    assert arm.based().gravity_torque(q) == pytest.approx(arm.gravity_torque(q))


@pytest.mark.parametrize("down", [(0.0, 0.0, -1.0), (0.36, 0.48, -0.8)])
def test_masses_of_a_urdf_are_those_that_pinocchio_reads(down: tuple[float, float, float]) -> None:
    pin = pytest.importorskip("pinocchio")
    text = URDF.format(mass=3, inertia=INERTIA)
    arm = arm_from_urdf(text, tip="tool")
    arm = replace(arm, down_in_base=arm.T_world_base.rotation.inv().apply(down))
    model = pin.buildModelFromXML(text)
    model.gravity.linear = 9.81 * np.array(down)
    for q in np.random.default_rng(0).uniform(-2.0, 2.0, (10, 2)):
        full = np.append(q, 0.0)  # the finger stands at zero
        assert arm.gravity_torque(q) == pytest.approx(
            -pin.computeGeneralizedGravity(model, model.createData(), full)[:2] * (9.80665 / 9.81), abs=1e-9
        )


def test_what_means_nothing_is_refused() -> None:
    with pytest.raises(BadFile):
        arm_from_urdf(URDF.format(mass=-3, inertia=""), tip="tool")
    arm = soft()
    with pytest.raises(Inconsistent):
        urdf_text(arm)  # which would be of a stiff arm
    with pytest.raises(Inconsistent):
        replace(arm, joints=tuple(replace(joint, mass_kg=0.0) for joint in arm.joints))
    with pytest.raises(Inconsistent):
        replace(arm, down_in_base=np.array([0.0, 0.0, -2.0]))
    with pytest.raises(Inconsistent):
        replace(arm, joints=tuple(replace(joint, compliance=1.0) for joint in arm.joints)).values(np.ones(6))
