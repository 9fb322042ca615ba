"""armsight identify, calibrate arm, calibrate robot-world: files in, the promised keys and files out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.kinematics import Coupling, fk, moved, preset
from armsight.ops.calibrate_robot import calibrate_arm
from armsight.store.arm_file import read_arm
from armsight.store.saving import write_calibrated_arm
from armsight.store.urdf import read_urdf
from refusals import names_it


def write_rows(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text("\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n")
    return path


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    """q1..q6,x,y,z of an irb120 whose second joint is off by 1 degree."""
    arm = preset("irb120")
    true = moved(arm, {f"{arm.joints[1].name}.theta_rad": np.deg2rad(1.0)})
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.9, 0.9, (60, 6))
    return np.hstack([q, fk(true, q)[:, :3, 3] + rng.normal(0.0, 1e-4, (60, 3))])


HEADER = "q1,q2,q3,q4,q5,q6,x_m,y_m,z_m"


def test_measurements_that_cannot_be_are_refused(armsight: Any, measured: np.ndarray, tmp_path: Path) -> None:
    out = ["-o", tmp_path / "arm.yaml"]
    centimetres = measured * np.r_[np.ones(6), np.full(3, 100.0)]
    slip = measured.copy()
    slip[5, 6] = 1e9
    for rows, header, said in (
        (centimetres, HEADER, "centimetres"),
        (slip, HEADER, "row 5: a position of 1e+09 m"),
        (measured[:, 1:], "q1,q2,q3,q4,q5,x_m,y_m,z_m", "6 joints"),
        (measured[:3], HEADER, "3 measurements"),
        (measured, HEADER.replace("q6", "p6"), "p6"),
    ):
        done = armsight(
            "calibrate", "arm", "--model", "irb120", "--points", write_rows(tmp_path / "p.csv", header, rows), *out
        )
        assert done.code == 3, said
        assert said in str(done.json["error"]), done.json
    given = ["--points", write_rows(tmp_path / "p.csv", HEADER, measured[:40])]
    given += ["--holdout", write_rows(tmp_path / "h.csv", HEADER, measured[39:])]
    done = armsight("calibrate", "arm", "--model", "irb120", *given, *out)
    assert done.code == 3 and names_it(done.json["error"], "1 of 21", "holdout")
    assert not (tmp_path / "arm.yaml").exists()


def test_an_arm_is_identified_with_every_promised_key(armsight: Any, tmp_path: Path) -> None:
    arm = preset("stanford-rrp")
    joint = np.repeat([1, 2, 3], 10)
    q = np.tile([0.0, 1.5, 0.7], (30, 1))
    q[np.arange(30), joint - 1] = np.concatenate(
        [np.linspace(0, 4, 10), np.linspace(0.5, 1.8, 10), np.linspace(0.6, 1.1, 10)]
    )
    places = fk(arm, q)[:, :3, 3] + np.random.default_rng(0).normal(0.0, 2e-4, (30, 3))
    header = "joint,q1,q2,q3,x_m,y_m,z_m"
    sweep = write_rows(tmp_path / "sweep.csv", header, np.hstack([joint[:, None], q, places]))
    done = armsight("identify", "--sweep", sweep, "-o", tmp_path / "arm.yaml")
    assert done.code == 0
    keys = "index type a_m alpha_rad d_m theta_rad lower upper sign std n discarded residual_rms_m residual_rms_px "
    keys += "p_line axis"
    assert set(keys.split()) <= set(done.json["joints"][0])
    assert {"joints", "method", "notes"} <= set(done.json)
    assert [item["type"] for item in done.json["joints"]] == ["revolute", "revolute", "prismatic"]
    assert (tmp_path / "arm.report.html").stat().st_size > 0
    again = read_arm(tmp_path / "arm.yaml")
    off = np.linalg.norm(fk(again, q)[:, :3, 3] - fk(arm, q)[:, :3, 3], axis=1)
    assert off.max() < 1e-3
    two = write_rows(
        tmp_path / "two.csv", "joint,q1,q2,q3,q4,x_m,y_m,z_m", np.hstack([joint[:, None], q, q[:, :1] * 0, places])
    )
    refused = armsight("identify", "--sweep", two, "-o", tmp_path / "no.yaml")
    assert refused.code == 3 and "joint 4" in str(refused.json["error"])
    assert armsight("identify", "--sweep", sweep, "--method", "guess", "-o", tmp_path / "no.yaml").code == 2
    assert armsight("identify", "--sweep", sweep, "--propose", "-o", tmp_path / "no.yaml").code == 2


def test_an_arm_is_identified_from_frames(armsight: Any, tmp_path: Path) -> None:
    """The scenario after Kapucu and Baysec (2005), its frames rendered: d1 1.27, a2 0.1, d2 -0.05 m."""
    cell = tmp_path / "cell"
    assert armsight("simulate", "kapucu2005-rrp", "-o", cell).code == 0
    words = ["--rig", cell / "rig.yaml", "--target", cell / "target.yaml", "--world", cell / "world.yaml"]
    frames = ["--left", cell / "left", "--right", cell / "right", "--joints", cell / "sweep_joints.csv"]
    done = armsight("identify", *words, *frames, "-o", tmp_path / "arm.yaml")
    assert done.code == 0
    first, second, third = done.json["joints"]
    assert [joint["type"] for joint in done.json["joints"]] == ["revolute", "revolute", "prismatic"]
    for joint, key, true in ((first, "d_m", 1.27), (first, "a_m", 0.0), (second, "d_m", -0.05), (second, "a_m", 0.1)):
        assert abs(joint[key] - true) < min(5.0 * joint["std"][key], 0.005), key
    assert third["std"]["a_m"] is None and third["std"]["beta_rad"] is None
    where = read_arm(tmp_path / "arm.yaml").T_world_base  # in the frame of --world, where the arm stands at the origin
    assert np.linalg.norm(where.translation) < 5e-3 and where.rotation.magnitude() < 2e-3
    assert (tmp_path / "arm.sweep.csv").exists()
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros_like(cv2.imread(str(next((cell / "left").iterdir())), 0)))
    masked = armsight("identify", *words, *frames, "--mask", tmp_path / "black.png", "-o", tmp_path / "no.yaml")
    assert masked.code == 3 and "seen in none" in str(masked.json["error"])
    nothing = armsight("identify", *words, "-o", tmp_path / "no.yaml")
    assert nothing.code == 2 and "--sweep" in str(nothing.json["error"])


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
