"""What would make a target's geometry better known, in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.calibrate.light_target.result import (
    GOOD_FRAMES,
    GOOD_TURN_RAD,
    LARGE_SCALE,
    MANY_REJECTED,
    TargetResult,
)
from armsight.units import DEG, MM

RIG_RULES = 0.7
EQUAL_SIGMA = 3.0


def advise(done: TargetResult) -> TargetResult:
    """Return the calibration with its advice."""
    advice: list[str] = []
    if len(done.names) == 2:
        advice.append("two lights: only their distance is known, and a pose's turn about their line never is")
    if done.n_used < GOOD_FRAMES:
        advice.append(f"{done.n_used} frames were used: {GOOD_FRAMES} and more tell wrong ones better")
    second_rad = done.rotation_excitation_rms_rad[1]
    if second_rad < GOOD_TURN_RAD:
        advice.append(
            f"the target was tilted by {second_rad / DEG:.2g} degrees RMS about its second axis: turn it by "
            "20 to 40 degrees to several sides, so that its depth is seen across the image"
        )
    if done.rig_share is None:
        advice.append(
            "the rig's file has no covariance: an error of its baseline scales all positions, and no residual shows it"
        )
    elif done.rig_share > RIG_RULES:
        advice.append(
            "most of the standard deviation comes from the rig's calibration: more frames will not help, a "
            "better rig will"
        )
    if done.scale > LARGE_SCALE:
        advice.append(
            f"residuals are {done.scale:.2g} times the spots' own standard deviations: the calibration, blur or "
            "shiny lights"
        )
    if len(done.rejected) > MANY_REJECTED * done.n_frames:
        advice.append(
            f"{len(done.rejected)} of {done.n_frames} frames were left out: cover reflections, show all lights"
        )
    return replace(done, advice=(*advice, *_apex(done)))


def _apex(done: TargetResult) -> list[str]:
    """Return a word on an isosceles target whose unlike corner is not A."""
    if len(done.names) != 3:
        return []
    lengths = done.distances_m
    ab, bc, ac = (lengths[k] for k in ("AB", "BC", "AC"))
    for corner, (p, q) in {"B": (ab, bc), "C": (ac, bc)}.items():
        if abs(p.value_m - q.value_m) < EQUAL_SIGMA * np.hypot(p.std_m, q.std_m):
            return [
                f"the sides that meet at {corner} are equal ({p.value_m / MM:.2f} mm): the frame starts at A, "
                "which was leftmost; hold the target the way it will be seen if that is not wanted"
            ]
    return []
