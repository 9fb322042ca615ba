"""The law of pose-based visual servoing, and the gains that a delay allows (MATH 3.3).

The printed law of Pachidis 2005 subtracts Euler angles and leaves the lever arm out; it does not converge for some
hand-eye rotations, and a pure error of 10 degrees swings the hand by 46 mm. Here the error of rotation is a rotation
vector.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.control.guard.space import pose_difference
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.geometry.kernels import rotvec
from armsight.records.output import Output, output
from armsight.units import MS

OVERSHOOT_SLACK = 1.001
"""A gain is told to overshoot beyond so many times the limit: a gain given in four digits is meant to be at it."""
WHOLE = 1e-6
"""A delay so little beyond a whole number of cycles is one: it comes from a sum of measured times."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServoError:
    """How far the target is from where it should be, in flange axes: translation (3,) in m, rotation vector (3,)."""

    translation_m: Array
    rotation_rad: Array


def servo_error(T_flange_target: Array, T_flange_desired: Array) -> ServoError:
    """Return e_t = p_FG - p_FD and e_R = rotvec(R_FG R_FD^T) of poses (4, 4) (MATH 3.3): F flange, G target, D where it
    should be."""
    turn = rotvec(np.ascontiguousarray(T_flange_target[:3, :3] @ T_flange_desired[:3, :3].T))
    return ServoError(translation_m=T_flange_target[:3, 3] - T_flange_desired[:3, 3], rotation_rad=turn)


def servo_twist(error: ServoError, p_FD_m: Array, gain_t: float, gain_r: float) -> tuple[Array, Array]:
    """Return velocity (3,) in m/s and angular velocity (3,) in rad/s of the flange, in flange axes (MATH 3.3).

    omega = K_r e_R; v = K_t e_t - omega x p_FD, so that |e_t| and |e_R| of a target at rest decay as exp(-K t), and
    a pure error of rotation turns the hand about the desired point. p_FD_m (3,): where the target should be, in flange
    axes. gain_t, gain_r: K_t and K_r in 1/s; gain_r 0 holds the rotation.
    """
    omega = gain_r * error.rotation_rad
    return gain_t * error.translation_m - cross(omega, p_FD_m), omega


def cross(a: Array, b: Array) -> Array:
    """Return a x b of two vectors (3,); numpy's own takes twenty times as long, most of it to look at their shapes."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def inverse(T: Array) -> Array:
    """Return the inverse of a pose (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def delay_cycles(delay_s: float, cycle_s: float) -> int:
    """Return how many cycles of the servo a delay lasts, begun ones counted whole. Raises UsageError below zero."""
    if not (cycle_s > 0.0 and 0.0 <= delay_s < math.inf):
        raise UsageError(
            f"a delay of {delay_s:g} s in cycles of {cycle_s:g} s cannot be",
            consequence="No gain is known to be stable",
            cure="Give a delay of zero or more seconds and a cycle of more than zero",
        )
    return math.ceil(delay_s / cycle_s - WHOLE)


def stability_gain(cycle_s: float, n: int) -> float:
    """Return the gain in 1/s from which e[k+1] = e[k] - K T e[k-n] no longer decays: 2 sin(pi / (2 (2 n + 1))) / T.

    n: whole cycles T of delay (MATH 3.3).
    """
    return 2.0 * math.sin(math.pi / (2.0 * (2 * n + 1))) / cycle_s


def no_overshoot_gain(cycle_s: float, n: int) -> float:
    """Return the gain in 1/s up to which the same error decays without overshoot: n^n / (n + 1)^(n + 1) / T."""
    return float(n**n / (n + 1) ** (n + 1)) / cycle_s


@output
class Gain(Output):
    """The gain, and what the measured delay allows (MATH 3.3)."""

    used: Annotated[float, Doc("Gain of translation and rotation, 1/s.")]
    no_overshoot: Annotated[float, Doc("Up to this one the error decays without overshoot, 1/s.")]
    stable: Annotated[float, Doc("From this one on the arm would swing up, 1/s; it is refused.")]
    cycle_s: Annotated[float, Doc("The servo's cycle: the cameras' or the controller's, the longer one, s.")]
    n_delay: Annotated[int, Doc("Cycles of delay, begun ones counted whole.")]
    note: Annotated[str, Doc("What to know about the gain; empty for nothing.")]


def chosen_gain(asked: float | None, cycle_s: float, delay_s: float) -> Gain:
    """Return the gain for a delay from exposure to motion: as asked, or the largest without overshoot.

    cycle_s: the servo's, which is the longer of the cameras' and the controller's. Raises Inconsistent for one that is
    not stable.
    """
    n = delay_cycles(delay_s, cycle_s)
    calm, stable = no_overshoot_gain(cycle_s, n), stability_gain(cycle_s, n)
    used = calm if asked is None else asked
    if not 0.0 < used < stable:
        raise Inconsistent(
            f"a gain of {used:g} 1/s is not above 0 and below {stable:.4g} 1/s, from where on the arm swings up at a "
            f"delay of {delay_s / MS:.0f} ms ({n} cycles of {cycle_s / MS:.0f} ms)",
            consequence="The arm is not moved",
            cure=f"Give a gain up to {calm:.4g} 1/s, which does not overshoot either (--gain), or shorten the delay",
        )
    note = ""
    if used > OVERSHOOT_SLACK * calm:
        note = f"a gain of {used:g} 1/s overshoots at a delay of {n} cycles; up to {calm:.4g} 1/s it would not"
    return Gain(used=used, no_overshoot=calm, stable=stable, cycle_s=cycle_s, n_delay=n, note=note)


LIKELY, FEW = 4.0, 8.0
"""Standard deviations by which the scatter of a pose that stands may be above what its noise makes of it, and what is
added to that: of few poses it is not yet like a normal distribution."""
POSES = 5
"""Of fewer poses the scatter tells nothing: two or three of a target that is followed at 0.2 m/s may agree."""
TELLING = 10.0
"""The camera's motion tells once it would move a resting target by so many standard deviations of its pose."""
STANDS = 3
"""So many poses in a row that came before, to the last digit, while the camera moved, are old pictures, one again and
again or some to and fro: one may be sent twice."""
SHOWN = 200
"""Poses that are remembered: seven seconds of a webcam."""
STANDS_M = 0.001
"""A camera that moved so far sees no equal poses: ten times what an arm shakes."""


class Reaction:
    """Watches the target's position before a camera that moves. One thread sees; any may look at missing."""

    def __init__(self, chase_m: float) -> None:
        self._chase_m = chase_m
        self._n = self._same = 0
        self._mean, self._scatter = np.zeros(6), 0.0
        self._T_base_since = self._T_since = np.eye(4)
        self._shown: deque[bytes] = deque(maxlen=SHOWN)
        self.missing = False

    def see(self, T_base_rig: Array, T_rig_target: Array, sigma: Array) -> None:
        """Take where the rig was, (4, 4), as the target was seen at (4, 4) with standard deviations (6,) in rig axes.

        Those of a rotation that was not seen are infinite.
        """
        shown = (T_rig_target + 0.0).tobytes()  # a zero is one, whatever its sign
        self._same = self._same + 1 if shown in self._shown else 0
        self._shown.append(shown)
        if self._n:
            off = np.concatenate(pose_difference(T_rig_target, self._T_since)) / sigma
            before = off - self._mean
            self._n += 1
            self._mean = self._mean + before / self._n
            self._scatter += float(before @ (off - self._mean))
        freedom = 6.0 * (self._n - 1)
        if not self._n or self._scatter > freedom + LIKELY * np.sqrt(2.0 * freedom) + FEW:
            self._n, self._mean, self._scatter = 1, np.zeros(6), 0.0
            self._T_base_since, self._T_since = T_base_rig, T_rig_target
        rested = inverse(T_base_rig) @ self._T_base_since @ self._T_since
        deviation = np.concatenate(pose_difference(rested, self._T_since)) / sigma
        way_m = float(np.linalg.norm(T_base_rig[:3, 3] - self._T_base_since[:3, 3]))
        stands = self._same >= STANDS and way_m > STANDS_M
        deviates = self._n >= POSES and way_m > self._chase_m and float(np.linalg.norm(deviation)) > TELLING
        if stands or deviates:
            self.missing = True

    def forget(self) -> None:
        """Begin anew: the operator has looked."""
        self._n = self._same = 0
        self.missing = False
