"""Corrections of a pose by LinuxCNC's external offsets: the shipped bridge beside a small LinuxCNC with a program."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth.emulated_links import Model

from armsight.drivers import RobotState
from armsight.drivers.goals import between
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.drivers.linuxcnc.offsets import Corrections
from armsight.errors import DeviceFailed, UsageError
from linuxcnc_world import ARM, AUTO, ENABLED, HOMED, JOINT_MODE, SPEED, WORLD
from refusals import refuses

SINGULAR = np.array([0.1, -0.4, 0.5, -0.8, 0.05, 0.4])


@pytest.fixture
def make(make_linuxcnc: Any) -> Any:
    def of(home: Any = None, doing: int = WORLD, **more: Any) -> Any:
        pair = make_linuxcnc(motion="offsets", arm=Model(), **more)
        world = pair.twin.world
        for one in world.machine["joints"]:
            one.update(lower=-math.degrees(3.0), upper=math.degrees(3.0))
        for joint, at in zip(world.joints, np.degrees(pair.home if home is None else home), strict=True):
            joint.at = joint.target = float(at)
        world.begin_world(doing)
        return pair

    return of


def straight(way_mm: Any, speed_mm_s: float) -> Iterator[np.ndarray]:
    """A program: a line, one step for each servo cycle, as fast as it is told to go."""
    n = max(1, round(np.linalg.norm(way_mm) / speed_mm_s / 1e-3))
    return iter([np.append(np.asarray(way_mm) / n, np.zeros(3))] * n)


def correction(pair: Any) -> np.ndarray:
    """Return by how much the flange is off its program, in m and rad, by the world's own kinematics."""
    world = pair.twin.world
    here = ARM.flange(pair.twin.q)
    bare = np.eye(4)
    bare[:3, :3] = Rotation.from_euler("xyz", world.bare[3:], degrees=True).as_matrix()
    bare[:3, 3] = 1e-3 * world.bare[:3]
    return np.concatenate(between(RigidTransform.from_matrix(bare), here))


def prove(robot: LinuxcncRobot, pair: Any) -> None:
    """Let the link be proven where the arm stands."""
    for _ in range(300):
        robot.correct(RigidTransform.from_translation(np.append(correction(pair)[:2], correction(pair)[2] + 1e-12)))
        pair.advance(pair.cycle_s)
        if robot.proven:
            return
    raise AssertionError(robot.why)


def asked(robot: LinuxcncRobot, pair: Any, goal: RigidTransform, cycles: int) -> None:
    for _ in range(cycles):
        robot.correct(goal)
        pair.advance(pair.cycle_s)


def test_a_correction_arrives_while_the_program_goes_on(make: Any) -> None:
    pair = make()
    goal = RigidTransform.from_components([0.0, 0.0015, 0.002], Rotation.from_rotvec([0.0, 0.01, -0.02]))
    with pair.robot as robot:
        prove(robot, pair)
        pair.twin.world.doing |= AUTO
        pair.twin.world.program = straight([0.0, 30.0, 0.0], 20.0)
        begin = pair.twin.world.bare.copy()
        asked(robot, pair, goal, 120)
        assert pair.twin.world.running, "the correction arrived meanwhile"
        assert pair.twin.world.bare[1] - begin[1] > 15.0
        assert correction(pair) == pytest.approx([0.0, 0.0015, 0.002, 0.0, 0.01, -0.02], abs=3e-5)
        # told where the flange is, the driver leaves it there
        pair.twin.world.program = None
        sent = robot.move_pose(ARM.flange(pair.twin.q))
        pair.advance(0.2)
        assert correction(pair) == pytest.approx([0.0, 0.0015, 0.002, 0.0, 0.01, -0.02], abs=3e-5)
        assert np.abs(np.concatenate(between(ARM.flange(pair.twin.q), sent.pose))).max() < 3e-5


def test_speed_and_size_of_corrections_are_bounded(make: Any) -> None:
    pair = make(largest_m=0.004, speed_m_s=0.01)
    rows = []
    with pair.robot as robot:
        prove(robot, pair)
        for _ in range(120):
            sent = robot.correct(RigidTransform.from_translation([0.05, 0.0, 0.0]))
            pair.advance(pair.cycle_s)
            rows.append(correction(pair)[0])
        assert "largest correction" in sent.limited
    assert rows[-1] == pytest.approx(0.004, abs=1e-5)
    assert np.abs(np.diff(rows)).max() <= 1.1 * 0.01 * pair.cycle_s
    assert max(rows) <= 0.004 + 5e-6


@pytest.mark.parametrize("how", ["killed", "stopped"])
def test_who_lets_go_leaves_the_correction_and_pauses_the_program(make: Any, how: str) -> None:
    pair = make()
    track = []
    with pair.robot as robot:
        prove(robot, pair)
        pair.twin.world.program = straight([0.0, 60.0, 0.0], 20.0)
        asked(robot, pair, RigidTransform.from_translation([0.0, 0.0, 0.002]), 60)
        before = correction(pair)
        if how == "killed":
            robot._answer = lambda state, sender: None
            pair.answered = lambda heard: False  # nobody waits for what never comes
        else:
            robot.stop()
        for _ in range(60):
            pair.advance(pair.cycle_s)
            track.append(correction(pair))
        assert np.abs(np.array(track) - before).max() < 2e-5
        assert not pair.twin.world.running, "paused: nobody watches what the correction does to the joints"
        assert robot.state in (RobotState.STOPPED, RobotState.LOST)


def test_the_next_one_begins_with_the_correction_in_force(make: Any) -> None:
    pair = make()
    with pair.robot as robot:
        prove(robot, pair)
        asked(robot, pair, RigidTransform.from_translation([0.0, 0.0, 0.002]), 60)
    pair.advance(1.5)
    with pair.robot as robot:
        prove(robot, pair)
        assert correction(pair)[2] == pytest.approx(0.002, abs=1e-6)
        asked(robot, pair, RigidTransform.identity(), 100)
        assert correction(pair) == pytest.approx(np.zeros(6), abs=1e-6)


def test_a_program_towards_a_singular_pose_is_paused_before_a_joint_runs_away(make: Any) -> None:
    """The wrist turns into line at constant speed: without the driver joint 4 or 6 is far too fast."""
    for watched in (True, False):
        pair = make()
        world, fastest, last = pair.twin.world, 0.0, None
        with pair.robot as robot:
            prove(robot, pair)
            asked(robot, pair, RigidTransform.from_translation([0.0, 0.0, 0.001]), 40)
            if not watched:
                robot._why_uncorrected = lambda state: ""
            world.program = towards_singular(pair)
            for _ in range(460):
                pair.advance(pair.cycle_s)
                fastest = max(fastest, 0.0 if last is None else float(np.abs(pair.twin.q - last).max()) / pair.cycle_s)
                last = pair.twin.q
            if watched:
                assert robot.state is RobotState.STOPPED
                assert "singular" in robot.why
                assert not world.running
                with refuses(DeviceFailed, "singular"):
                    robot.correct(RigidTransform.identity())
                there = pair.twin.q
                robot.reset()
                pair.advance(0.3)
                assert np.abs(pair.twin.q - there).max() < 1e-9, "it waits for LinuxCNC's operator"
        assert (math.degrees(fastest) < SPEED) == watched, math.degrees(fastest)


def towards_singular(pair: Any) -> Iterator[np.ndarray]:
    """A program that turns the flange evenly to a pose whose wrist is nearly in line."""
    world = pair.twin.world
    goal = ARM.flange(SINGULAR).as_matrix()
    end = np.append(1e3 * goal[:3, 3], np.degrees(Rotation.from_matrix(goal[:3, :3]).as_euler("xyz")))
    n = 2500
    return iter([(end - world.bare) / n] * n)


def test_a_singular_pose_is_told_when_it_is_opened(make: Any) -> None:
    pair = make(home=SINGULAR)
    with pair.robot as robot:
        pair.advance(pair.cycle_s)
        assert robot.state is RobotState.STOPPED
        with refuses(DeviceFailed, "singular", "of its 30 degrees/s"):
            robot.correct(RigidTransform.from_translation([0.0, 0.0, 0.001]))


def test_what_offsets_need_is_refused_with_the_line_to_add(make: Any, make_linuxcnc: Any) -> None:
    with refuses(UsageError, "--arm"):
        LinuxcncRobot("127.0.0.1", settings={"motion": "offsets"})
    pair = make()
    for one in pair.twin.world.machine["offsets"][2:4]:
        one["speed"] = 0.0
    with refuses(DeviceFailed, "AXIS_Z, AXIS_A", "OFFSET_AV_RATIO = 0.1"), pair.robot:
        pass
    jogs = make_linuxcnc()
    with jogs.robot as robot, refuses(UsageError, "no poses"):
        robot.correct(RigidTransform.identity())
    joints = make(doing=ENABLED | HOMED | JOINT_MODE)
    with joints.robot as robot:
        joints.advance(joints.cycle_s)
        with refuses(DeviceFailed, "joint mode", "teleop"):
            robot.correct(RigidTransform.identity())


def test_offsets_that_linuxcnc_does_not_take_are_found(make: Any) -> None:
    pair = make()
    with pair.robot as robot:
        prove(robot, pair)
        pair.twin.world.offsets[2].high = 1.0  # the end of an axis
        asked(robot, pair, RigidTransform.from_translation([0.0, 0.0, 0.002]), 40)
        pair.advance(0.8)
        assert robot.state is RobotState.STOPPED
        assert "did not take" in robot.why


def test_the_worst_direction_of_a_correction_counts() -> None:
    axes = np.array([[0.1] * 6, [1.0] * 6])
    watch = Corrections.of(Model(), axes=axes, joint_speed=np.full(6, 0.5), speeds=(0.02, 0.02))
    away, near = np.array([0.1, -0.4, 0.5, -0.8, 0.9, 0.4]), np.array([0.1, -0.4, 0.5, -0.8, 0.04, 0.4])
    assert watch.why_not(away, np.zeros(6)) == ""
    assert "joint" in watch.why_not(near, np.zeros(6))
    # a while before it is there, where it goes there
    before = away + 0.6 * (near - away)
    assert watch.why_not(before, np.zeros(6)) == ""
    assert "joint" in watch.why_not(before, 2.0 * (near - away))
