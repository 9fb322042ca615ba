"""Spots of one moment that were not exposed at one time, put where their lights were seen at the moment's own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Array
from armsight.measure.motion.kernels.state import N
from armsight.measure.motion.kernels.views import observe_all
from armsight.measure.motion.states import MotionState
from armsight.measure.poses.setup import Setup
from armsight.records import AT_ONCE, Frame, Spots

AT_ONE_TIME_S = 1e-4
"""What a spot moves in such a time is nothing: 0.1 mm at 1 m/s."""


def rig_times(setup: Setup, frames: Sequence[Frame | None]) -> tuple[float, Array]:
    """Return the time of a moment, the mean of its frames', and by how much later (v,) each one was taken."""
    at = [
        None if one is None else one.t_s if clock is None else float(clock.rig_time(one.t_s))
        for one, clock in zip(frames, setup.rig.timing, strict=True)
    ]
    there = [t for t in at if t is not None]
    t_s = sum(there) / len(there)
    return t_s, np.array([0.0 if t is None else t - t_s for t in at])


def apart(setup: Setup, late_s: Array) -> bool:
    """Tell whether views are of times so far apart that a motion shows."""
    rolling = any(one is not None and one.rolling for one in setup.rig.timing)
    return rolling or bool(np.abs(late_s).max() > AT_ONE_TIME_S)


def at_one_time(setup: Setup, seen: Sequence[Spots], late_s: Array, state: MotionState) -> list[Spots]:
    """Return the spots as they would have been seen at the moment's time, by the target's motion so far.

    late_s (v,): see rig_times. state: expected at the moment's time. Each spot goes as the light does that is expected
    nearest to it. What is open of that way is added to its covariance, times the number of lights: those of a view
    share it, so that their mean is no surer.
    """
    out, X = [], setup.model.xyz_m
    for s, spots in enumerate(seen):
        timing = setup.rig.timing[s] or AT_ONCE
        height, now, then = setup.rig.cameras[s].camera.height, _expected(setup, state, s, np.zeros(len(X))), None
        if now is not None:
            then = _expected(setup, state, s, late_s[s] + timing.line_time(now[0][:, 1], height))
        if now is None or then is None or not len(spots):
            out.append(spots)
            continue
        way, slope = now[0] - then[0], (now[1] - then[1]).reshape(len(X), 2, N)
        doubt = len(X) * np.einsum("mia,ab,mjb->mij", slope, state.C, slope)
        of = np.linalg.norm(spots.uv_px[:, None] - then[0], axis=2).argmin(axis=1)
        out.append(replace(spots, uv_px=spots.uv_px + way[of], covariance_px2=spots.covariance_px2 + doubt[of]))
    return out


def _expected(setup: Setup, state: MotionState, s: int, tau_s: Array) -> tuple[Array, Array] | None:
    """Return where a view shows the lights (m, 2), each tau_s (m,) after the state's time, and d / d state (2 m, 18).

    None where one is behind the camera.
    """
    m = len(setup.model)
    uv, H = np.empty((m, 2)), np.empty((2 * m, N))
    return (uv, H) if observe_all(state.x, setup.packed.camera(s), setup.model.xyz_m, tau_s, uv, H) else None
