"""What a joint can have wrong, as what is added to its reading: a zero, backlash, a gear's eccentricity, a slide's
scale, elasticity."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from armsight.arrays import Array
from armsight.kinematics import Arm, link_frames

STILL_RAD = 0.05
"""A joint that moved less (rad, or of the mean link) cannot be told from the geometry beside it."""
MOVING = 0.02
"""Share of a joint's greatest speed below which its direction is not told."""
LEAST_BOTH_WAYS = 0.15
"""Share of the rows that must come from either side for backlash to be judged."""
LEAST_LOAD = 0.05
"""Spread of a joint's gravity torque, as a share of the greatest of any joint, for elasticity to be judged."""


class Kind(StrEnum):
    """What a joint has wrong."""

    ZERO = "zero offset"
    BACKLASH = "backlash"
    ECCENTRICITY = "gear eccentricity"
    SCALE = "scale of the slide"
    LOAD = "elasticity under load"
    ACCELERATION = "elasticity under acceleration"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """An error of one joint (from 0): what is added to its reading is basis (m, k) times k unknown parameters.

    names: of the parameters, with their unit.
    """

    joint: int
    kind: Kind
    names: tuple[str, ...]
    basis: Array


def effects(arm: Arm, q: Array, speed: Array | None, acceleration: Array | None) -> tuple[Effect, ...]:
    """Return everything that the rows can show of single joints.

    q (m, n): joint values. speed, acceleration (m, n): None where rows are single poses; the way a joint came then is
    the sign of its step from the row before.
    """
    way = _direction(arm, q, speed)
    load = gravity_load(arm, q)
    found: list[Effect] = []
    for i in range(arm.n):
        one = np.ones((len(q), 1))
        unit = "rad" if arm.revolute[i] else "m"
        found.append(Effect(joint=i, kind=Kind.ZERO, names=(f"zero_{unit}",), basis=one))
        if np.ptp(q[:, i]) < still(arm)[i]:
            continue
        both = min((way[:, i] > 0).mean(), (way[:, i] < 0).mean())
        if both > LEAST_BOTH_WAYS:
            found.append(Effect(joint=i, kind=Kind.BACKLASH, names=(f"backlash_{unit}",), basis=0.5 * way[:, [i]]))
        if arm.revolute[i]:
            turn = np.stack([np.sin(q[:, i]), np.cos(q[:, i]) - np.cos(q[:, i]).mean()], axis=1)
            names = ("sin_rad", "cos_rad")
            found.append(Effect(joint=i, kind=Kind.ECCENTRICITY, names=names, basis=turn))
        else:  # a screw's pitch, a belt's wheel, a warm scale
            along = q[:, [i]] - q[:, i].mean()
            found.append(Effect(joint=i, kind=Kind.SCALE, names=("scale_m_per_m",), basis=along))
        if np.ptp(load[:, i]) > LEAST_LOAD * max(float(np.ptp(load, axis=0).max()), 1e-12):
            found.append(Effect(joint=i, kind=Kind.LOAD, names=(f"load_{unit}_per_m",), basis=load[:, [i]]))
        if acceleration is not None and np.ptp(acceleration[:, i]) > 0.0:
            name = f"acceleration_{unit}_s2_per_{unit}"
            found.append(Effect(joint=i, kind=Kind.ACCELERATION, names=(name,), basis=acceleration[:, [i]]))
    return tuple(found)


def still(arm: Arm) -> Array:
    """Return (n,) the range that a joint must have moved over to be judged."""
    return np.where(arm.revolute, STILL_RAD, STILL_RAD * arm.length_m)


def _direction(arm: Arm, q: Array, speed: Array | None) -> Array:
    """Return (m, n) from which side each joint came: 1 rising, -1 falling, 0 where it stood."""
    if speed is None:
        step = np.diff(q, axis=0, prepend=q[:1])
        return np.asarray(np.sign(np.where(np.abs(step) > 1e-3 * still(arm), step, 0.0)))
    return np.asarray(np.sign(np.where(np.abs(speed) > MOVING * np.abs(speed).max(axis=0), speed, 0.0)))


def gravity_load(arm: Arm, q: Array) -> Array:
    """Return (m, n) the lever in m by which equal weights at the ends of the links turn each joint.

    An assumption, as nobody says the masses: as much weight at each link's end and at the tool, the world's z up. Of a
    slide the share of the weight along it.
    """
    out = np.empty(q.shape)
    for k, row in enumerate(q):
        T = link_frames(arm, row)
        for i in range(arm.n):
            beyond = T[i + 1 :, :3, 3] - T[i, :3, 3]
            force = np.array([0.0, 0.0, -1.0])
            turned = np.cross(beyond, force).mean(axis=0)
            out[k, i] = T[i, :3, 2] @ (turned if arm.revolute[i] else force)
    return out


LAST_DIGIT_DEG = 1e-4
"""Angles are told to this, and so no surer than this."""


def shown(name: str, value: float, std: float) -> str:
    """Return a parameter in words, angles in degrees."""
    if name.endswith("_rad"):
        width = max(np.rad2deg(std), LAST_DIGIT_DEG)
        return f"{name.removesuffix('_rad')} {np.rad2deg(value):.4f} +- {width:.2g} deg"
    return f"{name} {value:.4g} +- {std:.2g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class JointVerdict:
    """What is known of one joint: judged or why not; its zero (rad or m) with standard deviation where estimated; the
    share that its best effect takes off left-out squares, and which effect that is, None where it takes nothing off.
    backlash: (rad or m, standard deviation), None where it did not come from both sides."""

    judged: bool
    why: str = ""
    offset: float | None = None
    std: float | None = None
    gain_heldout: float | None = None
    kind: Kind | None = None
    backlash: tuple[float, float] | None = None


def far_zeros(arm: Arm, joints: tuple[JointVerdict, ...], least: Array) -> str:
    """Return in words the zeros that are off by more than four deviations and least (n,); "" for none."""
    names = ["zero_rad" if turning else "zero_m" for turning in arm.revolute]
    off = [f"joint {i + 1} ({shown(names[i], *pair)})" for i, pair in _far(joints) if abs(pair[0]) > least[i]]
    return ", ".join(off)


def _far(joints: tuple[JointVerdict, ...]) -> list[tuple[int, tuple[float, float]]]:
    """Return the joints (from 0) whose zeros are off by more than four deviations: zero, deviation."""
    known = [(i, (v.offset, v.std)) for i, v in enumerate(joints) if v.offset is not None and v.std is not None]
    return [(i, (zero, std)) for i, (zero, std) in known if abs(zero) > 4.0 * std]


def several_off(joints: tuple[JointVerdict, ...], gains: dict[str, float]) -> str:
    """Return in words that several zeros are off; gains: shares that they take off."""
    far = [i + 1 for i, _ in _far(joints)]
    beyond = f" (those beyond four standard deviations: {', '.join(map(str, far))})" if far else ""
    return (
        f"Several joints' zeros are off{beyond}: together they take {100 * gains['zeros']:.3g} % off left-out squares."
    )


def model_off(gains: dict[str, float], joint: int, off: str) -> str:
    """Return in words that the geometry is the cause; joint (from 0): the best single one. off: zeros as far_zeros."""
    rows = "on these rows (of measurements and joints in two files `armsight join --as points` makes one)"
    either = f" Zeros ({off}) explain much as well: rows over more of the arm's range tell which it is." if off else ""
    return (
        f"The arm's model is the cause: correcting its geometry takes {100 * gains['model']:.3g} % off the squared "
        f"errors of rows left out, the best single joint (joint {joint + 1}) {100 * gains['joint']:.3g} "
        f"%.{either} Joint zeros read from a wrong model are not to be believed: run `armsight calibrate arm` {rows}."
    )
