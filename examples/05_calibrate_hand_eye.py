"""Where the camera is on the arm, from poses of the flange and of a target that the camera saw."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import armsight

rng = np.random.default_rng(1)
T_flange_camera = RigidTransform.from_components([0.02, 0.05, 0.11], Rotation.from_euler("xyz", [2, -3, 91], True))
T_base_target = RigidTransform.from_components([0.6, 0.1, 0.05], Rotation.from_euler("xyz", [178, 1, 30], True))

T_base_flange, T_camera_target = [], []
for _ in range(20):  # what the controller shows, and what the camera sees (here with noise)
    turn = Rotation.from_euler("xyz", [180, 0, 0], True) * Rotation.from_rotvec(rng.normal(0.0, 0.35, 3))
    flange = RigidTransform.from_components(rng.normal([0.6, 0.1, 0.5], 0.08), turn)
    noise = RigidTransform.from_components(rng.normal(0.0, 2e-4, 3), Rotation.from_rotvec(rng.normal(0.0, 5e-4, 3)))
    T_base_flange.append(flange.as_matrix())
    T_camera_target.append(((flange * T_flange_camera).inv() * T_base_target * noise).as_matrix())

he = armsight.calibrate_hand_eye(T_base_flange, T_camera_target)
print(he)
print("T_flange_camera:", he.T_flange_camera, "standard deviations:", he.std, "rejected:", he.rejected, sep="\n")
