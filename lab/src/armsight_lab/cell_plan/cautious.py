"""Small moves about the place where an arm stands, for a cell of which nothing is known yet."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, jacobian
from armsight.records import Motion
from armsight.units import DEG
from armsight_lab.cell_plan.path import SHARE, MotionBounds
from armsight_lab.cell_plan.plan import PlanSettings
from armsight_lab.cell_plan.scene import Free

CAUTIOUS_M, CAUTIOUS_RAD = 0.16, 45.0 * DEG
"""How far the flange goes, and each joint turns, in a motion about the place where the arm stands; from 0.1 m and
25 deg no simulated cell could be calibrated (benchmarks/cell_plan.py --cautious)."""
REST_S = 0.5
PEAK, PEAK_CHANGE = 1.875, 5.774
"""Of a reach of least jerk: largest speed and acceleration over way per time, and per time squared."""
HALVED = 5


def cautious_motion(
    arm: Arm, bounds: MotionBounds, free: Free, start: Array, settings: PlanSettings | None = None
) -> Motion:
    """Return small moves of all joints about start (n,) and back, for a cell of which nothing is known.

    The user sees the lights in both images there. No joint turns further than CAUTIOUS_RAD from it, and each moves the
    flange by its share of CAUTIOUS_M at the most. Reaches of many lengths with rests between: by the speeds of joints
    and lights the clocks are found. Raises Inconsistent where even the smallest of them leaves the limits.
    """
    settings = settings or PlanSettings()
    rng = np.random.default_rng(settings.seed)
    J = np.abs(jacobian(arm.based(), arm.values(start))[:3])
    most = np.where(arm.revolute, CAUTIOUS_RAD, CAUTIOUS_M)
    size = np.minimum(most, CAUTIOUS_M / np.sqrt(arm.n) / np.maximum(np.linalg.norm(J, axis=0), 1e-6))
    size = np.minimum(size, np.minimum(bounds.upper - start, start - bounds.lower))
    for _ in range(HALVED):
        motion = _reaches(start, size, J, bounds, settings, rng)
        if (bounds.within(motion.q) & free(motion.q)).all():
            return motion
        size = 0.5 * size
    raise Inconsistent(
        "even the smallest moves about where the arm stands leave its limits",
        consequence="No motion is planned",
        cure="Bring it away from the ends of its joints and from walls and boxes, still in view of both cameras",
    )


def _reaches(
    start: Array, size: Array, J: Array, bounds: MotionBounds, settings: PlanSettings, rng: np.random.Generator
) -> Motion:
    """Return reaches of least jerk (Flash, Hogan 1985) between places within size (n,) of start, and back at the end.

    J (3, n): by how much a joint moves the tool; the peak of such a reach is PEAK times its mean speed.
    """
    t = np.arange(int(settings.duration_s * settings.rate_hz) + 1) / settings.rate_hz
    q, here, at_s = np.tile(start, (len(t), 1)), start, REST_S
    while at_s < t[-1]:
        # slower ones among them: clocks and lines tell themselves by different speeds
        goal = start + size * rng.uniform(-1.0, 1.0, len(start))
        took = _reach_s(goal - here, J, bounds) * rng.uniform(1.0, 3.0)
        back = _reach_s(goal - start, J, bounds)
        if at_s + took + back + 2.0 * REST_S > t[-1]:
            goal, took = start, _reach_s(start - here, J, bounds)
        s = np.clip((t - at_s) / took, 0.0, 1.0)
        q += (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None] * (goal - here)
        if goal is start:
            break
        here, at_s = goal, at_s + took + rng.uniform(0.0, 2.0 * REST_S)
    return Motion(t_s=t, q=q)


def _reach_s(way: Array, J: Array, bounds: MotionBounds) -> float:
    """Return the shortest time of a reach over way (n,) within the limits of speed and acceleration."""
    tool = float(np.linalg.norm(J @ np.abs(way)))
    speed = max(float((np.abs(way) / bounds.speed).max()), tool / bounds.speed_m_s)
    sharp = max(float((np.abs(way) / bounds.acceleration).max()), tool / bounds.acceleration_m_s2)
    return float(max(PEAK * speed, np.sqrt(PEAK_CHANGE * sharp), 0.2)) / SHARE
