"""Spots of light in an image, each with its standard deviation, held against where the lights truly are."""

import numpy as np

import armsight

cell = armsight.simulate("webcam-cell", frames=1, room="dark")
frame = next(iter(cell))
spots = armsight.find_spots(frame.left)  # an array, or a picture's path

R, t = frame.T_rig_target[:3, :3], frame.T_rig_target[:3, 3]
true_px, _ = cell.rig.project(cell.target.xyz_m @ R.T + t)
for name, uv in zip(cell.target.names, true_px, strict=True):
    i = np.linalg.norm(spots.uv_px - uv, axis=1).argmin()
    std_px = np.sqrt(np.diag(spots.covariance_px2[i]))
    error_px = spots.uv_px[i] - uv
    print(f"{name}: at {spots.uv_px[i].round(2)} +- {std_px.round(3)} px, off by {error_px.round(3)} px")
    assert (abs(error_px) < 5.0 * std_px + 0.02).all()
