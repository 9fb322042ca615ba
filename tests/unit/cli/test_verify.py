"""armsight verify: files of several kinds in, the promised keys and files out, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import fk, moved, preset
from armsight.store.verify_files import read_measured, read_reported_joints
from refusals import names_it

AGAIN = "--overwrite"

POSE = "x_m,y_m,z_m,qx,qy,qz,qw"
JOINTS = "q1,q2,q3,q4,q5,q6"


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
