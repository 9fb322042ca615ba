"""A tool's tip, from poses of a target on the tool while the tip rests on one point."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import armsight

rng = np.random.default_rng(2)
tip_m, point_m = np.array([0.01, -0.02, 0.18]), np.array([0.4, 0.1, 0.02])
turns = Rotation.from_rotvec(rng.normal(0.0, 0.3, (40, 3)))
places = point_m - turns.apply(tip_m) + rng.normal(0.0, 1e-4, (40, 3))

tip = armsight.calibrate_tool_tip(RigidTransform.from_components(places, turns))
print(tip)
