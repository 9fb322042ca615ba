"""Random histories of a guarded arm behind a link that loses, delays and bunches packets; no thread, one clock.

Driver and emulated controller speak over a wire that decides by a seed what becomes of each packet. The judge reads the
emulated controller alone: where the motors were at each of its cycles, by its own time and its own kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.truth.emulated_links import HOME, Wire, link_of

import armsight.control.loop as loop_module
from armsight.clock import ManualClock
from armsight.control import CycleState, JointGoal, JointVelocity, SetPoint, ToolTwist
from armsight.control.guard import Box, Guard, GuardState, JointLimit, Limits
from armsight.control.loop import ControlLoop
from armsight.drivers.proof import ProofState
from armsight.kinematics import Arm, Joint
from armsight_sim.twins.base import small_arm
from armsight_sim.twins.egm import EgmController
from armsight_sim.twins.ur_controller import UrController

Array = NDArray[np.float64]

WINDOW = 3
"""Cycles of the controller that a speed is taken over."""
SPEED_TOLERANCE = 0.02
PLACE_TOLERANCE = 2e-4
"""rad and m by which an arm may pass a range or a wall: twenty encoder steps, and what a controller rounds."""

LONGEST = 2000
"""Cycles after which a history ends, proven or not; those until the link is proven come on top of those asked for."""

SPEEDS = np.array([0.5, 0.5, 0.5, 0.6, 0.6, 0.4])
REACH = 0.35
"""Each joint's range about the place it begins at, rad."""


@dataclass(slots=True)
class Found:
    """What the judge found. Ratios are of the largest speed to its limit, ways beyond limits in rad and m."""

    histories: int = 0
    cycles: int = 0
    moved: int = 0
    lost: int = 0
    late: int = 0
    stopped: int = 0
    joint_ratio: float = 0.0
    tool_ratio: float = 0.0
    joint_beyond: float = 0.0
    wall_beyond_m: float = 0.0
    too_fast: int = 0
    beyond: int = 0


ARM = Arm(
    name="small",
    joints=tuple(
        Joint(
            name=joint.name,
            a_m=joint.a_m,
            alpha_rad=joint.alpha_rad,
            d_m=joint.d_m,
            theta_rad=joint.theta_rad,
            lower=joint.lower,
            upper=joint.upper,
        )
        for joint in small_arm().joints
    ),
)


def tool_m(q: Array) -> Array:
    """Return where the tool's origin is (3,), by the emulated arm's own kinematics."""
    return np.asarray(small_arm().frames(q)[-1][:3, 3])


class Restless:
    """A source that wants something else every few tenths of a second, mostly more than is allowed."""

    name = "restless"

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._until_s, self._wanted = -1.0, JointVelocity(qd=np.zeros(6))

    def next(self, now: CycleState) -> SetPoint:
        if now.t_s >= self._until_s:
            rng = self._rng
            self._until_s = now.t_s + rng.uniform(0.2, 1.5)
            some = rng.random(6) < rng.choice([0.2, 0.6, 1.0])
            self._wanted = (
                JointVelocity(qd=some * rng.choice([-1.0, 1.0], 6) * SPEEDS * rng.choice([0.5, 0.95, 2.0])),
                JointGoal(q=HOME + rng.uniform(-1.2, 1.2, 6) * REACH),
                ToolTwist(velocity_m_s=rng.normal(0.0, 0.1, 3), angular_rad_s=rng.normal(0.0, 0.3, 3)),
            )[rng.integers(0, 3)]
        return self._wanted


def limits_of(rng: np.random.Generator) -> Limits:
    """Return limits of which each one binds in some histories."""
    here = tool_m(HOME)
    joints = tuple(
        JointLimit(lower=q - REACH, upper=q + REACH, speed=speed) for q, speed in zip(HOME, SPEEDS, strict=True)
    )
    walls = rng.uniform(0.03, 0.2, (2, 3))
    return Limits(
        joints=joints,
        speed_m_s=float(rng.choice([0.03, 0.1, 1.0])),
        turn_rad_s=5.0,
        workspace=Box(lower_m=here - walls[0] - 0.005, upper_m=here + walls[1] + 0.005, name="workspace"),
    )


def history(kind: str, seed: int, found: Found, *, cycles: int = 500, fault: str = "") -> None:
    """Run one history of a link of a kind (alter, egm, rsi, rtde), and add what the judge finds.

    fault takes one rule away: "pace" (the loop steps by its own clock), "confirm" (a goal counts as taken once it is
    sent).
    """
    rng = np.random.default_rng([seed, len(kind), ord(kind[0])])
    clock = ManualClock(100.0)
    link = link_of(kind, clock)
    tcp = kind == "rtde"
    loss, late = rng.choice([0.0, 0.02, 0.05, 0.1]) * (not tcp), rng.choice([0.0, 0.05, 0.2])
    up, down = (Wire(rng=rng, loss=loss, late=late, in_order=tcp) for _ in range(2))
    limits = limits_of(rng)
    loop = ControlLoop(
        link.robot, Guard(ARM, limits, link.cycle_s), Restless(rng), clock, enabled=lambda: True, by_pose=False
    )
    _take_away(fault, loop, link.robot)
    q, goals, stalled = [], [], 0
    patience, loop_module.PATIENCE = loop_module.PATIENCE, 0.0
    try:
        with link.robot:
            loop._begin()
            proven_at = cycle = 0
            while cycle < proven_at + cycles and cycle < LONGEST:
                proven_at = proven_at if link.robot._proof.state is ProofState.PASSED else cycle + 1
                clock.advance(link.cycle_s)
                goals.append(_controller_cycle(link, down.due(cycle)))
                q.append(link.twin.q)
                for data in link.spoken():
                    up.send(data, cycle)
                step = (lambda: None) if stalled else (lambda: _loop_cycle(loop, clock))
                for data in link.hear(up.due(cycle), together=rng.random() < 0.5, between=step):
                    down.send(data, cycle)
                step()
                stalled = max(0, stalled - 1) if stalled else int(rng.integers(1, 12)) * (rng.random() < 0.2 * late)
                if loop.status is not None and loop.status.guard is GuardState.STOPPED:
                    found.stopped += 1
                    break
                cycle += 1
    finally:
        loop_module.PATIENCE = patience
        if kind == "alter":
            link.twin.close()
    found.lost += up.lost + down.lost
    judge((np.array(q), np.array(goals)), limits, link.cycle_s, found)


def _take_away(fault: str, loop: ControlLoop, robot: Any) -> None:
    """Take a rule away."""
    if fault == "pace":
        loop._paced = None
    if fault == "confirm":
        tick = robot._tick
        # not before the link is proven: the probe would find that out
        robot._tick = lambda cycles, *, taken: tick(cycles, taken=taken or robot._proof.state is ProofState.PASSED)


def _controller_cycle(link: Any, answers: list[bytes]) -> Array:
    """Let the controller do a cycle; return where its motors are told to go, not a number where it halts by itself."""
    for data in answers:
        link.answer(data)
    if isinstance(link.twin, UrController):
        link.twin.cycle()
        return np.asarray(link.twin._servo.goal)
    counts = link.twin.counts
    name = "timeouts" if isinstance(link.twin, EgmController) else "ended"
    before = getattr(counts, name)
    link.twin.cycle()
    halted = getattr(counts, name) > before
    return np.full(6, np.nan) if halted else np.asarray(link.twin._servo.goal)


def _loop_cycle(loop: ControlLoop, clock: ManualClock) -> None:
    """Let the loop do a cycle as it does in its thread, without waiting."""
    waiting, _, due_s = loop._due(clock.now_s())
    loop._cycle(clock.now_s(), clock.now_s() - due_s, waiting=waiting)


def judge(motions: tuple[Array, ...], limits: Limits, cycle_s: float, found: Found) -> None:
    """Add what one history shows: joints (m, 6) at the ends of the controller's cycles, of motors and their goals."""
    window_s = WINDOW * cycle_s
    ratios = []
    for rows in motions:
        joint = np.abs(rows[WINDOW:] - rows[:-WINDOW]) / window_s / SPEEDS
        joint[[np.isnan(rows[i : i + WINDOW]).any() for i in range(len(joint))]] = np.nan  # it halted by itself
        place = np.array([tool_m(row) for row in rows])
        tool = np.linalg.norm(place[WINDOW:] - place[:-WINDOW], axis=1) / window_s / limits.speed_m_s
        tool[np.isnan(joint[:, 0])] = np.nan
        ratios.append((float(np.nanmax(joint, initial=0.0)), float(np.nanmax(tool, initial=0.0))))
        walls = limits.workspace
        if walls is not None:
            over = np.nanmax(np.maximum(walls.lower_m - place, place - walls.upper_m))
            found.wall_beyond_m = max(found.wall_beyond_m, float(over))
            found.beyond += over > PLACE_TOLERANCE
        out = np.nanmax(np.abs(rows - HOME) - REACH)
        found.joint_beyond = max(found.joint_beyond, float(out))
        found.beyond += out > PLACE_TOLERANCE
    worst = np.max(ratios, axis=0)
    found.joint_ratio, found.tool_ratio = max(found.joint_ratio, worst[0]), max(found.tool_ratio, worst[1])
    found.too_fast += bool(worst.max() > 1.0 + SPEED_TOLERANCE)
    found.histories += 1
    found.cycles += len(motions[0])
    found.moved += int((np.abs(np.diff(motions[0], axis=0)).max(axis=1) > 1e-6).sum())
