"""`base` is the arm model's root, wherever a result names it: with an arm whose first joint stands aside and turned.

The truth is the product of the URDF's own transforms. Each test fails where base were the first joint's frame (0.35 m
and 45 degrees from it) or the world.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight
from armsight.app.operator.robot_cell import Placement
from armsight.control.guard.guard import Guard
from armsight.control.guard.limits import Box, Limits, joint_bounds
from armsight.control.guard.space import Space
from armsight.control.session.loop_host import flange_pose
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, fk, in_convention, moved, parameter_jacobian, parameter_names
from armsight.ops.robot.opening import LinkArm
from armsight.records import TaughtPath
from armsight.store import World
from armsight.store.arm_file import arm_mapping, read_arm, write_arm
from armsight.store.urdf import arm_from_urdf, urdf_text
from armsight_sim.twins.base import twin_arm
from shouldered_arm import BASE, base_flange, base_tool, drawn, placed, shouldered_urdf

T_BASE_RIG = placed((0.55, 0.3, 1.2), (2.0, -0.3, 0.7))


@pytest.fixture(scope="module")
def arm() -> Arm:
    return arm_from_urdf(shouldered_urdf())


def forms(arm: Arm, folder: Path) -> dict[str, Arm]:
    """The arm as its URDF says it, and after each way to write it."""
    write_arm(folder / "a.yaml", arm)
    craig = in_convention(arm, "craig")
    write_arm(folder / "c.yaml", craig)
    return {
        "urdf": arm,
        "yaml": read_arm(folder / "a.yaml"),
        "urdf again": arm_from_urdf(urdf_text(arm)),
        "craig": craig,
        "craig's yaml": read_arm(folder / "c.yaml"),
        "standard again": in_convention(craig, "standard"),
        "on its base": arm.based(),
        "calibrated": moved(arm, {"j3.a_m": 0.0}),
    }


def test_all_forms_of_an_arm_have_one_base(arm: Arm, tmp_path: Path) -> None:
    assert (arm.base_link, arm.tool_link) == ("base_link", "tool0")
    for name, form in forms(arm, tmp_path).items():
        stand = RigidTransform.identity() if name == "on its base" else placed(*BASE)
        assert form.T_world_base.as_matrix() == pytest.approx(stand.as_matrix(), abs=1e-12), name
        for q in drawn(5):
            T = stand * base_tool(q)
            assert fk(form, q) == pytest.approx(T.as_matrix(), abs=1e-12), name
            assert flange_pose(form, q).as_matrix() == pytest.approx(LinkArm(arm=form).fk(q).as_matrix(), abs=1e-12)
            assert (LinkArm(arm=form).fk(q) * form.T_flange_tool).as_matrix() == pytest.approx(
                base_tool(q).as_matrix(), abs=1e-12
            ), name
    kept = read_arm(tmp_path / "a.yaml")
    assert (kept.base_link, kept.tool_link) == ("base_link", "tool0")
    assert kept.T_base_frame0.translation == pytest.approx([0.15, 0.1, 0.3])  # the shoulder


@pytest.mark.parametrize("convention", ["standard", "craig"])
def test_derivatives_by_the_base_are_about_its_own_origin(arm: Arm, convention: str) -> None:
    form = in_convention(arm, convention)
    names, q, step = parameter_names(form), drawn(1)[0], 1e-6
    _, J = parameter_jacobian(form, q)
    for k, name in enumerate(names):
        there, here = fk(moved(form, {name: step}), q), fk(moved(form, {name: -step}), q)
        dt = (there - here)[:3, 3] / (2 * step)
        dw = Rotation.from_matrix(there[:3, :3] @ here[:3, :3].T).as_rotvec() / (2 * step)
        assert J[:, k] == pytest.approx(np.r_[dt, dw], abs=1e-8), name


def test_robot_world_gives_the_rig_in_the_base_link(arm: Arm) -> None:
    q = drawn(20)
    seen = T_BASE_RIG.inv().apply([base_tool(row).translation for row in q])
    found = armsight.calibrate_robot_world(arm, q, seen)
    assert found.T_base_rig == pytest.approx(T_BASE_RIG.as_matrix(), abs=1e-9)
    assert "base_link" in found.notes[0] and "tool0" in found.notes[0]


def test_hand_eye_of_joints_gives_the_rig_in_the_base_link(arm: Arm) -> None:
    T_flange_target, q = placed((0.05, 0.02, 0.1), (0.1, 0.4, -0.3)), drawn(15)
    seen = [T_BASE_RIG.inv() * base_flange(row) * T_flange_target for row in q]
    hands = [LinkArm(arm=arm).fk(row).as_matrix() for row in q]
    found = armsight.calibrate_hand_eye(hands, [T.as_matrix() for T in seen], setup="eye-to-hand")
    # the flange of the arm's model may be another link than the URDF's, the base may not
    assert found.T_base_camera == pytest.approx(T_BASE_RIG.as_matrix(), abs=1e-6)


def test_identify_in_a_rigs_axes_keeps_the_base_of_the_rigs_calibration() -> None:
    """The rig's place in base is known: the arm found stands on that base, not on its own first axis."""
    home, sweeps = np.array([0.2, -0.6, 0.7, 0.3, 0.9, 0.1]), []
    for joint in range(6):
        q = np.tile(home, (12, 1))
        q[:, joint] += np.linspace(-0.5, 0.5, 12)
        sweeps.append((np.full(12, joint + 1), q))
    joint, q = np.concatenate([s[0] for s in sweeps]), np.concatenate([s[1] for s in sweeps])
    seen = T_BASE_RIG.inv().apply([base_tool(row).translation for row in q])
    found = armsight.identify_arm(joint, q, seen, T_base_rig=T_BASE_RIG.as_matrix(), sigma=1e-6).arm
    assert found.T_world_base.as_matrix() == pytest.approx(np.eye(4))
    for row in drawn(5, seed=3):
        assert fk(found, row)[:3, 3] == pytest.approx(base_tool(row).translation, abs=1e-5)
        assert LinkArm(arm=found).fk(row).translation == pytest.approx(base_tool(row).translation, abs=0.2)


def test_calibration_leaves_base_and_shoulder_where_they_are(arm: Arm) -> None:
    q = drawn(60, seed=1)
    xyz = np.array([base_tool(row).translation for row in q])
    found = armsight.calibrate_arm(arm, q, xyz).arm
    assert found.T_base_frame0.as_matrix() == pytest.approx(arm.T_base_frame0.as_matrix())
    assert found.T_world_base.as_matrix() == pytest.approx(np.eye(4), abs=1e-6)  # measured in base axes
    assert fk(found, q[0])[:3, :3] == pytest.approx(base_tool(q[0]).rotation.as_matrix(), abs=1e-5)


def test_verify_with_the_rigs_place_in_base(arm: Arm) -> None:
    t_s = 0.05 * np.arange(240)
    q = drawn(1)[0] + 0.4 * np.sin(np.outer(t_s, [0.5, 0.7, 0.9, 1.1, 1.3, 1.7]))
    seen = np.array([(T_BASE_RIG.inv() * base_tool(row)).as_matrix() for row in q])
    found = armsight.verify((t_s, seen), arm=arm, joints=(t_s, q), world=T_BASE_RIG)
    assert found.after.max_m < 1e-6


def straight(q: np.ndarray, parent: str) -> TaughtPath:
    """A line of 60 mm along the base's x from where the tool is at q, in base or world axes."""
    start, stand = base_tool(q), placed(*BASE) if parent == "world" else RigidTransform.identity()
    poses = [stand * RigidTransform.from_translation([x, 0.0, 0.0]) * start for x in np.linspace(0.0, 0.06, 13)]
    return TaughtPath.of_poses(np.array([T.as_matrix() for T in poses]), parent=parent)


@pytest.mark.parametrize("parent", ["base", "world"])
def test_a_path_in_base_is_run_in_base(arm: Arm, parent: str, tmp_path: Path) -> None:
    q = drawn(1, seed=12)[0]
    found = armsight.paths.check(straight(q, parent), arm, start=q)
    assert found.ok, found
    exported = tmp_path / "path.csv"
    armsight.paths.export(straight(q, parent), exported, arm=arm, start=q)
    assert exported.exists()
    at = base_tool(q).translation
    for shift, broken in (([0.0, 0.0, 0.0], False), ([0.3, 0.0, 0.0], True)):  # 0.35 m are between the frames
        room = Box(lower_m=at + shift - 0.25, upper_m=at + shift + 0.25)
        inside = armsight.paths.check(straight(q, parent), arm, start=q, limits=Limits(workspace=room, margin_m=0.0))
        assert ("workspace" in str([issue.text for issue in inside.issues])) is broken


def test_boxes_of_the_guard_are_in_base_axes(arm: Arm) -> None:
    q = drawn(1)[0]
    at = base_tool(q).translation
    limits = Limits(workspace=Box(lower_m=at - 0.4, upper_m=at + 0.4), margin_m=0.0)
    space = Space(arm, limits, joint_bounds(arm, limits))
    still = np.zeros((1, 6))
    broken, sight = space.along(q[None], still, still, 0.004, in_space=False)
    assert not broken.outside().any()
    assert sight.T[:3, 3] == pytest.approx(at, abs=1e-12)
    elsewhere = Limits(workspace=Box(lower_m=at + 0.05, upper_m=at + 0.8), margin_m=0.0)
    space = Space(arm, elsewhere, joint_bounds(arm, elsewhere))
    assert space.along(q[None], still, still, 0.004, in_space=False)[0].outside().any()


def test_a_box_out_of_reach_is_measured_from_the_shoulder() -> None:
    """An arm on a beam 6 m from its base link: a workspace about it is within reach, one about the base link is not."""
    text = shouldered_urdf(world=False).replace('xyz="0.15 0.1 0.3"', 'xyz="6 0 3"')
    arm = arm_from_urdf(text)
    Guard(arm, Limits(workspace=Box(lower_m=[5, -1, 2], upper_m=[7, 1, 4])), 0.004)
    with pytest.raises(Inconsistent, match="first joint"):
        Guard(arm, Limits(workspace=Box(lower_m=[-1, -1, -1], upper_m=[1, 1, 1])), 0.004)


def test_the_console_puts_a_rig_of_the_base_into_the_world(arm: Arm) -> None:
    world = World(parent="base", T_parent_rig=T_BASE_RIG)
    placement = Placement(world=world, handeye=None)
    T = placement.rig_pose(arm, None)
    assert T is not None
    assert placement.world_parent(arm).as_matrix() == pytest.approx(placed(*BASE).as_matrix(), abs=1e-12)
    assert T.as_matrix() == pytest.approx((placed(*BASE) * T_BASE_RIG).as_matrix(), abs=1e-12)


def test_a_twin_tells_the_flange_in_base_axes(arm: Arm) -> None:
    told = replace(arm, joints=tuple(replace(j, sign=abs(j.sign)) for j in arm.joints))
    for q in drawn(3):
        assert twin_arm(arm_mapping(told)).flange(q).as_matrix() == pytest.approx(
            LinkArm(arm=told).fk(q).as_matrix(), abs=1e-12
        )
