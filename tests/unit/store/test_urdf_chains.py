"""Which chain of a branching URDF is the arm: tips, bases, grippers, mimicking joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from armsight._files import arm_source
from armsight.cli.commands import app
from armsight.errors import BadFile, UsageError
from armsight.kinematics import fk
from armsight.ops import kinematics
from armsight.ops.arm_files import arm_file, load_arm
from armsight.ops.kinematics_results import read_values
from armsight.store.urdf import arm_from_urdf
from refusals import names_it, refuses

LIMIT = '<limit lower="-2" upper="2"/>'


def joint(name: str, parent: str, child: str, xyz: str = "0 0 0", *, kind: str = "revolute", more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="0 0 1"/>{LIMIT}{more}</joint>'
    )


def robot(*joints: str) -> str:
    links = sorted({part.split('"')[0] for text in joints for part in text.split('link="')[1:]})
    return "".join(['<robot name="r">', *(f'<link name="{link}"/>' for link in links), *joints, "</robot>"])


GRIPPER = robot(
    joint("j1", "base", "upper", "0 0 0.3"),
    joint("j2", "upper", "fore", "0.4 0 0"),
    joint("mount", "fore", "hand", "0.2 0 0", kind="fixed"),
    joint("finger1", "hand", "left", kind="prismatic"),
    joint("finger2", "hand", "right", kind="prismatic", more='<mimic joint="finger1"/>'),
    joint("eye", "fore", "camera", kind="fixed"),
)
TWO_ARMS = robot(
    joint("lift", "floor", "torso", kind="prismatic"),
    joint("l1", "torso", "l_upper", "0 0.2 1"),
    joint("l2", "l_upper", "l_hand", "0.5 0 0"),
    joint("r1", "torso", "r_upper", "0 -0.2 1"),
    joint("r2", "r_upper", "r_hand", "0.5 0 0"),
    joint("neck", "torso", "head", kind="floating"),
)


def test_a_branch_without_a_tip_is_refused_with_the_tips() -> None:
    with refuses(BadFile, "branches", "hand", "finger1, finger2") as error:
        arm_from_urdf(GRIPPER)
    assert names_it(error.value, "--tip", "hand (2 joints)", "camera (2 joints)", "left (3 joints)", "right (3 joints)")
    with refuses(BadFile, "branches", "torso", "l1, r1, neck") as error:
        arm_from_urdf(TWO_ARMS)
    assert "r_hand (3 joints)" in str(error.value)


def test_a_mimicking_joint_matters_only_inside_the_chain() -> None:
    arm = arm_from_urdf(GRIPPER, tip="hand")
    assert [j.name for j in arm.joints] == ["j1", "j2"]
    np.testing.assert_allclose(fk(arm, [0.0, np.pi / 2])[:3, 3], [0.4, 0.2, 0.3], atol=1e-15)
    with refuses(BadFile, "finger2", "mimics", "finger1", "--tip"):
        arm_from_urdf(GRIPPER, tip="right")


def test_a_base_begins_the_chain_and_is_the_world() -> None:
    whole, above = arm_from_urdf(TWO_ARMS, tip="r_hand"), arm_from_urdf(TWO_ARMS, base="torso", tip="r_hand")
    assert [j.name for j in whole.joints] == ["lift", "r1", "r2"]
    assert [j.name for j in above.joints] == ["r1", "r2"]
    np.testing.assert_allclose(fk(above, [0.0, 0.0])[:3, 3], [0.5, -0.2, 1.0], atol=1e-15)
    np.testing.assert_allclose(fk(whole, [0.7, 0.0, 0.0])[:3, 3], [0.5, -0.2, 1.7], atol=1e-15)
    hand = arm_from_urdf(TWO_ARMS, base="l_upper")  # below it nothing branches
    assert [j.name for j in hand.joints] == ["l2"]
    with refuses(BadFile, "r_hand", "l_upper", "hang"):
        arm_from_urdf(TWO_ARMS, base="l_upper", tip="r_hand")
    with refuses(BadFile, "neck", "floating"):
        arm_from_urdf(TWO_ARMS, tip="head")
    with refuses(BadFile, "nose", "link"):
        arm_from_urdf(TWO_ARMS, base="nose")


def test_a_chain_is_named_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "two.urdf"
    path.write_text(TWO_ARMS, encoding="utf-8")
    assert arm_source(str(path)) == str(path)
    named = arm_source(str(path), tip="l_hand", base="torso")
    assert named == f"{path}#torso:l_hand"
    assert [j.name for j in load_arm(named).joints] == ["l1", "l2"]
    assert [j.name for j in load_arm(f"{path}#l_hand").joints] == ["lift", "l1", "l2"]
    assert [j.name for j in load_arm(arm_source(str(path), base="l_upper")).joints] == ["l2"]
    assert arm_file(named) == path
    assert arm_file("ur5") is None
    with refuses(UsageError, "its chain"):
        arm_source(named, tip="r_hand")
    with refuses(UsageError, "ur10", "URDF"):
        load_arm("ur10#tool0")
    odd = tmp_path / "a#b.urdf"
    odd.write_text(robot(joint("j1", "base", "end")), encoding="utf-8")
    assert load_arm(str(odd)).n == 1


FOLLOWING = robot(
    joint("turn", "base", "upper", "0 0 0.3"),
    joint("lift", "upper", "fore", "0.4 0 0"),
    joint("rod", "fore", "wrist", "0.3 0.1 0", more='<mimic joint="lift" multiplier="-1.2" offset="0.1"/>'),
    joint("roll", "wrist", "hand", "0.2 0 0.1"),
)


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (("turn", "lift", "roll"), (0, 1, 3)),
        (("roll", "rod", "turn", "lift"), (3, 2, 0, 1)),
        (("q1", "q2", "q4"), (0, 1, 3)),
    ],
)
def test_a_log_needs_no_column_of_a_joint_that_mimics(tmp_path: Path, names: tuple[str, ...], columns: tuple[int, ...]):
    (tmp_path / "arm.urdf").write_text(FOLLOWING)
    arm = arm_from_urdf(FOLLOWING)
    values = np.random.default_rng(3).uniform(-1.5, 1.5, (30, 4))
    values[:, 2] = -1.2 * values[:, 1] + 0.1
    np.savetxt(tmp_path / "q.csv", values[:, columns], "%.12g", ",", header=",".join(names), comments="")
    turns = np.cumsum(values, axis=1)  # all joints turn about z
    links = (0.4, 0.3 + 0.1j, 0.2)
    places = sum(link * np.exp(1j * turn) for link, turn in zip(links, turns.T[:3], strict=True))
    motion = read_values(arm, tmp_path / "q.csv")
    found = np.array([fk(arm, q) for q in motion.q])
    np.testing.assert_allclose(found[:, 0, 3] + 1j * found[:, 1, 3], places, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * turns[:, 3]), found[:, 0, 0] + 1j * found[:, 1, 0], atol=1e-9)

    kinematics.fk(tmp_path / "arm.urdf", tmp_path / "q.csv", tmp_path / "poses.csv")
    words = ["verify", "--measured", tmp_path / "poses.csv", "--joints", tmp_path / "q.csv", "-o", tmp_path / "v"]
    done = CliRunner().invoke(app, [str(word) for word in (*words, "--arm", tmp_path / "arm.urdf")])
    assert done.exit_code == 0, done.output


def test_a_log_by_names_that_are_not_the_arms_is_told_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "q.csv").write_text("pan,tilt\n0.1,0.2\n")
    with refuses(BadFile, "q1") as error:
        read_values(arm_from_urdf(FOLLOWING), tmp_path / "q.csv")
    assert names_it(error.value, "turn", "lift", "rod", "roll")
