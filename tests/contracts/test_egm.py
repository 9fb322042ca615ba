"""The EGM driver against its twin, beside what all by UDP do: what it reports, and garbage. Both step on one clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.contracts.conftest import until

from armsight.drivers import RobotState
from armsight.errors import DeviceFailed
from refusals import refuses

CYCLE_S = 0.004


def test_nothing_moves_by_opening_and_holding(make_egm: Any) -> None:
    pair = make_egm()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        late = pair.twin.counts.late  # while the driver opens, the controller does not wait for its answers
        pair.advance(0.4)
        assert robot.state is RobotState.READY
        assert np.abs(pair.twin.q - pair.home).max() <= 1e-5
        assert pair.twin.counts.taken >= 100
        assert pair.twin.counts.refused == pair.twin.counts.late - late == 0


def test_the_lag_of_an_arm_that_is_held_up_limits_a_goal(make_egm: Any) -> None:
    pair = make_egm()
    with pair.robot as robot:
        pair.prove()
        pair.twin.fault("blocked")
        for _ in range(400):
            sent = robot.step_joints(np.full(6, -1.0))
            pair.advance(CYCLE_S)
        assert "lag of joint 1" in sent.limited
        assert np.abs(sent.q - pair.home).max() < 0.6


@pytest.mark.parametrize(("fault", "named"), [("motors_off", "motors"), ("egm_stopped", "EGM")])
def test_a_controller_that_takes_no_motion_is_told_and_not_pulled_back(make_egm: Any, fault: str, named: str) -> None:
    pair = make_egm()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin.fault(fault)
        pair.advance(2 * CYCLE_S)
        assert robot.state is RobotState.STOPPED
        with refuses(DeviceFailed, named):
            robot.step_joints(np.zeros(6))
        with refuses(DeviceFailed, "stays stopped"):
            robot.reset()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(2 * CYCLE_S)
        pair.twin.fault(fault, on=False)
        pair.advance(2 * CYCLE_S)
        with refuses(DeviceFailed, "goes on"):
            robot.step_joints(np.zeros(6))
        robot.reset()
        pair.advance(0.4)
    assert np.abs(pair.twin.q - pair.home - 0.1).max() < 2e-5


def test_garbage_on_the_wire_is_counted_and_moves_nothing(make_egm: Any) -> None:
    pair = make_egm()
    rng = np.random.default_rng(7)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        good = pair.twin._packet()
        for i in range(300):
            bad = bytearray(good)
            if i % 3 == 0:
                bad = bytearray(rng.bytes(int(rng.integers(0, 900))))
            elif i % 3 == 1:
                bad = bad[: int(rng.integers(0, len(bad)))]
            else:
                for place in rng.integers(0, len(bad), 8):
                    bad[place] = int(rng.integers(0, 256))
            pair.twin.link.sendto(bytes(bad), ("127.0.0.1", robot.port))
        counts = robot.counts
        until(lambda: counts.refused + counts.repeated + counts.heard >= 300)
        assert robot.counts.refused > 100
        pair.advance(10 * CYCLE_S)
    assert np.abs(pair.twin.q - pair.home).max() < 0.25  # what a packet says of the arm is no goal
