"""Cameras' files of devices and other programs, written in their form from a world that OpenCV projects."""

import json
from typing import NamedTuple

import cv2
import numpy as np

SIZE = (1280, 720)
D = np.array([-0.17, 0.026, 0.0003, -0.0002, 0.004])


class View(NamedTuple):
    """A camera by OpenCV: p_camera = Rodrigues(r) p_world + t (m)."""

    K: np.ndarray
    r: np.ndarray
    t: np.ndarray
    D: np.ndarray = D

    @property
    def R(self):
        return cv2.Rodrigues(self.r)[0]

    def sees(self, points):
        return cv2.projectPoints(points, self.r, self.t, self.K, self.D)[0].reshape(-1, 2)


def matrix(f, cx, cy):
    return np.array([[f, 0.0, cx], [0.0, f + 1.0, cy], [0.0, 0.0, 1.0]])


LEFT = View(matrix(700.0, 640.5, 361.0), np.zeros(3), np.zeros(3))
RIGHT = View(matrix(703.0, 645.5, 355.0), np.array([0.003, -0.02, 0.001]), np.array([-0.1199, 0.0004, 0.0007]))
THIRD = View(matrix(690.0, 630.0, 350.0), np.array([0.02, 0.31, -0.04]), np.array([0.15, -0.02, 0.03]))
POINTS = np.random.default_rng(8).uniform((-0.2, -0.1, 0.7), (0.2, 0.1, 1.1), (40, 3))


def zed(path, *, rational=False, name="HD"):
    lens = "".join(f"{key}={value}\n" for key, value in zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True))
    text = ""
    for side, view in (("LEFT", LEFT), ("RIGHT", RIGHT)):
        (fx, _, cx), (_, fy, cy), _ = view.K
        text += f"[{side}_CAM_{name}]\nfx={fx}\nfy={fy}\ncx={cx}\ncy={cy}\n{lens}\n[{side}_CAM_VGA]\nfx=350.\n\n"
        if rational:
            text += f"[{side}_DISTO]\n{lens}k4=0\nk5=0\nk6=0\n\n"
    rx, cv, rz = RIGHT.r
    t = 1e3 * RIGHT.t
    text += f"[STEREO]\nBaseline={-t[0]}\nTY={t[1]}\nTZ={t[2]}\nCV_{name}={cv}\nRX_{name}={rx}\nRZ_{name}={rz}\n"
    path.write_text(text)
    return path


def depthai(path, **changes):
    def camera(view, to, step, **more):
        R, t = step
        spec = {"x": -7.5, "y": 0.0, "z": 0.0}  # the drawing's
        return {
            "cameraType": 0,
            "width": SIZE[0],
            "height": SIZE[1],
            "intrinsicMatrix": view.K.tolist(),
            "distortionCoeff": [*view.D, *[0.0] * 9],
            "extrinsics": {
                "rotationMatrix": R.tolist(),
                "translation": dict(zip("xyz", (100.0 * t).tolist(), strict=True)),
                "specTranslation": spec,
                "toCameraSocket": to,
            },
        } | more

    def step(a, b):
        R = b.R @ a.R.T
        return R, b.t - R @ a.t

    cameras = [
        [1, camera(LEFT, 2, step(LEFT, RIGHT), **changes)],
        [2, camera(RIGHT, 0, step(RIGHT, THIRD))],
        [0, camera(THIRD, -1, (np.zeros((3, 3)), np.zeros(3)))],
        [3, {"cameraType": 0, "intrinsicMatrix": [], "extrinsics": {"toCameraSocket": -1}}],
    ]
    path.write_text(json.dumps({"boardName": "X", "version": 7, "cameraData": cameras}))
    return path


def toml(value):
    return json.dumps(value)


def aniposelib(path, views, unit=1.0):
    text = ""
    for k, view in enumerate(views):
        text += f'[cam_{k}]\nname = "c{k}"\nsize = {toml(SIZE)}\nmatrix = {toml(view.K.tolist())}\n'
        text += f"distortions = {toml(view.D.tolist())}\nrotation = {toml(view.r.tolist())}\n"
        text += f"translation = {toml((unit * view.t).tolist())}\n\n"
    path.write_text(text + "[metadata]\nadjusted = false\nerror = 0.2\n")


def caliscope(path, views, unit=1.0):
    text = ""
    for k, view in enumerate(views):
        text += f"[cameras.{k}]\ncam_id = {k}\nsize = {toml(SIZE)}\nrotation_count = 0\nerror = 0.3\n"
        text += f"matrix = {toml(view.K.tolist())}\ndistortions = {toml(view.D.tolist())}\n"
        text += (
            f"translation = {toml((unit * view.t).tolist())}\nrotation = {toml(view.r.tolist())}\nfisheye = false\n\n"
        )
    path.write_text(text)


def multical(path, views, unit=1.0):
    def pose(view):
        return {"R": view.R.tolist(), "T": (unit * view.t).tolist()}

    cameras = {
        f"c{k}": {"model": "standard", "image_size": SIZE, "K": view.K.tolist(), "dist": [view.D.tolist()]}
        for k, view in enumerate(views)
    }
    poses = {("c0" if k == 0 else f"c{k}_to_c0"): pose(view) for k, view in enumerate(views)}
    path.write_text(json.dumps({"cameras": cameras, "camera_poses": poses, "image_sets": {"rgb": []}}))


def halcon(path, **lens):
    values = {"Focus": 0.008, **lens, "Sx": 1.1e-5, "Sy": 1.1e-5, "Cx": 378.0, "Cy": 297.5}
    text = '# INTERNAL CAMERA PARAMETERS\n\nParGroup: Camera: Parameter;\n  "Internal camera parameters";\n\n'
    for name, value in values.items():
        text += f'{name}:{name.lower()}: {value};\n  DOUBLE:0.0:;\n  "{name}";\n\n'
    for name, value in (("ImageWidth", 768), ("ImageHeight", 576)):
        text += f'{name}:{name.lower()}: {value};\n  INT:1:32767;\n  "{name}";\n\n'
    path.write_text(text)
    return values


def step(a, b):
    R = b.R @ a.R.T
    return R, b.t - R @ a.t


def printed(R, t, a="Depth", b="Color"):
    rows = "\n".join("  ".join(f" {x:.6g}   " for x in row) for row in R)
    head = f'Extrinsic from "{a}"\t  To\t  "{b}" :\n Rotation Matrix:\n'
    return head + f"{rows}\n\n Translation Vector: {t[0]}  {t[1]}  {t[2]}  \n\n"


def enumerated(name, view, size=SIZE, form="Y8"):
    (fx, _, cx), (_, fy, cy), _ = view.K
    lens = "  \t".join(str(x) for x in view.D[[0, 1, 2, 3, 4]])
    return (
        f' Intrinsic of "{name}" / {size[0]}x{size[1]} / {{{form}}}\n'
        f"  Width:      \t{size[0]}\n  Height:     \t{size[1]}\n"
        f"  PPX:        \t{cx}\n  PPY:        \t{cy}\n  Fx:         \t{fx}\n  Fy:         \t{fy}\n"
        f"  Distortion: \tBrown Conrady\n  Coeffs:     \t{lens}  \n  FOV (deg):  \t69.37 x 42.54\n\n"
    )


def matlab(view, *, new, **more):
    """A cameraParameters struct; new: as R2022b and later write it."""
    K = view.K + np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    lens = {"RadialDistortion": view.D[[0, 1, 4]], "TangentialDistortion": view.D[[2, 3]], "WorldUnits": "mm"}
    sized = {"ImageSize": np.array([SIZE[1], SIZE[0]])} | ({"K": K} if new else {})
    return lens | sized | {"IntrinsicMatrix": K.T, "EstimateSkew": 0} | more


def stereo(first, second, **more):
    R, t = step(LEFT, RIGHT)
    both = {"CameraParameters1": first, "CameraParameters2": second}
    return both | {"RotationOfCamera2": R.T, "TranslationOfCamera2": 1000.0 * t} | more
