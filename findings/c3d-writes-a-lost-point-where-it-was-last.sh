#!/usr/bin/env bash
# c3d 0.6.0: its writer, given a frame in which a point is lost (coordinates 0, residual -1), writes the coordinates of the
# frame before with the residual -1. Whoever reads the first three numbers alone gets a marker that stands still. The
# numbers in the file are looked at by themselves, at the block that its header names.
# Seen with Python 3.11 on Linux: "given 0.0, written 41.0, residual -1.0". Exits 1 where that has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install --quiet --target "$folder/lib" c3d==0.6.0
found=$(PYTHONPATH="$folder/lib" python3 -W ignore - "$folder/a.c3d" <<'PY'
import struct
import sys

import c3d
import numpy as np

path = sys.argv[1]
writer = c3d.Writer(point_rate=100, analog_rate=0, point_scale=-0.1)
for i in range(4):
    point = [0.0, 0.0, 0.0, -1.0, -1.0] if i == 2 else [40.0 + i, 50.0, 60.0, 1.0, 1.0]
    writer.add_frames([(np.array([point]), np.zeros((0, 0)))])
with open(path, "wb") as file:
    writer.write(file)
with open(path, "rb") as file:
    data = file.read()
first = 512 * (struct.unpack_from("<H", data, 16)[0] - 1)
x, _, _, residual = struct.unpack_from("<4f", data, first + 2 * 16)
print(f"given 0.0, written {x:.1f}, residual {residual:.1f}")
PY
)
echo "$found"
test "$found" = "given 0.0, written 41.0, residual -1.0"
