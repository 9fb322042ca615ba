"""What links find out about their controllers, and that each rule is needed: drivers and twins on one virtual clock."""

from __future__ import annotations

import re
from collections import deque
from typing import Any

import numpy as np
import pytest
from tests.truth.emulated_links import Link, Wire, World, link_of

from armsight.clock import ManualClock
from armsight.drivers import PROVING, RobotState
from armsight.drivers.pace import ControllerClock
from armsight.errors import DeviceFailed
from armsight.testing.wrong_controllers import prove
from armsight_sim.twins.base import Wrong
from refusals import refuses


def opened(kind: str, **more: Any) -> Link:
    return link_of(kind, ManualClock(100.0), World(), **more)


def advance(link: Link, cycles: int) -> None:
    for _ in range(cycles):
        link.cycle()


def proven(link: Link) -> None:
    prove(link.robot, lambda time_s: link.cycle())


def test_a_link_that_loses_every_second_packet_each_way_is_opened_and_proven() -> None:
    link, rng = opened("rsi"), np.random.default_rng(3)
    up, down = (Wire(rng=rng, loss=0.5, late=0.0) for _ in range(2))
    link.cycle = lambda: lossy_cycle(link, up, down)  # type: ignore[method-assign]
    with link.robot as robot:
        assert robot.measured_cycle_s == pytest.approx(0.004)
        proven(link)
        assert robot.proven


def lossy_cycle(link: Link, up: Wire, down: Wire) -> None:
    link.clock.advance(link.twin_cycle_s)
    link.twin.cycle()
    for data in link.spoken():
        up.send(data, 0)
    for data in link.hear(up.due(0), together=True, between=lambda: None):
        down.send(data, 0)
    for data in down.due(0):
        link.answer(data)


def test_a_line_of_thirty_milliseconds_each_way_says_that_it_is_too_slow() -> None:
    link = opened("egm")
    up: deque[list[bytes]] = deque([[]] * 7)
    down: deque[list[bytes]] = deque([[]] * 7)

    def cycle() -> None:
        link.clock.advance(link.twin_cycle_s)
        link.twin.cycle()
        up.append(link.spoken())
        down.append(link.hear(up.popleft(), together=True, between=lambda: None))
        for data in down.popleft():
            link.answer(data)

    link.cycle = cycle  # type: ignore[method-assign]
    with link.robot as robot, refuses(DeviceFailed, "only every", "too slow"):
        for _ in range(800):
            robot.step_joints(np.full(6, 1e-4))
            link.cycle()


def test_doubled_and_late_packets_are_no_new_start_and_a_new_start_is_one() -> None:
    link = opened("egm")
    with link.robot as robot:
        kept: list[bytes] = []
        for i in range(60):
            link.clock.advance(link.cycle_s)
            link.twin.cycle()
            kept += link.spoken()
            if i % 6 == 5:  # the newest first, then those that it overtook, all twice
                for data in [kept[-1], *kept[:-1]]:
                    link.hear([data, data], together=False, between=lambda: None)
                kept.clear()
        assert robot.state is RobotState.READY
        assert robot.counts.repeated > 100
        link.twin.restart()
        for _ in range(10):
            link.twin.cycle()
            link.hear(link.spoken(), together=True, between=lambda: None)
        assert "anew" in robot.why


def test_a_controller_that_takes_no_answer_is_not_opened_and_the_file_is_named() -> None:
    link = opened("rsi")
    link.twin._sen = re.compile("<Another>(.*)</Another>")
    link.twin._connected = True  # it counts from its start
    with refuses(DeviceFailed, "Delay", "counted", "--rsi-config"), link.robot:
        pass


@pytest.mark.parametrize("kind", ["rsi", "egm"])
def test_a_clock_that_jumps_stops_the_arm(kind: str) -> None:
    link = opened(kind)
    with link.robot as robot:
        proven(link)
        if kind == "rsi":
            link.twin._ipoc += 3000
        else:
            link.twin._started_cycle -= 750
        advance(link, 3)
        assert "clock jumped by +3" in robot.why
        with refuses(DeviceFailed, "jumped"):
            robot.step_joints(np.full(6, 1e-3))
        robot.reset()
        assert PROVING in robot.step_joints(np.full(6, 1e-3)).limited


def test_a_controller_that_changes_its_pace_stops_the_arm_and_the_setting_is_named() -> None:
    link = opened("rsi")
    with link.robot as robot:
        proven(link)
        link.twin._ms, link.twin_cycle_s = 2, 0.002
        before = link.twin.q
        for _ in range(80):
            if robot.state is not RobotState.STOPPED:
                robot.step_joints(np.full(6, 1.0))
            link.cycle()
        assert np.abs(link.twin.q - before).max() < 0.01
        assert "every 2 ms" in robot.why
        assert "cycle_s to 0.002" in robot.why


@pytest.mark.parametrize(("pace", "steps"), [(0.001, 100), (0.002, 200), (0.004, 400), (0.012, 400)])
def test_no_more_steps_than_the_controllers_clock_allows(pace: float, steps: int) -> None:
    clock, taken = ControllerClock(0.004, numbered=False), 0
    for i in range(400):
        clock.hear(i * pace, 0, i * pace)
        taken += clock.take_step()
    assert steps <= taken <= steps + 2


def test_packets_that_come_late_make_no_jump_of_the_clock_and_a_jump_is_one() -> None:
    clock, rng = ControllerClock(0.004, numbered=False), np.random.default_rng(5)
    said = [clock.hear(0.004 * i, 0, 0.004 * i + float(rng.exponential(0.05))) for i in range(2000)]
    assert not any(said)
    assert "jumped" in clock.hear(8.0 + 0.5, 0, 8.0)


@pytest.mark.parametrize(("cycle_s", "piled_up", "jitter_s"), [(0.028, 14, 0.0), (0.028, 0, 0.04), (0.014, 6, 0.0)])
def test_a_computer_that_reads_late_is_no_other_cycle(cycle_s: float, piled_up: int, jitter_s: float) -> None:
    clock, rng = ControllerClock(0.028, numbered=True, own=True), np.random.default_rng(2)
    for i in range(36):
        read_s = cycle_s * max(i, piled_up) + float(rng.uniform(0.0, jitter_s)) + 1e-4 * i
        clock.hear(read_s, i, read_s)
    assert clock.sure
    assert bool(clock.wrong) is (cycle_s == 0.014)


def test_an_arm_that_goes_on_though_it_is_told_to_stand_is_answered_no_more() -> None:
    link = opened("rsi")
    with link.robot as robot:
        proven(link)
        for _ in range(5):
            robot.step_joints(np.full(6, 2e-4))
            link.cycle()
        link.twin.wrong = Wrong(adds=True)
        robot.stop()
        advance(link, 300)
        assert robot.state is RobotState.LOST
        assert "answered no more" in robot.why
        advance(link, 120)
        assert link.twin.counts.ended >= 1


def test_a_stop_under_way_ends_the_probe_where_it_began() -> None:
    link = opened("rsi")
    with link.robot as robot:
        home = link.twin.q
        robot.step_joints(np.full(6, 1e-3))
        advance(link, 30)
        assert np.abs(link.twin.q - home).max() > 1e-4
        robot.stop()
        advance(link, 60)
        assert np.abs(link.twin.q - home).max() < 2e-5
        robot.reset()
        proven(link)
        assert robot.proven


def test_the_probe_stays_within_the_ranges_of_the_joints() -> None:
    home = World().home
    link = opened("rsi", upper_rad=(home + 1e-4).tolist(), lower_rad=(home - 1.0).tolist())
    with link.robot:
        proven(link)
        assert (link.twin.q <= home + 1e-4).all()
