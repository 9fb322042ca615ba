"""After a crash: the joint that moved, the tool, nothing, or that it cannot be told; poses that decide."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent
from armsight.kinematics import fk, preset
from armsight.verify import Align, Measured
from armsight.verify.mastering import check_mastering, propose
from refusals import refuses

NOISE = np.array([2e-4, 5e-4])
ARM = replace(preset("irb120"), T_flange_tool=RigidTransform.from_translation([0.02, 0.0, 0.08]))
Q = np.array([0.1, 0.2, -0.1, 0.3, 0.8, 0.2]) + np.random.default_rng(2).uniform(-0.5, 0.5, (10, 6))
SAME = RigidTransform.identity()
BENT = RigidTransform.from_components([3e-3, 0.0, 1e-3], Rotation.from_rotvec([0.01, 0.02, 0.0]))


def measured(by: tuple[float, ...] = (0.0,) * 6, tool: RigidTransform = SAME, q: np.ndarray = Q) -> Measured:
    """Poses of the arm with zeros off by so many degrees and the tool moved."""
    rng = np.random.default_rng(4)
    T = RigidTransform.from_matrix(fk(ARM, q + np.deg2rad(by))) * tool
    return Measured(
        xyz_m=T.translation + rng.normal(0.0, NOISE[0], (10, 3)),
        rotation=(Rotation.from_rotvec(rng.normal(0.0, NOISE[1], (10, 3))) * T.rotation).as_matrix(),
        std=np.tile(np.repeat(NOISE, 3), (10, 1)),
    )


@pytest.mark.parametrize("joint", [0, 2, 5])
def test_the_joint_that_moved_is_named_with_its_value(joint: int) -> None:
    found = check_mastering(ARM, Q, measured(tuple(0.4 * (i == joint) for i in range(6))), Align.NONE)
    assert found.cause == f"joint {joint + 1}"
    assert found.offset is not None and found.std is not None
    assert abs(found.offset - np.deg2rad(0.4)) < 4.0 * found.std
    assert found.std < np.deg2rad(0.05)


def test_nothing_moved_and_a_bent_tool_is_no_joint() -> None:
    assert check_mastering(ARM, Q, measured(), Align.NONE).cause == "none"
    found = check_mastering(ARM, Q, measured(tool=BENT), Align.NONE)
    assert found.cause == "tool" and found.joint is None and found.T_tool is not None
    assert np.linalg.norm(found.T_tool.translation - BENT.translation) < 1e-3


def test_a_bent_tool_is_no_joint_of_a_wrist_that_hardly_turned() -> None:
    """Bent about the fifth axis: where the wrist stays within 0.06 rad, that joint's zero does the same."""
    q = Q.copy()
    q[:, 3:] = np.array([0.3, 0.8, 0.2]) + np.random.default_rng(3).uniform(-0.06, 0.06, (10, 3))
    middle = q.mean(axis=0)
    straight, bent = RigidTransform.from_matrix(
        fk(ARM, middle + np.deg2rad([[0.0] * 6, [0.0, 0.0, 0.0, 0.0, 0.4, 0.0]]))
    )
    found = check_mastering(ARM, q, measured(tool=straight.inv() * bent, q=q), Align.NONE)
    assert found.cause == "undecided" and found.joint is None


def test_two_joints_are_not_called_one() -> None:
    assert check_mastering(ARM, Q, measured((0.0, 0.5, 0.0, 0.0, 0.5, 0.0)), Align.NONE).cause == "several"


def test_without_base_and_tool_the_first_and_the_last_joint_are_not_judged() -> None:
    found = check_mastering(ARM, Q, measured((0.0, 0.0, 0.4, 0.0, 0.0, 0.0)), Align.BOTH)
    assert [one.judged for one in found.joints] == [False, True, True, True, True, False]
    assert found.cause == "joint 3"


def test_a_row_of_another_pose_is_left_out_by_number() -> None:
    wrong = Q.copy()
    wrong[6] += 0.3
    found = check_mastering(ARM, wrong, measured((0.0, 0.0, 0.4, 0.0, 0.0, 0.0)), Align.NONE)
    assert [row for row, _ in found.rejected] == [7]
    assert found.cause == "joint 3"


def test_poses_in_another_frame_are_no_crash() -> None:
    seen = replace(measured(), std=None, covariance=None)
    T = RigidTransform.from_components([1.7, 0.1, 0.3], Rotation.from_rotvec([1.2, 1.2, 1.2]))
    turned = replace(seen, xyz_m=T.apply(seen.xyz_m), rotation=T.rotation.as_matrix() @ seen.rotation)
    with refuses(Inconsistent, "left"):
        check_mastering(ARM, Q, turned, Align.NONE)


def test_proposed_poses_tell_what_they_are_said_to() -> None:
    q = Q.mean(axis=0) + np.random.default_rng(1).uniform(-0.5, 0.5, (60, 6))
    plan = propose(ARM, q, Align.NONE, NOISE)
    assert plan.q.shape == (10, 6) and len(np.unique(plan.q, axis=0)) == 10
    assert set().union(*plan.decides) == {0, 1, 2, 3, 4}
    assert np.isfinite(plan.expected[:5]).all() and np.isinf(plan.expected[5])
