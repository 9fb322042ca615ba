"""armsight verify: files of several kinds in, the promised keys and files out, and what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadFile
from armsight.kinematics import fk, moved, preset
from armsight.store.verify_files import read_commanded, read_measured, read_reported_joints
from refusals import names_it, refuses

AGAIN = "--overwrite"

POSE = "x_m,y_m,z_m,qx,qy,qz,qw"
JOINTS = "q1,q2,q3,q4,q5,q6"
FIGURES = {"me", "mae", "max", "sd", "rms"}


def write(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text("\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n")
    return path


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray]:
    """Joints (40, 6) and measured poses (40, 7) of an irb120 whose second joint is off by 0.5 degrees."""
    arm = preset("irb120")
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.9, 0.9, (40, 6))
    T = RigidTransform.from_matrix(fk(moved(arm, {"j2.theta_rad": np.deg2rad(0.5), "base.z_m": 0.3}), q))
    xyz = T.translation + rng.normal(0.0, 1e-4, (40, 3))
    turn = Rotation.from_rotvec(rng.normal(0.0, 2e-4, (40, 3)))
    return q, np.hstack([xyz, (turn * T.rotation).as_quat()])


@pytest.fixture
def files(truth: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> tuple[Path, Path, list[Any]]:
    q, poses = truth
    measured, joints = write(tmp_path / "m.csv", POSE, poses), write(tmp_path / "j.csv", JOINTS, q)
    return (
        measured,
        joints,
        ["verify", "--measured", measured, "--arm", "irb120", "-o", tmp_path / "out", AGAIN],
    )


@pytest.fixture(scope="module")
def verified(
    armsight: Any, truth: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Any]:
    """A run's folder, and what it told."""
    folder = tmp_path_factory.mktemp("verified")
    measured, joints = write(folder / "m.csv", POSE, truth[1]), write(folder / "j.csv", JOINTS, truth[0])
    done = armsight("verify", "--measured", measured, "--arm", "irb120", "--joints", joints, "-o", folder / "out")
    assert done.code == 0
    return folder / "out", done.json


def test_an_arm_is_verified_with_every_promised_key(verified: tuple[Path, Any]) -> None:
    out, content = verified
    assert (
        set(content["task"]) == {"x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"} == set(content["measurement_std"])
    )
    assert all(set(item) == FIGURES for item in content["task"].values())
    assert content["n"] == 40 and content["cause"] == "joint 2" and content["kind"] == "zero offset"
    assert content["time"] == {"offset_s": None, "std_s": None, "drift_ppm": None, "bursts": False}
    second = content["joints"][1]
    assert second["judged"] and abs(second["offset_rad"] - np.deg2rad(0.5)) < 4.0 * second["std_rad"]
    assert not content["joints"][0]["judged"] and content["joints"][0]["offset_rad"] is None
    assert content["alignment"]["free"] == ["base", "tool"]
    assert {"j1.theta_rad", "j6.theta_rad"} <= set(content["alignment"]["undetermined"])
    assert content["after"]["rms_m"] < content["before"]["rms_m"]
    assert {item["withheld"] is not None for item in content["iso9283"].values()} == {True}
    assert content["rejected"] == []
    assert json.loads((out / "verify.json").read_text()) == content
    with (out / "errors.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["row"]) for row in rows] == list(range(1, 41))
    rms = np.sqrt(np.mean([float(row["error_m"]) ** 2 for row in rows]))
    assert rms == pytest.approx(content["after"]["rms_m"], rel=1e-9)
    page = (out / "report.html").read_text()
    assert "Cause: joint 2" in page and "@page" in page and "over joint angles" in page


def test_joints_may_be_columns_and_runs_are_compared(
    armsight: Any, verified: tuple[Path, Any], truth: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    both = write(tmp_path / "both.csv", f"{JOINTS},{POSE},temperature_c", np.hstack([*truth, np.full((40, 1), 20.0)]))
    words = ["verify", "--measured", both, "--arm", "irb120", "-o", tmp_path / "again", "--overwrite"]
    done = armsight(*words, "--compare", verified[0])
    assert done.code == 0
    assert done.json["compared"]["after"] == done.json["after"]
    assert any("temperature_c" in text for text in done.json["doubts"])
    assert "the other run" in (tmp_path / "again" / "report.html").read_text()
    assert armsight(*words, "--compare", tmp_path / "nothing").code == 3


def test_a_commanded_path_needs_no_arm(armsight: Any, truth: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    q, poses = truth
    asked = RigidTransform.from_matrix(fk(preset("irb120"), q))
    commanded = write(tmp_path / "path.csv", POSE, np.hstack([asked.translation, asked.rotation.as_quat()]))
    measured = write(tmp_path / "m.csv", POSE, poses)
    words = ["verify", "--measured", measured, "--commanded", commanded, "-o", tmp_path / "out", AGAIN]
    done = armsight(*words, "--align", "none")
    assert done.code == 0
    assert done.json["before"] == done.json["after"] and done.json["joints"] == []
    assert done.json["after"]["rms_m"] == pytest.approx(0.3, abs=0.02)
    assert armsight(*words).json["after"]["rms_m"] < 0.005
    flat = write(tmp_path / "flat.csv", "x_m,y_m,z_m", asked.translation)
    points = armsight("verify", "--measured", measured, "--commanded", flat, "-o", tmp_path / "out", AGAIN).json
    assert points["alignment"]["free"] == ["base"] and points["after"]["rms_rad"] is None


def test_torn_rows_are_left_out_and_the_others_keep_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "torn.csv"
    path.write_bytes(
        b"t_s,x_m,y_m,z_m,status\n0,1,2,3,ok\n0.1,\x00\x00\x00\n0.2,4,5,6,ok\n0.3,,,,lost\n0.4,1,1,1,position_only\n"
    )
    found = read_measured(path)
    assert found.measured.rows.tolist() == [1, 3] and found.n == 5
    assert names_it(dict(found.rejected)[2], "line 3", "NUL")
    assert "position only" in dict(found.rejected)[5]
    assert any(names_it(note, "1 of 4 rows", "lost", "line 5") for note in found.notes)
    path.write_bytes(b"q1,q2\n1,2\n\x00\x00\n3,4\n")
    q = read_reported_joints(path).q
    assert q is not None and np.isnan(q[1]).all() and q[2].tolist() == [3.0, 4.0]


def test_trackers_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("# t x y z\n0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n")
    tum = read_measured(path).measured
    assert tum.t_s is not None and tum.t_s.tolist() == [0.0, 1.0] and tum.rotation is not None
    path.write_text("t_s,spot,x_m,y_m,z_m,sx_m,sy_m,sz_m,pose\n0,A,1,2,3,.1,.2,.3,p1\n0,B,1,2,4,.1,.1,.1,p1\n")
    found = read_measured(path)
    assert found.measured.labels == ("A", "B") and found.pose is not None and found.pose.tolist() == [0.0, 0.0]
    assert found.measured.std is not None and found.measured.std[0, :3].tolist() == [0.1, 0.2, 0.3]
    path.write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n")
    told = read_commanded(path)
    reported, turned = told.reported, told.turned
    assert not turned and reported.T is not None and reported.T[0, :3, 3].tolist() == [1.0, 2.0, 3.0]
    for text, said in (
        ("x_m,y_m\n1,2\n", ("z_m", "missing")),
        ("x_m,y_m,z_m,qx\n1,2,3,0\n", ("qx", "only")),
        ("x_m,y_m,z_m\n1,2,three\n", ("line 2", "z_m")),
    ):
        path.write_text(text)
        with refuses(BadFile, said):
            read_measured(path)


@pytest.fixture
def repeats(tmp_path: Path) -> tuple[Path, Path]:
    """Six visits each of P1, P2 and P4, which stand 0.1, 0.2 and 0.3 mm further along x than commanded; the command."""
    goals = {"P1": (0.5, 0.0, 0.4), "P2": (0.7, -0.2, 0.6), "P4": (0.3, 0.2, 0.2)}
    rng = np.random.default_rng(5)
    lines = ["pose,visit,x_m,y_m,z_m"]
    for visit in range(6):
        for k, (name, goal) in enumerate(goals.items()):
            xyz = goal + rng.normal([1e-4 * (k + 1), 0.0, 0.0], 1e-5)
            lines.append(f"{name},{visit},{','.join(repr(float(v)) for v in xyz)}")
    measured, commanded = tmp_path / "repeats.csv", tmp_path / "plan.csv"
    measured.write_text("\n".join(lines) + "\n")
    rows = [f"{name},{goal[0]},{goal[1]},{goal[2]}" for name, goal in goals.items()]
    commanded.write_text("\n".join(["pose,x_m,y_m,z_m", *rows]) + "\n")
    return measured, commanded


def test_accuracy_needs_a_command_in_a_frame_that_was_not_fitted(
    armsight: Any, repeats: tuple[Path, Path], tmp_path: Path
) -> None:
    words = ["verify", "--measured", repeats[0], "--commanded", repeats[1], "-o", tmp_path / "out", AGAIN]
    given = armsight(*words, "--align", "none").json["iso9283"]
    assert given["AP_m P4"]["value"] == pytest.approx(3e-4, abs=2e-5)
    assert given["AP_m"]["value"] == given["AP_m P4"]["value"]
    fitted = armsight(*words, "--align", "tool")
    assert fitted.code == 0
    assert "fitted" in fitted.json["iso9283"]["AP_m"]["withheld"]
    assert fitted.json["iso9283"]["AD_m"]["value"] is not None
    repeats[1].write_text(repeats[1].read_text().replace("P2", "P9"))
    missing = armsight(*words, "--align", "none")
    assert missing.json["n"] == 12 and any("P2" in text for text in missing.json["doubts"])


def test_rows_without_a_visit_that_follow_each_other_are_one_visit(
    armsight: Any, repeats: tuple[Path, Path], tmp_path: Path
) -> None:
    rows = [line.split(",") for line in repeats[0].read_text().splitlines()]
    held = [",".join([row[0], *row[2:]]) for row in [rows[0], *sorted(rows[1:])]]
    repeats[0].write_text("\n".join(held) + "\n")
    iso = armsight("verify", "--measured", repeats[0], "-o", tmp_path / "out", AGAIN).json["iso9283"]
    assert iso["RP_m"]["value"] is None and iso["RP_m"]["n"] == 1


def test_runs_along_a_named_path(armsight: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    lines, along = ["tag,run,t_s,x_m,y_m,z_m"], np.arange(0.0, 0.4, 0.005)
    for run in range(6):
        y, t0 = rng.normal(2e-4, 1e-5), 10.0 * run
        lines += [f"line,{run},{t0 + s / 0.25!r},{s!r},{y!r},0.3" for s in along.tolist()]
    measured, commanded = tmp_path / "runs.csv", tmp_path / "path.csv"
    measured.write_text("\n".join(lines) + "\n")
    commanded.write_text("tag,x_m,y_m,z_m,speed_m_s\nline,0.0,0.0,0.3,0.25\nline,0.39,0.0,0.3,0.25\n")
    words = [
        "verify",
        "--measured",
        measured,
        "--commanded",
        commanded,
        "--align",
        "none",
        "-o",
        tmp_path / "out",
        AGAIN,
    ]
    iso = armsight(*words).json["iso9283"]
    assert iso["AT_m"]["value"] == pytest.approx(2e-4, abs=2e-5)
    assert iso["AV_ratio"]["value"] == pytest.approx(0.0, abs=1e-6)
    burst = [line.split(",") for line in lines[1:]]
    same = [",".join([*row[:2], "1.0", *row[3:]]) for row in burst]
    measured.write_text("\n".join([lines[0], *same]) + "\n")
    assert "arrival times" in armsight(*words).json["iso9283"]["AV_ratio"]["withheld"]
