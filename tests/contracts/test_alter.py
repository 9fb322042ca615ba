"""The driver of real-time path control against its twin on a pseudo terminal. Both step on one clock."""

from __future__ import annotations

import contextlib
import os
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation
from tests.contracts.conftest import until

from armsight.drivers import PROVING, RobotState
from armsight.drivers.alter import AlterRobot
from armsight.drivers.alter.frames import FrameSplitter, parse_state
from armsight.errors import DataRefused, DeviceFailed, DeviceLost, DeviceNotFound, UsageError
from armsight_sim.twins.alter import AlterController
from armsight_sim.twins.base import small_arm, twin_drive, twin_home
from refusals import refuses

CYCLE_S = 0.028
HOME = twin_home(small_arm())


@pytest.mark.parametrize("tool", [False, True])
@pytest.mark.parametrize("cumulative", [False, True])
def test_joints_and_poses_are_followed_in_every_mode(cumulative: bool, tool: bool, make_alter: Any) -> None:
    pair = make_alter(cumulative=cumulative, tool=tool)
    with pair.robot as robot:
        pair.prove()
        for _ in range(5):
            sent = robot.step_joints(np.array([1.0, -1.0, 1.0, 2.0, -2.0, 1.0]) * 1e-3)
            pair.advance(CYCLE_S)
        pair.advance(15 * CYCLE_S)
        assert np.abs(pair.twin.q - sent.q).max() < 2e-5
        assert sent.pose is not None
        goal = RigidTransform.from_components(
            sent.pose.translation + np.array([0.004, -0.003, 0.002]),
            Rotation.from_rotvec([0.01, 0.02, 0.01]) * sent.pose.rotation,
        )
        assert robot.move_pose(goal).limited
        for _ in range(6):
            pair.advance(CYCLE_S)
            last = robot.move_pose(goal)
        pair.advance(15 * CYCLE_S)
        assert last.limited == ()
        reached = RigidTransform.from_matrix(pair.twin.commanded)
        assert np.linalg.norm(reached.translation - goal.translation) < 2e-6
        assert (reached.rotation * goal.rotation.inv()).magnitude() < 5e-6
        assert pair.twin.counts.refused == 0


def test_opening_and_holding_moves_nothing_even_with_a_slightly_wrong_arm(make_alter: Any) -> None:
    pair = make_alter(longer=0.003)
    with pair.robot as robot:
        pair.advance(10 * CYCLE_S)
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - pair.home).max() <= 1e-5


def test_the_file_of_another_arm_is_refused(make_alter: Any) -> None:
    pair = make_alter(longer=0.05, open_s=0.1)
    with refuses(DeviceNotFound, "another arm"), pair.robot:
        pass


def test_the_controllers_mode_must_be_the_one_that_is_set(make_alter: Any) -> None:
    pair = make_alter(axes="tool", open_s=0.1)
    with refuses(DeviceNotFound, "otherwise"), pair.robot:
        pass
    assert np.abs(pair.twin.q - pair.home).max() <= 1e-5


def test_without_the_arms_geometry_it_takes_poses_alone(make_alter: Any) -> None:
    pair = make_alter(longer=None)
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        with pytest.raises(UsageError, match="geometry"):
            robot.step_joints(np.full(6, 1e-3))
        start = robot.step_joints(np.zeros(6)).pose
        assert start is not None
        while PROVING in robot.move_pose(RigidTransform.from_translation([0.001, 0.0, 0.0]) * start).limited:
            pair.advance(CYCLE_S)
        sent = robot.move_pose(RigidTransform.from_translation([0.001, 0.0, 0.0]) * start)
        pair.advance(15 * CYCLE_S)
        assert np.allclose(pair.twin.commanded, sent.pose.as_matrix(), atol=2e-6)  # type: ignore[union-attr]


def test_no_command_is_faster_than_the_flange_may_be(make_alter: Any) -> None:
    pair = make_alter()
    with pair.robot as robot:
        pair.prove()
        before = pair.twin.commanded
        for _ in range(20):
            robot.step_joints(np.full(6, 1.0))
            pair.advance(CYCLE_S)
            assert np.linalg.norm(pair.twin.commanded[:3, 3] - before[:3, 3]) <= 0.1 * CYCLE_S * 1.02
            before = pair.twin.commanded


def test_a_port_that_is_taken_away_is_told(make_alter: Any) -> None:
    pair = make_alter()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        pair._done.set()
        pair._pump.join()
        pair.twin.close()
        until(lambda: robot.state is RobotState.LOST)
        with refuses(DeviceLost, "port", "gone"):
            robot.read()
        robot.stop()


def test_a_second_program_is_refused(make_alter: Any) -> None:
    pair = make_alter()
    with pair.robot as robot:
        pair.advance(CYCLE_S)
        with refuses(DeviceFailed, "one program"), AlterRobot(robot.port):
            pass


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"baud": 19200, "cycle_s": 0.028}, "longer"),
        ({"axes": "joint"}, "axes"),
        ({"arm": "arm.yaml"}, "arm"),
        ({"cycle": 0.028}, "cycle"),
        ({"upper_rad": [1.0]}, "upper_rad"),
    ],
)
def test_wrong_settings_are_refused(more: dict[str, object], match: str) -> None:
    with refuses(UsageError, match):
        AlterRobot("/dev/null", settings=more)


def test_no_controller_and_no_port_are_told() -> None:
    with refuses(DeviceFailed, "opened"), AlterRobot("/dev/there-is-none"):
        pass
    master, slave = os.openpty()
    with refuses(DeviceNotFound, "no controller"), AlterRobot(os.ttyname(slave), settings={"open_s": 0.05}):
        pass
    os.close(master)
    os.close(slave)


@given(st.lists(st.binary(max_size=120) | st.just(b"\xa5\x53\x2b"), max_size=8), st.integers(0, 10))
@settings(max_examples=200, deadline=None)
def test_garbage_makes_no_state_and_hides_none_behind_it(pieces: list[bytes], cut: int) -> None:
    pair_frame = GOOD
    splitter = FrameSplitter()
    for piece in pieces:
        for state in splitter.feed(piece):
            assert np.isfinite(state.q).all()
    found = splitter.feed(b"\x00" * 48 + pair_frame[:cut])
    found += splitter.feed(pair_frame[cut:])
    assert found[-1].sequence == parse_state(pair_frame).sequence


@given(st.integers(0, 47 * 8 + 7))
@settings(max_examples=100, deadline=None)
def test_no_state_with_a_wrong_bit_is_taken(bit: int) -> None:
    bad = bytearray(GOOD)
    bad[bit // 8] ^= 1 << bit % 8
    with pytest.raises(DataRefused):
        parse_state(bytes(bad))


def _good() -> bytes:
    twin = AlterController(arm=small_arm(), drive=twin_drive(small_arm(), CYCLE_S), home=HOME)
    with contextlib.closing(twin):
        twin.move()
        return twin._frame


GOOD = _good()


def test_garbage_on_the_line_is_counted_and_moves_nothing(make_alter: Any) -> None:
    pair = make_alter()
    rng = np.random.default_rng(7)
    with pair.robot as robot:
        for _ in range(20):
            with contextlib.suppress(BlockingIOError):
                os.write(pair.twin.link, rng.bytes(int(rng.integers(1, 90))) + b"\x00" * 48)
            pair.advance(CYCLE_S)
        assert robot.counts.garbage_bytes > 500
        assert robot.state is RobotState.READY
    assert np.abs(pair.twin.q - pair.home).max() <= 1e-5
