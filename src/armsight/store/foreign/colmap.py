"""COLMAP's cameras.txt.

One line for each camera: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS. Models OPENCV (fx, fy, cx, cy, k1, k2, p1, p2),
FULL_OPENCV (... k3, k4, k5, k6) and OPENCV_FISHEYE (fx, fy, cx, cy, k1, k2, k3, k4).
COLMAP counts pixels from the image's corner: the centre of its first pixel is
(0.5, 0.5), so that its principal point is half a pixel beyond ours (its documentation, "Output Format").
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from armsight.errors import Inconsistent
from armsight.optics import Camera, LensKind
from armsight.store.atomic import write_text
from armsight.store.tables import number

CORNER_PX = 0.5


def cameras_to_colmap(path: Path, cameras: Sequence[Camera]) -> None:
    """Write cameras.txt, numbered from 1; Inconsistent where a camera has skew or looks through a plate."""
    lines = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    lines.append(f"# Number of cameras: {len(cameras)}")
    for k, camera in enumerate(cameras, 1):
        fx, fy, cx, cy, skew = camera.intrinsics[:5].tolist()
        if skew != 0.0 or camera.plate is not None:
            raise Inconsistent(
                f"camera {k} has skew or looks through a plate",
                consequence="COLMAP's models cannot say this",
                cure="Calibrate with skew fixed at zero",
            )
        first, k3 = camera.distortion[:4].tolist(), camera.distortion[4:].tolist()
        params = [fx, fy, cx + CORNER_PX, cy + CORNER_PX, *first]
        if camera.lens is LensKind.FISHEYE:
            model = "OPENCV_FISHEYE"
        else:
            model = "OPENCV" if k3 == [0.0] else "FULL_OPENCV"
            params += [] if k3 == [0.0] else [*k3, 0.0, 0.0, 0.0]
        values = " ".join(number(value) for value in params)
        lines.append(f"{k} {model} {camera.width} {camera.height} {values}")
    write_text(path, "\n".join(lines) + "\n")
