"""Which chain of a branching URDF is the arm: tips, bases, grippers, mimicking joints."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armsight._files import arm_source
from armsight.errors import BadFile, UsageError
from armsight.kinematics import fk, preset
from armsight.ops.arm_files import arm_file, load_arm
from armsight.store.urdf import arm_from_urdf
from refusals import refuses

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


def urdf_of(joints: list[tuple[str, str, str, str, str, str]]) -> str:
    """A URDF of joints: name, type, parent, child, origin, axis."""
    links = sorted({link for joint in joints for link in joint[2:4]})
    return (
        "<robot name='r'>"
        + "".join(f"<link name='{link}'/>" for link in links)
        + "".join(
            f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/><origin {origin}/>"
            f"<axis xyz='{axis}'/><limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
            for name, kind, parent, child, origin, axis in joints
        )
        + "</robot>"
    )


FINGER = [
    ("j1", "revolute", "base", "a", "xyz='0 0 0'", "0 0 1"),
    ("j2", "revolute", "a", "flange", "xyz='0.3 0 0'", "0 1 0"),
    ("to_tool", "fixed", "flange", "tool", "xyz='0 0 0.1'", "1 0 0"),
    ("finger", "revolute", "flange", "jaw", "xyz='0 0.02 0.05'", "0 0 1"),
]
SO101_LINKS = ("base_link", "shoulder_link", "upper_arm_link", "lower_arm_link", "wrist_link", "gripper_link")
SO101_ORIGINS = {  # xyz and rpy, as TheRobotStudio's Simulation/SO101/so101_new_calib.urdf has them
    "shoulder_pan": ("0.0388353 -8.97657e-09 0.0624", "3.14159 4.18253e-17 -3.14159"),
    "shoulder_lift": ("-0.0303992 -0.0182778 -0.0542", "-1.5708 -1.5708 0"),
    "elbow_flex": ("-0.11257 -0.028 1.73763e-16", "-3.63608e-16 8.74301e-16 1.5708"),
    "wrist_flex": ("-0.1349 0.0052 3.62355e-17", "4.02456e-15 8.67362e-16 -1.5708"),
    "wrist_roll": ("5.55112e-17 -0.0611 0.0181", "1.5708 0.0486795 3.14159"),
}
JAW = ("moving_jaw_so101_v1_link", "xyz='0.0202 0.0188 -0.0234' rpy='1.5708 -5.24284e-08 -1.41553e-15'")
BETWEEN = ("gripper_frame_link", "xyz='-0.0079 -0.000218121 -0.0981274' rpy='0 3.14159 0'")
SO101 = [
    *(
        (name, "revolute", parent, child, f"xyz='{xyz}' rpy='{rpy}'", "0 0 1")
        for (name, (xyz, rpy)), parent, child in zip(SO101_ORIGINS.items(), SO101_LINKS, SO101_LINKS[1:], strict=False)
    ),
    ("gripper", "revolute", "gripper_link", *JAW, "0 0 1"),
    ("gripper_frame_joint", "fixed", "gripper_link", *BETWEEN, "0 0 0"),
]


def test_a_finger_beside_a_fixed_tool_is_no_joint_of_the_arm_unasked() -> None:
    with refuses(BadFile, "tool (2 joints)", "jaw (3 joints)", "--tip"):
        arm_from_urdf(urdf_of(FINGER))
    np.testing.assert_allclose(fk(arm_from_urdf(urdf_of(FINGER), tip="tool"), [0, 0])[:3, 3], [0.3, 0, 0.1], atol=1e-15)
    assert arm_from_urdf(urdf_of(FINGER), tip="jaw").n == 3
    with refuses(BadFile, "gripper_frame_link (5 joints)", "moving_jaw_so101_v1_link (6 joints)"):
        arm_from_urdf(urdf_of(SO101))


def test_the_so101_preset_is_its_makers_urdf_up_to_the_tool_between_the_jaws() -> None:
    file, arm = arm_from_urdf(urdf_of(SO101), tip="gripper_frame_link"), preset("so101")
    q = np.random.default_rng(3).uniform(arm.lower, arm.upper, (50, 5))
    assert np.abs(fk(file, q) - fk(arm, q)).max() < 2e-5  # its right angles have five digits
    assert (arm.base_link, arm.tool_link) == (file.base_link, file.tool_link)
    np.testing.assert_allclose(fk(arm, np.zeros(5))[:3, 3], [0.391, 0.000, 0.226], atol=1e-3)


def test_the_so100_presets_chain_is_its_makers() -> None:
    arm, q = preset("so100"), np.array([0.3, 1.2, -0.7, -0.4, 0.9])
    T = np.eye(4)
    for (xyz, rpy, axis), angle in zip(
        (
            ([0, -0.0452, 0.0165], [1.57079, 0, 0], [0, 1, 0]),
            ([0, 0.1025, 0.0306], [-1.8, 0, 0], [1, 0, 0]),
            ([0, 0.11257, 0.028], [1.57079, 0, 0], [1, 0, 0]),
            ([0, 0.0052, 0.1349], [-1, 0, 0], [1, 0, 0]),
            ([0, -0.0601, 0], [0, 1.57079, 0], [0, 1, 0]),
        ),
        q,
        strict=True,
    ):
        step = np.eye(4)
        step[:3, :3] = (
            Rotation.from_euler("xyz", rpy) * Rotation.from_rotvec(angle * np.array(axis, dtype=float))
        ).as_matrix()
        step[:3, 3] = xyz
        T = T @ step
    assert np.abs(fk(arm, q) - T).max() < 2e-5
