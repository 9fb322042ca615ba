"""--check: exit code 3 where a verdict is not good, with the files written; `verdict_` in the words of the report."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.kinematics import fk, moved, preset

POSE = "x_m,y_m,z_m,qx,qy,qz,qw,sx_m,sy_m,sz_m,srx_rad,sry_rad,srz_rad"


def table(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text("\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n")
    return path


def verified(folder: Path, knock_deg: float) -> list[object]:
    """Return the flags of verify for an arm in the measurements' frame whose third joint was knocked."""
    arm, rng = preset("irb120"), np.random.default_rng(3)
    q = rng.uniform(-0.9, 0.9, (40, 6))
    T = RigidTransform.from_matrix(fk(moved(arm, {"j3.theta_rad": np.deg2rad(knock_deg)}), q))
    turn = Rotation.from_rotvec(rng.normal(0.0, 2e-4, (40, 3)))
    std = np.tile([1e-4] * 3 + [2e-4] * 3, (40, 1))
    poses = np.hstack([T.translation + rng.normal(0.0, 1e-4, (40, 3)), (turn * T.rotation).as_quat(), std])
    measured, joints = table(folder / "m.csv", POSE, poses), table(folder / "j.csv", "q1,q2,q3,q4,q5,q6", q)
    return ["--measured", measured, "--arm", "irb120", "--joints", joints, "--align", "none", "-o", folder / "out"]


@pytest.mark.parametrize(("knock_deg", "level", "code"), [(0.0, "good", 0), (0.4, "bad", 3)])
def test_a_joint_that_is_off_ends_a_checked_command_with_3_and_its_files(
    armsight: Any, tmp_path: Path, knock_deg: float, level: str, code: int
) -> None:
    flags = verified(tmp_path, knock_deg)
    done = armsight("verify", *flags, "--check")
    assert done.code == code
    verdict = done.json["verdict_"]
    assert verdict["level"] == level and set(verdict) == {"level", "headline", "reasons", "next"}
    page = (tmp_path / "out" / "report.html").read_text()
    assert verdict["headline"] in page and (tmp_path / "out" / "verify.json").exists()
    said = CliRunner().invoke(app, [str(word) for word in ("verify", *flags, "--overwrite")])
    assert said.exit_code == 0  # without it exit codes stay as they are
    assert f"Verdict: {level}. {verdict['headline']}. {verdict['next'][0]}" in " ".join(said.stderr.split())


def test_a_measurement_with_gaps_ends_a_checked_command_with_3(armsight: Any, tmp_path: Path) -> None:
    cell = tmp_path / "cell"
    assert armsight("simulate", "hand-cell", "--frames", "8", "--room", "dark", "-o", cell).code == 0
    files = {"rig": "rig.yaml", "target": "target.yaml", "left": "left", "right": "right"}
    flags = [part for flag, name in files.items() for part in (f"--{flag}", cell / name)]
    whole = armsight("measure", *flags, "-o", tmp_path / "whole", "--check")
    assert (whole.code, whole.json["verdict_"]["level"]) == (0, "good")
    for name in sorted((cell / "left").iterdir())[2:5]:  # dark: the target is not seen in them
        cv2.imwrite(str(name), np.zeros_like(cv2.imread(str(name))))
    gaps = armsight("measure", *flags, "-o", tmp_path / "gaps", "--check")
    assert gaps.code == 3 and gaps.json["verdict_"]["level"] == "care"
    assert gaps.json["verdict_"]["headline"] in (tmp_path / "gaps" / "report.html").read_text()
    assert armsight("measure", *flags, "-o", tmp_path / "unchecked").code == 0
