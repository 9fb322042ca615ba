"""Points from pixels of two cameras, each with a covariance that 1000 repeats with noise confirm."""

import numpy as np

import armsight

rig = armsight.simulate("hand-cell", frames=1, room="dark").rig
rng = np.random.default_rng(1)
true_m = np.tile([0.1, -0.05, 1.2], (1000, 1))
left_px, right_px = (uv + rng.normal(0.0, 0.1, uv.shape) for uv in rig.project(true_m))
covariance_px2 = 0.1**2 * np.eye(2)  # one for all pixels; or (n, 2, 2)
points = armsight.triangulate(rig, left_px, right_px, covariance_px2, covariance_px2)

claimed_mm = 1e3 * np.sqrt(np.diag(points.covariance_m2[0]))
scatter_mm = 1e3 * points.xyz_m.std(axis=0)
bias_mm = 1e3 * (points.xyz_m - true_m).mean(axis=0)
print(f"claimed +- {claimed_mm.round(3)} mm, found +- {scatter_mm.round(3)} mm, mean error {bias_mm.round(3)} mm")
assert np.allclose(claimed_mm, scatter_mm, rtol=0.1)
