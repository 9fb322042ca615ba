"""Where a camera is on the arm, from the flange's poses and the target's poses that the camera saw."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import armsight

rng = np.random.default_rng(1)
T_flange_camera = RigidTransform.from_components([0.02, 0.05, 0.11], Rotation.from_euler("xyz", [2, -3, 91], True))
T_base_target = RigidTransform.from_translation([0.6, 0.1, 0.05])
turn = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * Rotation.from_rotvec(rng.normal(0.0, 0.35, (20, 3)))
T_base_flange = RigidTransform.from_components(rng.normal([0.6, 0.1, 0.5], 0.08, (20, 3)), turn)
noise = RigidTransform.from_components(rng.normal(0, 2e-4, (20, 3)), Rotation.from_rotvec(rng.normal(0, 5e-4, (20, 3))))
T_camera_target = (T_base_flange * T_flange_camera).inv() * T_base_target * noise

found = armsight.calibrate_hand_eye(T_base_flange, T_camera_target)  # arrays (n, 4, 4) do as well
print(found)
error_mm = 1e3 * (found.T_flange_camera[:3, 3] - T_flange_camera.translation)
std_mm = 1e3 * np.array([found.std[name] for name in ("x_m", "y_m", "z_m")])
print(f"off the truth by {error_mm.round(2)} mm +- {std_mm.round(2)}; measure next at")
print(found.propose(1)[0].T_base_flange.translation.round(3), "m")
assert (abs(error_mm) < 4.0 * std_mm).all()
