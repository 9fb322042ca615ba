#!/usr/bin/env bash
# ezc3d 1.7.2: of a C3D point's fourth number the low byte is the residual over the scale, the high byte the cameras (C3D
# user guide). ezc3d reports them the other way round: "residuals" are the camera byte times the scale, "camera_masks" the
# bits of the residual. A point of residual 2.5 mm seen by cameras 1 and 2 (byte 3), written by c3d 0.6.0 at a scale of 0.1
# and read back by it as 2.5, has there a residual of 0.3 and the mask of 25.
# Seen with Python 3.11 on Linux: "c3d 2.5, ezc3d 0.3, mask 25". Exits 1 where that has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install --quiet --target "$folder/lib" ezc3d==1.7.2 c3d==0.6.0
found=$(PYTHONPATH="$folder/lib" python3 -W ignore - "$folder/a.c3d" <<'PY'
import sys

import c3d
import ezc3d
import numpy as np

path = sys.argv[1]
writer = c3d.Writer(point_rate=100, analog_rate=0, point_scale=-0.1)
for i in range(4):
    writer.add_frames([(np.array([[10.0 + i, 20.0, 30.0, 2.5, 3.0]]), np.zeros((0, 0)))])
with open(path, "wb") as file:
    writer.write(file)
with open(path, "rb") as file:
    residual = next(iter(c3d.Reader(file).read_frames(copy=True)))[1][0, 3]
about = ezc3d.c3d(path)["data"]["meta_points"]
bits = about["camera_masks"][:, 0, 0].astype(int)
mask = int(sum(bit << k for k, bit in enumerate(bits)))
print(f"c3d {residual:.1f}, ezc3d {about['residuals'].ravel()[0]:.1f}, mask {mask}")
PY
)
echo "$found"
test "$found" = "c3d 2.5, ezc3d 0.3, mask 25"
