"""An arm follows a target that the camera on its flange sees: a simulated cell, whose target a hand leads about."""

import tempfile
from pathlib import Path

import numpy as np

import armsight

name = "pachidis2005-static"
with tempfile.TemporaryDirectory() as folder:
    cell, out = Path(folder) / "cell", Path(folder) / "out"
    armsight.write_simulation(name, cell, frames=1)  # rig, target and hand-eye calibration of this cell
    files = [cell / f"{kind}.yaml" for kind in ("rig", "target", "handeye")]
    done = armsight.servo(
        f"sim:{name}", *files, confirm=True, hand="circle", hand_speed_m_s=0.02, seconds_s=5.0, out=out
    )
    with armsight.open_recording(out / "servo.mcap") as recording:  # set points, commands, readings, poses, events
        poses = [pose for pose in recording.poses() if pose.status == "ok"]

print(done)
off_mm = 1e3 * np.linalg.norm([pose.T_parent_target[:3, 3] - [0.0, 0.0, 0.6] for pose in poses], axis=1)
std_mm = 1e3 * np.sqrt(poses[-1].covariance[2, 2])
print(f"wanted 600 mm before the camera: off by {off_mm[0]:.1f} mm at first, at most {off_mm.max():.1f} mm,")
print(f"by {off_mm[-10:].mean():.1f} +- {std_mm:.1f} mm in the last ten frames, while the target goes 20 mm/s")
assert off_mm[-10:].max() < 10.0
