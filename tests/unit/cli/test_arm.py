"""armsight identify, calibrate arm, calibrate robot-world: files in, the promised keys and files out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from action_cases import write_rows
from armsight.kinematics import Coupling, fk, moved, preset
from armsight.ops.calibrate_robot import calibrate_arm
from armsight.store.arm_file import read_arm
from armsight.store.saving import write_calibrated_arm
from armsight.store.urdf import read_urdf
from refusals import names_it


def test_measurements_that_were_calibrated_with_are_no_holdout(armsight: Any, tmp_path: Path) -> None:
    arm, rng = preset("irb120"), np.random.default_rng(0)
    q = rng.uniform(-0.9, 0.9, (60, 6))
    rows = np.hstack([q, fk(arm, q)[:, :3, 3] + rng.normal(0.0, 1e-4, (60, 3))])
    for name, part in (("points", rows[:40]), ("holdout", rows[39:])):
        write_rows(str(tmp_path / f"{name}.csv"), "q1,q2,q3,q4,q5,q6,x_m,y_m,z_m", part)
    given = ["--points", tmp_path / "points.csv", "--holdout", tmp_path / "holdout.csv"]
    done = armsight("calibrate", "arm", "--model", "irb120", *given, "-o", tmp_path / "arm.yaml")
    assert done.code == 3 and names_it(done.json["error"], "1 of 21", "holdout")
    assert not (tmp_path / "arm.yaml").exists()


TWO_ARMS = """<robot name="two"><link name="floor"/><link name="a"/><link name="b"/><link name="hand"/><link name="c"/>
<link name="left"/><link name="right"/><link name="other"/>
<joint name="j1" type="revolute"><parent link="floor"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2"/></joint>
<joint name="mount" type="fixed"><parent link="c"/><child link="hand"/><origin xyz="0.2 0 0"/></joint>
<joint name="f1" type="prismatic"><parent link="hand"/><child link="left"/><limit lower="0" upper="0.04"/></joint>
<joint name="f2" type="prismatic"><parent link="hand"/><child link="right"/><mimic joint="f1"/></joint>
<joint name="r1" type="revolute"><parent link="floor"/><child link="other"/><limit lower="-1" upper="1"/></joint>
</robot>"""


def test_a_branching_urdf_with_a_tip_points_by_name_and_no_stale_files(armsight: Any, tmp_path: Path) -> None:
    model = tmp_path / "two.urdf"
    model.write_text(TWO_ARMS)
    arm = read_urdf(model, tip="hand")
    rng = np.random.default_rng(2)
    true = moved(arm, {"j2.theta_rad": 0.02})
    q, at = rng.uniform(-1.2, 1.2, (14, 3)), np.array([[0.0, 0.02, 0.03], [0.05, 0.0, -0.03]])
    T = fk(true, q)
    x = np.einsum("mij,kj->mki", T[:, :3, :3], at) + T[:, None, :3, 3] + rng.normal(0.0, 1e-4, (14, 2, 3))
    rows = [
        ",".join([*map(repr, row.tolist()), *map(repr, place.tolist()), name])
        for row, places in zip(q, x, strict=True)
        for place, name in zip(places, "AB", strict=True)
    ]
    points = tmp_path / "points.csv"
    points.write_text("\n".join(["q1,q2,q3,x_m,y_m,z_m,point", *rows]) + "\n")
    words = ["calibrate", "arm", "--model", model, "--points", points, "--no-scale", "-o", tmp_path / "arm.yaml"]
    branches = armsight(*words)
    assert branches.code == 3 and "hand (3 joints)" in str(branches.json["error"])
    done = armsight(*words, "--tip", "hand", "--propose", 1)
    assert done.code == 0 and done.json["gain"] is True and done.json["other_arm"] is None
    again = read_arm(tmp_path / "arm.yaml")
    assert [point.name for point in again.tool_points] == ["A", "B"]
    in_tool = [again.T_flange_tool.inv().apply(point.xyz_m) for point in again.tool_points]
    np.testing.assert_allclose(np.diff(in_tool, axis=0), np.diff(at, axis=0), atol=1e-3)
    placed = armsight(
        "calibrate", "robot-world", "--arm", tmp_path / "arm.yaml", "--points", points, "-o", tmp_path / "world.yaml"
    )
    assert placed.code == 0 and placed.json["residual_rms_m"] < 5e-4
    # a run after it whose arm has no place in a URDF, and that proposes nothing
    found = calibrate_arm(model, points, scale=False, tip="hand")
    found = replace(found, arm=replace(again, couplings=(Coupling(joint="j2", by="j1"),)))
    (tmp_path / "theirs.urdf").write_text(TWO_ARMS)
    for name in ("theirs", "arm"):
        write_calibrated_arm(tmp_path / f"{name}.yaml", found)
    assert (tmp_path / "theirs.urdf").read_text() == TWO_ARMS and not (tmp_path / "arm.urdf").exists()
    assert armsight(*words, "--tip", "hand").code == 0
    assert (tmp_path / "arm.urdf").exists() and not (tmp_path / "arm.proposed.csv").exists()
    over = armsight(*words[:-1], tmp_path / "two.yaml", "--tip", "hand")
    assert over.code == 2 and "written over" in str(over.json["error"]) and model.read_text() == TWO_ARMS
