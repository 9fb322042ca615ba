"""How far spots lie from the motion that they gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its ndimage where it is used

from armsight.arrays import Array, Index, Mask
from armsight.fitting.quantiles import chi2_sf
from armsight.measure.motion.estimate import Start
from armsight.measure.motion.kernels.state import N
from armsight.measure.motion.kernels.views import observe
from armsight.measure.motion.states import MotionState, View
from armsight.measure.poses.outcome import judged_by
from armsight.optics import PackedRig

VIEW_CHANCE = 1e-6
"""Chance below which a view is not of the target as it moves."""
LEAST_DOF = 1.0
"""What a view is taken to say about itself at the least."""
SPELL_VIEWS, SPELL_SHARE = 9, 0.5
"""Views in a row, and how many of them lie off the motion where it was something else that was followed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionResiduals:
    """Of m spots: view (m,) and side (m,) they are of, residual_px (m, 2) measured less expected, chi2 and dof (m,).

    dof: of two coordinates, what the motion did not take from the spot itself. judged (m,): see judged_by.
    """

    view: Index
    side: Index
    residual_px: Array
    chi2: Array
    dof: Array
    judged: Mask

    def outliers(self, n_views: int) -> Mask:
        """Tell which views lie further from the motion than chance and the recording's own scatter explain."""
        chi2 = np.bincount(self.view, self.chi2, n_views)
        dof = np.maximum(np.bincount(self.view, self.dof, n_views), LEAST_DOF)
        scale = max(float(np.median(chi2 / dof)), 1.0) if n_views else 1.0
        return np.asarray(chi2_sf(chi2 / scale, dof) < VIEW_CHANCE)

    def of_views(self, chosen: Mask) -> MotionResiduals:
        """Return the residuals of the chosen views (n_views,)."""
        rows = chosen[self.view]
        return MotionResiduals(
            view=self.view[rows],
            side=self.side[rows],
            residual_px=self.residual_px[rows],
            chi2=self.chi2[rows],
            dof=self.dof[rows],
            judged=self.judged[rows],
        )

    def chi2_per_dof(self, first: int = 0, end: int | None = None) -> float | None:
        """Return chi-square per degree of freedom of the views from first up to end; None: nothing is left over."""
        rows = (self.view >= first) & (self.view < (np.inf if end is None else end))
        dof = float(self.dof[rows].sum())
        return float(self.chi2[rows].sum()) / dof if dof > 0.0 else None


def motion_residuals(
    packed: PackedRig, positions_m: Array, views: Sequence[View], states: Sequence[MotionState | None]
) -> MotionResiduals:
    """Return the residuals of all spots of views about the smoothed states at their times; None: left out.

    positions_m (m, 3): of the lights in the target's frame.
    """
    rows, residual, chi2, dof, judged = [], [], [], [], []
    uv, H = np.empty(2), np.zeros((2, N))
    for number, (view, state) in enumerate(zip(views, states, strict=True)):
        if state is None:
            continue
        s, judged_of = view.side, judged_by(view.cov_px2)
        for i, light in enumerate(view.lights.tolist()):
            if not observe(state.x, packed.camera(s), positions_m[light], view.tau_s[i], uv, H):
                continue
            r, weight = view.uv_px[i] - uv, np.linalg.inv(view.cov_px2[i])
            rows.append((number, s))
            judged.append(judged_of[i])
            residual.append(r)
            chi2.append(float(r @ weight @ r))
            dof.append(max(2.0 - float(np.trace(weight @ H @ state.C @ H.T)), 0.0))
    at = np.array(rows, dtype=np.intp).reshape(-1, 2)
    return MotionResiduals(
        view=at[:, 0],
        side=at[:, 1],
        residual_px=np.array(residual).reshape(-1, 2),
        chi2=np.array(chi2),
        dof=np.array(dof),
        judged=np.array(judged, dtype=bool),
    )


def without_outliers(
    found: MotionResiduals, views: Sequence[View], starts: Sequence[Start], states: Sequence[MotionState | None]
) -> tuple[list[View], list[Start]]:
    """Return the views that fit the motion, and the starts; after a spell of others a track begins anew."""
    bad = found.outliers(len(views))
    spell = scipy.ndimage.uniform_filter1d(bad.astype(float), SPELL_VIEWS, mode="nearest") > SPELL_SHARE
    kept: list[View] = []
    begun: list[Start] = []
    for start, end in zip(starts, [*(one.view for one in starts[1:]), len(views)], strict=True):
        broken = True
        for k in range(start.view, end):
            state = states[k]
            if spell[k] or bad[k] or state is None:
                broken |= bool(spell[k])
                continue
            if broken:
                begun.append(Start(view=len(kept), T=state.T_rig_target, covariance=state.covariance))
                broken = False
            kept.append(views[k])
    return kept, begun


def fitting_stretches(
    found: MotionResiduals, views: Sequence[View], starts: Sequence[Start], most_chi2: float
) -> tuple[list[View], list[Start]]:
    """Return the views and starts of the stretches whose chi-square per degree of freedom is below a limit."""
    kept: list[View] = []
    begun: list[Start] = []
    for start, end in zip(starts, [*(one.view for one in starts[1:]), len(views)], strict=True):
        chi2 = found.chi2_per_dof(start.view, end)
        if chi2 is not None and chi2 <= most_chi2:
            begun.append(Start(view=len(kept), T=start.T, covariance=start.covariance))
            kept += views[start.view : end]
    return kept, begun
