"""How far a rig's own calibration lets matching pixels miss each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.pairs import SLACK_PX
from armsight.optics import INTRINSICS, Rig, mean_axes, moved_rig
from armsight.optics.parallelism import DERIVATIVE_STEPS, POSE_STEP

Array = NDArray[np.float64]

AWAY = 8.0
"""Baselines at which the miss is worked out: it hardly changes with distance."""

POINT_STEP_M = 1e-6

SHARED = 2.0
"""Slack for each standard deviation: slack is judged light by light, and a rig's error is the same at all of them, so
that three lights with a common miss of three standard deviations must still pass."""


def rig_slack_px(rig: Rig) -> float:
    """Return the slack that a rig's covariance asks for, in px; SLACK_PX at least.

    It is SHARED times the standard deviation of what two pixels of a point keep once the point is fitted to them.
    """
    if rig.covariance is None:
        return SLACK_PX
    axes = mean_axes(rig)
    middle = 0.5 * (np.asarray(rig.T_rig_left.translation) + np.asarray(rig.T_rig_right.translation))
    point = middle + AWAY * rig.baseline_m * axes[:, 2]
    J = np.column_stack([_slope(_pixels(rig, point + h), _pixels(rig, point - h), POINT_STEP_M) for h in _steps(3)])
    miss = np.linalg.svd(J)[0][:, 3]  # (4,): what no move of the point explains
    names = tuple(name for name in rig.parameters if name in rig.covariance.names)
    D = np.column_stack([_by_parameter(rig, name, point) for name in names])  # (4, p)
    variance = miss @ D @ rig.covariance.block(names) @ D.T @ miss
    return max(SLACK_PX, SHARED * float(np.sqrt(variance)))


def _steps(n: int) -> Array:
    return np.asarray(POINT_STEP_M * np.eye(n))


def _pixels(rig: Rig, point: Array) -> Array:
    return np.concatenate([uv[0] for uv in rig.project(point)])


def _slope(plus: Array, minus: Array, step: float) -> Array:
    return np.asarray((plus - minus) / (2.0 * step))


def _by_parameter(rig: Rig, name: str, point: Array) -> Array:
    """Return d pixels (4,) of both views / d one of the rig's parameters."""
    i = rig.parameters.index(name)
    size = DERIVATIVE_STEPS[i % len(INTRINSICS)] if i < 2 * len(INTRINSICS) else POSE_STEP
    step = np.zeros(len(rig.parameters))
    step[i] = size
    return _slope(_pixels(moved_rig(rig, step), point), _pixels(moved_rig(rig, -step), point), size)
