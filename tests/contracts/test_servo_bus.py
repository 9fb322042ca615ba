"""Drivers of bus servos against their twins: the contract of robots, what is found at opening, broken answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests.contracts.servo_pairs import KINDS, ServoPair

from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController

STEP = 2 * 3.141592653589793 / 4096


@pytest.fixture(params=list(KINDS))
def make(request: Any) -> Iterator[Callable[..., ServoPair]]:
    pairs: list[ServoPair] = []

    def one(**more: Any) -> ServoPair:
        pairs.append(ServoPair(request.param, **more))
        return pairs[-1]

    yield one
    for pair in pairs:
        pair.close()


class TestContract(RobotContract):
    @pytest.fixture(autouse=True)
    def _of(self, make: Any) -> None:
        self._make = make

    def make(self) -> RobotCase:
        pair = self._make()
        return RobotCase(
            robot=pair.robot,
            advance=pair.advance,
            lose_link=lambda: pair.twin.fault("silent"),
            freeze=None,  # an old answer is known by its size: it is none
            stand_still=pair.clock.pass_over,
            true_joints=lambda: pair.twin.q,
            tolerance=1.6 * STEP,
        )

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        pair = self._make()
        if fault is WrongController.RELATIVE and pair.kind == "feetech":
            pair.twin.servos[2].table[33] = 3
            return WrongCase(robot=pair.robot, advance=pair.advance, joints=lambda: pair.twin.q)
        if fault.cycles != 1.0:
            return "a servo has no cycle: it answers when it is asked"
        return "goal and position of a servo are steps of the same encoder: what is wrong with one is so with both"
