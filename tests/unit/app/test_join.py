"""A joint log and measurements on clocks apart: the offset found, and the tables that calibrations read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import Setup
from armsight.kinematics import fk, preset
from armsight.ops.files import join
from armsight.store import read_poses, write_poses
from armsight.store.arm_points import read_arm_points
from armsight.store.handeye_file import read_pairs
from armsight.verify.pairing import bare_arm

ARM = bare_arm(preset("ur10"))
LEAD_S = 1_700_000_003.417
"""What the measurements' clock is ahead of the robot's: seconds since 1970 against seconds since it was switched on."""
T_rig_base = RigidTransform.from_components([0.4, -0.2, 2.0], Rotation.from_rotvec([0.3, -1.2, 0.4]))
T_flange_target = RigidTransform.from_components([0.02, 0.03, 0.15], Rotation.from_rotvec([0.5, 0.1, -0.3]))


def joints_at(t: np.ndarray) -> np.ndarray:
    """Irregular motion (m, 6) with rests: time stands still for the third second of every six."""
    phase = t % 6.0
    moved = 5.0 * (t // 6.0) + np.where(phase < 2.0, phase, np.where(phase < 3.0, 2.0, phase - 1.0))
    rates = np.array([0.31, 0.53, 0.47, 0.71, 0.43, 0.61])
    smooth = moved - np.sin(2.0 * np.pi * moved) / (2.0 * np.pi)  # whole seconds begin and end at rest
    middle = np.array([0.3, -1.2, 1.4, -0.6, 0.9, 0.2])
    return middle + 0.5 * np.sin(np.outer(smooth, rates) + np.arange(6))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with joints.csv (50 Hz, degrees), flange.csv, poses.csv and points.csv (12 Hz, another clock)."""
    folder, rng = tmp_path_factory.mktemp("join"), np.random.default_rng(4)
    t = np.arange(20.0, 36.0, 0.02)
    degrees = np.degrees(joints_at(t))
    names = ",".join(f"q{i + 1}_deg" for i in range(6))
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in np.column_stack([t, degrees]))
    (folder / "joints.csv").write_text(f"t_s,{names}\n{rows}\n")
    F = RigidTransform.from_matrix(fk(ARM, joints_at(t)))
    xyzq = np.column_stack([t, F.translation, F.rotation.as_quat()])
    head = "t_s,x_m,y_m,z_m,qx,qy,qz,qw"
    (folder / "flange.csv").write_text(head + "\n" + "\n".join(",".join(map(repr, map(float, r))) for r in xyzq) + "\n")
    s = np.arange(22.0, 34.5, 1.0 / 12.0)
    seen = T_rig_base * RigidTransform.from_matrix(fk(ARM, joints_at(s))) * T_flange_target
    xyz = seen.translation + 1e-4 * rng.standard_normal((len(s), 3))
    turned = Rotation.from_rotvec(5e-4 * rng.standard_normal((len(s), 3))) * seen.rotation
    table = np.column_stack([s + LEAD_S, xyz, turned.as_quat()])
    lines = [",".join(map(repr, map(float, row))) for row in table]
    (folder / "poses.csv").write_text("\n".join([head, *lines]) + "\n")
    points = [",".join(line.split(",")[:4]) for line in lines]
    (folder / "points.csv").write_text("\n".join(["t_s,x_m,y_m,z_m", *points]) + "\n")
    inverse = RigidTransform.from_components(xyz, turned).inv()
    table = np.column_stack([s + LEAD_S, inverse.translation, inverse.rotation.as_quat()])
    lines = [",".join(map(repr, map(float, row))) for row in table]
    (folder / "moved.csv").write_text("\n".join([head, *lines]) + "\n")
    return folder


def check_points(path: Path, tolerance_m: float) -> int:
    points = read_arm_points(path)
    want = T_rig_base * RigidTransform.from_matrix(fk(ARM, points.q)) * T_flange_target
    assert np.linalg.norm(points.xyz_m - want.translation, axis=1).max() < tolerance_m
    return len(points.q)


def test_points_of_a_joint_log_in_degrees_on_another_clock(run: Path, tmp_path: Path) -> None:
    known = {"out": tmp_path / "out.csv", "joints": run / "joints.csv", "arm": "ur10"}
    done = join(run / "points.csv", kind="observed", **known)
    assert done.by == "time" and done.n > 0.9 * done.n_measured
    assert done.offset_std_s is not None and done.offset_std_s < 1e-3
    assert done.offset_s == pytest.approx(-LEAD_S, abs=max(1e-3, 4.0 * done.offset_std_s))
    assert check_points(tmp_path / "out.csv", 2e-3) == done.n
    assert (tmp_path / "out.csv").read_text().startswith("q1,q2,q3,q4,q5,q6,x_m,y_m,z_m\n")


def test_one_row_for_each_rest(run: Path, tmp_path: Path) -> None:
    known = {"out": tmp_path / "p.csv", "joints": run / "joints.csv", "arm": "ur10"}
    done = join(run / "poses.csv", still=True, offset_s=-LEAD_S, **known)
    assert 2 <= done.n < 10
    assert check_points(tmp_path / "p.csv", 2.5e-4) == done.n  # means of noise of 0.1 mm
    assert (tmp_path / "p.csv").read_text().startswith("q1,q2,q3,q4,q5,q6,x_m,y_m,z_m,qx,qy,qz,qw,t_s\n")


@pytest.mark.parametrize(("setup", "by"), [(Setup.EYE_IN_HAND, "joints"), (Setup.EYE_TO_HAND, "stream")])
def test_pairs_for_the_hand_eye_calibration(run: Path, tmp_path: Path, setup: Setup, by: str) -> None:
    # the same run seen the other way round is a camera on the hand: T_camera_target = T_target_rig of the file
    file = run / ("poses.csv" if setup is Setup.EYE_TO_HAND else "moved.csv")
    source = {"joints": run / "joints.csv", "arm": "ur10"} if by == "joints" else {"robot_stream": run / "flange.csv"}
    offset_s = None if by == "stream" else -LEAD_S
    done = join(file, out=tmp_path / "pairs.csv", kind="pairs", setup=setup, offset_s=offset_s, **source)
    assert done.offset_s == pytest.approx(-LEAD_S, abs=1e-3)
    pairs = read_pairs(tmp_path / "pairs.csv")
    want = T_rig_base * pairs.T_base_flange * T_flange_target
    got = pairs.T_camera_target if setup is Setup.EYE_TO_HAND else pairs.T_camera_target.inv()
    assert np.linalg.norm(got.translation - want.translation, axis=1).max() < 2e-3
    assert np.max((got.rotation * want.rotation.inv()).magnitude()) < 6e-3


def test_covariances_go_along_in_the_axes_they_were_measured_in(run: Path, tmp_path: Path) -> None:
    rng, m = np.random.default_rng(8), 150
    L = 1e-4 * rng.standard_normal((m, 6, 6))
    C, S = L @ L.transpose(0, 2, 1), 1e-9 * np.eye(6)
    for name in ("poses.csv", "moved.csv"):
        found = read_poses(run / name)
        with_them = [replace(p, covariance=C[i] + S, systematic_covariance=S) for i, p in enumerate(found)]
        write_poses(tmp_path / name, with_them)
    known = {"offset_s": -LEAD_S, "joints": run / "joints.csv", "arm": "ur10"}
    for setup, name in ((Setup.EYE_TO_HAND, "poses.csv"), (Setup.EYE_IN_HAND, "moved.csv")):
        join(tmp_path / name, out=tmp_path / "pairs.csv", kind="pairs", setup=setup, **known)
        got = read_pairs(tmp_path / "pairs.csv").camera_covariance
        assert got is not None and len(got) == m
        assert np.abs(got / (C + S) - 1.0).max() < 1e-9
    alike = [replace(p, covariance=C[0] + S, systematic_covariance=S) for p in read_poses(run / "poses.csv")]
    write_poses(tmp_path / "alike.csv", alike)
    join(tmp_path / "alike.csv", out=tmp_path / "p.csv", still=True, **known)
    header, first = [line.split(",") for line in (tmp_path / "p.csv").read_text().splitlines()[:2]]
    value = dict(zip(header, map(float, first), strict=True))
    k = round(C[0, 0, 1] / value["cov_x_y"])  # the mean is better by its number of rows, but for what repeats
    assert k >= 3 and value["cov_x_y"] == pytest.approx(C[0, 0, 1] / k, rel=1e-6)
    assert value["sx_m"] ** 2 == pytest.approx(C[0, 0, 0] / k + 1e-9, rel=1e-6)
