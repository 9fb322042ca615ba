"""What repeats from pose to pose: the uncertainty of rig, target and timing, carried to a moving target's pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armsight.measure.motion.kernels import state as kernels
from armsight.measure.motion.kernels.views import observe
from armsight.measure.motion.states import MotionState
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.poses.setup import Setup
from armsight.records import CameraTiming
from armsight.records.timing import PPM

Array = NDArray[np.float64]

SIDES = 2


def systematic_covariance(
    setup: Setup, state: MotionState, timing: Sequence[CameraTiming], heights_px: Sequence[int]
) -> Array | None:
    """Return the covariance (6, 6) that rig, target and the cameras' timing leave in a pose; None where all are exact.

    All lights count as seen in both views, all spots as equally good. timing, heights_px: of the left and right camera.
    """
    slopes, tau = _slopes(setup, state, timing, heights_px)
    if slopes is None:
        return None
    C = np.linalg.inv(np.einsum("sica,sicb->ab", slopes, slopes))
    out = np.zeros((6, 6))
    if setup.covariance.size:
        X, packed = setup.model.xyz_m, setup.packed
        unit = np.tile(np.eye(2), (len(X), SIDES, 1, 1))
        rig_covariance.carry_to_pose(
            packed.k,
            packed.R,
            packed.t,
            unit,
            X,
            state.T_rig_target,
            setup.covariance,
            C,
            np.zeros((len(X), SIDES, 2)),
            out,
        )
    out += _of_timing(slopes, tau, C, state, timing)
    return out if out.any() else None


def _slopes(
    setup: Setup, state: MotionState, timing: Sequence[CameraTiming], heights_px: Sequence[int]
) -> tuple[Array | None, Array]:
    """Return d pixel / d pose [side, light, 2, 6] and each spot's line time [side, light]; None: behind a camera."""
    packed, X = setup.packed, setup.model.xyz_m
    H, uv, tau = np.zeros((SIDES, len(X), 2, kernels.N)), np.empty(2), np.zeros((SIDES, len(X)))
    for side in range(SIDES):
        for i, place in enumerate(X):
            if not observe(state.x, packed.k[side], packed.R[side], packed.t[side], place, 0.0, uv, H[side, i]):
                return None, tau
            tau[side, i] = float(timing[side].line_time(uv[1], heights_px[side]))
    return H[..., :6], tau


def _of_timing(slopes: Array, tau: Array, C: Array, state: MotionState, timing: Sequence[CameraTiming]) -> Array:
    """Return the part (6, 6) of delay, drift and read-out: a time moves a spot by the target's own motion."""
    out = np.zeros((6, 6))
    rate = slopes @ state.velocity  # [side, light, 2], px/s
    for side, one in enumerate(timing):
        if one.covariance is None:
            continue
        readout = tau[side] / one.readout_s if one.readout_s else np.zeros(tau.shape[1])
        shift_s = {
            "delay_s": np.ones(tau.shape[1]),
            "drift_ppm": np.full(tau.shape[1], PPM * state.t_s),
            "readout_s": readout,
        }
        names = tuple(name for name in shift_s if name in one.names)
        if not names:
            continue
        moved = np.stack([rate[side] * shift_s[name][:, None] for name in names], axis=-1)  # [light, 2, name]
        A = C @ np.einsum("ica,icn->an", slopes[side], moved)
        out += A @ one.covariance.block(names) @ A.T
    return out
