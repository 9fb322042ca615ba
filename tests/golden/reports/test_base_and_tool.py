"""Strangers' arms whose base link is not their first joint's frame, and whose tool is turned or one of several."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import BadFile
from armsight.kinematics import fk
from armsight.ops.arm_files import load_arm
from armsight.ops.calibrate_robot import calibrate_arm, calibrate_robot_world
from armsight.store import read_world
from refusals import names_it, refuses
from reports import case


@pytest.mark.parametrize(
    ("arm", "points", "right_mm"),
    [("gantry.urdf", "observed.csv", (550, 300, 1200)), ("arm.urdf", "arm_observed.csv", (1400, 200, 900))],
)
def test_the_rig_stands_in_the_axes_of_the_base_link(arm, points, right_mm, tmp_path):
    folder = case("cameras-06")
    calibrate_robot_world(str(folder / arm), folder / points, out=tmp_path / "world.yaml")
    T = read_world(tmp_path / "world.yaml").T_parent_rig
    assert 1e3 * np.asarray(T.translation) == pytest.approx(right_mm, abs=1.0)  # 0.6 mm of noise
    if arm == "arm.urdf":
        model = load_arm(str(folder / arm))
        row = np.loadtxt(folder / points, delimiter=",", skiprows=1)[0]
        assert 1e3 * np.asarray(T.apply(row[3:])) == pytest.approx(1e3 * fk(model, row[:3])[:3, 3], abs=2.0)


def test_positions_alone_leave_the_tools_rotation_nominal(tmp_path):
    folder = case("arms-12")
    model = str(folder / "nominal.urdf")
    done = calibrate_arm(model, folder / "points.csv", out=tmp_path / "a.yaml")
    assert [note for note in done.notes if names_it(note, "rotation", "nominal")]
    q = np.loadtxt(folder / "q.csv", delimiter=",", skiprows=1)
    nominal = fk(load_arm(model), q)
    for file in ("a.yaml", "a.urdf"):
        turned = nominal[:, :3, :3].transpose(0, 2, 1) @ fk(load_arm(str(tmp_path / file)), q)[:, :3, :3]
        assert np.rad2deg(Rotation.from_matrix(turned).magnitude()).max() < 2.0


@pytest.mark.parametrize("file", ["ee_and_tool.urdf", "ee_first.urdf"])
def test_one_of_two_tools_is_asked_for_and_the_cure_names_it(file):
    path = case("urdf") / file
    with refuses(BadFile, file, "ee", "tool", "--tip") as error:
        load_arm(str(path))
    assert "--tip tool" in error.value.cure or "--tip ee" in error.value.cure
    chosen = {tip: load_arm(f"{path}#{tip}") for tip in ("tool", "ee")}
    assert [arm.tool_link for arm in chosen.values()] == ["tool", "ee"]
    away = fk(chosen["tool"], np.zeros(6))[:3, :3].T @ fk(chosen["ee"], np.zeros(6))[:3, :3]
    assert np.rad2deg(Rotation.from_matrix(away).magnitude()) == pytest.approx(120.0)


@pytest.mark.parametrize(("name", "prefix"), [("tool0", ""), ("flange", ""), ("tool0", "left_"), ("tool0", "cell/")])
def test_the_usual_name_is_the_tool_and_is_told(name, prefix, tmp_path):
    text = (case("urdf") / "ee_first.urdf").read_text().replace('"tool"', f'"{prefix}{name}"')
    (tmp_path / "a.urdf").write_text(text)
    assert load_arm(str(tmp_path / "a.urdf")).tool_link == prefix + name
