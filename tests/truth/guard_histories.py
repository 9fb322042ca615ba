"""Random histories against the guard: arms that stand inside and outside limits of every kind, asked for anything.

The judge has its own kinematics, from the arm's table alone, and knows nothing of how the guard looks ahead.
benchmarks/guard_limits.py runs thousands of them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.control import Hold, JointGoal, JointVelocity, SetPoint, ToolPose, ToolTwist
from armsight.control.guard import Box, Guard, GuardState, Inputs, JointLimit, Limits
from armsight.errors import Inconsistent
from armsight.kinematics import preset
from armsight.records import JointReading

Array = NDArray[np.float64]
CYCLE_S = 0.012
CYCLES = 150
ARMS = {name: preset(name) for name in ("ur10", "irb120", "stanford-rrp")}
SLACK = 2e-6
"""m or rad: what rounding and the guard's own tolerances may add up to in a history."""


@dataclass
class Found:
    """What histories came to. worst: the largest growth of a violation for each kind of limit, in m or rad."""

    cycles: int = 0
    moved: int = 0
    outside: int = 0
    refused: int = 0
    worst: dict[str, float] = field(default_factory=dict)
    grown: Counter[str] = field(default_factory=Counter)


def points(arm, q: Array) -> Array:
    """Return tool and flange (2, 3) in base axes, link by link from the table (standard convention)."""
    T = np.eye(4)
    for joint, value, slides in zip(arm.joints, q, ~arm.revolute, strict=True):
        turn = joint.theta_rad + (0.0 if slides else joint.sign * value)
        d = joint.d_m + (joint.sign * value if slides else 0.0)
        c, s, ca, sa = np.cos(turn), np.sin(turn), np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
        T = T @ np.array(
            [[c, -s * ca, s * sa, joint.a_m * c], [s, c * ca, -c * sa, joint.a_m * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return np.array([(T @ arm.T_flange_tool.as_matrix())[:3, 3], T[:3, 3]])


def depths(arm, limits: Limits, q: Array) -> dict[str, float]:
    """Return how far each limit is passed, 0 where it is kept."""
    found = {}
    for i, (row, value) in enumerate(zip(limits.joints, q, strict=True), 1):
        found[f"joint {i} lower"], found[f"joint {i} upper"] = row.lower - value, value - row.upper
    for name, p in zip(("tool", "flange"), points(arm, q), strict=True):
        for k in range(3):
            found[f"wall {name} {k} lower"] = limits.workspace.lower_m[k] + limits.margin_m - p[k]
            found[f"wall {name} {k} upper"] = p[k] + limits.margin_m - limits.workspace.upper_m[k]
        for box in limits.forbidden:
            inside = min(np.min(p - box.lower_m), np.min(box.upper_m - p))
            found[f"box {name} {box.name}"] = inside + limits.margin_m
    return {name: max(0.0, depth) for name, depth in found.items()}


def world(rng: np.random.Generator) -> tuple[object, Limits, Array]:
    """Return an arm, limits near it, and readings inside or outside of some of them."""
    arm = ARMS[rng.choice(list(ARMS))]
    low = np.where(np.isfinite(arm.lower), arm.lower, -2.0)
    high = np.where(np.isfinite(arm.upper), arm.upper, 2.0)
    q = low + (high - low) * rng.uniform(0.25, 0.75, arm.n)
    far = np.where(rng.random((2, arm.n)) < 0.06, -1.0, 1.0) * rng.uniform(0.01, 0.3, (2, arm.n))
    far[1] = np.where(far[0] < 0.0, np.abs(far[1]) + 0.1 - far[0], far[1])
    far[0] = np.where(far[1] < 0.0, np.abs(far[0]) + 0.1 - far[1], far[0])  # outside of one end only
    joints = tuple(JointLimit(lower=v - a, upper=v + b) for v, a, b in zip(q, far[0], far[1], strict=True))
    p = points(arm, q)
    walls = np.where(rng.random((2, 3)) < 0.06, -1.0, 1.0) * rng.uniform(0.02, 0.3, (2, 3))
    out = walls < 0.0  # of one face of an axis only
    out = walls < 0.0
    space = Box(lower_m=p.min(axis=0) - walls[0] - out[1], upper_m=p.max(axis=0) + walls[1] + out[0])
    centre = p[0] + rng.uniform(-0.3, 0.3, 3)
    box = Box(lower_m=centre - rng.uniform(0.02, 0.2, 3), upper_m=centre + rng.uniform(0.02, 0.2, 3), name="box")
    return arm, Limits(joints=joints, workspace=space, forbidden=(box,), jump_m=0.5, jump_rad=1.0), q


def wanted(rng: np.random.Generator, guard: Guard, arm) -> SetPoint:
    """Return anything that may be asked for."""
    now = guard.q_sent
    match rng.integers(6):
        case 0:
            return JointVelocity(qd=rng.normal(0.0, 0.5, arm.n))
        case 1:
            return ToolTwist(velocity_m_s=rng.normal(0.0, 0.1, 3), angular_rad_s=rng.normal(0.0, 0.5, 3))
        case 2:
            return JointGoal(q=now + rng.normal(0.0, 0.3, arm.n) * (rng.random(arm.n) < 0.6))
        case 3:
            return JointVelocity(qd=np.where(np.arange(arm.n) == rng.integers(arm.n), rng.normal(0.0, 0.5), 0.0))
        case 4:
            T = guard.cycle_state(0.0, None).T_base_tool
            return ToolPose(T_base_tool=RigidTransform.from_translation(rng.normal(0.0, 5e-4, 3)) * T)
        case _:
            return Hold()


def history(seed: int, found: Found) -> None:
    """Run one history, and add what it came to."""
    rng = np.random.default_rng(seed)
    arm, limits, q = world(rng)
    try:
        guard = Guard(arm, limits, CYCLE_S)
    except Inconsistent:  # boxes that leave the arm no place at all are refused, and nothing moves
        found.refused += 1
        return
    guard.begin(q, 0.0)
    least = depths(arm, limits, q)
    found.outside += any(least.values())
    asked, enabled = wanted(rng, guard, arm), True
    for cycle in range(1, CYCLES + 1):
        if rng.random() < 0.05:
            asked = wanted(rng, guard, arm)
        enabled = enabled if rng.random() > 0.01 else not enabled
        late_s = CYCLE_S * rng.uniform(0.0, 3.0) if rng.random() < 0.01 else 0.0
        reading = JointReading(q=guard.q_sent, t_s=cycle * CYCLE_S, sequence=cycle, source="robot")
        decision = guard.step(asked, reading, Inputs(now_s=cycle * CYCLE_S, enabled=enabled, late_s=late_s))
        found.cycles += 1
        if decision.step is None:
            continue
        found.moved += bool(decision.step.any())
        guard.acknowledge(decision.q)
        for name, depth in depths(arm, limits, decision.q).items():
            grown, kind = depth - least[name], name.split()[0]
            found.worst[kind] = max(found.worst.get(kind, 0.0), grown)
            if grown > SLACK:
                found.grown[kind] += 1
            least[name] = min(least[name], depth)
        if decision.state is GuardState.STOPPED:
            guard.reset(guard.q_sent, cycle * CYCLE_S)
