"""Tracks along paths: continuity, speeds, jumps, singular passages, with their places."""

import dataclasses

import numpy as np
import pytest

from armsight.errors import NotConverged
from armsight.kinematics import Arm, Trouble, fk, preset, track_path
from refusals import names_it, refuses

HOME = np.array([0.1, -0.6, 0.9, 0.2, 0.7, 0.3])


def swing(arm: Arm, goal: np.ndarray, rows: int = 80) -> np.ndarray:
    return HOME + np.linspace(0, 1, rows)[:, None] * (goal - HOME)


@pytest.mark.parametrize("name", ["korayem6r", "ur10", "puma761", "irb120"])
def test_a_track_comes_back_as_it_was(name: str) -> None:
    arm = preset(name)
    q = swing(arm, HOME + np.array([0.5, 0.3, -0.4, 0.6, 0.5, -2.0]))
    path = track_path(arm, fk(arm, q), start=HOME)
    assert path.complete
    np.testing.assert_allclose(path.q, q, atol=1e-8)
    assert path.issues == ()
    assert len(path.branch) == 3
    assert path.motion.q.shape == (80, 6)


def test_speeds_against_the_motors_of_table_3() -> None:
    """Joint 3 may do 0.73 rad/s (Korayem 2018, Table 3); it is asked for 0.9 over the second half."""
    arm = preset("korayem6r")
    t = np.linspace(0, 2, 101)
    q = np.tile(HOME, (101, 1))
    q[:, 2] += 0.5 * t + np.where(t > 1, 0.4 * (t - 1), 0.0)
    path = track_path(arm, fk(arm, q), t_s=t, start=HOME)
    (issue,) = [issue for issue in path.issues if issue.trouble is Trouble.SPEED]
    assert (issue.joint, issue.limit) == ("j3", 0.73)
    assert issue.value == pytest.approx(0.9, rel=1e-6)
    assert (issue.first, issue.last) == (51, 100)
    assert track_path(arm, fk(arm, q), t_s=2 * t, start=HOME).issues == ()


def test_a_wrist_singularity_that_is_passed_straight_is_named_with_its_place() -> None:
    arm = preset("ur10")
    q = swing(arm, HOME + np.array([0.2, 0, 0, 0, -1.4, 0]), rows=81)  # joint 5 from 0.7 to -0.7
    path = track_path(arm, fk(arm, q), start=HOME)
    np.testing.assert_allclose(path.q, q, atol=1e-7)
    singular = [issue for issue in path.issues if issue.trouble is Trouble.SINGULAR]
    assert [("wrist" in issue.text, issue.worst) for issue in singular] == [(True, 40)]
    assert "passes through" in singular[0].text
    (branch,) = [issue for issue in path.issues if issue.trouble is Trouble.BRANCH]
    assert names_it(branch.text, "no flip", "wrist flip")


def test_a_track_close_to_a_singularity_jumps_and_says_where() -> None:
    """A straight line of the wrist past axis 1 at 0.3 mm: joint 1 must turn half round between two poses."""
    arm = preset("puma761")
    arm = dataclasses.replace(
        arm, joints=tuple(dataclasses.replace(j, d_m=0.0 if j.name == "j2" else j.d_m) for j in arm.joints)
    )
    T = np.tile(fk(arm, [0.0, -1.2, 1.9, 0.1, 1.0, 0.2]), (61, 1, 1))
    T[:, :3, 3] = np.array([0.0, 3e-4, 0.9]) + np.linspace(-0.3, 0.3, 61)[:, None] * [1, 0, 0] + 0.125 * T[:, :3, 2]
    path = track_path(arm, T)
    jumps = [issue for issue in path.issues if issue.trouble is Trouble.JUMP]
    assert any(issue.joint == "j1" and issue.first <= 31 <= issue.last + 1 for issue in jumps)
    assert any(issue.trouble is Trouble.SINGULAR and "shoulder" in issue.text for issue in path.issues)


def test_a_path_that_leaves_reach_ends_there() -> None:
    arm = preset("korayem6r")
    T = np.tile(fk(arm, HOME), (50, 1, 1))
    T[:, 0, 3] += np.linspace(0, 0.8, 50)
    path = track_path(arm, T, start=HOME)
    assert not path.complete
    (issue,) = [issue for issue in path.issues if issue.trouble is Trouble.UNREACHED]
    assert issue.first == len(path.q)
    assert "out_of_reach" in issue.text
    np.testing.assert_allclose(fk(arm, path.q), T[: len(path.q)], atol=1e-9)
    with refuses(NotConverged, f"pose {len(path.q)}", "50"):
        _ = path.motion


def test_limits_are_told_with_joint_and_row() -> None:
    arm = preset("korayem6r")
    joints = tuple(dataclasses.replace(j, lower=-2.0, upper=1.0) for j in arm.joints)
    tight = dataclasses.replace(arm, joints=joints)
    q = swing(arm, HOME + np.array([1.4, 0, 0, 0, 0, 0]))
    path = track_path(tight, fk(arm, q), start=HOME)
    issue = next(issue for issue in path.issues if issue.trouble is Trouble.LIMITS)
    assert issue.joint == "j1"
    assert issue.limit == 1.0
    assert path.q[issue.first, 0] > 1.0 >= path.q[issue.first - 1, 0]
