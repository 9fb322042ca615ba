"""What cannot be: refused with cause, consequence and cure."""

import numpy as np
import pytest

from armsight.errors import ArmsightError, Inconsistent, NotConverged
from armsight.kinematics import Effort, Joint, fk, ik, ik_many, preset, solve_numeric, track_path
from refusals import refuses

ARM = preset("korayem6r")
HOME = np.array([0.1, -0.4, 0.6, 0.2, 0.7, 0.3])


def told(error: pytest.ExceptionInfo[ArmsightError]) -> str:
    return str(error.value)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"type": "ball"}, ("ball", "revolute, prismatic")),
        ({"sign": 0.0}, "sign"),
        ({"sign": 57.3}, "sign"),
        ({"lower": 1.0, "upper": 1.0}, "equal"),
        ({"max_speed": -1.0}, "max_speed"),
    ],
)
def test_joints_that_cannot_be(fields: dict[str, object], words: str) -> None:
    with refuses(Inconsistent, words):
        Joint(name="j", **fields)  # type: ignore[arg-type]


def test_a_pose_in_millimetres_is_told_as_such() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] *= 1000.0
    for call in (lambda: ik(ARM, T), lambda: ik_many(ARM, T[None]), lambda: solve_numeric(ARM, T)):
        with pytest.raises(Inconsistent, match="millimetres") as error:
            call()
        assert "pose 0" in told(error)
    with refuses(Inconsistent, "pose 1", "millimetres"):
        track_path(ARM, np.array([fk(ARM, HOME), T]))


def test_an_unreachable_pose_says_so_and_by_how_much() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] = [2.0, 0.0, 0.4]
    answer = ik(ARM, T)
    assert answer.status == "out_of_reach"
    assert answer.solutions == ()
    assert "2.03961 m" in answer.why
    T[:3, 3] = [0.75, 0.0, 0.4]  # inside the sum of the lengths, outside what the wrist can do
    assert ik(ARM, T).status == "out_of_reach"


def test_a_numeric_run_that_misses_is_not_a_solution() -> None:
    T = fk(ARM, HOME)
    T[:3, 3] = [0.75, 0.0, 0.4]
    attempt = solve_numeric(ARM, T, HOME, effort=Effort(restarts=3))
    assert not attempt.converged
    assert attempt.error_m > 1e-3
    with refuses(NotConverged, "4 starts", "local minimum"):
        _ = attempt.q
