"""Torque and speed of a track against what the motors can give (Korayem 2018, Table 3).

The masses come from a URDF and are computed by Pinocchio, an optional extra (`pip install armsight[dynamics]`).
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics.arm import Arm
from armsight.records import Motion, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Load:
    """What a track asks of each joint: speed, acceleration and effort (m, n), and the share of what the motor can give.

    effort: N m or N, all NaN-free; None without masses. A motor gives stall_effort (1 - |speed| / max_speed) at a speed
    (its straight torque-speed line), so effort_share is effort over that. Shares above 1 cannot be driven; they are
    +inf where the speed alone is too high, and None where the motors are not known.
    """

    t_s: Array
    speed: Array
    acceleration: Array
    effort: Array | None
    speed_share: Array | None
    effort_share: Array | None

    def __post_init__(self) -> None:
        for name in ("t_s", "speed", "acceleration"):
            value = getattr(self, name)
            object.__setattr__(self, name, frozen_array(name, value, (None,) * np.ndim(value)))

    @property
    def drivable(self) -> bool | None:
        """Whether every joint can follow the track; None where the motors are not known."""
        shares = [share for share in (self.speed_share, self.effort_share) if share is not None]
        return all(bool((share <= 1.0).all()) for share in shares) if shares else None


def track_load(arm: Arm, motion: Motion, urdf: str | None = None) -> Load:
    """Return speeds, accelerations, efforts and motor shares along a track.

    urdf: text of the same arm's URDF with inertias; without it efforts are left out. Speeds and accelerations are
    central differences of the track, so it must be sampled finely. Raises NotEnoughData below three rows and
    Inconsistent where the URDF's joints are not the arm's.
    """
    q = arm.checked(motion.q)
    if len(q) < 3:
        raise NotEnoughData(
            f"a track of {len(q)} rows has no acceleration", consequence="No load is given", cure="Sample it finely"
        )
    speed = np.gradient(q, motion.t_s, axis=0, edge_order=2)
    acceleration = np.gradient(speed, motion.t_s, axis=0, edge_order=2)
    effort = None if urdf is None else inverse_dynamics(arm, urdf, q, speed, acceleration)
    limits = np.array([joint.max_speed or np.nan for joint in arm.joints])
    stalls = np.array([joint.stall_effort or np.nan for joint in arm.joints])
    speed_share = np.abs(speed) / limits if np.isfinite(limits).all() else None
    effort_share = None
    if effort is not None and speed_share is not None and np.isfinite(stalls).all():
        left = stalls * (1.0 - speed_share)
        effort_share = np.where(left > 0.0, np.abs(effort) / np.where(left > 0.0, left, 1.0), np.inf)
    return Load(
        t_s=motion.t_s,
        speed=speed,
        acceleration=acceleration,
        effort=effort,
        speed_share=speed_share,
        effort_share=effort_share,
    )


def inverse_dynamics(arm: Arm, urdf: str, q: Array, speed: Array, acceleration: Array) -> Array:
    """Return the efforts (m, n) in N m or N against inertia and gravity (recursive Newton-Euler)."""
    pin = _pinocchio()
    try:
        model = pin.buildModelFromXML(urdf)
    except Exception as error:  # the binding raises bare exceptions of several kinds
        raise Inconsistent(
            f"the URDF is refused by Pinocchio: {error}", consequence="No efforts are computed"
        ) from error
    names = [str(name) for name in list(model.names)[1:]]
    missing = [joint.name for joint in arm.joints if joint.name not in names]
    if missing or len(names) != arm.n:
        raise Inconsistent(
            f"the URDF moves {', '.join(names)}; the arm moves {', '.join(joint.name for joint in arm.joints)}",
            consequence="No efforts are computed",
            cure="Give the URDF of this arm, with the same joint names and nothing else that moves",
        )
    if not any(inertia.mass > 0.0 for inertia in list(model.inertias)[1:]):
        raise Inconsistent(
            "the URDF holds no masses", consequence="No efforts are computed", cure="Give one with inertial elements"
        )
    data = model.createData()
    ids = [model.getJointId(joint.name) for joint in arm.joints]
    at = [model.joints[i].idx_v for i in ids]
    effort = np.empty_like(q)
    for row in range(len(q)):
        full_q = pin.neutral(model)
        v, a = np.zeros(model.nv), np.zeros(model.nv)
        for k, i in enumerate(ids):
            _set_joint(model.joints[i], full_q, q[row, k])
        v[at], a[at] = speed[row], acceleration[row]
        effort[row] = np.asarray(pin.rnea(model, data, full_q, v, a))[at]
    return effort


def _set_joint(joint: Any, full_q: Array, value: float) -> None:
    """Set one joint's value in Pinocchio's configuration; joints without limits are stored as cosine and sine."""
    if joint.nq == 2:
        full_q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
    else:
        full_q[joint.idx_q] = value


def _pinocchio() -> Any:
    """Return the Pinocchio module; UsageError where it is not installed."""
    try:
        return importlib.import_module("pinocchio")
    except ImportError as error:
        raise UsageError("Pinocchio is not installed", cure="pip install 'armsight[dynamics]'") from error
