"""The check of a run whose views are each at their own time: the same sums as of pairs, the motion eliminated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.measure.consistency import kernels
from armsight.measure.consistency.diagnosis import Consistency, judge
from armsight.measure.consistency.evidence import BIAS_PX, BLOCKS, STILL_PX, Block, Evidence
from armsight.measure.motion.estimate import Filtered, Start
from armsight.measure.motion.states import View
from armsight.measure.poses.setup import Setup

Array = NDArray[np.float64]

SETTLED_VIEWS = 8
"""Views after a start whose chi-square says nothing: the state they are held against is a guess."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingCheck:
    """The verdict, and how the pose at each view (n, 6, q) follows the parameters that it is about."""

    verdict: Consistency
    slopes: Array


def check_motion(setup: Setup, views: Sequence[View], starts: Sequence[Start], jerk: Array) -> MovingCheck:
    """Return what the views' innovations under a motion of strength jerk (n,) say of rig and target."""
    evidence = Evidence.of(setup)
    n, q = len(views), evidence.size
    t, block = np.array([view.t_s for view in views]), (np.arange(n) * BLOCKS) // n
    run = Filtered.of(setup.packed, setup.model.xyz_m, views, starts, jerk)
    dp, ds = (np.zeros((n, run.Cs.shape[1], q)) for _ in range(2))
    weight = _weights(views)
    for start in starts:
        weight[start.view : start.view + SETTLED_VIEWS] = 0.0
    information, score, chi2 = np.zeros((BLOCKS, q, q)), np.zeros((BLOCKS, q)), np.zeros(BLOCKS)
    kernels.run_evidence(
        run.rows.views,
        run.rows.spots,
        setup.packed.arrays,
        (run.positions_m, np.ascontiguousarray(evidence.basis)),
        (weight, block),
        *run.states(ds, dp),
        (information, score, chi2),
    )
    dof = np.bincount(block, weight * [2.0 * len(view.lights) for view in views], BLOCKS)
    for k in np.unique(block[weight > 0.0]).tolist():
        part = Block(
            float(t[block == k][0]), information[k], score[k], max(float(chi2[k]), float(dof[k])), float(dof[k])
        )
        part.frames = int((block == k).sum())
        evidence.blocks.append(part)
    run.smooth(ds, dp)
    moves, turns = ds[:, :3], ds[:, 3:6]
    evidence.shift_m2 = np.einsum("nap,naq->pq", moves, moves)
    evidence.shift_rad2 = np.einsum("nap,naq->pq", turns, turns)
    variances = np.diagonal(run.Cs, axis1=1, axis2=2)
    evidence.claimed_m2, evidence.claimed_rad2 = float(variances[:, :3].sum()), float(variances[:, 3:6].sum())
    evidence.frames = n
    return MovingCheck(verdict=judge(evidence), slopes=ds[:, :6])


def _weights(views: Sequence[View]) -> Array:
    """Return what one more look at lights that stand still is worth (n,), as of pairs."""
    out, still = np.ones(len(views)), [0, 0]
    anchor: list[View | None] = [None, None]
    for k, view in enumerate(views):
        s, last = view.side, anchor[view.side]
        if (
            last is None
            or len(last.lights) != len(view.lights)
            or (last.lights != view.lights).any()
            or np.abs(last.uv_px - view.uv_px).max(initial=0.0) > STILL_PX
        ):
            anchor[s], still[s] = view, 0
        variance = float(np.einsum("nii->", view.cov_px2)) / (2.0 * len(view.lights))
        out[k] = 1.0 / (1.0 + still[s] * BIAS_PX**2 / variance) ** 2
        still[s] += 1
    return out
