"""The backlash of every joint as a figure of its own, against what was planted, beside other faults."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import armsight
from armsight.kinematics import fk


def test_every_joints_backlash_is_told_beside_sag_and_a_zero_within_its_deviation() -> None:
    arm, rng = armsight.presets.so101(), np.random.default_rng(4)
    gives = zip(arm.joints, [0.0, 0.004, 0.003, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0], strict=True)
    true = replace(arm, joints=tuple(replace(joint, compliance=c, mass_kg=m) for joint, c, m in gives))
    q = rng.uniform(0.7 * arm.lower, 0.7 * arm.upper, (60, 5))
    q[:, 4] = np.sort(q[:, 4])  # reached from one side alone
    side = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    play = np.deg2rad([0.0, 0.8, 0.3, 0.5, 0.4])
    T = fk(true, true.values(q + 0.5 * play * side + [0.0, 0.0, 0.01, 0.0, 0.0]))
    T[:, :3, 3] += rng.normal(0.0, 3e-4, (60, 3))
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0.0, 2e-3, (60, 3))).as_matrix()
    joints = armsight.verify(T, arm=arm, joints=q).joints
    assert joints[4].backlash_rad is None
    for joint, own in zip(joints[:4], play[:4], strict=True):
        assert joint.backlash_rad is not None
        assert joint.backlash_std_rad is not None
        assert abs(joint.backlash_rad - own) < 3.5 * joint.backlash_std_rad
        assert joint.backlash_std_rad < np.deg2rad(0.08)
