"""How much the hand turned: what the poses can determine, before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.handeye.pairs import Array, PosePairs
from armsight.errors import Degenerate
from armsight.geometry.lengths import FAR_M, check_metres
from armsight.records import frozen_array
from armsight.units import DEG

LEAST_TURN_RAD = 2.5 * DEG
"""Least root-mean-square turn about the second axis: errors of orientation are blown up by its inverse, here 23
times (0.05 degrees seen become more than a degree in the answer). Poses spread evenly over +-4.3 degrees reach it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationExcitation:
    """Turns of the hand about its mean orientation.

    rotvecs_rad (n, 3): in the mean orientation's axes. rms_rad (3,): about the principal axes, falling. axes (3, 3):
    those axes in rows.
    """

    rotvecs_rad: Array
    rms_rad: Array
    axes: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotvecs_rad", frozen_array("rotvecs_rad", self.rotvecs_rad, (None, 3)))
        object.__setattr__(self, "rms_rad", frozen_array("rms_rad", self.rms_rad, (3,)))
        object.__setattr__(self, "axes", frozen_array("axes", self.axes, (3, 3)))


def rotation_excitation(rotations: Rotation) -> RotationExcitation:
    """Return how far a stack of orientations turns, and about which axes."""
    w = (rotations.mean().inv() * rotations).as_rotvec()
    w = w - w.mean(axis=0)
    values, vectors = np.linalg.eigh(w.T @ w / len(w))
    rms = np.sqrt(np.maximum(values[::-1], 0.0))
    return RotationExcitation(rotvecs_rad=w, rms_rad=rms, axes=vectors.T[::-1])


def require_turning(found: RotationExcitation) -> None:
    """Raise Degenerate where the hand turned too little, or about one axis only."""
    first, second, _ = found.rms_rad
    if second >= LEAST_TURN_RAD:
        return
    cure = "Add poses that tilt the hand by 15 to 30 degrees about at least two axes that are not parallel"
    if first < LEAST_TURN_RAD:
        raise Degenerate(
            f"the hand turns by only {first / DEG:.2g} degrees (root mean square) over all poses",
            consequence="Noise would decide where the camera is, by centimetres; no calibration is given",
            cure=cure,
        )
    x, y, z = found.axes[0]
    raise Degenerate(
        f"the hand turns about one axis only, ({x:.2f}, {y:.2f}, {z:.2f}) in its own frame: {first / DEG:.3g} degrees "
        f"about it, {second / DEG:.2g} across it (root mean square)",
        consequence="Where the camera is along that axis, and part of its orientation, cannot be known",
        cure=cure,
    )


def require_metres(pairs: PosePairs) -> None:
    """Raise Inconsistent where distances are so large that they must be millimetres."""
    for what, t in (
        ("the robot's poses lie from the base by", pairs.T_base_flange.translation),
        ("the camera sees the target from", pairs.T_camera_target.translation),
    ):
        check_metres(np.linalg.norm(t, axis=1), FAR_M, what)
