"""Two cameras calibrated from images of a checkerboard.

left_images and right_images may also be folders: armsight.calibrate_stereo("left", "right", board=...).
"""

import tempfile
from pathlib import Path

import armsight

cell = armsight.simulate("board-cell", frames=14, seed=1)
frames = list(cell)
cal = armsight.calibrate_stereo(
    [frame.left for frame in frames], [frame.right for frame in frames], board="checkerboard:9x6:0.025"
)
print(cal)
print(f"true baseline {1e3 * cell.rig.baseline_m:.3f} mm")

with tempfile.TemporaryDirectory() as folder:
    cal.rig.save(Path(folder) / "rig.yaml")
    rig = armsight.read_rig(Path(folder) / "rig.yaml")
