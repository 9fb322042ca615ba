"""An unknown arm, from where a beacon on it was while one joint after the other moved."""

import numpy as np

import armsight

truth = armsight.presets.stanford_rrp()  # here a simulated arm makes the readings
rng = np.random.default_rng(3)
home = np.array([0.2, 0.3, 0.5])
joint = np.repeat([1, 2, 3], 25)  # joints count from 1
q = np.tile(home, (75, 1))
for number, travel in enumerate((1.2, 1.0, 0.4)):
    q[joint == number + 1, number] += np.linspace(-0.5, 0.5, 25) * travel
xyz_m = truth.fk(q)[:, :3, 3] + rng.normal(0.0, 2e-4, (75, 3))

found = armsight.identify_arm(joint, q, xyz_m)
print(found)
T = found.arm.fk(home)  # the arm found is ready for kinematics: fk, ik, jacobian
