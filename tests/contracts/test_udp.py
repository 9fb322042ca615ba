"""What every driver of a controller that speaks by UDP does, beside what test_links.py holds: faults of the link.

Each steps with its twin on one clock.
"""

from __future__ import annotations

import contextlib
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation
from tests.contracts.conftest import until

from armsight.drivers import PROVING, RobotState, egm, rsi
from armsight.drivers.egm import EgmRobot
from armsight.drivers.rsi import RsiRobot
from armsight.errors import DataRefused, DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, StaleData, UsageError
from armsight_sim.twins.base import small_arm, twin_home
from refusals import refuses

CYCLE_S = 0.004


def test_the_range_of_the_arm_limits_a_goal(make_pair: Any) -> None:
    home = twin_home(small_arm())
    pair = make_pair(upper_rad=(home + 0.003).tolist(), lower_rad=[-3.0] * 6)
    with pair.robot as robot:
        pair.prove()
        robot.step_joints(np.full(6, 0.002))
        pair.advance(CYCLE_S)
        sent = robot.step_joints(np.full(6, 0.002))
        assert "range of joint 1" in sent.limited
        assert sent.q.max() <= (pair.home + 0.003).max() + 1e-12


def test_a_silent_link_stays_lost_even_when_it_speaks_again(make_pair: Any) -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.twin.fault("silent")
        pair.advance(20 * CYCLE_S)
        until(lambda: bool(robot._lost))
        pair.twin.fault("silent", on=False)
        pair.advance(5 * CYCLE_S)
        assert robot.state is RobotState.LOST
        assert "silent" in robot.why


def test_a_second_program_and_a_second_controller_are_refused(make_pair: Any) -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        second = type(robot)(str(robot.port), settings={"bind": "127.0.0.1"})
        with refuses(DeviceFailed, "taken"), second:
            pass
        stranger = pair.controller(robot.port, pair.home + 1.0)
        with contextlib.closing(stranger):
            for _ in range(5):
                stranger.cycle()
            pair.advance(3 * CYCLE_S)
            assert robot.counts.foreign == 5
            assert stranger.counts.taken == 0
        assert np.abs(robot.read().q - pair.home).max() < 2e-5


@pytest.mark.parametrize("parse", [partial(egm.parse, n=6), rsi.parse])
@given(data=st.binary(max_size=600) | st.text(max_size=300).map(str.encode))
@settings(max_examples=150, deadline=None)
def test_garbage_is_refused_by_the_parser(parse: Any, data: bytes) -> None:
    with contextlib.suppress(DataRefused):
        assert np.isfinite(parse(data).q).all()


@pytest.mark.parametrize("driver", [EgmRobot, RsiRobot])
def test_no_controller_is_told(driver: Any, free_port: int) -> None:
    robot = driver(str(free_port), settings={"open_s": 0.05})
    with refuses(DeviceNotFound, "no controller", "sent"), robot:
        pass
    assert robot.state is RobotState.CLOSED


@pytest.mark.parametrize("driver", [EgmRobot, RsiRobot])
@pytest.mark.parametrize(
    ("device", "more", "match"),
    [
        ("abc", {}, "UDP port"),
        ("99999", {}, "UDP port"),
        ("6510", {"cycle": 4}, "cycle"),
        ("6510", {"cycle_s": -1}, "cycle_s"),
        ("6510", {"guidance": "both"}, "guidance"),
    ],
)
def test_wrong_settings_are_refused(driver: Any, device: str, more: dict[str, object], match: str) -> None:
    with refuses(UsageError, match):
        driver(device, settings=more)


@pytest.mark.parametrize(("driver", "named"), [(EgmRobot, "1 joint limits"), (RsiRobot, "lower_rad")])
def test_a_range_of_fewer_joints_is_refused(driver: Any, named: str) -> None:
    with refuses(UsageError, named):
        driver("6510", settings={"lower_rad": [0.0]})


def test_poses_are_followed_in_pose_guidance(make_pair: Any) -> None:
    pair = make_pair(guidance="pose")
    start = pair.arm.flange(pair.home)
    goal = RigidTransform.from_components(
        start.translation + np.array([0.004, -0.003, 0.002]), Rotation.from_rotvec([0.0, 0.02, 0.01]) * start.rotation
    )
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        first = robot.move_pose(goal)
        assert PROVING in first.limited
        while PROVING in robot.move_pose(goal).limited:
            pair.advance(CYCLE_S)
        for _ in range(60):
            last = robot.move_pose(goal)
            pair.advance(CYCLE_S)
        pair.advance(0.4)
        assert last.limited == ()
        reached = pair.arm.flange(pair.twin.q)
        assert np.linalg.norm(reached.translation - goal.translation) < 2e-5
        assert (reached.rotation * goal.rotation.inv()).magnitude() < 5e-5
        assert robot.state is RobotState.READY
        with refuses(UsageError, "guided"):
            robot.step_joints(np.full(6, 0.001))
        with refuses(Inconsistent, "finite"):
            robot.move_pose(RigidTransform.from_translation([np.nan, 0.0, 0.0]))


def test_a_reading_where_the_arm_cannot_be_is_refused(make_pair: Any) -> None:
    pair = make_pair()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair.stand(1.0)
        pair.advance(2 * CYCLE_S)
        assert robot.counts.refused == 2
        pair.advance(20 * CYCLE_S)
        with pytest.raises((StaleData, DeviceLost)):
            robot.read()
