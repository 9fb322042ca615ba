"""Two results of one kind: agreement as chance has it, what moved named with its sigma, other kinds refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadFile, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import preset
from armsight.ops.compare.calibrations import Value, differences, judged
from armsight.ops.files import compare
from armsight.ops.measurement.outputs import made_with
from armsight.ops.verify import verify
from armsight.optics import Camera, MountedCamera, Rig, RigKind
from armsight.records import NamedCovariance, Target, TargetKind
from armsight.store import read_rig, write_camera, write_rig
from armsight.store.arm_file import write_arm
from refusals import names_it, refuses

CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
KNOWN = NamedCovariance(names=("fx", "fy", "cx", "cy"), matrix=np.diag([0.4, 0.4, 0.3, 0.3]) ** 2)


def camera_file(folder, name, *, covariance=KNOWN, **moved):
    values = dict(zip(("fx", "fy", "cx", "cy"), CAMERA.intrinsics[:4].tolist(), strict=True))
    values = {key: value + moved.get(key, 0.0) for key, value in values.items()}
    file = folder / name
    write_camera(file, Camera.pinhole(640, 480, *values.values()), covariance=covariance, rms_px=0.1)
    return file


def poses_file(folder, name, seed, *, shift_m=0.0, start_s=0.0, std_m=1e-4, std_rad=1e-3):
    rng = np.random.default_rng(seed)
    lines = ["t_s,status,x_m,y_m,z_m,qx,qy,qz,qw,sx_m,sy_m,sz_m,srx_rad,sry_rad,srz_rad,spots"]
    for i in range(200):
        xyz = np.array([0.1 * np.cos(0.05 * i) + shift_m, 0.1 * np.sin(0.05 * i), 0.8]) + std_m * rng.standard_normal(3)
        turn = Rotation.from_rotvec(std_rad * rng.standard_normal(3)) * Rotation.from_euler("z", 0.05 * i)
        numbers = [start_s + i / 30, *xyz, *turn.as_quat(canonical=True)]
        text = [f"{numbers[0]:.9f}", "ok", *(f"{v:.12f}" for v in numbers[1:]), *[str(std_m)] * 3, *[str(std_rad)] * 3]
        lines.append(",".join([*text, "A B C"]))
    file = folder / name
    file.write_text("\n".join(lines) + "\n")
    return file


def test_chance_parts_results_as_often_as_p_says():
    rng = np.random.default_rng(1)
    mixed = rng.standard_normal((4, 4))
    C = [NamedCovariance(names=tuple("abcd"), matrix=mixed @ mixed.T * scale) for scale in (1.0, 0.3)]
    draws = [rng.multivariate_normal(np.zeros(4), one.matrix, 2000) for one in C]
    p = []
    for a, b in zip(*draws, strict=True):
        values = [Value(name=name, value=value, unit="m") for name, value in zip("abcd", a.tolist(), strict=True)]
        p.append(judged(differences(values, b.tolist(), *C), *C).p)
    assert np.allclose(np.quantile(p, [0.05, 0.25, 0.5, 0.75, 0.95]), [0.05, 0.25, 0.5, 0.75, 0.95], atol=0.05)


def test_a_moved_principal_point_is_named_with_its_sigma(tmp_path):
    a = camera_file(tmp_path, "a.yaml")
    same = compare(a=a, b=camera_file(tmp_path, "b.yaml", cx=0.3, fy=-0.3))
    assert same.agree
    assert names_it(same.verdict, "agrees", "A")
    moved = compare(a=a, b=camera_file(tmp_path, "c.yaml", cx=2.0))
    assert moved.agree is False
    assert names_it(moved.verdict, "cx", "2 px", f"{2.0 / np.hypot(0.3, 0.3):.1f} sigma")
    effects = {one.name: one.value for one in moved.effects}
    assert effects["shift at the worst corner"] == pytest.approx(2.0, abs=1e-6)


def test_what_has_no_uncertainty_is_not_called_equal(tmp_path):
    a, b = (camera_file(tmp_path, f"{n}.yaml", covariance=None, cx=n) for n in (0.0, 1.0))
    silent = compare(a=a, b=b)
    assert silent.agree is None and silent.p is None
    known = NamedCovariance(names=("fx", "fy"), matrix=np.diag([0.4, 0.4]) ** 2)
    a, b = (camera_file(tmp_path, f"{n}.yaml", covariance=known, cx=n) for n in (0.0, 1.0))
    partly = compare(a=a, b=b)
    assert partly.agree is None
    assert names_it(partly.verdict, "cx", "sure")


def test_a_longer_baseline_shows_where_points_are_measured(tmp_path):
    files = []
    for baseline_m in (0.12, 0.1206):
        T = RigidTransform.from_translation([baseline_m, 0.0, 0.0])
        known = NamedCovariance(names=("right.tx",), matrix=np.array([[1e-5**2]]))
        rig = Rig(
            kind=RigKind.STEREO,
            left=CAMERA,
            right=CAMERA,
            T_rig_left=RigidTransform.identity(),
            T_rig_right=T,
            rms_px=0.1,
            covariance=known,
        )
        files.append(tmp_path / f"{baseline_m}.yaml")
        write_rig(files[-1], rig)
    done = compare(a=files[0], b=files[1], distance_m=1.0)
    effects = {one.name: one.value for one in done.effects}
    assert names_it(done.verdict, "right.tx", "0.6 mm")
    assert effects["baseline of B over A, less one"] == pytest.approx(0.005)
    assert 5e-3 < effects["points measured at 1 m, RMS"] < 6.5e-3  # 0.5 % of the distance from the left camera


def three(seed, *, top_m=0.0, order=("a", "b", "top")):
    """Three cameras that look at one place, a little off by chance, `top` moved along x."""
    rng, std = np.random.default_rng(seed), 1e-4
    cameras = []
    for i, (name, turn) in enumerate((("a", 0.0), ("b", 0.5), ("top", -0.5))):
        R = Rotation.from_euler("y", -turn)
        place = np.array([0.0, 0.0, 1.0]) - R.apply([0.0, 0.0, 1.0]) + (i > 0) * std * rng.standard_normal(3)
        place[0] += top_m * (name == "top")
        R = Rotation.from_rotvec((i > 0) * std * rng.standard_normal(3)) * R
        cameras.append(MountedCamera(name=name, camera=CAMERA, T_rig_camera=RigidTransform.from_components(place, R)))
    names = Rig(cameras=tuple(cameras)).parameters  # the lenses first, then the places of b and top
    stds = np.r_[np.full(len(names) - 12, 1e-6), np.full(12, std)]
    known = NamedCovariance(names=names, matrix=np.diag(stds**2))
    return Rig(cameras=tuple(cameras), covariance=known).only(*order)


def measured_off(a, b):
    """How far all cameras of b that see a point of a plane 1 m before a's first one put it from there, RMS."""
    off = []
    for u, v in np.stack(np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 9)), axis=-1).reshape(-1, 2):
        point = np.array([(u - 320.0) / 500.0, (v - 240.0) / 500.0, 1.0])
        seen = [np.array([u, v]), *(picture(one, point) for one in a.cameras[1:])]
        shown = [k for k, uv in enumerate(seen) if k == 0 or ((uv > -0.5) & (uv < [639.5, 479.5])).all()]
        if len(shown) > 1:
            found = least_squares(
                lambda x, shown=shown, seen=seen: np.concatenate([picture(b.cameras[k], x) - seen[k] for k in shown]),
                point,
                xtol=1e-15,
            )
            off.append(np.sum((found.x - point) ** 2))
    return np.sqrt(np.mean(off))


def picture(one, point):
    """A point in a camera's picture; a's first camera holds the axes."""
    x, y, z = one.T_rig_camera.inv().apply(point)
    return np.array([320.0 + 500.0 * x / z, 240.0 + 500.0 * y / z])


def test_rigs_of_several_cameras_are_compared_by_name_whatever_their_order(tmp_path):
    for name, rig in (
        ("a", three(1)),
        ("b", three(2, order=("top", "a", "b"))),
        ("moved", three(3, top_m=0.002)),
        ("two", three(2).only("a", "top")),
    ):
        write_rig(tmp_path / f"{name}.yaml", rig)
    same = compare(a=tmp_path / "a.yaml", b=tmp_path / "b.yaml")
    assert same.agree
    moved = compare(a=tmp_path / "a.yaml", b=tmp_path / "moved.yaml")
    assert moved.agree is False and names_it(moved.verdict, "top.tx")
    effects = {one.name: one.value for one in moved.effects}
    far, near = (effects[f"a, {name}: points measured at 1 m, RMS"] for name in ("top", "b"))
    assert 2.0 * near < far < 0.02  # 2 mm across sight lines that cross at half a radian
    whole = effects["points measured at 1 m, RMS"]
    assert names_it(moved.verdict, f"points measured at 1 m, RMS {1e3 * whole:.3g} mm")  # the rig's, of no pair
    assert whole == pytest.approx(measured_off(three(1), three(3, top_m=0.002)), rel=1e-4)
    with refuses(Inconsistent, "a, top", "a, b, top"):
        compare(a=tmp_path / "a.yaml", b=tmp_path / "two.yaml")


def test_arms_are_compared_where_their_tool_goes(tmp_path):
    arm = preset("irb120")
    longer = replace(arm, joints=(replace(arm.joints[0], d_m=arm.joints[0].d_m + 1e-3), *arm.joints[1:]))
    for name, one in (("a.yaml", arm), ("b.yaml", longer), ("c.yaml", preset("ur10"))):
        write_arm(tmp_path / name, one)
    done = compare(a=tmp_path / "a.yaml", b=tmp_path / "b.yaml")
    assert done.agree is None
    assert {one.name: one.value for one in done.effects}["tool apart, largest"] == pytest.approx(1e-3, rel=1e-6)
    assert [one.name for one in done.parameters if one.difference] == ["joint 1 d_m"]


def test_measurements_agree_where_their_noise_is_as_claimed(tmp_path):
    a = poses_file(tmp_path, "a.csv", 1)
    done = compare(a=a, b=poses_file(tmp_path, "b.csv", 2))
    assert done.agree and done.n == 200
    assert {one.name: one.value for one in done.effects}["inside their 95 % ellipsoid"] > 0.9
    apart = compare(a=a, b=poses_file(tmp_path, "c.csv", 3, shift_m=5e-4))
    assert apart.agree is False
    assert next(one for one in apart.parameters if one.name == "mean x_m").difference == pytest.approx(5e-4, abs=5e-5)
    with refuses(NotEnoughData, "one moment"):
        compare(a=a, b=poses_file(tmp_path, "d.csv", 4, start_s=1000.0))


def test_other_kinds_and_other_things_are_refused(tmp_path):
    camera, other = camera_file(tmp_path, "camera.yaml"), tmp_path / "small.yaml"
    write_camera(other, Camera.pinhole(320, 240, 250.0, 250.0, 160.0, 120.0), rms_px=0.1)
    with refuses(Inconsistent, "camera", "measure"):
        compare(a=camera, b=poses_file(tmp_path, "a.csv", 1))
    with refuses(Inconsistent, "640x480", "320x240"):
        compare(a=camera, b=other)
    (tmp_path / "empty").mkdir()
    with refuses(UsageError, "one result"):
        compare(a=camera, b=tmp_path / "empty")
    (tmp_path / "odd.yaml").write_text("format: armsight/odd\nversion: 1\n")
    with refuses(BadFile, "armsight/odd", "compared"):
        compare(a=camera, b=tmp_path / "odd.yaml")
    (tmp_path / "odd.yaml").write_text("arm: ur5e\n")
    with refuses(BadFile, "odd.yaml", "format:", "armsight/camera"):
        compare(a=tmp_path / "odd.yaml", b=camera)
    (tmp_path / "odd.yaml").write_text("camera_name: left\ncamera_matrix: {rows: 3, cols: 3}\n")
    with refuses(BadFile, "ros", "armsight.convert"):
        compare(a=tmp_path / "odd.yaml", b=camera)


def run_folder(folder, seed, rig, target=None):
    """A folder of measure: poses, and the summary's part on what they were measured with."""
    folder.mkdir()
    poses_file(folder, "poses.csv", seed)
    told = made_with(rig, target or beacons(0.1))
    (folder / "measure.json").write_text(json.dumps({"n_frames": 200, "made_with": told.to_dict()}))
    return folder


def beacons(width_m):
    xyz = [[0.0, 0.0, 0.0], [width_m, 0.0, 0.0], [0.0, 0.05, 0.0]]
    return Target(kind=TargetKind.SPOTS, names=("A", "B", "C"), xyz_m=np.array(xyz))


def pair(baseline_m):
    right = RigidTransform.from_translation([baseline_m, 0.0, 0.0])
    eye = RigidTransform.identity()
    return Rig(kind=RigKind.STEREO, left=CAMERA, right=CAMERA, T_rig_left=eye, T_rig_right=right)


def test_another_rig_or_target_is_told(tmp_path):
    write_rig(tmp_path / "rig.yaml", pair(0.12))
    again = replace(read_rig(tmp_path / "rig.yaml"), rms_px=0.3)  # what a file adds changes nothing
    a = run_folder(tmp_path / "a", 1, pair(0.12))
    same = compare(a=a, b=run_folder(tmp_path / "b", 2, again))
    assert (same.same_rig, same.same_target) == (True, True)
    assert "another" not in same.verdict and names_it(same.notes[0], "rig", "target")
    other = compare(a=a, b=run_folder(tmp_path / "c", 3, pair(0.1201), beacons(0.1001)))
    assert (other.same_rig, other.same_target) == (False, False)
    assert names_it(other.verdict, "another rig", "another target")
    bare = compare(a=a, b=poses_file(tmp_path, "bare.csv", 4))
    assert bare.same_rig is None and "recorded" in bare.notes[0]
    assert "same_rig" not in bare.to_dict()
    (a / "measure.json").write_text("{")
    with refuses(BadFile, "summary", "measurement"):
        compare(a=a, b=tmp_path / "b")


def handeye_file(folder, name, *, moved_m=0.0, setup="eye-in-hand"):
    """A handeye.yaml with 0.2 mm and 0.5 mrad on the camera's pose."""
    camera, target = ("flange", "base") if setup == "eye-in-hand" else ("base", "flange")
    names = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"]
    matrix = np.diag([2e-4**2] * 3 + [5e-4**2] * 3).tolist()
    pose = "{xyz_m: [%s, 0.0, 0.1], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}"
    lines = [
        "format: armsight/handeye",
        "version: 1",
        f"setup: {setup}",
        f"T_{camera}_camera: {pose % (0.05 + moved_m)}",
        f"T_{target}_target: {pose % 0.8}",
        f"covariance: {{names: {json.dumps([f'camera.{one}' for one in names])}, matrix: {json.dumps(matrix)}}}",
    ]
    file = folder / name
    file.write_text("\n".join(lines) + "\n")
    return file


def test_a_camera_knocked_on_the_hand_is_named(tmp_path):
    a = handeye_file(tmp_path, "a.yaml")
    same = compare(a=a, b=handeye_file(tmp_path, "b.yaml", moved_m=1e-4))
    assert same.kind == "handeye" and same.agree
    moved = compare(a=a, b=handeye_file(tmp_path, "c.yaml", moved_m=2e-3), out=tmp_path / "out")
    first = max(moved.parameters, key=lambda one: abs(one.sigmas or 0.0))
    assert moved.agree is False and first.sigmas == pytest.approx(2e-3 / np.hypot(2e-4, 2e-4), rel=1e-6)
    assert {one.name: one.value for one in moved.effects}["camera moved by"] == pytest.approx(2e-3, rel=1e-9)
    assert "hand-eye calibrations" in (tmp_path / "out/report.html").read_text()
    with refuses(Inconsistent, "eye-in-hand", "eye-to-hand"):
        compare(a=a, b=handeye_file(tmp_path, "d.yaml", setup="eye-to-hand"))


def verify_folder(folder, seed, *, scatter_m=3e-5):
    """A folder of verify: thirty visits of two poses."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    lines = ["pose,visit,x_m,y_m,z_m"]
    for visit in range(30):
        for name, x_m in (("P1", 0.3), ("P2", 0.6)):
            x, y, z = np.array([x_m, 0.1, 0.4]) + scatter_m * rng.standard_normal(3)
            lines.append(f"{name},{visit},{x},{y},{z}")
    (folder / "visits.csv").write_text("\n".join(lines) + "\n")
    verify(measured=folder / "visits.csv", out=folder)
    return folder


def test_verifications_agree_until_an_arm_scatters_more(tmp_path):
    a = verify_folder(tmp_path / "a", 1)
    same = compare(a=a, b=verify_folder(tmp_path / "b", 2))
    assert same.kind == "verify" and same.agree
    worn = compare(a=a, b=verify_folder(tmp_path / "c", 3, scatter_m=9e-5))
    assert worn.agree is False and "RP" in worn.verdict
    names = {one.name: one for one in worn.parameters}
    assert names["RP_m"].b == pytest.approx(3.0 * names["RP_m"].a, rel=0.35)
    assert same.same_rig is None and "same_rig" not in same.to_dict()
    (a / "verify.json").write_text("{}")
    with refuses(BadFile, "summary", "verification"):
        compare(a=a, b=tmp_path / "b")
