"""Which joints count the other way, where some joints' senses cannot be told."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints
from armsight.calibrate.arm.senses import other_senses
from armsight.kinematics import fk, preset


def test_a_tool_on_the_last_axis_leaves_the_other_joints_known():
    arm = replace(preset("irb120"), T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.05]))
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.0, 1.0, (40, 6))
    tracker = RigidTransform.from_components([0.9, -0.2, 0.4], Rotation.from_rotvec([0.3, -0.5, 1.2]))
    seen = tracker.apply(fk(arm, q)[:, :3, 3]) + rng.normal(0, 1e-4, (40, 3))
    found = other_senses(arm, ArmPoints(q=q * [1, 1, -1, 1, 1, 1], xyz_m=seen))
    assert found is not None
    senses, given_m = found
    assert senses.joints == ("j3",)
    assert senses.left_m < 3e-4 < given_m
    assert np.abs(senses.zeros_rad).max() < 0.01
