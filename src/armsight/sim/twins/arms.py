"""The arms behind the emulated controllers, by their makers' data sheets, or as an arm file has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from armsight.errors import Inconsistent
from armsight.sim.arms import SimArm, SimJoint

QUARTER = math.pi / 2

PLAIN = {"beta_rad": 0.0, "sign": 1.0, "coupled": None}
"""Keys of a joint that the simulated arm has only in this value."""


def irb120() -> SimArm:
    """Return ABB's IRB 120-3/0.6, by its product specification (3HAC035960)."""
    table = (  # a m, alpha quarter turns, d m, theta quarter turns, range in degrees
        (0.0, -1, 0.290, 0, -165, 165),
        (0.270, 0, 0.0, -1, -110, 110),
        (0.070, -1, 0.0, 0, -110, 70),
        (0.0, 1, 0.302, 0, -160, 160),
        (0.0, -1, 0.0, 0, -120, 120),
        (0.0, 0, 0.072, 2, -400, 400),
    )
    return SimArm(
        joints=tuple(
            SimJoint(
                name=f"j{i}",
                a_m=a,
                alpha_rad=alpha * QUARTER,
                d_m=d,
                theta_rad=theta * QUARTER,
                lower=math.radians(low),
                upper=math.radians(high),
            )
            for i, (a, alpha, d, theta, low, high) in enumerate(table, 1)
        )
    )


def ur10() -> SimArm:
    """Return the UR10 of Universal Robots, by the DH parameters that its maker gives out."""
    table = (
        (0.0, 1, 0.1273),
        (-0.612, 0, 0.0),
        (-0.5723, 0, 0.0),
        (0.0, 1, 0.163941),
        (0.0, -1, 0.1157),
        (0.0, 0, 0.0922),
    )
    return SimArm(
        joints=tuple(
            SimJoint(name=f"j{i}", a_m=a, alpha_rad=alpha * QUARTER, d_m=d, lower=-math.tau, upper=math.tau)
            for i, (a, alpha, d) in enumerate(table, 1)
        )
    )


def arm_of(content: Mapping[str, Any]) -> SimArm:
    """Return the arm of an arm file's content. Raises Inconsistent for what the simulated arm cannot be."""
    if content.get("convention", "standard") != "standard":
        raise Inconsistent(
            "the emulated arm takes standard Denavit-Hartenberg parameters only",
            consequence="There is no twin",
            cure="Convert the file: armsight convert arm FILE -o OUT",
        )
    joints = content.get("joints")
    if not isinstance(joints, Sequence) or not joints:
        raise Inconsistent("an arm without joints cannot be emulated", consequence="There is no twin")
    return SimArm(joints=tuple(_joint(number, joint) for number, joint in enumerate(joints, 1)))


def _joint(number: int, joint: Mapping[str, Any]) -> SimJoint:
    for key, value in PLAIN.items():
        if joint.get(key, value) != value:
            raise Inconsistent(
                f"joint {number} has {key} {joint[key]}: the emulated arm has no such joints",
                consequence="There is no twin",
                cure="Leave --arm out: the twin then has an arm of its own",
            )
    lower, upper = joint.get("lower"), joint.get("upper")
    return SimJoint(
        name=str(joint.get("name", f"j{number}")),
        prismatic=joint.get("type", "revolute") == "prismatic",
        lower=-math.inf if lower is None else float(lower),
        upper=math.inf if upper is None else float(upper),
        **{key: float(joint.get(key, 0.0)) for key in ("a_m", "alpha_rad", "d_m", "theta_rad")},
    )
