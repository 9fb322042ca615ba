"""Arrays in and out: OpenCV's triangulation beside armsight's, poses as scipy's transforms, figures as plotly's."""

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

import armsight

cell = armsight.simulate("hand-cell", frames=8, room="dark")
frames = list(cell)
poses = armsight.measure(cell.rig, cell.target, [f.left for f in frames], [f.right for f in frames]).poses
T_rig_target = RigidTransform.from_matrix(poses.T_parent_target)  # scipy's, as any (n, 4, 4)
for name, T in (("measured", T_rig_target), ("truly", RigidTransform.from_matrix(cell.T_rig_target))):
    moved = T[0].inv() * T[-1]
    turned_deg = np.rad2deg(moved.rotation.magnitude())
    print(f"{name} moved {1e3 * np.linalg.norm(moved.translation):.1f} mm, {turned_deg:.1f} deg")

lights_m = T_rig_target[0].apply(cell.target.xyz_m)
pixels, plain, P = cell.rig.project(lights_m), [], []
for side, uv_px in zip(("left", "right"), pixels, strict=True):  # OpenCV triangulates without distortion
    camera = cell.rig.camera(side)
    plain.append(cv2.undistortPoints(uv_px, camera.matrix, camera.distortion)[:, 0].T)
    P.append(cell.rig.T_rig_camera(side).inv().as_matrix()[:3])
opencv_m = cv2.convertPointsFromHomogeneous(cv2.triangulatePoints(*P, *plain).T)[:, 0]
ours_m = armsight.triangulate(cell.rig, *pixels, np.eye(2), np.eye(2)).xyz_m
print(f"OpenCV's points differ by {1e3 * abs(opencv_m - ours_m).max():.1e} mm")
print(len(poses.plot().data), "traces")  # the figure: figure.show(), or figure.write_html("track.html")
assert abs(opencv_m - ours_m).max() < 1e-6 and abs(ours_m - lights_m).max() < 1e-6
