"""The premises that may hold in place of those that a servo believes, and what each makes of the target's way."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.geometry.poses import skew
from armsight.records import PoseStatus
from armsight.units import DEG, MM, MS

HONEST_RAD, HONEST_SCALE, HONEST_M = 0.6 * DEG, 0.007, 0.005
"""Standard deviations of a good hand-eye calibration and of a rig's scale: no wrong premise."""
TURNS_DEG = (5.0, 10.0, 20.0, 35.0, 60.0, 90.0, 120.0, 150.0)
"""Turns of the cameras that are asked for, beside half a turn, about 26 directions."""


class Cause(StrEnum):
    """Whose fault a wrong premise is."""

    HAND_EYE = "hand-eye"
    RIG = "rig"
    TARGET = "target"
    PICTURES = "pictures"
    ROBOT = "robot"


CURES = {
    Cause.HAND_EYE: "calibrate the hand-eye anew, with the cameras as they are mounted",
    Cause.RIG: "check that rig.yaml is of these cameras, left and right, and in metres",
    Cause.TARGET: "check that target.yaml is of this target, and in metres",
    Cause.PICTURES: "check the cameras, their driver and --latency",
    Cause.ROBOT: "check that the arm's model is of this robot",
}


@dataclass(frozen=True, slots=True)
class Premise:
    """What may be so in place of what is believed.

    says: what the target's motion looks like. handicap: by how much more than LIKELY its logarithm of likelihood has to
    be: honest hands that are followed well look like some premises.
    """

    cause: Cause
    says: str
    handicap: float = 0.0

    @property
    def text(self) -> str:
        """What is wrong, and what to look at."""
        return f"wrong premise ({self.cause}): {self.says}; {CURES[self.cause]}"


def named_cause(wrong: Premise | None, rig: str = "") -> str | None:
    """Return whose fault a wrong premise is, as results name it; rig: what is wrong with the rig, in words."""
    return Cause.RIG.value if rig else None if wrong is None else wrong.cause.value


def _as_if(cause: Cause, what: str, handicap: float = 0.0) -> Premise:
    return Premise(cause, f"the target moves in the pictures as if {what}", handicap)


UNMOVED = _as_if(Cause.PICTURES, "they did not show what the arm does: old pictures, or other cameras", 30.0)
INVERTED = _as_if(Cause.HAND_EYE, "the hand-eye calibration were inverted: T_camera_flange in its place", 2.0)


def late_by(late_s: float) -> Premise:
    """Return the premise that pictures are so much older than their times."""
    return Premise(Cause.PICTURES, f"the pictures are older than their times by about {late_s / MS:.0f} ms", 4.0)


def joint_reversed(joint: int) -> Premise:
    """Return the premise that a joint, from 0, goes the other way than the arm's model has it."""
    return _as_if(Cause.ROBOT, f"joint {joint + 1} turned the other way than the model has it", 2.0)


NEAR_M, FAR_M = 0.02, 20.0
"""Nearer and further no rig of this kind sees a target."""


def impossible_pose(status: PoseStatus, distance_m: float) -> Premise | None:
    """Return what is wrong where a pose with its target so far before the cameras cannot be; None where it can."""
    if status is PoseStatus.DOUBTFUL:
        return Premise(Cause.TARGET, "the lights that are seen do not fit the target's on this rig")
    if distance_m <= 0.0:
        return Premise(Cause.RIG, "the target is seen behind the cameras: are left and right exchanged?")
    if not NEAR_M < distance_m < FAR_M:
        return Premise(Cause.RIG, f"the target is seen {distance_m:.3g} m before the cameras: other units?")
    return None


TERMS = 48
"""Products of the entries of a rig's T (3, 4) with those of a point (x, y, z, 1) in it, of which a way is made."""


def weights(M: Array, m: Array) -> Array:
    """Return (TERMS, 3): the way M^-1 (R (M x + m) + p) of a target seen at x is in the products of R, p with x.

    M (3, 3), m (3,): what is seen is x, and in the axes of the rig that is believed it is M x + m. The way is told in
    the axes of what is seen, where the noise is as claimed.
    """
    seen = np.vstack([np.column_stack([M, m]), [0.0, 0.0, 0.0, 1.0]])
    return np.asarray(np.einsum("il,sj->lsji", np.linalg.inv(M), seen).reshape(TERMS, 3))


@cache
def bank() -> tuple[tuple[Premise, ...], Array, Array]:
    """Return the premises under which what is seen is changed alike in each frame: the one believed first, their
    weights (3, TERMS, h), and the doubt (3, TERMS, r): what honest errors of a standard deviation do."""
    found: list[tuple[Premise, Array, Array]] = [(Premise(Cause.HAND_EYE, ""), np.eye(3), np.zeros(3))]
    directions = [np.array(v) - 1.0 for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]
    for direction in directions:
        axis = direction / np.linalg.norm(direction)
        half = (180.0,) if tuple(direction) > (0.0, 0.0, 0.0) else ()
        found += [
            (_turned(deg, axis), Rotation.from_rotvec(deg * DEG * axis).as_matrix(), np.zeros(3))
            for deg in TURNS_DEG + half
        ]
        if np.abs(direction).sum() == 1.0:
            found += [(_aside(far_m, axis), np.eye(3), far_m * axis) for far_m in (0.03, 0.1)]
    for i, name in enumerate("xy"):
        M = np.eye(3)
        M[i, i] = -1.0
        found.append((_as_if(Cause.RIG, f"they were mirrored along {name}"), M, np.zeros(3)))
    for factor in (0.5, 0.8, 0.9, 0.95, 1.05, 1.1, 1.25, 2.0):
        longer = _as_if(Cause.RIG, f"all lengths were {factor:.3g} times those measured", 10.0)
        found.append((longer, factor * np.eye(3), np.zeros(3)))
        if abs(factor - 1.0) > 0.06:
            deeper = _as_if(Cause.RIG, f"its distance were {factor:.3g} times the one measured", 4.0)
            found.append((deeper, np.diag([1.0, 1.0, factor]), np.zeros(3)))
    premises, maps, shifts = zip(*found, strict=True)
    ways = np.array(list(map(weights, maps, shifts)))
    return premises, np.ascontiguousarray(ways.T), np.ascontiguousarray(np.array(honest_errors()).T)


def honest_errors() -> list[Array]:
    """Return the weights (TERMS, 3) of a calibration's errors by turn, scale and place, a standard deviation each."""
    believed, still, eps = np.eye(3), np.zeros(3), 1e-6
    steps = [(HONEST_RAD, skew(axis), still) for axis in np.eye(3)]
    steps += [(HONEST_SCALE, believed, still)] + [(HONEST_M, np.zeros((3, 3)), axis) for axis in np.eye(3)]
    return [
        size * (weights(believed + eps * M, eps * m) - weights(believed - eps * M, -eps * m)) / (2.0 * eps)
        for size, M, m in steps
    ]


def _turned(deg: float, axis: Array) -> Premise:
    """Return the premise that the cameras are turned about an axis (3,) of theirs."""
    names = " and ".join(
        f"{'-' if part < 0.0 else ''}{name}" for part, name in zip(axis, "xyz", strict=True) if abs(part) > 0.1
    )
    return _as_if(Cause.HAND_EYE, f"the cameras were turned by about {deg:.0f} deg about their {names}")


def _aside(far_m: float, axis: Array) -> Premise:
    """Return the premise that the cameras are elsewhere on the flange, along an axis (3,) of theirs."""
    i = int(np.argmax(np.abs(axis)))
    far = f"{np.sign(axis[i]) * far_m / MM:.0f} mm further along their {'xyz'[i]}"
    return _as_if(Cause.HAND_EYE, f"the cameras were {far}", 8.0)
