"""An arm held against its controller: which joint is wrong, and how well it repeats (ISO 9283)."""

import numpy as np

import armsight

arm = armsight.presets.ur10()
rng = np.random.default_rng(1)
q = np.array([0.0, -1.2, 1.5, -0.5, 1.0, 0.0]) + rng.uniform(-1.2, 1.2, (60, 6))
measured = arm.moved({"j3.theta_rad": np.deg2rad(0.3)}).fk(q)  # joint 3 reads 0.3 degrees too little
measured[:, :3, 3] += rng.normal(0.0, 1e-4, (60, 3))
found = armsight.verify(measured, arm=arm, joints=q)
joint = found.joints[2]
print(f"cause: {found.cause}, {np.rad2deg(joint.offset_rad):.3f} +- {np.rad2deg(joint.std_rad):.3f} deg (0.3 is true)")
assert found.cause == "joint 3" and abs(joint.offset_rad - np.deg2rad(0.3)) < 4.0 * joint.std_rad

commanded = {"pose": ["P1", "P2"], "x_m": [0.4, 0.8], "y_m": [-0.2, 0.2], "z_m": [0.5, 0.1]}
visits = {"pose": commanded["pose"] * 30, "visit": np.repeat(np.arange(30), 2)}
for axis in ("x_m", "y_m", "z_m"):  # 0.2 mm off in every axis, 0.03 mm of scatter
    visits[axis] = np.tile(commanded[axis], 30) + 2e-4 + rng.normal(0.0, 3e-5, 60)
figures = armsight.verify(visits, commanded=commanded, align="none").iso9283
for key in ("AP_m", "RP_m"):  # of the worst of all poses
    print(f"{key}: {1e3 * figures[key].value:.3f} +- {1e3 * figures[key].std:.3f} mm, {figures[key].n} visits")
assert abs(figures["AP_m"].value - 2e-4 * np.sqrt(3.0)) < 4.0 * figures["AP_m"].std
