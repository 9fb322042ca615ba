"""Which joints count the other way, are exchanged or have other zeros, where some of it cannot be told."""

import re
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, calibrate_arm
from armsight.calibrate.arm.senses import other_senses
from armsight.errors import Inconsistent
from armsight.kinematics import fk, preset
from refusals import refuses


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


def rows_of(arm, seed=4, n=40, reach=1.2):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-reach, reach, (n, arm.n))
    tracker = RigidTransform.from_components([0.9, -0.2, 0.4], Rotation.from_rotvec([0.3, -0.5, 1.2]))
    return q, tracker.apply(fk(arm, q)[:, :3, 3]) + rng.normal(0, 1e-4, (n, 3))


def followed(refused, arm):
    """Return the arm changed as the cure says."""
    joints = {joint.name: joint for joint in arm.joints}
    if "sign: -1" in refused.cure:
        for name in re.findall(r"j\d", refused.cure.split("in the arm's file")[0]):
            joints[name] = replace(joints[name], sign=-joints[name].sign)
    for number, name in re.findall(r"(-?\d\.\d+) \((j\d)\)", refused.cure):
        joints[name] = replace(joints[name], theta_rad=joints[name].theta_rad + float(number))
    return replace(arm, joints=tuple(joints.values()))


def test_what_half_turns_make_alike_is_all_told_and_the_cure_works():
    reversed_, zeros = (2, 4), {2: 0.3, 4: -0.2}
    arm = replace(preset("iiwa14"), T_flange_tool=RigidTransform.from_translation([0.03, -0.02, 0.1]))
    q, seen = rows_of(arm)
    every = range(1, arm.n + 1)
    signs, off = [-1 if j in reversed_ else 1 for j in every], [zeros.get(j, 0.0) for j in every]
    points = ArmPoints(q=(q - off) * signs, xyz_m=seen)
    with refuses(Inconsistent) as caught:
        calibrate_arm(arm, points)
    ways = [part.split("counted")[0] for part in caught.value.cause.split(" with ") if "counted" in part]
    assert [f"j{j}" for j in reversed_] in [re.findall(r"j\d", way) for way in ways]
    assert all(f"j{j} by" in caught.value.cause for j in zeros)
    done = calibrate_arm(followed(caught.value, arm), points)
    assert done.after.mean_m < 3e-4


def test_exchanged_columns_are_named_and_exchanging_them_is_the_cure():
    arm = replace(preset("ur5e"), T_flange_tool=RigidTransform.from_translation([0.03, -0.02, 0.1]))
    q, seen = rows_of(arm)
    read = q.copy()
    read[:, [1, 2]] = q[:, [2, 1]]
    with refuses(Inconsistent, "exchanged") as caught:
        calibrate_arm(arm, ArmPoints(q=read, xyz_m=seen))
    first, second = (int(name[1:]) - 1 for name in re.findall(r"j\d", caught.value.cure))
    read[:, [first, second]] = read[:, [second, first]]
    assert calibrate_arm(arm, ArmPoints(q=read, xyz_m=seen)).before.mean_m < 3e-4
