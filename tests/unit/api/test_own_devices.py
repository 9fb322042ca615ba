"""Cameras and robots of one's own, handed over as objects."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import armsight
from hand_cell import hand_cell, pictures
from refusals import refuses


class Camera:
    """Gives frames only while it is open, and without end."""

    def __init__(self, side: str) -> None:
        self.side, self.opened, self.n = side, [], 0

    def __enter__(self) -> Camera:
        self.opened.append(True)
        return self

    def __exit__(self, *_: object) -> None:
        self.opened.append(False)

    def __iter__(self) -> Iterator[armsight.Frame]:
        for number in range(10**9):
            assert self.opened == [True]
            self.n = number + 1
            image = pictures(self.side)[number % 3]
            yield armsight.Frame(image=image, t_s=5.0 + number / 60.0, sequence=number, source=self.side)


class Robot:
    """Goes where it is told; held: takes every step and goes nowhere."""

    name, n_joints, cycle_s, takes_poses, state = "mine", 6, 0.004, False, armsight.RobotState.READY

    def __init__(self, *, held: bool = False) -> None:
        self.q, self.n, self.held = np.array([0.0, -1.0, 1.0, 1.0, 2.0, 0.0]), 0, held

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def read(self) -> armsight.JointReading:
        self.n += 1
        return armsight.JointReading(q=self.q, t_s=time.monotonic(), sequence=self.n, source=self.name)

    def step_joints(self, step: Any) -> armsight.Sent:
        self.q = self.q if self.held else self.q + step
        return armsight.Sent(q=self.q, t_s=time.monotonic(), sequence=self.n)

    def move_pose(self, T_base_flange: Any) -> armsight.Sent:
        raise armsight.UsageError("it takes no poses")

    def reset(self) -> None: ...

    def stop(self) -> None: ...


def test_a_camera_is_opened_read_as_far_as_asked_with_its_times_and_closed() -> None:
    left, right = Camera("left"), Camera("right")
    done = armsight.measure(hand_cell().rig, hand_cell().target, left, right, frames=3)
    np.testing.assert_allclose(done.poses.t_s, 5.0 + np.arange(3) / 60.0, atol=1e-8)
    plain = armsight.measure(hand_cell().rig, hand_cell().target, pictures("left"), pictures("right"), stills=True)
    off_m = done.poses.T_parent_target[0, :3, 3] - plain.poses.T_parent_target[0, :3, 3]
    assert done.n_ok == 3 and abs(off_m).max() < 1e-9
    assert left.opened == right.opened == [True, False] and left.n == right.n == 3


@pytest.mark.alone
def test_a_robot_moves_and_one_that_goes_nowhere_is_told() -> None:
    assert armsight.jog(Robot(), 2, 0.02, confirm=True).reached[1] == pytest.approx(-0.98)
    with refuses(armsight.DeviceFailed, "nowhere"):
        armsight.jog(Robot(held=True), 2, 0.02, confirm=True)


@pytest.mark.parametrize(
    ("robot", "what"),
    [
        (Robot, "class"),
        (type("Half", (), {"step_joints": None})(), "__enter__"),
        (type("Text", (Robot,), {"state": "ready"})(), "RobotState"),
    ],
)
def test_a_robot_that_is_not_complete_is_refused(robot: Any, what: str) -> None:
    with refuses(armsight.UsageError, what):
        armsight.jog(robot, 1, 0.01, confirm=True)
