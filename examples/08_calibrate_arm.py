"""A known arm corrected from measured places of its tool, where the measurements prove a gain."""

from dataclasses import replace

import numpy as np

import armsight

nominal = armsight.presets.ur10()
joints = [replace(joint, theta_rad=joint.theta_rad + 0.002 * i) for i, joint in enumerate(nominal.joints)]
real = replace(nominal, joints=tuple(joints))  # an arm whose joint zeros are off by up to 10 mrad

rng = np.random.default_rng(4)
q = rng.uniform(-1.5, 1.5, (60, 6))
xyz_m = real.fk(q)[:, :3, 3] + rng.normal(0.0, 1e-4, (60, 3))

result = armsight.calibrate_arm(nominal, q, xyz_m)
print(result)

T = result.arm.fk(q[0])
best = result.arm.ik(T, near=q[0])[0].q  # inverse kinematics, nearest first
J = result.arm.jacobian(best)
