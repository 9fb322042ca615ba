"""A known arm corrected from measured places of its tool, and the correction held against the real arm elsewhere."""

import numpy as np

import armsight

nominal = armsight.presets.ur10()
real = nominal.moved({f"{joint.name}.theta_rad": 0.002 * i for i, joint in enumerate(nominal.joints)})  # up to 10 mrad
rng = np.random.default_rng(4)
q, elsewhere = rng.uniform(-1.5, 1.5, (2, 60, 6))
xyz_m = real.fk(q)[:, :3, 3] + rng.normal(0.0, 1e-4, (60, 3))

result = armsight.calibrate_arm(nominal, q, xyz_m)
print(result)
assert result.gain  # else result.arm is the nominal one
for name, arm in (("nominal", nominal), ("corrected", result.arm)):
    error_mm = 1e3 * np.linalg.norm(arm.fk(elsewhere)[:, :3, 3] - real.fk(elsewhere)[:, :3, 3], axis=1)
    print(f"{name}: off the real arm by {np.sqrt(np.mean(error_mm**2)):.2f} mm RMS at other joint values")
assert error_mm.max() < 1.0
