"""The pose of a lit target from one pair of images.

With a rig of your own: rig = armsight.read_rig("rig.yaml").
"""

import numpy as np

import armsight

cell = armsight.simulate("webcam-cell", frames=1)
rig = cell.rig
target = armsight.LightTarget({"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.032, 0.0), "C": (0.03, -0.032, 0.0)})

frame = next(iter(cell))
result = armsight.estimate_pose(frame.left, frame.right, rig, target)
print(result)

if not result.ok:
    raise SystemExit(f"no pose: {result.why}")
off_mm = 1e3 * np.linalg.norm(result.T_rig_target[:3, 3] - frame.T_rig_target[:3, 3])
print(f"off by {off_mm:.2f} mm from the truth")
