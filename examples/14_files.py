"""Rig, arm and poses to files of other programs and back: ROS, OpenCV, Kalibr, URDF, TUM."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import armsight

cell = armsight.simulate("webcam-cell", frames=4, room="dark")
left, right = (replace(camera, intrinsics=[*camera.intrinsics[:-1], 0.0]) for camera in (cell.rig.left, cell.rig.right))
rig = replace(cell.rig, left=left, right=right)  # Kalibr knows no k3, the last of the intrinsics
points_m = np.random.default_rng(1).uniform([-0.2, -0.2, 0.7], [0.2, 0.2, 1.2], (50, 3))
q = np.random.default_rng(2).uniform(-1.5, 1.5, (20, 6))
with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    files = {"ros": [folder / "l.yaml", folder / "r.yaml"], "opencv": folder / "cv.yaml", "kalibr": folder / "k.yaml"}
    for program, out in files.items():
        armsight.convert(rig, out, to=program)
        off_px = abs(np.subtract(armsight.read_rig(out).project(points_m), rig.project(points_m))).max()
        print(f"{program}: pixels off by {off_px:.1e} px")
    arm = armsight.read_arm(cell.arm.save(folder / "arm.urdf"))
    track = armsight.read_poses(armsight.write_table(folder / "poses.csv", (cell.t_s, cell.T_rig_target)))
    tum = armsight.read_poses(track.save(folder / "poses.tum"))
off_mm = [1e3 * abs(d[:, :3, 3]).max() for d in (arm.fk(q) - cell.arm.fk(q), tum.T_parent_target - cell.T_rig_target)]
print(f"URDF: tool off by {off_mm[0]:.1e} mm; TUM: poses off by {off_mm[1]:.1e} mm")
assert max(off_px, *off_mm) < 1e-6
