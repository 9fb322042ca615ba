"""Kalibr's lenses, RealSense's and MATLAB's files: truth by the makers' formulas and by OpenCV."""

import json

import cv2
import numpy as np
import pytest
import scipy.io
import yaml

from armsight.errors import BadFile, UsageError
from armsight.ops.conversion import convert_rig, load_camera, load_rig
from armsight.optics import LensKind
from armsight.store.foreign import Asked
from foreign_cameras import LEFT, POINTS, RIGHT, SIZE, THIRD, enumerated, matlab, printed, step, stereo
from refusals import names_it, refuses

RADTAN = (-0.05, 0.01, 0.00002, -0.00001)
PU, PV = 641.0, 357.0
FOCAL = {"omni": (1100.0, 1101.0), "eucm": (500.0, 501.0), "ds": (500.0, 501.0), "fov": (700.0, 701.0)}


def radtan(m):
    rays = np.column_stack([m, np.ones(len(m))])
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(RADTAN))[0].reshape(-1, 2)


def drawn(name, points, lens):
    """Pixels of points (n, 3) by Kalibr's euclideanToKeypoint."""
    x, y, z = points.T
    d = np.sqrt(x**2 + y**2 + z**2)
    if name == "omni":
        m = points[:, :2] / (z + lens[0] * d)[:, None]
        m = radtan(m)
    elif name == "eucm":
        alpha, beta = lens
        m = points[:, :2] / (alpha * np.sqrt(beta * (x**2 + y**2) + z**2) + (1 - alpha) * z)[:, None]
    elif name == "ds":
        xi, alpha = lens
        d2 = np.sqrt(x**2 + y**2 + (xi * d + z) ** 2)
        m = points[:, :2] / (alpha * d2 + (1 - alpha) * (xi * d + z))[:, None]
    else:
        (w,) = lens
        r = np.hypot(x, y) / z
        m = points[:, :2] / z[:, None] * (np.arctan(2.0 * r * np.tan(0.5 * w)) / (r * w))[:, None]
    return m * FOCAL[name] + (PU, PV)


def block(name, lens, **more):
    own = () if name == "fov" else lens
    return {
        "camera_model": "pinhole" if name == "fov" else name,
        "intrinsics": [*own, *FOCAL.get(name, ()), PU, PV],
        "distortion_model": {"omni": "radtan", "fov": "fov"}.get(name, "none"),
        "distortion_coeffs": list({"omni": RADTAN, "fov": lens}.get(name, ())),
        "resolution": list(SIZE),
    } | more


LENSES = {"omni": (1.2,), "eucm": (0.6, 1.1), "ds": (-0.2, 0.55), "fov": (0.9,)}


@pytest.mark.parametrize("name", LENSES)
def test_kalibrs_lenses_become_the_nearest_one_and_it_is_said_how_near(tmp_path, name):
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump({"cam0": block(name, LENSES[name])}))
    asked = Asked()
    camera = load_camera(tmp_path / "chain.yaml", asked)
    rng = np.random.default_rng(5)
    theta, phi = rng.uniform(0.02, 1.48, 4000), rng.uniform(-np.pi, np.pi, 4000)
    points = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    uv = drawn(name, points, LENSES[name])
    inside = ((uv >= 0.0) & (uv <= np.array(SIZE) - 1.0)).all(axis=1)
    assert inside.sum() > 500
    apart = np.linalg.norm(camera.project(points[inside]) - uv[inside], axis=1).max()
    said = float(asked.told[0].split(" px apart")[0].split()[-1])
    assert apart < 1.2 * said + 1e-9 and said < 0.05


def test_a_lens_that_sees_further_than_a_camera_here_is_refused_or_taken_in_part(tmp_path):
    path = tmp_path / "chain.yaml"
    path.write_text(yaml.safe_dump({"cam0": block("ds", LENSES["ds"], intrinsics=[-0.2, 0.55, 350, 350, 640, 360])}))
    with refuses(BadFile, "cam0", "85", "--approximate"):
        load_camera(path)
    asked = Asked(approximate=True)
    assert load_camera(path, asked).lens is LensKind.FISHEYE
    assert names_it(asked.told, "2 % of the picture")
    path.write_text(yaml.safe_dump({"cam0": block("ds", (-0.2, 0.55), intrinsics=[-0.2, 0.9, 60, 60, 640, 360])}))
    with refuses(BadFile, "sees less"):
        load_camera(path, Asked(approximate=True))


def test_a_lens_too_far_from_ours_is_refused_with_the_distance(tmp_path):
    path, far = tmp_path / "chain.yaml", [-0.4, 0.5, 0.0003, -0.0002]
    path.write_text(yaml.safe_dump({"cam0": block("omni", (1.0,), distortion_coeffs=far)}))
    with refuses(BadFile, "cam0", "--approximate"):
        load_camera(path)


def test_a_chain_of_three_and_two_of_it_by_name(tmp_path):
    def link(before, after):
        T = np.eye(4)
        T[:3, :3] = after.R @ before.R.T
        T[:3, 3] = after.t - T[:3, :3] @ before.t
        return {"T_cn_cnm1": T.tolist()}

    chain, before = {}, None
    for k, view in enumerate((LEFT, RIGHT, THIRD)):
        (fx, _, cx), (_, fy, cy), _ = view.K.tolist()
        given = {"distortion_model": "radtan", "distortion_coeffs": list(view.D[:4]), "intrinsics": [fx, fy, cx, cy]}
        chain[f"cam{k}"] = block("pinhole", ()) | given | ({} if before is None else link(before, view))
        before = view
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(chain, default=float))))
    rig = load_rig([tmp_path / "chain.yaml"])
    assert rig.names == ("cam0", "cam1", "cam2")
    for got, view in zip(rig.project(POINTS), (LEFT, RIGHT, THIRD), strict=True):
        assert np.abs(got - view._replace(D=np.append(view.D[:4], 0.0)).sees(POINTS)).max() < 1e-9
    done = convert_rig([tmp_path / "chain.yaml"], [tmp_path / "pair.yaml"], asked=Asked(names=("cam1", "cam2")))
    assert done.baseline_m == pytest.approx(np.linalg.norm(THIRD.t - THIRD.R @ RIGHT.R.T @ RIGHT.t), abs=1e-12)
    chain["cam2"]["camera_model"] = "new"
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(chain, default=float))))
    assert load_rig([tmp_path / "chain.yaml"], Asked(names=("cam0", "cam1"))).names == ("left", "right")
    with refuses(BadFile, "cam2", "camera_model", "new"):
        load_rig([tmp_path / "chain.yaml"])


def intrinsics(view, model, coeffs):
    (fx, _, ppx), (_, fy, ppy), _ = view.K.tolist()
    size = {"width": SIZE[0], "height": SIZE[1]}
    return size | {"fx": fx, "fy": fy, "ppx": ppx, "ppy": ppy, "model": model, "coeffs": list(coeffs)}


def modified(rays, coeffs):
    """Rays (n, 2) as bent by librealsense's rs2_project_point_to_pixel of the models inverse and modified."""
    k1, k2, p1, p2, k3 = coeffs
    r2 = (rays**2).sum(axis=1)
    x, y = (rays * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3)[:, None]).T
    shift = [2 * p1 * x * y + p2 * (r2 + 2 * x * x), 2 * p2 * x * y + p1 * (r2 + 2 * y * y)]
    return np.stack([x, y], axis=1) + np.stack(shift, axis=1)


@pytest.mark.parametrize("model", ["distortion.inverse_brown_conrady", "Modified Brown Conrady", 2, 4, "none"])
def test_a_realsenses_json_is_read_by_what_its_maker_projects(tmp_path, model):
    coeffs = (0.0,) * 5 if model == "none" else (-0.056, 0.068, -0.0007, 0.0009, -0.022)
    R, t = step(LEFT, RIGHT)
    content = {
        "infrared1": {"intrinsics": intrinsics(LEFT, model, coeffs)},
        "color": {"intrinsics": intrinsics(RIGHT, model, coeffs)},
        "infrared1_to_color": {"rotation": R.T.ravel().tolist(), "translation": t.tolist()},
    }
    (tmp_path / "rs.json").write_text(json.dumps(content))
    asked = Asked()
    rig = load_rig([tmp_path / "rs.json"], asked)
    for got, view in zip(rig.project(POINTS), (LEFT, RIGHT), strict=True):
        rays = POINTS @ view.R.T + view.t
        rays = rays[:, :2] / rays[:, 2:]
        if model == 4:
            want = view._replace(D=np.array(coeffs)).sees(POINTS)
        else:
            want = modified(rays, coeffs) * view.K.diagonal()[:2] + view.K[:2, 2]
        assert np.abs(got - want).max() < (0.02 if model not in (4, "none") else 1e-9)
    content["infrared1_to_color"]["rotation"] = R.tolist()
    (tmp_path / "rs.json").write_text(json.dumps(content))
    with refuses(BadFile, "column by column", "nine numbers"):
        load_rig([tmp_path / "rs.json"])


def test_what_rs_enumerate_devices_prints_is_read(tmp_path):
    half = (640, 360)
    head = "Device info: \n    Name  : \tIntel RealSense D435\n\nIntrinsic Parameters:\n\n"
    text = head + enumerated("Depth", LEFT) + enumerated("Depth", LEFT._replace(K=0.5 * LEFT.K), half)
    text += enumerated("Color", RIGHT) + enumerated("Infrared 1", LEFT) + "Extrinsic Parameters:\n"
    R, t = step(LEFT, RIGHT)
    text += (
        printed(np.eye(3), (0, 0, 0), "Depth", "Infrared 1") + printed(R, t) + printed(R.T, -R.T @ t, "Color", "Depth")
    )
    path = tmp_path / "rs.txt"
    path.write_text(text)
    with refuses(UsageError, "Depth", "1280x720", "640x360", "--size"):
        load_rig([path])
    with refuses(BadFile, "Depth", "Infrared 1", "same point"):
        load_rig([path], Asked(size=SIZE))
    rig = load_rig([path], Asked(size=SIZE, names=("Infrared 1", "Color")))
    for got, view in zip(rig.project(POINTS), (LEFT, RIGHT), strict=True):
        assert np.abs(got - view.sees(POINTS)).max() < 2e-3  # the tool prints rotations with six digits
    path.write_text(text + enumerated("Color", LEFT, form="Y16"))
    with refuses(UsageError, "Color", "raw and rectified"):
        load_rig([path], Asked(size=SIZE))
    path.write_text(text.replace("PPX:        \t640.5", "PPX:        \t640,5"))
    with refuses(BadFile, "damaged", "640,5"):
        load_rig([path], Asked(size=SIZE))


@pytest.mark.parametrize("new", [False, True])
def test_matlabs_pair_is_read_with_its_own_conventions(tmp_path, new):
    path = tmp_path / "stereo.mat"
    scipy.io.savemat(path, {"s": stereo(matlab(LEFT, new=new), matlab(RIGHT, new=new))})
    asked = Asked()
    for got, view in zip(load_rig([path], asked).project(POINTS), (LEFT, RIGHT), strict=True):
        assert np.abs(got - view.sees(POINTS)).max() < 1e-9
    assert names_it(asked.told, "mm", "WorldUnits")
    with refuses(BadFile, "ImageSize", "1280x720", "--size"):
        load_rig([path], Asked(size=(640, 480)))
    with refuses(UsageError, "WorldUnits", "--unit"):
        load_rig([path], Asked(unit_m=0.001))
    scipy.io.savemat(path, {"params": matlab(LEFT, new=new)})
    assert load_camera(path).intrinsics[2] == pytest.approx(LEFT.K[0, 2], abs=1e-12)


def test_what_matlabs_files_leave_open_is_asked_for(tmp_path):
    path = tmp_path / "stereo.mat"
    loose = {"WorldUnits": "squares", "ImageSize": np.zeros((0, 0))}
    scipy.io.savemat(path, {"s": stereo(matlab(LEFT, new=False, **loose), matlab(RIGHT, new=False, **loose))})
    with refuses(BadFile, "apart", "--unit 0.001"):
        load_rig([path], Asked(size=SIZE))
    with refuses(UsageError, "ImageSize", "--size"):
        load_rig([path], Asked(unit_m=0.001))
    rig = load_rig([path], Asked(size=SIZE, unit_m=0.001))
    assert rig.baseline_m == pytest.approx(np.linalg.norm(RIGHT.t), abs=1e-12)
    scipy.io.savemat(path, {"K1": LEFT.K.T, "K2": RIGHT.K.T, "R": np.eye(3), "T": np.ones(3)})
    with refuses(BadFile, "0 structs", "toStruct"):
        load_rig([path])
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM")
    with refuses(BadFile, "-v7"):
        load_rig([path])
    del (one := matlab(LEFT, new=True))["RadialDistortion"]
    scipy.io.savemat(path, {"s": stereo(one, matlab(RIGHT, new=True))})
    with refuses(BadFile, "RadialDistortion"):
        load_rig([path])
