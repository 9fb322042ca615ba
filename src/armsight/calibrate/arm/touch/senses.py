"""Joints that count the other way, or from elsewhere, told by touches alone: spikes scatter least with the right ones.

A mirror image of an arm touches a mirror image of the spikes: of an arm with a plane of symmetry the joints that run
the other way, and all others that turn about axes in that plane, are alike, and both are told.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.senses import (
    FEWEST,
    FITS,
    FITS_ALIKE,
    MOST_JOINTS,
    ROWS,
    Senses,
    all_choices,
    fit_choices,
    judged,
    tool_points,
)
from armsight.calibrate.arm.touch.fit import FIRST_M, LEAST_JOINT, TouchNoise, fit_touches
from armsight.calibrate.arm.touch.model import start
from armsight.calibrate.arm.touch.touches import Kind, Touches
from armsight.errors import NotConverged
from armsight.kinematics import Arm, fk

ROUGH = TouchNoise(touch_m=dict.fromkeys(Kind, FIRST_M), joint=LEAST_JOINT)
"""Of touches whose scatter is not known yet."""
PULL = 3.0
"""Rows that a known distance is worth: enough that no choice shrinks the spikes to one."""


def other_senses(arm: Arm, touches: Touches) -> Senses | None:
    """Return the senses and zeros that explain the touches of spikes where the given ones do not; else None.

    Flats, balls and gauges say too little for it.
    """
    turning = np.flatnonzero(arm.revolute)
    spikes = np.flatnonzero(~touches.scalar)
    if not 1 <= len(turning) <= MOST_JOINTS or len(spikes) < FEWEST or arm.couplings:
        return None
    used = touches.take(spikes[np.unique(np.linspace(0, len(spikes) - 1, ROWS).astype(np.intp))])
    there = set(used.feature)
    used = replace(used, lengths=tuple(one for one in used.lengths if one.b and {one.a, one.b} <= there))
    flange = fk(arm, used.q)[:, :3, 3]
    spread = float(np.sqrt(((flange - flange.mean(axis=0)) ** 2).sum(axis=1).mean()))
    # zeros and tip are free beside every choice
    left_of = partial(_left, arm, turning, used)
    choices = all_choices(len(turning))
    left, found = fit_choices(arm, turning, choices, used.q, left_of)
    if left.min() > FITS * spread:
        return None
    return judged(arm, turning, choices, left, found, FITS_ALIKE * spread, partial(_refined, used))


def _refined(touches: Touches, arm: Arm) -> float:
    """Return what an arm leaves of the touches once lengths and angles are fitted within tolerance, RMS in m."""
    model, guess = start(ArmModel(arm=arm, labels=("",), turned=False), touches)
    try:
        fitted = fit_touches(model, guess, model.arm_model.geometry, Tolerance(), ROUGH)
    except NotConverged:
        return float("inf")
    return float(np.sqrt((fitted.misses_m(model, touches) ** 2).mean()))


def _left(arm: Arm, turning: NDArray[np.intp], touches: Touches, read: Array, x: Array) -> tuple[Array, Array]:
    """Return how far each touch is from the middle of its spike's, (c, 3 m + d), and by how much d known distances are
    off, with the derivatives by zeros and tool x (c, k + 3)."""
    there, by_x = tool_points(arm, turning, read, x)
    c, m, width = len(x), len(touches), x.shape[1]
    which = np.unique(touches.which, return_inverse=True)[1]
    # where a spike is goes with every choice: the mean of its touches
    share = np.equal.outer(np.arange(which.max() + 1), which) / np.bincount(which)[:, None]
    middle, by_middle = share @ there, (share @ by_x.reshape(c, m, -1)).reshape(c, -1, 3, width)
    off, by_off = there - middle[:, which], by_x - by_middle[:, which]
    r, J = [off.reshape(c, -1)], [by_off.reshape(c, -1, width)]
    names = list(dict.fromkeys(touches.feature))
    number = {name: int(which[touches.feature.index(name)]) for name in names}
    for one in touches.lengths:
        a, b = number[one.a], number[one.b]
        apart = middle[:, a] - middle[:, b]
        size = np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
        along = (apart / size)[:, None]
        r.append(PULL * (size - one.length_m))
        J.append(PULL * along @ (by_middle[:, a] - by_middle[:, b]))
    return np.concatenate(r, axis=1), np.concatenate(J, axis=1)
