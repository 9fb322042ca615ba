"""What every driver does whose controller asks for an answer in each cycle: the contract of robots, and sessions.

Each steps with its twin on one clock.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.contracts.conftest import OF_EVERY_LINK, SAME_CODE, WRONG
from tests.truth.emulated_links import World, link_of

from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.errors import DeviceLost
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController
from armsight_sim.twins.base import RIGHT
from refusals import refuses


class TestContract(RobotContract):
    @pytest.fixture(autouse=True)
    def _of(self, make_link: Any) -> None:
        self._make = make_link

    def make(self) -> RobotCase:
        pair = self._make()
        return RobotCase(
            robot=pair.robot,
            advance=pair.advance,
            lose_link=lambda: pair.twin.fault("silent"),
            freeze=lambda: pair.twin.fault("frozen"),
            stand_still=pair.stand_still,
            true_joints=lambda: pair.twin.q,
            tolerance=1e-4,
        )

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        kind = self._make.of.kind
        if kind != "rsi" and fault not in OF_EVERY_LINK:
            return SAME_CODE
        if kind == "linuxcnc":
            return linuxcnc_wrong(fault, self._make)
        link = link_of(kind, ManualClock(100.0), World(wrong=WRONG.get(fault, RIGHT), cycles=fault.cycles))
        return link.wrong_case()


def linuxcnc_wrong(fault: WrongController, make: Any) -> WrongCase | str:
    """Return a LinuxCNC whose joints take counts otherwise."""
    if fault.cycles != 1.0:
        return "the driver says how many servo cycles a state has, and its cycle is that many"
    if fault is WrongController.RELATIVE:
        return "counts are differences, and the bridge alone adds them up"
    pair = make(wrong=WRONG[fault])
    return WrongCase(robot=pair.robot, advance=pair.advance, joints=lambda: pair.twin.q)


def test_a_step_that_was_taken_before_a_stand_still_goes_out_no_more(make_link: Any) -> None:
    pair = make_link()
    with pair.robot as robot:
        pair.prove()
        robot.step_joints(np.full(6, 0.001))
        pair.advance(25 * pair.cycle_s)
        rest, tick = pair.twin.q, robot._tick

        def stands_still(cycles: int, *, taken: bool) -> None:
            tick(cycles, taken=taken)
            robot._tick = tick
            for _ in range(round(0.15 / pair.cycle_s)):  # its controller goes on
                pair.clock.advance(pair.cycle_s)
                pair.twin.cycle()

        robot._tick = stands_still
        robot.step_joints(np.full(6, 0.001))
        pair.advance(25 * pair.cycle_s)
        assert np.abs(pair.twin.q - rest).max() < 2e-5
        assert robot.state in (RobotState.STOPPED, RobotState.LOST)  # RSI's session may have ended meanwhile
        if robot.state is RobotState.LOST:
            return
        assert "stood still" in robot.why
        robot.reset()
        pair.prove()
        sent = robot.step_joints(np.full(6, 0.0005))
        pair.advance(25 * pair.cycle_s)
        assert np.abs(pair.twin.q - rest - 0.0005).max() < 4e-5, sent


def test_a_late_caller_leaves_the_arm_where_it_was_told_to_go(make_link: Any) -> None:
    pair = make_link()
    with pair.robot as robot:
        pair.prove()
        sent = robot.step_joints(np.full(6, 0.002))
        pair.advance(100 * pair.cycle_s)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert np.allclose(sent.q, pair.home + 0.002, atol=2e-5)


def test_stop_holds_within_one_cycle_and_drops_what_was_asked(make_link: Any) -> None:
    pair = make_link()
    with pair.robot as robot:
        pair.prove()
        for _ in range(20):
            sent = robot.step_joints(np.full(6, 1.0))
            pair.advance(pair.cycle_s)
        robot.step_joints(np.full(6, 1.0))
        robot.stop()
        pair.advance(1.0)
        assert np.abs(pair.twin.q - sent.q).max() < pair.brakes_rad
        assert robot.state is RobotState.STOPPED


def test_a_controller_that_starts_anew_is_lost_and_can_be_opened_again(make_link: Any) -> None:
    pair = make_link()
    with pair.robot as robot:
        pair.prove()
        robot.step_joints(np.full(6, 0.001))
        pair.advance(25 * pair.cycle_s)
        pair.restart()
        pair.twin.push(np.full(6, 0.1))
        pair.advance(25 * pair.cycle_s)
        assert robot.state is RobotState.LOST
        with refuses(DeviceLost, "anew"):
            robot.read()
    there = pair.twin.q
    assert np.abs(there - pair.home - 0.101).max() < 1e-4
    with robot:
        pair.advance(25 * pair.cycle_s)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - there).max() < 2e-5
