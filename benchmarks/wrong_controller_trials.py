"""Controllers that take what they are sent otherwise than they should, behind each link; no thread, one clock.

What is asked for is a motion of all axes, cycle after cycle, until the driver stops, and for a second more. The judge
reads the emulated controller's motors alone. What a right controller's arm does while the link is proven is the probe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth.emulated_links import HOME, Link, World, link_of

from armsight.clock import ManualClock
from armsight.drivers import PROVING, RobotState, Sent
from armsight.errors import DeviceFailed
from armsight_sim.twins.base import Wrong

Array = NDArray[np.float64]

KINDS = ("rsi", "rsi pose", "egm", "egm pose", "alter", "alter whole", "rtde")
"""Links, and how they are guided; whole: not cumulative."""

ASKED_S, AFTER_S = 1.5, 0.4

Change = Callable[[World, np.random.Generator], World]


def _wrong(make: Callable[[np.random.Generator], Wrong]) -> Change:
    return lambda world, rng: replace(world, wrong=make(rng))


def _pair(rng: np.random.Generator) -> tuple[int, int]:
    """Return two axes of the first or of the last three: of a flange, ways and turns are no alike."""
    i, j = rng.choice(3, 2, replace=False) + 3 * rng.integers(2)
    return int(i), int(j)


FAULTS: dict[str, tuple[Change, str]] = {
    "relative mode": (_wrong(lambda rng: Wrong(adds=True)), "relative mode|cumulative"),
    "cycle x 0.25": (lambda world, rng: replace(world, cycles=0.25), "every"),
    "cycle x 0.5": (lambda world, rng: replace(world, cycles=0.5), "every"),
    "cycle x 2": (lambda world, rng: replace(world, cycles=2.0), "every"),
    "cycle x 3": (lambda world, rng: replace(world, cycles=3.0), "every"),
    "one axis reversed": (_wrong(lambda rng: Wrong(reversed=(int(rng.integers(6)),))), "reversed"),
    "two exchanged": (_wrong(lambda rng: Wrong(exchanged=_pair(rng))), "exchanged"),
    "scale 1.1": (_wrong(lambda rng: Wrong(scale=1.1)), "every axis moves 1.[01]|times as far as sent: the units"),
    "scale 57.3": (_wrong(lambda rng: Wrong(scale=57.3)), "radians for degrees"),
    "gear ratio 2": (_wrong(lambda rng: Wrong(gear=(int(rng.integers(6)), 2.0))), "gear ratio"),
}
"""What is wrong, and a word of its cause."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What a trial came to: largest way of any joint in rad, the cause in words, time until the link was proven in s.

    refused: it was not opened. proven_s: not a number where it was never proven.
    """

    largest_rad: float
    cause: str
    proven_s: float
    refused: bool
    rest_rad: float


def world_of(rng: np.random.Generator) -> World:
    """Return a right controller: an arm of another posture, drives of another lag, readings of another noise."""
    home = HOME + rng.uniform(-0.2, 0.2, 6)
    return World(home=home, lag_s=float(rng.uniform(0.0, 0.05)), noise=float(rng.choice([0.0, 5e-6, 1e-5])))


def trial(kind: str, fault: str, seed: int) -> Outcome:
    """Run one trial of a kind of KINDS; fault: of FAULTS, empty for a right controller."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    world = world_of(rng)
    if fault:
        world = FAULTS[fault][0](world, rng)
    clock, (name, _, how) = ManualClock(100.0), kind.partition(" ")
    more: dict[str, object] = {"guidance": "pose"} if how == "pose" else {"cumulative": False} if how else {}
    link = link_of(name, clock, world, **more)
    way = rng.choice([-1.0, 1.0], 6) * rng.uniform(0.2, 1.0, 6) * 0.3 * link.cycle_s
    try:
        return _watched(link, world, way)
    finally:
        link.close()


def _watched(link: Link, world: World, way: Array) -> Outcome:
    robot, twin, q, proven_s, cause = link.robot, link.twin, [], float("nan"), ""
    try:
        with robot:
            stopped_s, begun_s = None, link.clock.now_s()
            while True:
                now_s = link.clock.now_s() - begun_s
                if robot.state is RobotState.STOPPED or robot.state is RobotState.LOST:
                    cause, stopped_s = robot.why, now_s if stopped_s is None else stopped_s
                elif PROVING not in _asked(robot, way).limited and np.isnan(proven_s):
                    proven_s = now_s
                    if stopped_s is None and world.wrong is World().wrong and world.cycles == 1.0:
                        break
                if now_s > ASKED_S or (stopped_s is not None and now_s - stopped_s > AFTER_S):
                    break
                link.cycle()
                q.append(twin.q)
    except DeviceFailed as error:
        return Outcome(largest_rad=0.0, cause=str(error), proven_s=proven_s, refused=True, rest_rad=0.0)
    away = np.abs(np.array(q) - world.home).max(axis=1)
    return Outcome(
        largest_rad=float(away.max()), cause=cause, proven_s=proven_s, refused=False, rest_rad=float(away[-1])
    )


def _asked(robot: Any, way: Array) -> Sent:
    if getattr(robot, "settings", None) is not None and getattr(robot.settings, "guidance", "joint") == "pose":
        here = robot._last.T_base_flange
        turn = Rotation.from_rotvec(way[3:])
        return robot.move_pose(RigidTransform.from_components(here.translation + way[:3], turn * here.rotation))
    return robot.step_joints(way)
