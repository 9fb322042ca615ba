"""Cameras' files of devices and other programs hold the cameras that OpenCV projects their world by."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import BadFile, UsageError
from armsight.geometry import is_close
from armsight.ops.arm_files import load_arm
from armsight.ops.conversion import convert_camera, convert_rig, load_camera, load_rig
from armsight.ops.file_kinds import listing, pointed_elsewhere
from armsight.ops.tables import convert_table
from armsight.records import NamedCovariance
from armsight.store import write_rig
from armsight.store.foreign import FORMATS, READ, Asked, kind_of
from foreign_cameras import (
    LEFT,
    POINTS,
    RIGHT,
    SIZE,
    THIRD,
    aniposelib,
    caliscope,
    depthai,
    halcon,
    multical,
    step,
    zed,
)
from refusals import names_it, refuses


def is_read(views, path, *, scale=1.0, tolerance_px=1e-6, **asked):
    """Hold a rig that is read to the pixels that OpenCV gives; its axes are the first view's."""
    rig = load_rig([path], Asked(**asked))
    first = views[0]
    seen = rig.project(scale * (POINTS @ first.R.T + first.t))
    for got, view in zip(seen, views, strict=True):
        assert np.abs(got - view.sees(POINTS)).max() < tolerance_px
    return rig


@pytest.mark.parametrize("rational", [False, True])
def test_a_zeds_file_is_read_at_the_size_that_is_said(tmp_path, rational):
    path = zed(tmp_path / "SN1.conf", rational=rational)
    rig = is_read((LEFT, RIGHT), path, size=SIZE)
    assert rig.names == ("left", "right")
    assert convert_rig([path], [tmp_path / "rig.yaml"], asked=Asked(size=SIZE)).baseline_m == pytest.approx(
        0.119902, abs=1e-6
    )
    with refuses(UsageError, "1280x720", "672x376", "--size"):
        load_rig([path])
    with refuses(UsageError, "mm", "Leave --unit out"):
        load_rig([path], Asked(size=SIZE, unit_m=0.001))


def test_a_zeds_first_files_say_less_and_a_line_less_is_refused(tmp_path):
    path = zed(tmp_path / "SN1.conf")
    first = re.sub(r"^(p1|p2|k3|TY|TZ)=.*\n", "", path.read_text(), flags=re.MULTILINE).replace("Baseline", "BaseLine")
    for text, own in ((path.read_text(), ()), (first, ("without TY and TZ",))):
        path.write_text(text)
        asked = Asked(size=SIZE)
        rig = load_rig([path], asked)
        assert len(asked.told) == len(own) and all(said in told for said, told in zip(own, asked.told, strict=True))
        R, t = step(LEFT, RIGHT)
        t = t * (1.0, not own, not own)
        X = POINTS + np.array([0.0, 0.0, 1.0])
        for camera, r, shift, view in zip(rig.cameras, (np.eye(3), R), (0.0 * t, t), (LEFT, RIGHT), strict=True):
            D = view.D * (1, 1, not own, not own, not own)
            want = cv2.projectPoints(X, cv2.Rodrigues(r)[0], shift, view.K, D)[0].reshape(-1, 2)
            inside = camera.T_rig_camera.inv().apply(X)
            assert np.abs(camera.camera.project(inside) - want).max() < 1e-6
        for gone in re.findall(r"^(?:k\d|p\d|TY|TZ|Base[Ll]ine)=.*\n", text, flags=re.MULTILINE):
            path.write_text(text.replace(gone, "", 1))
            with pytest.raises(BadFile):
                load_rig([path], Asked(size=SIZE))


def test_the_two_lenses_of_a_newer_zed_are_held_against_each_other_and_its_prism_is_not_left_out(tmp_path):
    path, asked = zed(tmp_path / "SN1.conf", rational=True), Asked(size=SIZE)
    path.write_text(path.read_text().replace("k4=0\n", "k4=0.01\n", 1))
    load_rig([path], asked)
    assert names_it(asked.told[0], "LEFT_DISTO", "LEFT_CAM_HD", "px")
    assert len(asked.told) == 1
    path.write_text(path.read_text().replace("k6=0\n", "k6=0\ns1=0.02\ns2=0\ns3=0\ns4=0\n", 1))
    with refuses(BadFile, "thin prism", "--approximate"):
        load_rig([path], Asked(size=SIZE))


def test_the_cameras_of_a_depthai_board_are_chained_as_measured(tmp_path):
    path = depthai(tmp_path / "oak.json")
    rig = is_read((THIRD, LEFT, RIGHT), path)
    assert rig.names == ("CAM_A", "CAM_B", "CAM_C")
    is_read((LEFT, RIGHT), path, names=("CAM_B", "CAM_C"))
    assert load_camera(path, Asked(names=("CAM_C",))).intrinsics[0] == RIGHT.K[0, 0]
    with refuses(UsageError, "CAM_A, CAM_B, CAM_C", "--name"):
        load_camera(path)
    with refuses(UsageError, "CAM_Z", "CAM_A"):
        load_rig([path], Asked(names=("CAM_Z",)))
    with refuses(BadFile, "1280x720", "cutting"):
        load_camera(path, Asked(names=("CAM_C",), size=(640, 400)))
    with refuses(UsageError, "CAM_D"):
        load_rig([path], Asked(names=("CAM_D",)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cameraType": 2}, "equirectangular"),
        ({"distortionCoeff": [0.1] * 9}, "9 coefficients"),
        ({"width": 0}, "width"),
        ({"extrinsics": {"toCameraSocket": 1}}, "circle"),
        ({"extrinsics": {"toCameraSocket": 2, "rotationMatrix": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]}}, "rotation"),
    ],
)
def test_what_a_board_cannot_mean_is_refused(tmp_path, changes, says):
    with refuses(BadFile, "CAM_B" if says != "circle" else "circle", says):
        load_rig([depthai(tmp_path / "oak.json", **changes)])


@pytest.mark.parametrize("write", [aniposelib, caliscope, multical])
def test_rigs_of_other_calibrations_are_read_and_written(tmp_path, write):
    kind, path = write.__name__, tmp_path / "cameras"
    write(path, (LEFT, RIGHT, THIRD))
    assert kind_of(path) == kind
    rig = is_read((LEFT, RIGHT, THIRD), path)
    assert rig.names == (("cam0", "cam1", "cam2") if write is caliscope else ("c0", "c1", "c2"))
    done = convert_rig([path], [tmp_path / "back"], to=kind)
    assert done.baseline_m == pytest.approx(0.119902, abs=1e-6)
    is_read((LEFT, RIGHT, THIRD), tmp_path / "back")
    write(path, (LEFT, RIGHT, THIRD), unit=1000.0)
    with refuses(BadFile, "apart", "--unit 0.001"):
        load_rig([path])
    is_read((LEFT, RIGHT, THIRD), path, unit_m=0.001)


def test_poses_of_multical_are_followed_from_camera_to_camera(tmp_path):
    multical(tmp_path / "c.json", (RIGHT, LEFT, THIRD))
    content = json.loads((tmp_path / "c.json").read_text())
    R = THIRD.R @ LEFT.R.T
    content["camera_poses"] = {
        "c0": {"R": RIGHT.R.tolist(), "T": RIGHT.t.tolist()},
        "c2_to_c1": {"R": R.tolist(), "T": (THIRD.t - R @ LEFT.t).tolist()},
        "c1_to_c0": {"R": RIGHT.R.T.tolist(), "T": (-RIGHT.R.T @ RIGHT.t).tolist()},
    }
    (tmp_path / "c.json").write_text(json.dumps(content))
    is_read((RIGHT, LEFT, THIRD), tmp_path / "c.json")
    del content["camera_poses"]["c1_to_c0"]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with refuses(BadFile, "no pose of c1, c2", "--name c0"):
        load_rig([tmp_path / "c.json"])


def frame_of_agisoft(xy, *, f, cx, cy, b1, b2, k, p):
    """u, v by the manual's formulas, the first pixel's centre at (0.5, 0.5)."""
    x, y = xy.T
    r2 = x**2 + y**2
    radial = 1.0 + sum(value * r2 ** (j + 1) for j, value in enumerate(k))
    x2 = x * radial + p[0] * (r2 + 2 * x**2) + 2 * p[1] * x * y
    y2 = y * radial + p[1] * (r2 + 2 * y**2) + 2 * p[0] * x * y
    return np.stack([0.5 * SIZE[0] + cx + x2 * f + x2 * b1 + y2 * b2, 0.5 * SIZE[1] + cy + y2 * f], axis=1)


@pytest.mark.parametrize(("k4", "tolerance_px"), [(0.0, 1e-9), (0.0006, 0.05)])
def test_metashapes_frame_camera_is_read_by_its_own_formulas(tmp_path, k4, tolerance_px):
    given = {"f": 700.5, "cx": 1.5, "cy": -2.5, "b1": 0.4, "b2": -0.3}
    k, p = (-0.1, 0.03, -0.002, k4), (0.001, -0.0004)
    values = given | {f"k{j + 1}": value for j, value in enumerate(k)} | {"p1": p[0], "p2": p[1]}
    tags = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
    path = tmp_path / "meta.xml"
    path.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration><projection>frame</projection><width>{SIZE[0]}</width>'
        f"<height>{SIZE[1]}</height>{tags}</calibration>"
    )
    camera = load_camera(path)
    xy = np.random.default_rng(3).uniform((-0.8, -0.45), (0.8, 0.45), (200, 2))
    uv = frame_of_agisoft(xy, **given, k=k, p=p) - 0.5
    inside = ((uv >= 0.0) & (uv <= np.array(SIZE) - 1.0)).all(axis=1)
    assert inside.sum() > 100
    assert np.abs(camera.project(np.column_stack([xy, np.ones(200)])) - uv)[inside].max() < tolerance_px
    more = '<corrections type="fourier"><coeffs>-6.4e-02 3.5e-02</coeffs></corrections></calibration>'
    path.write_text(path.read_text().replace("</calibration>", more))
    with refuses(BadFile, "additional corrections", "Fit additional"):
        load_camera(path)


def test_halcons_division_and_polynomial_lenses_are_read(tmp_path):
    path = tmp_path / "campar.dat"
    uv = np.random.default_rng(4).uniform((0.0, 0.0), (767.0, 575.0), (200, 2))
    for lens in ({"Kappa": -1500.0}, {"Kappa": -9000.0}, {"K1": 900.0, "K2": 2e7, "K3": 0.0, "P1": 0.05, "P2": -0.02}):
        of = halcon(path, **lens)
        x, y = ((uv - (of["Cx"], of["Cy"])) * of["Sx"]).T
        r2 = x**2 + y**2
        if "Kappa" in lens:
            straight = np.stack([x, y], axis=1) / (1.0 + lens["Kappa"] * r2)[:, None]
            bent = 2.0 * straight / (1.0 + np.sqrt(1.0 - 4.0 * lens["Kappa"] * (straight**2).sum(axis=1)))[:, None]
            assert np.allclose(bent, np.stack([x, y], axis=1), atol=1e-15)  # the reference's formula, from ray to pixel
        else:
            factor = 1.0 + lens["K1"] * r2 + lens["K2"] * r2**2
            straight = np.stack(
                [
                    x * factor + lens["P1"] * (r2 + 2 * x**2) + 2 * lens["P2"] * x * y,
                    y * factor + 2 * lens["P1"] * x * y + lens["P2"] * (r2 + 2 * y**2),
                ],
                axis=1,
            )
        rays = np.column_stack([straight / of["Focus"], np.ones(200)])
        assert np.abs(load_camera(path).project(rays) - uv).max() < 0.05
    of = halcon(path, Kappa=-9000.0)
    by_text = load_camera(path).intrinsics
    units = {"Focus": 1e3, "Kappa": 1e-6, "Sx": 1e3, "Sy": 1e3, "Cx": 1.0, "Cy": 1.0}
    numbers = struct.pack(">6d2i", *(unit * of[name] for name, unit in units.items()), 768, 576)
    path.write_bytes(b"HCPR" + bytes.fromhex("0003000000000000000008") + numbers)
    assert kind_of(path) == "halcon"
    assert load_camera(path).intrinsics == pytest.approx(by_text, rel=1e-9)
    for spoiled in (path.read_bytes()[:-1], path.read_bytes().replace(b"R\0\3", b"R\0\4")):
        path.write_bytes(spoiled)
        with refuses(BadFile, "binary form", "read_cam_par"):
            load_camera(path)
    halcon(path, Kappa=-60000.0)
    with refuses(BadFile, "nearest", "--approximate"):
        load_camera(path)
    done = convert_camera(path, tmp_path / "camera.yaml", asked=Asked(approximate=True))
    assert names_it(done.note, "nearest", "px apart")


def test_a_rig_of_colmap_is_read_and_written(tmp_path):
    lines = ["# Camera list with one line of data per camera:"]
    for k, view in enumerate((LEFT, RIGHT, THIRD), 1):
        (fx, _, cx), (_, fy, cy), _ = view.K
        lens = " ".join(str(x) for x in view.D)
        lines.append(f"{k} FULL_OPENCV {SIZE[0]} {SIZE[1]} {fx} {fy} {cx + 0.5} {cy + 0.5} {lens} 0 0 0")
    (tmp_path / "cameras.txt").write_text("\n".join([*lines, "9 FOV 640 480 1 2 3 4 5", ""]))
    rig = "# Rig calib list with one line of data per calib:\n1 4 CAMERA 1 IMU 7 0"
    for k, view in ((2, RIGHT), (3, THIRD)):
        x, y, z, w = Rotation.from_rotvec(view.r).as_quat()
        rig += f" CAMERA {k} 1 {w} {x} {y} {z} " + " ".join(str(10.0 * t) for t in view.t)
    (tmp_path / "rigs.txt").write_text(rig + "\n")
    files = [tmp_path / "cameras.txt", tmp_path / "rigs.txt"]
    with refuses(BadFile, "camera 9", "FOV", "OPENCV"):
        load_camera(files[0], Asked(names=("9",)))  # which no rig of the file has
    with refuses(UsageError, "unit", "--unit 1"):
        load_rig(files)
    convert_rig(files, [tmp_path / "rig.yaml"], asked=Asked(unit_m=0.1))
    back = [tmp_path / "c.txt", tmp_path / "r.txt"]
    convert_rig([tmp_path / "rig.yaml"], back, to="colmap")
    for paths, unit_m in ((files, 0.1), (back, 1.0)):
        for got, view in zip(load_rig(paths, Asked(unit_m=unit_m)).project(POINTS), (LEFT, RIGHT, THIRD), strict=True):
            assert np.abs(got - view.sees(POINTS)).max() < 1e-6
    files[1].write_text(rig.replace(" 1 ", " 2 ", 1) + " CAMERA 4 1 1 0 0\n")
    with refuses(BadFile, "rigs.txt"):
        load_rig(files, Asked(unit_m=0.1))


def test_every_kind_that_is_read_has_a_case_here_or_of_its_own_program():
    here = {"zed", "depthai", "aniposelib", "caliscope", "multical", "metashape", "halcon", "colmap"}
    there = {"realsense", "matlab"}  # tests/golden/test_camera_models.py
    assert set(READ) == here | there | {"ros", "opencv", "kalibr"}  # tests/golden/test_foreign_files.py


def test_two_cameras_of_a_larger_rig_become_a_pair_with_their_covariance(tmp_path):
    aniposelib(tmp_path / "c.toml", (LEFT, RIGHT, THIRD))
    rig = load_rig([tmp_path / "c.toml"])
    A = np.random.default_rng(2).normal(size=(42, 50))
    known = replace(rig, covariance=NamedCovariance(names=rig.parameters, matrix=1e-8 * A @ A.T))
    write_rig(tmp_path / "rig.yaml", known)
    done = convert_rig([tmp_path / "rig.yaml"], [tmp_path / "pair.yaml"], asked=Asked(names=("c2", "c1")))
    assert names_it(done.note, "c2", "c1", "left", "right")
    pair, part = load_rig([tmp_path / "pair.yaml"]), known.only("c2", "c1")
    assert pair.names == ("left", "right") and is_close(pair.T_rig_right, rig.T_rig_camera("c1"), tol_m=0, tol_rad=0)
    renamed = [name.replace("c2.", "left.").replace("c1.", "right.") for name in part.covariance.names]
    order = [renamed.index(name) for name in pair.covariance.names]
    assert np.allclose(pair.covariance.matrix, part.covariance.matrix[np.ix_(order, order)], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cam0:\n  camera_model: pinhole\n  intrinsics: [1, 2\n", ("Kalibr", "line 4")),
        ("Camera-system parameters:\n\tcam0 (/c):\n", ("camchain.yaml",)),
        ("time,x,y\n0,1.5,2\n", ("convert table",)),
        ('<robot name="r">\n  <link name="a"/>\n</robot>\n', ("URDF", "convert arm")),
        ("nothing known\n", ("convert --list",)),
    ],
)
def test_an_unknown_file_is_answered_with_the_nearest_kinds(tmp_path, text, says):
    (tmp_path / "file.dat").write_text(text)
    with refuses(BadFile, "file.dat", *says):
        load_rig([tmp_path / "file.dat"])


def test_a_file_given_to_another_command_is_sent_to_its_own(tmp_path):
    path = zed(tmp_path / "SN1.conf")
    with refuses(BadFile, "SN1.conf", "convert rig"), pointed_elsewhere(path, "convert table"):
        convert_table(path)
    with refuses(BadFile, "SN1.conf", "convert rig"), pointed_elsewhere(path, "convert arm"):
        load_arm(str(path))


def test_the_list_and_the_guide_name_every_kind_that_is_known():
    lines = list(listing())
    guide = (Path(__file__).parents[2] / "docs" / "guide" / "camera-files.md").read_text()
    for name, one in FORMATS.items():
        (line,) = (line for line in lines if line.split()[0] == name)
        both = one.write_rig is not None
        assert one.title in line and one.needs in line and ("written" in line) == both
        (row,) = (row for row in guide.splitlines() if row.startswith(f"| {name} |"))
        assert ("both" in row.split("|")[5]) == both
    for command in ("convert rig", "convert table", "convert arm", "convert poses", "convert recording"):
        assert any(line.endswith(command) for line in lines)
