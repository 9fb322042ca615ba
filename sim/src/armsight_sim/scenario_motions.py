"""How a scenario's robot moves, or how its target is led, checked."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from armsight_sim.scenario_keys import Finite, Keys, NotNegative, PoseKeys, Positive, Vector3


class WayKeys(Keys):
    """The joints go from one row of q (degrees or m) to the next, each in lasts_s, after a rest of start_s."""

    kind: Literal["ways"]
    q: Annotated[list[list[Finite]], Field(min_length=1, max_length=1000)]
    start_s: NotNegative = 0.0
    lasts_s: Positive


class SweepKeys(Keys):
    """One joint from `begin` to `end` (degrees or m) in `readings` places, the others at rest at `rest`."""

    joint: Annotated[int, Field(ge=1, le=12)]
    begin: Finite
    end: Finite
    readings: Annotated[int, Field(ge=2, le=1000)]
    rest: list[Finite]


class SweepsKeys(Keys):
    """One joint after the other; every_s from one reading to the next, the arm at rest at each."""

    kind: Literal["sweeps"]
    every_s: Positive
    sweeps: Annotated[list[SweepKeys], Field(min_length=1, max_length=50)]


class SwingKeys(Keys):
    """Every joint swings about home by amplitude (degrees or m) with its period; phases from the seed."""

    kind: Literal["swing"]
    home: list[Finite]
    amplitude: list[NotNegative]
    period_s: list[Positive]


class FollowKeys(Keys):
    """The robot keeps its rig before the target, distance_m ahead of the real camera; home begins the search."""

    home: list[Finite]
    distance_m: Positive
    delay_s: NotNegative = 0.0


class HandKeys(Keys):
    """How still a hand is: RMS per axis."""

    rms_m: NotNegative = 0.0
    rms_deg: NotNegative = 0.0


class RestKeys(Keys):
    """The target stays at a pose of the world; the robot follows."""

    kind: Literal["rest"]
    T_world_target: PoseKeys
    hand: HandKeys = HandKeys()
    follow: FollowKeys


class ArcKeys(Keys):
    """The target turns about world z on a base: centre, radius, and angle from the base's x axis."""

    kind: Literal["arc"]
    T_world_centre: PoseKeys
    radius_m: Positive
    T_arm_target: PoseKeys
    from_deg: Finite
    to_deg: Finite
    start_s: NotNegative
    lasts_s: Positive
    hand: HandKeys = HandKeys()
    follow: FollowKeys


class EdgeKeys(Keys):
    """The target is led along corners of the world at a speed, by a hand."""

    kind: Literal["edges"]
    corners_m: Annotated[list[Vector3], Field(min_length=2, max_length=1000)]
    turn_deg: Vector3
    speed_m_s: Positive
    smooth_s: Positive
    start_s: NotNegative
    hand: HandKeys = HandKeys()
    follow: FollowKeys

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if np.linalg.norm(np.diff(np.array(self.corners_m), axis=0), axis=1).min() < 1e-6:
            raise ValueError("two neighbouring corners_m are in one place")
        return self


RobotMotion = WayKeys | SweepsKeys | SwingKeys
FollowedMotion = RestKeys | ArcKeys | EdgeKeys


def joint_rows(motion: RobotMotion | FollowedMotion) -> list[tuple[str, list[float]]]:
    """Return the joint values that a motion names, with their keys."""
    if isinstance(motion, WayKeys):
        return [(f"q[{i}]", row) for i, row in enumerate(motion.q)]
    if isinstance(motion, SwingKeys):
        extremes = [[h + sign * a for h, a in zip(motion.home, motion.amplitude, strict=False)] for sign in (-1.0, 1.0)]
        return [
            ("home", motion.home),
            ("amplitude", extremes[0]),
            ("amplitude", extremes[1]),
            ("period_s", motion.home),
        ]
    if isinstance(motion, SweepsKeys):
        rows = []
        for i, sweep in enumerate(motion.sweeps):
            for end in ("begin", "end"):
                row = list(sweep.rest)
                if sweep.joint <= len(row):
                    row[sweep.joint - 1] = getattr(sweep, end)
                rows.append((f"sweeps[{i}].{end}", row))
        return rows
    return [("follow.home", motion.follow.home)]
