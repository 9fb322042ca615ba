"""What cannot be: refused with cause, consequence and cure."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.errors import ArmsightError, Inconsistent, NotConverged, UsageError
from armsight.kinematics import (
    Arm,
    Effort,
    Joint,
    dh_arm,
    fk,
    fk_jacobian,
    ik,
    ik_many,
    jacobian,
    link_to_line,
    moved,
    preset,
    solve_numeric,
    track_path,
)
from refusals import refuses

ARM = preset("korayem6r")
HOME = np.array([0.1, -0.4, 0.6, 0.2, 0.7, 0.3])


def told(error: pytest.ExceptionInfo[ArmsightError]) -> str:
    return str(error.value)


@pytest.mark.parametrize("q", [[0.0] * 5, [0.0] * 7, np.zeros((3, 5)), np.zeros((2, 2, 6)), 0.0])
def test_wrong_number_of_joints(q: object) -> None:
    with pytest.raises(UsageError, match="6 joints") as error:
        fk(ARM, q)  # type: ignore[arg-type]
    assert "j1, j2, j3, j4, j5, j6" in told(error)


@pytest.mark.parametrize("value", [np.nan, np.inf, 2e4])
def test_joint_values_that_are_none(value: float) -> None:
    for q in ([value, 0, 0, 0, 0, 0], [[0] * 6, [0, 0, value, 0, 0, 0]]):
        with refuses(Inconsistent, "joint value"):
            jacobian(ARM, q)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"type": "ball"}, ("ball", "revolute, prismatic")),
        ({"a_m": np.nan}, ("a_m", "joint j", "finite")),
        ({"sign": 0.0}, "sign"),
        ({"sign": 57.3}, "sign"),
        ({"lower": 1.0, "upper": -1.0}, "swapped"),
        ({"lower": 1.0, "upper": 1.0}, "equal"),
        ({"lower": np.nan}, "swapped"),
        ({"max_speed": -1.0}, "max_speed"),
    ],
)
def test_joints_that_cannot_be(fields: dict[str, object], words: str) -> None:
    with refuses(Inconsistent, words):
        Joint(name="j", **fields)  # type: ignore[arg-type]


def test_arms_that_cannot_be() -> None:
    with refuses(Inconsistent, "one joint"):
        Arm(name="none", joints=())
    with refuses(Inconsistent, "joint names"):
        Arm(name="twice", joints=(Joint(name="j"), Joint(name="j")))


def test_an_unknown_arm_is_answered_with_the_known_ones() -> None:
    with refuses(
        UsageError, "korayem6r", "puma761", "stanford-rrp", "ur3", "ur10e", "kr6", "iiwa14", "panda", "irb120"
    ):
        preset("puma560")
    with refuses(UsageError, "j1.a_m"):
        moved(ARM, {"j7.a_m": 1.0})


def test_a_pose_in_millimetres_is_told_as_such() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] *= 1000.0
    for call in (lambda: ik(ARM, T), lambda: ik_many(ARM, T[None]), lambda: solve_numeric(ARM, T)):
        with pytest.raises(Inconsistent, match="millimetres") as error:
            call()
        assert "pose 0" in told(error)
    with refuses(Inconsistent, "pose 1", "millimetres"):
        track_path(ARM, np.array([fk(ARM, HOME), T]))


def test_poses_that_are_none() -> None:
    T = fk(ARM, HOME)
    broken = T.copy()
    broken[0, 3] = np.nan
    with refuses(Inconsistent, "pose 1", "finite"):
        ik_many(ARM, np.array([T, broken]))
    mirrored = T.copy()
    mirrored[:3, 0] *= -1.0
    stretched = T.copy()
    stretched[:3, :3] *= 1.001
    for matrix in (mirrored, stretched):
        with refuses(Inconsistent, "rotation"):
            ik(ARM, matrix)
    with pytest.raises(UsageError, match="4x4"):
        ik(ARM, T[:3])


def test_an_unreachable_pose_says_so_and_by_how_much() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] = [2.0, 0.0, 0.4]
    answer = ik(ARM, T)
    assert answer.status == "out_of_reach"
    assert answer.solutions == ()
    assert "2.03961 m" in answer.why
    T[:3, 3] = [0.75, 0.0, 0.4]  # inside the sum of the lengths, outside what the wrist can do
    assert ik(ARM, T).status == "out_of_reach"


def test_no_closed_form_is_told() -> None:
    arm = dh_arm("odd", [(0.1, 0.5, 0.1, 0.0)] * 6)
    with refuses(UsageError, "closed form"):
        ik_many(arm, np.eye(4))


def test_a_numeric_run_that_misses_is_not_a_solution() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] = [0.75, 0.0, 0.4]
    attempt = solve_numeric(ARM, T, HOME, effort=Effort(restarts=3))
    assert not attempt.converged
    assert attempt.error_m > 1e-3
    with refuses(NotConverged, "4 starts", "local minimum"):
        _ = attempt.q


def test_unknown_words_are_answered_with_the_known_ones() -> None:
    T = fk(ARM, HOME)
    with refuses(UsageError, "pose, position"):
        ik(ARM, T, task="pointing")
    with refuses(UsageError, "damped, newton"):
        solve_numeric(ARM, T, method="magic")
    with refuses(UsageError, "world", "base", "tool"):
        jacobian(ARM, HOME, axes="camera")  # type: ignore[arg-type]


def test_an_axis_that_is_not_of_unit_length() -> None:
    with refuses(Inconsistent, "length 2"):
        link_to_line(np.eye(4), [0, 0, 0], [0, 0, 2])


def test_arrays_to_fill_that_are_too_small() -> None:
    with refuses(UsageError, "beyond"):
        fk_jacobian(ARM, np.tile(HOME, (3, 1)), out=(np.empty((2, 4, 4)), np.empty((3, 6, 6))))
