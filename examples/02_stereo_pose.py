"""The pose of a lit target from one pair of images; rig and target are records (here), or files read with read_rig."""

import numpy as np
from scipy.spatial.transform import Rotation

import armsight

cell = armsight.simulate("webcam-cell", frames=1, room="dark")
frame = next(iter(cell))
pose = armsight.estimate_pose(frame.left, frame.right, cell.rig, cell.target)
print(pose)

if not pose.ok:  # a lost pose has no numbers: asking for them raises the reason
    raise SystemExit(f"no pose: {pose.why}")
error_mm = 1e3 * (pose.xyz_m - frame.T_rig_target[:3, 3])
turn = Rotation.from_matrix(pose.T_rig_target[:3, :3] @ frame.T_rig_target[:3, :3].T)
std_mm = 1e3 * np.array([pose.std[name] for name in ("x_m", "y_m", "z_m")])
print(f"off the truth by {error_mm.round(2)} mm +- {std_mm.round(2)}, {np.rad2deg(turn.magnitude()):.2f} deg")
assert (abs(error_mm) < 4.0 * std_mm).all()
