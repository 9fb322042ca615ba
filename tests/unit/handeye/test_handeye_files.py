"""calibrate handeye and calibrate tooltip from files: contract, exit codes, report, round trips."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from armsight.calibrate.handeye import PosePairs
from armsight.calibrate.tooltip import calibrate_tooltip
from armsight.cli.commands import app
from armsight.ops.calibrate_robot import calibrate_tool_tip
from armsight.records import PoseStatus, TargetPose
from armsight.store import write_poses
from armsight.store.handeye_file import read_pairs, write_pairs


def run(*words: object) -> Any:
    return CliRunner().invoke(app, ["calibrate", *map(str, words)])


def recording(n: int = 14, *, to_hand: bool = False) -> PosePairs:
    rng = np.random.default_rng(21)
    X = RigidTransform.from_components([0.03, -0.06, 0.09], Rotation.from_rotvec([0.2, -0.3, 0.5]))
    Z = RigidTransform.from_components([0.6, 0.1, 0.0], Rotation.from_rotvec([0.1, 0.2, -0.4]))
    seen = RigidTransform.from_components(
        rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.8], (n, 3)), Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (n, 3)))
    )
    robot = X * seen * Z.inv() if to_hand else Z * seen.inv() * X.inv()
    noise = Rotation.from_rotvec(rng.normal(0, 8e-4, (n, 3)))
    seen = RigidTransform.from_components(seen.translation + rng.normal(0, 3e-4, (n, 3)), noise * seen.rotation)
    return PosePairs(T_base_flange=robot, T_camera_target=seen, names=tuple(f"row {i + 1}" for i in range(n)))


def unequal(pairs: PosePairs) -> PosePairs:
    """The pairs with covariances, correlated, of half of which the claim is five times as large."""
    rng = np.random.default_rng(3)
    L = np.array([3e-4] * 3 + [8e-4] * 3)[:, None] * (np.eye(6) + 0.4 * rng.uniform(-1, 1, (len(pairs), 6, 6)))
    L[::2] *= 5.0
    return replace(pairs, camera_covariance=L @ L.transpose(0, 2, 1))


def test_covariances_of_pairs_are_read_as_written_and_weigh(tmp_path: Path) -> None:
    pairs, file = unequal(recording()), tmp_path / "pairs.csv"
    write_pairs(file, pairs)
    read = read_pairs(file)
    assert read.camera_covariance is not None and pairs.camera_covariance is not None
    assert np.abs(read.camera_covariance / pairs.camera_covariance - 1.0).max() < 1e-12
    weighed = json.loads(run("handeye", "--pairs", file, "-o", tmp_path / "a.yaml", "--json").stdout)
    assert weighed["covariance_factor"] > 0.0
    assert not any("pairs.csv" in text for text in weighed["advice"])
    lines = [line.split(",") for line in file.read_text().splitlines()]

    def output(last: int, spoil: int = 0) -> dict[str, Any]:
        rows = [line[:last] for line in lines]
        if spoil:
            rows[3][spoil] = ""
        file.write_text("\n".join(map(",".join, rows)) + "\n")
        return dict(json.loads(run("handeye", "--pairs", file, "-o", tmp_path / "b.yaml", "--json").stdout))

    deviations = output(20)  # without cov_...: weighed, and the lack is told
    assert deviations["covariance_factor"] > 0.0
    assert sum("uncorrelated" in text for text in deviations["advice"]) == 1
    assert deviations["T_flange_camera"] != weighed["T_flange_camera"]
    partial, alike = output(35, spoil=16), output(14)
    assert sum("not used" in text for text in partial["advice"]) == 1
    assert "covariance_factor" not in partial and "covariance_factor" not in alike
    assert partial["T_flange_camera"] == alike["T_flange_camera"] != weighed["T_flange_camera"]


def test_a_tip_from_a_file_is_that_of_the_poses_in_memory(tmp_path: Path) -> None:
    """Errors that go almost together: without the columns cov_... the answer is another, and the lack is told."""
    rng, tip, n = np.random.default_rng(5), np.array([0.0, 0.02, 0.15]), 24
    R = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (n, 3)))
    L = rng.standard_normal((n, 6, 2)) @ rng.standard_normal((n, 2, 6)) + 0.05 * rng.standard_normal((n, 6, 6))
    L *= np.array([1e-4] * 3 + [1e-3] * 3)[:, None]
    noise, C = np.einsum("nij,nj->ni", L, rng.standard_normal((n, 6))), L @ L.transpose(0, 2, 1)
    turned = Rotation.from_rotvec(noise[:, 3:]) * R
    T = RigidTransform.from_components(np.array([0.05, -0.1, 0.7]) - R.apply(tip) + noise[:, :3], turned)
    poses = [
        TargetPose(t_s=0.0, status=PoseStatus.OK, parent="rig", T_parent_target=T[i].as_matrix(), covariance=C[i])
        for i in range(n)
    ]
    write_poses(tmp_path / "poses.csv", poses)
    done = calibrate_tool_tip(tmp_path / "poses.csv", out=tmp_path / "tip.yaml")
    memory = calibrate_tooltip([pose.pose for pose in poses], C)
    assert np.abs(np.array(done.tip_m) - memory.tip_m).max() < 1e-12 and not done.notes
    assert done.std_tip.x_m == pytest.approx(memory.std["x_m"], rel=1e-9)
    rows = (tmp_path / "poses.csv").read_text().splitlines()
    keep = rows[0].split(",").index("cov_x_y")
    (tmp_path / "old.csv").write_text("\n".join(",".join(row.split(",")[:keep]) for row in rows) + "\n")
    old = calibrate_tool_tip(tmp_path / "old.csv", out=tmp_path / "old.yaml")
    assert any("uncorrelated" in note for note in old.notes)
    assert np.abs(np.array(old.tip_m) - memory.tip_m).max() > 1e-6


def test_angles_in_another_order_are_told_with_the_order_that_fits(tmp_path: Path) -> None:
    pairs, path, out = recording(), tmp_path / "pairs.csv", tmp_path / "handeye.yaml"
    robot, seen = pairs.T_base_flange, pairs.T_camera_target
    angles = robot.rotation.as_euler("ZYX", degrees=True)
    rows = np.hstack([robot.translation, angles, seen.translation, seen.rotation.as_quat()])
    path.write_text("\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n")
    names = "base_flange_xyz_m,base_flange_euler_deg,camera_target_xyz_m,camera_target_quat_xyzw"
    words = ("handeye", "--pairs", path, "--columns", names, "-o", out, "--json", "--euler")
    for wrong in ("xyz", "zyz", "zyx-fixed"):
        done = run(*words, wrong)
        error = json.loads(done.stdout)["error"]
        assert done.exit_code == 3
        assert error["cure"] == "Give --euler zyx", error
        assert not out.exists()
    assert run(*words, "zyx").exit_code == 0
    slipped = rows.copy()
    slipped[7:, 6] += 0.02
    path.write_text("\n".join(",".join(map(repr, row)) for row in slipped.tolist()))
    assert "before row 8" in json.loads(run(*words, "zyx").stdout)["error"]["cure"]
    mixed = np.hstack([rows[:, :6], rows[::-1, 6:]])  # no order brings these together: the other causes are told
    path.write_text("\n".join(",".join(map(repr, row)) for row in mixed.tolist()))
    assert "--euler" not in json.loads(run(*words, "zyx").stdout)["error"]["cure"]
