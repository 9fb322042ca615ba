"""How a servo follows its target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent
from armsight.units import DEG

FIRST_M_S = 0.04
"""The first centimetre is gone at no more than this speed: nothing has tested the premises, and cameras and arm are
some 0.1 s late."""


class Mount(StrEnum):
    """Where the cameras are."""

    EYE_IN_HAND = "eye-in-hand"
    EYE_TO_HAND = "eye-to-hand"


class Turning(StrEnum):
    """How the arm turns after the target: until their axes agree, as they stood when it was first seen, or not."""

    ALIGN = "align"
    KEEP = "keep"
    HOLD = "hold"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServoSettings:
    """How the target is followed.

    T_parent_camera: the rig's pose in flange (EYE_IN_HAND) or base (EYE_TO_HAND), by hand-eye calibration.
    T_flange_desired: where the target should be, in flange axes: on the camera's axis, or at a tool's frame. gain_t,
    gain_r: K_t and K_r in 1/s. turning: how the arm turns; where it KEEPs the rotation first seen, only the position
    of T_flange_desired counts. arm_lag_s: from a command to the arm's motion, as first assumed. predict: go for where
    the target will be when the command takes effect, with its velocity fed forward; else the law of MATH 3.3 alone, of
    the newest frame as it was. resume_m, resume_rad: after a jump the target is followed again by itself where it is so
    near to where it would have been. chase_m: so far the camera may go while the target, seen away from where it is
    wanted, stays where it is in the picture: then the picture stands, or the target is fixed to the camera. first_m_s:
    so fast a camera on the flange goes its first centimetre after a target at most.
    """

    mount: Mount
    T_parent_camera: RigidTransform
    T_flange_desired: RigidTransform
    gain_t: float
    gain_r: float
    arm_lag_s: float = 0.0
    predict: bool = True
    turning: Turning = Turning.ALIGN
    resume_m: float = 0.02
    resume_rad: float = 3.0 * DEG
    chase_m: float = 0.01
    first_m_s: float = FIRST_M_S

    def with_gain(self, gain: float) -> ServoSettings:
        """Return the same with one gain for position and rotation, in 1/s."""
        return replace(self, gain_t=gain, gain_r=gain)


def on_axis(T_flange_frame: RigidTransform, distance_m: float) -> RigidTransform:
    """Return T_flange_desired of a target that stands on the z axis of a camera or tool, with its axes (MATH 3.2).

    distance_m: from the frame's origin along its z, not negative. Raises Inconsistent for another.
    """
    if not (np.isfinite(distance_m) and distance_m >= 0.0):
        raise Inconsistent(
            f"a distance of {distance_m:g} m is not before the camera or tool",
            consequence="The target cannot be there",
            cure="Give metres, zero or more (--distance)",
        )
    return T_flange_frame * RigidTransform.from_translation([0.0, 0.0, distance_m])
