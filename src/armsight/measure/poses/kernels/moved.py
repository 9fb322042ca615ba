"""Compiled: where the pose goes when one of its spots is moved, by as much as may be hidden of its light."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel
from armsight.geometry.kernels import copy_1, copy_2
from armsight.measure.poses.kernels.pose import SOLVED, Lights, Observations, refine_pose, slack_chi2, weights
from armsight.measure.poses.kernels.pose_ambiguity import difference, split
from armsight.optics.kernels.camera import RigK


@kernel
def moved_poses(rig, views, rules, lights, T, at, steps, shares, ways):
    """Fill ways (k, 2, 6) from the pose T (4, 4) to those with spot at (k, 2: light, view) moved by -step and by step.

    rig, views, lights: as solve_named takes them; rules: slack in px^2, and the largest chi-square that is believed.
    Of shares (m,), the first counts with which the target fits either way; NaN where it does not.
    """
    slack2, limit = rules
    uv, cov = views
    moved, W = uv.copy(), np.empty_like(cov)
    seen = Observations(moved, W)
    of = Lights(lights[0].copy(), lights[1], lights[2])  # writable as in solve_named: one compilation serves both
    Rp, tp, R2, t2 = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    H, residual = np.empty((6, 6)), np.empty(uv.shape)
    split(T, Rp, tp)
    ways[:] = np.nan
    if not weights(cov, 0.0, W):
        return
    for k in range(at.shape[0]):
        i, s = at[k]
        found = False
        for share in shares:
            for side in range(2):
                for a in range(2):
                    moved[i, s, a] = uv[i, s, a] + (2.0 * side - 1.0) * share * steps[k, a]
                copy_2(Rp, R2)
                copy_1(tp, t2)
                state, _ = refine_pose(RigK(*rig), of, seen, R2, t2, H, residual)
                if state == SOLVED and slack_chi2(residual, cov, slack2) <= limit:
                    difference(Rp, tp, R2, t2, ways[k, side])
                    found = True
            if found:
                break
        for a in range(2):
            moved[i, s, a] = uv[i, s, a]
