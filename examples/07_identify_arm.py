"""An arm without drawings, from where a beacon on it was seen while one joint after the other moved."""

import numpy as np

import armsight

truth = armsight.presets.stanford_rrp()  # here a simulated arm makes the readings
home = np.array([0.2, 0.3, 0.5])
joint = np.repeat([1, 2, 3], 25)  # joints count from 1
q = np.tile(home, (75, 1))
for i, travel in enumerate((1.2, 1.0, 0.4)):
    q[joint == i + 1, i] += np.linspace(-0.5, 0.5, 25) * travel
xyz_m = truth.fk(q)[:, :3, 3] + np.random.default_rng(3).normal(0.0, 2e-4, (75, 3))

found = armsight.identify_arm(joint, q, xyz_m)
print(found)
print("types:", [str(j.type) for j in found.arm.joints])
elsewhere = home + np.random.default_rng(4).uniform(-0.2, 0.2, (50, 3))
error_mm = 1e3 * np.linalg.norm(found.arm.fk(elsewhere)[:, :3, 3] - truth.fk(elsewhere)[:, :3, 3], axis=1)
print(f"beacon predicted elsewhere to {error_mm.max():.2f} mm at most")
assert [j.type for j in found.arm.joints] == [j.type for j in truth.joints] and error_mm.max() < 1.0
