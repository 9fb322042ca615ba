"""What repeats from pose to pose: the uncertainty of rig and target, carried to a moving target's pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.measure.motion.kernels import state as kernels
from armsight.measure.motion.kernels.views import observe
from armsight.measure.motion.states import MotionState
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.poses.setup import Setup

Array = NDArray[np.float64]

SIDES = 2


def systematic_covariance(setup: Setup, state: MotionState) -> Array | None:
    """Return the covariance (6, 6) that rig and target leave in a pose; None where both are exact.

    All lights count as seen in both views, all spots as equally good.
    """
    if not setup.covariance.size:
        return None
    slopes = _slopes(setup, state)
    if slopes is None:
        return None
    C = np.linalg.inv(np.einsum("sica,sicb->ab", slopes, slopes))
    X, packed = setup.model.xyz_m, setup.packed
    unit, out = np.tile(np.eye(2), (len(X), SIDES, 1, 1)), np.zeros((6, 6))
    rig_covariance.carry_to_pose(
        packed.arrays,
        unit,
        X,
        state.T_rig_target,
        setup.covariance,
        C,
        np.zeros((len(X), SIDES, 2)),
        out,
    )
    return out if out.any() else None


def _slopes(setup: Setup, state: MotionState) -> Array | None:
    """Return d pixel / d pose [side, light, 2, 6]; None where a light is behind a camera."""
    packed, X = setup.packed, setup.model.xyz_m
    H, uv = np.zeros((SIDES, len(X), 2, kernels.N)), np.empty(2)
    for side in range(SIDES):
        for i, place in enumerate(X):
            if not observe(state.x, packed.camera(side), place, 0.0, uv, H[side, i]):
                return None
    return H[..., :6]
