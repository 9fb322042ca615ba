"""The rigid arm nearest to one that gives way: nearer than the arm with its compliance left out, on the same base."""

from dataclasses import replace

import numpy as np
import pytest

from armsight.errors import Inconsistent
from armsight.kinematics import Coupling, fk, preset
from armsight.kinematics.rigid import as_rigid, nearest_rigid
from armsight.store.urdf import arm_from_urdf, urdf_text


def test_what_an_arm_gives_way_goes_into_its_zeros_as_far_as_it_can():
    arm = preset("ur10")
    soft = replace(arm, joints=tuple(replace(j, compliance=3e-5, mass_kg=4.0, com_m=(0.05, 0, 0)) for j in arm.joints))
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (300, 6))
    there = fk(soft, soft.sagged(q))[:, :3, 3]
    left_out = np.linalg.norm(fk(arm, q)[:, :3, 3] - there, axis=1)
    found = nearest_rigid(soft)
    written = arm_from_urdf(urdf_text(found.arm))
    off = np.linalg.norm(fk(written, q)[:, :3, 3] - there, axis=1)
    assert written.T_world_base.as_matrix() == pytest.approx(arm.T_world_base.as_matrix())
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.rms_m, rel=0.15)  # told by other postures
    assert np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(left_out**2))
    assert f"{1e3 * found.rms_m:.3g} mm" in found.lost


def test_an_arm_whose_joint_gives_way_alike_everywhere_is_that_rigid_arm():
    """A slide that hangs: its weight is the same in every posture, so that nothing is lost."""
    from armsight.kinematics import Arm, Joint

    joint = Joint(name="z", type="prismatic", lower=0.0, upper=1.0, mass_kg=10.0, compliance=1e-5)
    found = nearest_rigid(Arm(name="lift", joints=(joint,)))
    assert found.most_m < 1e-12
    assert fk(found.arm, np.array([0.3]))[2, 3] == pytest.approx(0.3 - 1e-5 * 10.0 * 9.80665)


def test_errors_of_gears_lose_what_is_told():
    """Scales, and a reading coupled a little: what a rigid arm cannot turn into zeros and lengths is said, in mm."""
    arm = preset("irb120")
    joints = tuple(
        replace(j, sign=j.sign * (1.001 if k == 1 else 0.9995 if k == 3 else 1.0)) for k, j in enumerate(arm.joints)
    )
    names = [joint.name for joint in joints]
    worn = replace(arm, joints=joints, couplings=(Coupling(joint=names[4], by=names[3], share=0.002),))
    found = as_rigid(worn)
    assert as_rigid(arm).arm is arm and not as_rigid(arm).lost
    written = arm_from_urdf(urdf_text(found.arm))
    q = np.random.default_rng(7).uniform(arm.lower, arm.upper, (400, 6))
    there = fk(worn, worn.values(q))[:, :3, 3]
    off = np.linalg.norm(fk(written, q)[:, :3, 3] - there, axis=1)
    left_out = np.linalg.norm(fk(arm, q)[:, :3, 3] - there, axis=1)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.rms_m, rel=0.15)
    assert 1e-5 < found.rms_m < 0.9 * np.sqrt(np.mean(left_out**2))
    assert all(part in found.lost for part in (f"{names[1]} by 1.001", f"coupled to other joints' ({names[4]})"))


def test_a_parallelogram_is_no_rigid_arm():
    arm = preset("irb120")
    names = [joint.name for joint in arm.joints]
    with pytest.raises(Inconsistent, match=r"\d+ mm RMS"):
        as_rigid(replace(arm, couplings=(Coupling(joint=names[2], by=names[1], share=-1.0),)))
