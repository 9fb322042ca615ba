"""One camera and four mirrors, both views in each image: the rig is calibrated with a board, then measures lights."""

import tempfile
from pathlib import Path

import numpy as np

import armsight

with tempfile.TemporaryDirectory() as folder:
    armsight.write_simulation("mirrors", folder)
    true_rig = armsight.read_rig(Path(folder) / "rig_true.yaml")
    target = armsight.read_target(Path(folder) / "target.yaml")
    found = armsight.calibrate_mirrors(Path(folder) / "complex", "checkerboard:7x5:0.015")
    lights = Path(folder) / "lights"
    seen, truth = (armsight.measure(rig, target, image=lights, stills=True).poses for rig in (found.rig, true_rig))

print(found)
off_mm = 1e3 * (found.rig.baseline_m - true_rig.baseline_m)
print(f"baseline off the truth by {off_mm:.3f} +- {1e3 * found.std['baseline_m']:.3f} mm")
off_mm = 1e3 * (seen.T_parent_target - truth.T_parent_target)[:, :3, 3]
std_mm = [1e3 * seen.table()[name].max() for name in ("sx_m", "sy_m", "sz_m")]
print(f"lights off those by the true rig by {abs(off_mm).max(axis=0).round(3)} mm at most, +- {np.round(std_mm, 3)}")
assert (abs(off_mm).max(axis=0) < 4.0 * np.array(std_mm)).all()
