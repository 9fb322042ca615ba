"""Write the files of this folder: one calibration by OpenCV of its own sample pairs, in three programs' formats.

    python make.py FOLDER_WITH_left01.jpg_AND_SO_ON

Nothing of armsight is used. See README.md beside this script.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).parent
SIZE = (640, 480)
ROS = """image_width: {w}
image_height: {h}
camera_name: narrow_stereo/{name}
camera_matrix:
  rows: 3
  cols: 3
  data: {K}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: {D}
rectification_matrix:
  rows: 3
  cols: 3
  data: {R}
projection_matrix:
  rows: 3
  cols: 4
  data: {P}
"""
KALIBR = """cam{i}:
{T}  cam_overlaps: [{j}]
  camera_model: pinhole
  distortion_coeffs: {D}
  distortion_model: radtan
  intrinsics: {f}
  resolution: [{w}, {h}]
  rostopic: /cam{i}/image_raw
"""


def corners(path):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    found, points = cv2.findChessboardCorners(image, (9, 6))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
    return cv2.cornerSubPix(image, points, (5, 5), (-1, -1), criteria) if found else None


def main(folder):
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = np.mgrid[0:9, 0:6].T.reshape(-1, 2) * 0.025
    numbers = [f"{i:02d}" for i in range(1, 15) if i != 10]
    left = [corners(folder / f"left{n}.jpg") for n in numbers]
    right = [corners(folder / f"right{n}.jpg") for n in numbers]
    boards = [board] * len(numbers)
    _, K1, D1, _, _ = cv2.calibrateCamera(boards, left, SIZE, None, None, flags=cv2.CALIB_FIX_K3)
    _, K2, D2, _, _ = cv2.calibrateCamera(boards, right, SIZE, None, None, flags=cv2.CALIB_FIX_K3)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    _, M1, D1, M2, D2, R, T, *_ = cv2.stereoCalibrate(boards, left, right, K1, D1, K2, D2, SIZE, flags=flags)
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(M1, D1, M2, D2, SIZE, R, T, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    for name, parts in (
        ("intrinsics.yml", {"M1": M1, "D1": D1, "M2": M2, "D2": D2}),
        ("extrinsics.yml", {"R": R, "T": T, "R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q}),
    ):
        storage = cv2.FileStorage(str(HERE / "opencv" / name), cv2.FILE_STORAGE_WRITE)
        for key, value in parts.items():
            storage.write(key, value)
        storage.release()
    storage = cv2.FileStorage(str(HERE / "opencv" / "camera.yml"), cv2.FILE_STORAGE_WRITE)
    for key, value in {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": K1,
        "distortion_coefficients": D1.T,
    }.items():
        storage.write(key, value)
    storage.release()
    for name, K, D, R_, P in (("left", M1, D1, R1, P1), ("right", M2, D2, R2, P2)):
        row = {key: [round(float(x), 6) for x in m.ravel()] for key, m in (("K", K), ("D", D), ("R", R_), ("P", P))}
        (HERE / "ros" / f"{name}.yaml").write_text(ROS.format(w=640, h=480, name=name, **row))
    T_cn_cnm1 = "".join(f"  - {[float(x) for x in row]}\n" for row in np.vstack([np.hstack([R, T]), [0, 0, 0, 1]]))
    text = ""
    for i, (K, D, place) in enumerate(((M1, D1, ""), (M2, D2, "  T_cn_cnm1:\n" + T_cn_cnm1))):
        f = [float(x) for x in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
        text += KALIBR.format(i=i, j=1 - i, T=place, D=[float(x) for x in D.ravel()[:4]], f=f, w=640, h=480)
    (HERE / "kalibr" / "camchain.yaml").write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
