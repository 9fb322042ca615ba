"""Goals of a link: what one cycle allows, ranges, and that no limit moves an arm by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from armsight.drivers.goals import JointGoals, JointLimits
from armsight.errors import ArmsightError, Inconsistent, UsageError
from refusals import refuses

CYCLE_S = 0.004
SPEED = np.array([1.0, 2.0, 0.5])


def goals(start: np.ndarray) -> JointGoals:
    limits = JointLimits(lower=np.full(3, -1.0), upper=np.full(3, 1.0), max_speed=SPEED)
    made = JointGoals("arm", limits, CYCLE_S)
    made.start(start)
    return made


@given(arrays(float, (20, 3), elements=st.floats(-5.0, 5.0)), st.integers(1, 7))
@settings(max_examples=100, deadline=None)
def test_no_cycle_is_longer_than_the_speed_and_no_goal_out_of_range(steps: np.ndarray, calls: int) -> None:
    start = np.array([0.995, -0.3, -0.999])
    made = goals(start)
    before = start
    for i, step in enumerate(steps):
        asked, _ = made.step(step, before)
        if i % calls == 0:
            sent = made.take()
            assert np.array_equal(sent, asked)
            assert (np.abs(sent - before) <= SPEED * CYCLE_S * (1 + 1e-9)).all()
            assert (np.abs(sent) <= 1.0).all()
            before = sent


def test_an_arm_beyond_its_range_stays_or_comes_back() -> None:
    start = np.array([1.5, 0.0, 0.0])
    made = goals(start)
    out, limited = made.step(np.array([0.001, 0.0, 0.0]), start)
    assert np.array_equal(out, start)
    assert limited == ("range of joint 1",)
    back, limited = made.step(np.array([-0.001, 0.0, 0.0]), start)
    assert back[0] == pytest.approx(1.499)
    assert limited == ()


def test_what_was_asked_and_not_sent_is_forgotten_by_a_hold() -> None:
    made = goals(np.zeros(3))
    made.step(np.full(3, 0.001), np.zeros(3))
    made.hold()
    assert np.array_equal(made.take(), np.zeros(3))


@pytest.mark.parametrize(
    ("step", "kind"),
    [(np.zeros(2), UsageError), (np.full(3, np.nan), Inconsistent), (np.array([0.0, np.inf, 0.0]), Inconsistent)],
)
def test_nonsense_is_refused(step: np.ndarray, kind: type[ArmsightError]) -> None:
    with refuses(kind, "step") as refused:
        goals(np.zeros(3)).step(step, np.zeros(3))
    assert refused.value.consequence.startswith("Nothing was")
