"""Compiled: where the pose goes when one of its spots is moved, by as much as may be hidden of its light."""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt

import numpy as np

from armsight._numba import kernel, lean_kernel
from armsight.geometry.kernels import copy_1, copy_2
from armsight.measure.poses.kernels.hidden import UU, UV, VV
from armsight.measure.poses.kernels.pose import SOLVED, Lights, Observations, refine_pose, slack_chi2, weights
from armsight.measure.poses.kernels.pose_ambiguity import difference, split
from armsight.optics.kernels.camera import RigK


@kernel
def add_moved(rig, views, rules, lights, T, hidden, shares, C):
    """Add to C (6, 6) the ways from the pose T (4, 4) to those with a spot moved by as much as may be hidden, squared.

    rig, views, lights: as solve_named takes them; rules: slack in px^2, the largest chi-square that is believed, and
    the least step in px. hidden (v, n, FINDING): the variance of each centre, which is moved along both of its axes.
    Of shares (m,), the first counts with which the target fits, on either side or on both.
    """
    slack2, limit, least = rules
    uv, cov = views
    moved, W = uv.copy(), np.empty_like(cov)
    seen = Observations(moved, W)
    of = Lights(lights[0].copy(), lights[1], lights[2])  # writable as in solve_named: one compilation serves both
    Rp, tp, R2, t2 = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    H, residual = np.empty((6, 6)), np.empty(uv.shape)
    split(T, Rp, tp)
    if not weights(cov, 0.0, W):
        return
    ways, step = np.empty((2, 6)), np.empty(2)
    for s in range(uv.shape[1]):
        for i in range(uv.shape[0]):
            for axis in range(2):
                if not principal_step(hidden[s, i], axis, step) > least:
                    continue
                found = 0
                for share in shares:
                    for side in range(2):
                        for a in range(2):
                            moved[i, s, a] = uv[i, s, a] + (2.0 * side - 1.0) * share * step[a]
                        copy_2(Rp, R2)
                        copy_1(tp, t2)
                        state, _ = refine_pose(RigK(*rig), of, seen, R2, t2, H, residual)
                        if state == SOLVED and slack_chi2(residual, cov, slack2) <= limit:
                            difference(Rp, tp, R2, t2, ways[found])
                            found += 1
                    if found > 0:
                        break
                for k in range(found):
                    for a in range(6):
                        for b in range(6):
                            C[a, b] += ways[k, a] * ways[k, b] / found
                for a in range(2):
                    moved[i, s, a] = uv[i, s, a]


@lean_kernel
def principal_step(hidden, axis, step):
    """Fill step (2,) with a standard deviation along an axis of a variance (uu, uv, vv, ..); return its length."""
    half = 0.5 * (hidden[UU] + hidden[VV])
    root = sqrt(0.25 * (hidden[UU] - hidden[VV]) ** 2 + hidden[UV] ** 2)
    angle = 0.5 * atan2(2.0 * hidden[UV], hidden[UU] - hidden[VV]) + 0.5 * pi * axis
    long = sqrt(max(half + root - 2.0 * root * axis, 0.0))
    step[0] = long * cos(angle)
    step[1] = long * sin(angle)
    return long
