"""The kinematics commands: files in, files out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.errors import Inconsistent
from armsight.kinematics import Coupling, fk, moved, pose, preset
from armsight.ops.kinematics_results import left_open
from armsight.records import Motion, NamedCovariance, PoseStatus, TargetPose
from armsight.store import read_poses, read_table, write_joints, write_poses
from armsight.store.arm_file import write_arm
from refusals import refuses

Q = np.array([[0.1, -0.5, 0.7, 0.2, 0.6, 0.3], [0.15, -0.55, 0.75, 0.15, 0.55, 0.25], [0.2, -0.6, 0.8, 0.1, 0.5, 0.2]])


def run(*words: object, code: int = 0) -> dict[str, Any]:
    done = CliRunner().invoke(app, [str(word) for word in (*words, "--json")])
    assert done.exit_code == code, done.output
    content: dict[str, Any] = json.loads(done.stdout)
    return content


@pytest.fixture
def joints(tmp_path: Path) -> Path:
    path = tmp_path / "joints.csv"
    write_joints(path, Motion(t_s=np.arange(3.0), q=Q))
    return path


def test_commands_take_and_give_the_readings_of_a_controller(tmp_path: Path, joints: Path) -> None:
    """An elbow that shows its absolute angle, q3 + q2: the same places, other numbers."""
    arm = replace(preset("korayem6r"), couplings=(Coupling(joint="j3", by="j2", share=-1.0),))
    write_arm(tmp_path / "arm.yaml", arm)
    shown = Q.copy()
    shown[:, 2] += shown[:, 1]
    write_joints(tmp_path / "shown.csv", Motion(t_s=np.arange(3.0), q=shown))
    poses, solutions = tmp_path / "poses.csv", tmp_path / "solutions.csv"
    run("kinematics", "fk", "--arm", tmp_path / "arm.yaml", "--joints", tmp_path / "shown.csv", "-o", poses)
    for row, T in zip(read_poses(poses), fk(preset("korayem6r"), Q), strict=True):
        np.testing.assert_allclose(row.T_parent_target, T, atol=1e-12)
    known = ["--arm", tmp_path / "arm.yaml", "--poses", poses, "--near", tmp_path / "shown.csv"]
    run("kinematics", "ik", *known, "-o", solutions)
    names = ("pose", "solution", *(f"q{k}" for k in range(1, 7)), "error_m", "error_rad", "status")
    np.testing.assert_allclose(read_table(solutions, names, text=("status",)).stacked(names[2:8]), shown, atol=1e-9)
    run("kinematics", "jacobian", "--arm", tmp_path / "arm.yaml", "--joints", tmp_path / "shown.csv", "-o", solutions)
    J = np.loadtxt(solutions, delimiter=",", skiprows=1)[0, 1:].reshape(6, 6)
    step = 1e-6 * np.eye(6)
    moved = [fk(arm, arm.values(shown[0] + sign * step))[:, :3, 3] for sign in (1.0, -1.0)]
    np.testing.assert_allclose(J[:3], ((moved[0] - moved[1]) / 2e-6).T, atol=1e-8)
    run("convert", "arm", tmp_path / "arm.yaml", "-o", tmp_path / "arm.urdf", code=3)
    run("kinematics", "formulas", "--arm", tmp_path / "arm.yaml", "-o", tmp_path / "arm.py", code=3)
    with refuses(Inconsistent, "no joint"):
        replace(arm, couplings=(Coupling(joint="j2", by="j3"),))


def test_poses_without_a_solution_have_a_row_and_a_reason(tmp_path: Path) -> None:
    arm = preset("korayem6r")
    far = fk(arm, Q[0])
    far[:3, 3] = [3.0, 0.0, 0.0]
    rows = [
        TargetPose(
            t_s=0.0,
            status=PoseStatus.OK,
            parent="world",
            T_parent_target=pose(arm, Q[0]).as_matrix(),
            covariance=np.zeros((6, 6)),
        ),
        TargetPose(t_s=1.0, status=PoseStatus.LOST, parent="world", why="dark"),
    ]
    write_poses(tmp_path / "poses.csv", rows)
    text = (tmp_path / "poses.csv").read_text().splitlines()
    cells = text[1].split(",")
    text.append(",".join(["2.0", "3.0", "0.0", "0.0", *cells[4:]]))
    (tmp_path / "poses.csv").write_text("\n".join(text) + "\n")
    content = run("kinematics", "ik", "--arm", "korayem6r", "--poses", tmp_path / "poses.csv", "-o", tmp_path / "s.csv")
    assert content["status"] == {"ok": 1, "no_solution": 1, "out_of_reach": 1}
    assert [entry["pose"] for entry in content["unsolved"]] == [1, 2]
    lines = (tmp_path / "s.csv").read_text().splitlines()
    assert len({line.count(",") for line in lines}) == 1
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == ["ok", "no_solution", "out_of_reach"]


def test_deviations_of_poses_are_those_that_the_arms_parameters_leave(tmp_path: Path) -> None:
    """Against a thousand arms drawn from the covariance: correlated zeros of two joints, and a length."""
    rng = np.random.default_rng(0)
    C = np.diag([1e-4, 2e-4, 3e-4]) ** 2
    C[0, 1] = C[1, 0] = -0.6e-4 * 2e-4
    names = ("j2.theta_rad", "j3.theta_rad", "j3.a_m")
    arm = replace(preset("ur10"), covariance=NamedCovariance(names=names, matrix=C))
    q = np.array([[0.3, -1.2, 1.4, -0.5, 1.2, 0.4]])
    found = next(iter(left_open(arm, q)))
    drawn = rng.multivariate_normal(np.zeros(3), C, 1000)
    places = [fk(moved(arm, dict(zip(names, row.tolist(), strict=True))), q[0])[:3, 3] for row in drawn]
    np.testing.assert_allclose(np.sqrt(np.diag(found)[:3]), np.std(places, axis=0), rtol=0.1)
    assert not next(iter(left_open(preset("ur10"), q))).any()
