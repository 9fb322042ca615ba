"""Simulated cameras that watch a real controller's arm: a scenario's cell, drawn where the robot says that it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.session.channels import JointTrack
from armsight.drivers import Robot, listen
from armsight.drivers.live import SILENCE_S
from armsight.errors import DeviceLost, Inconsistent
from armsight.ops.simulation.scenarios import live_cell

KEPT = 8192
"""Readings kept: eight seconds at 1000 a second, for pictures that take long to draw."""
TICK_S = 1e-3


def when_heard(track: JointTrack, clock: Clock) -> Callable[[float], Array]:
    """Return what gives the joints (n,) at a time of the clock: it waits until they are heard, and guesses nothing.

    It raises DeviceLost where they do not come within SILENCE_S, StaleData for a time before the first that is kept.
    """

    def joints(t_s: float) -> Array:
        until_s = clock.now_s() + SILENCE_S
        while not track.reaches(t_s):
            if clock.now_s() >= until_s:
                raise DeviceLost(
                    f"the robot told no joints for {SILENCE_S:g} s",
                    consequence="Where its arm was at a picture's exposure is not known, and there is no picture",
                    cure="Look at the robot's controller and its link",
                )
            clock.sleep_until(clock.now_s() + TICK_S)
        return track.at(t_s)

    return joints


def followed_cell(scenario: str, robot: Robot, clock: Clock, **asked: Any) -> Any:
    """Return the live cell of a scenario whose cameras watch the joints that a robot, not yet open, will tell.

    The scenario's arm is what the cameras see moved by them, its own robot stays unused. asked: of live_cell. Raises
    UsageError for a robot whose link does not tell when its joints were read, Inconsistent for one of another number of
    joints, and as live_cell.
    """
    cell = live_cell(scenario, clock, **asked)
    require_joints(cell.robot.n_joints, robot.name, robot.n_joints)
    with cell.pairs:
        cell.pairs.pair(0)  # what draws is compiled before a controller waits for answers
    track = JointTrack(robot.n_joints, slots=KEPT)
    listen(robot, track.write)
    cell.robot.follow(when_heard(track, clock))
    return cell


def require_joints(n: int, robot: str, n_robot: int) -> None:
    """Raise Inconsistent where a scenario's arm has another number of joints, n, than a robot."""
    if n != n_robot:
        raise Inconsistent(
            f"the scenario's arm has {n} joints, {robot} has {n_robot}",
            consequence="Its cameras cannot show this robot",
            cure="Make a scenario of this robot's arm: armsight simulate SCENARIO --arm FILE -o FOLDER",
        )
