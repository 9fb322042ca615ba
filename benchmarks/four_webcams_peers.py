"""One other program's places of cameras from a board's corners, in an interpreter that has it: JSON in, JSON out.

    PYTHON four_webcams_peers.py caliscope|aniposelib|multical|opencv < corners.json

Prints T_first_camera (3, 6), m and rad. Lenses are held where the program can.
"""

from __future__ import annotations

import json
import sys

import numpy as np

given = json.load(sys.stdin)
X, K, d = np.array(given["X"]), np.array(given["K"]), np.array(given["d"])
C, G, n = len(K), len(given["views"][0]), len(X)
uv = np.full((C, G, n, 2), np.nan)
for c, views in enumerate(given["views"]):
    for g, view in enumerate(views):
        if view is not None:
            uv[c, g, view[0]] = view[1]
size = tuple(given["size"])


def aniposelib() -> list[np.ndarray]:
    """T_camera_world (4, 4) of each camera."""
    from aniposelib.boards import Checkerboard
    from aniposelib.cameras import Camera, CameraGroup

    cameras = [Camera(name=str(c), size=size, matrix=K[c], dist=d[c]) for c in range(C)]
    board = Checkerboard(3, 4, square_length=0.054)
    board.objPoints = X.copy()
    rows = []
    for c in range(C):
        own = []
        for g in range(G):
            seen = np.isfinite(uv[c, g, :, 0])
            if not seen.any():
                continue
            corners = uv[c, g][:, None]
            own.append({"framenum": (0, g), "corners": corners, "filled": corners, "ids": np.arange(n)[:, None]})
        rows.append(own)
    group = CameraGroup(cameras)
    group.calibrate_rows(rows, board, init_intrinsics=False, init_extrinsics=True, verbose=False)
    return [camera.get_extrinsics_mat() for camera in group.cameras]


def opencv() -> list[np.ndarray]:
    """T_camera_world (4, 4) of each camera; boards that are seen whole, for it returns nonsense for parts of them."""
    import cv2

    if not hasattr(cv2, "calibrateMultiview"):
        raise ImportError(f"OpenCV {cv2.__version__} has no calibrateMultiview")
    whole = np.isfinite(uv).all(axis=(2, 3))
    kept = whole.sum(axis=0) > 1
    points = [
        [
            uv[c, g].astype(np.float32) if whole[c, g] else np.full((n, 2), -1.0, np.float32)
            for g in np.flatnonzero(kept)
        ]
        for c in range(C)
    ]
    found = cv2.calibrateMultiview(
        [X.astype(np.float32)] * int(kept.sum()),
        points,
        [size] * C,
        whole[:, kept].astype(np.uint8),
        np.zeros(C, np.uint8),
        list(K.copy()),
        list(d.copy()),
        [np.eye(3) for _ in range(C)],
        [np.zeros((3, 1)) for _ in range(C)],
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_INTRINSIC,
    )
    _, _, _, R, t = found[:5]
    out = []
    for r, shift in zip(R, t, strict=True):
        T = np.eye(4)
        T[:3, :3] = r if np.shape(r) == (3, 3) else cv2.Rodrigues(np.asarray(r))[0]
        T[:3, 3] = np.ravel(shift)
        out.append(T)
    return out


def caliscope() -> list[np.ndarray]:
    """T_camera_world (4, 4) of each camera."""
    import pandas as pd
    from caliscope.cameras.camera_array import CameraArray, CameraData
    from caliscope.core.bootstrap_pose.build_paired_pose_network import build_paired_pose_network
    from caliscope.core.capture_volume import CaptureVolume
    from caliscope.core.point_data import ImagePoints

    cameras = CameraArray({c: CameraData(cam_id=c, size=size, matrix=K[c], distortions=d[c]) for c in range(C)})
    rows = [
        {
            "sync_index": g,
            "cam_id": c,
            "object_id": 0,
            "keypoint_id": i,
            "img_loc_x": uv[c, g, i, 0],
            "img_loc_y": uv[c, g, i, 1],
            "obj_loc_x": X[i, 0],
            "obj_loc_y": X[i, 1],
            "obj_loc_z": 0.0,
        }
        for c, g, i in zip(*np.nonzero(np.isfinite(uv[..., 0])), strict=True)
    ]
    points = ImagePoints(pd.DataFrame(rows))
    build_paired_pose_network(points, cameras).apply_to(cameras)
    volume = CaptureVolume(cameras, points, points.triangulate(cameras)).optimize()
    return [np.asarray(volume.camera_array.cameras[c].transformation) for c in range(C)]


def multical() -> list[np.ndarray]:
    """T_camera_world (4, 4) of each camera."""
    raise ImportError("multical takes its own detections only, from pictures")


T = {"aniposelib": aniposelib, "opencv": opencv, "caliscope": caliscope, "multical": multical}[sys.argv[1]]()
first = T[0]
import cv2  # noqa: E402  # every one of them brings it

sides = []
for other in T[1:]:
    T_first_camera = first @ np.linalg.inv(other)
    sides.append(np.r_[T_first_camera[:3, 3], cv2.Rodrigues(T_first_camera[:3, :3])[0].ravel()].tolist())
print(json.dumps(sides))
