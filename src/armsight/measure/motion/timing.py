"""What the views of one recording tell of its cameras' timing, beyond what was calibrated before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from armsight.arrays import Array
from armsight.measure.motion.states import View
from armsight.records import CameraTiming, frozen_array
from armsight.records.timing import CLOCK, PPM

UNKNOWNS = ("right.delay_s", "right.drift_ppm", "left.readout_s", "right.readout_s")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimingPrior:
    """What is known of the cameras' timing before a recording is looked at.

    mid_s: the rig's time at which the delay is meant. covariance (4, 4): of UNKNOWNS. readout_s: of the left and the
    right camera.
    """

    mid_s: float
    covariance: Array
    readout_s: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen_array("covariance", self.covariance, (4, 4)))

    @classmethod
    def of(cls, timing: Sequence[CameraTiming], mid_s: float, stamps: Sequence[Array]) -> TimingPrior:
        """Return what the cameras' files say at mid_s, with what this recording's stamps leave open of their clocks.

        stamps: covariance (2, 2) of the offset (s) at mid_s and the rate (ppm) of the left and the right clock.
        """
        left, right = timing
        C = np.zeros((4, 4))
        names = tuple(name for name in CLOCK if name in right.names)
        if right.covariance is not None and names:
            at = np.ix_(*[[CLOCK.index(name) for name in names]] * 2)
            C[:2, :2][at] = right.covariance.block(names)
        move = np.array([[1.0, PPM * mid_s], [0.0, 1.0]])
        C[:2, :2] = move @ C[:2, :2] @ move.T + sum(stamps)
        for k, one in enumerate((left, right)):
            C[2 + k, 2 + k] = one.std.get("readout_s", 0.0) ** 2
        return cls(mid_s=mid_s, covariance=C, readout_s=(left.readout_s, right.readout_s))

    def lines(self, views: Sequence[View]) -> Array:
        """Return how much later each spot of the views is for each of UNKNOWNS (m, 4)."""
        parts = [np.zeros((0, 4))]
        for view in views:
            part = np.zeros((len(view.lights), 4))
            readout_s = self.readout_s[view.side]
            if view.side:
                part[:, 0] = 1.0
                part[:, 1] = PPM * (view.t_s - self.mid_s)
            if readout_s:
                part[:, 2 + view.side] = view.tau_s / readout_s
            parts.append(part)
        return np.concatenate(parts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimingEstimate:
    """What a recording's views make of its timing: change (4,) of UNKNOWNS, its covariance (4, 4).

    prior: what was known before.
    """

    prior: TimingPrior
    change: Array
    covariance: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "change", frozen_array("change", self.change, (4,)))
        object.__setattr__(self, "covariance", frozen_array("covariance", self.covariance, (4, 4)))

    @property
    def mahalanobis2(self) -> float:
        """Squared Mahalanobis distance of the change from none, by how much of it chance explains."""
        gained = self.prior.covariance - self.covariance
        scale = np.sqrt(np.maximum(np.diag(self.prior.covariance), 1e-300))
        return float(
            self.change / scale @ np.linalg.pinv(gained / np.outer(scale, scale), 1e-9) @ (self.change / scale)
        )

    def retimed(self, views: Sequence[View]) -> list[View]:
        """Return the views with their spots' times as they are now known."""
        late = self.prior.lines(views) @ self.change
        ends = np.concatenate([[0], np.cumsum([len(view.lights) for view in views])])
        return [
            replace(view, tau_s=view.tau_s + late[a:b])
            for view, (a, b) in zip(views, pairwise(ends.tolist()), strict=True)
        ]


def estimate_timing(prior: TimingPrior, L: Array, g: Array, change: Array) -> TimingEstimate:
    """Return the estimate from the innovations' equations L (4, 4), g (4,), taken as linear about a change (4,)."""
    scale = np.sqrt(np.maximum(np.diag(prior.covariance), 1e-300))
    values, axes = np.linalg.eigh(prior.covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0))  # what is exact stays so
    half = np.linalg.solve(np.linalg.cholesky(np.eye(4) + root.T @ L @ root), root.T)
    C = half.T @ half
    return TimingEstimate(prior=prior, change=C @ (g + L @ change), covariance=C)
