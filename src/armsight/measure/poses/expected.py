"""Where a view shows the lights of a target that moves, each at the time of its own line, and which spots they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from armsight.arrays import Array, Index
from armsight.fitting.quantiles import chi2_isf
from armsight.measure.motion.kernels.state import N
from armsight.measure.motion.kernels.views import choose, observe_all
from armsight.measure.motion.states import MotionState, View
from armsight.measure.poses.setup import Setup
from armsight.records import CameraTiming, Spots, trusted

GATE_SIGMA = 5.0
"""Standard deviations of where a spot is expected beyond which it is another one."""
VIEW_CHANCE = 1e-6
"""Chance below which a view that fits so badly is not of the target as it moves."""


MAX_SPOTS = 16
"""Among more it is guesswork which of them went where."""
FEWEST_SPOTS = 3
ALIKE_PX = 12.0
"""By how much the ways of one target's lights differ: it turns and comes nearer, which its shift leaves out."""
MOST_WAYS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shutter:
    """When a view of a camera (side) is exposed: its middle line late_s after a time, its lines as timing has them."""

    side: int
    timing: CameraTiming
    height: int
    late_s: float = 0.0

    def tau_s(self, v_px: Array) -> Array:
        """Return when lines v_px (n,) are exposed, in s after that time."""
        return self.late_s + self.timing.line_time(v_px, self.height)

    def view(self, t_s: float, lights: Index, uv_px: Array, cov_px2: Array) -> View:
        """Return the view at t_s of spots of lights (n,)."""
        tau = self.tau_s(uv_px[:, 1])
        return trusted(View, t_s=t_s, side=self.side, lights=lights, uv_px=uv_px, cov_px2=cov_px2, tau_s=tau)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """Where a view shows m lights: uv_px (m, 2) and its covariance S (2 m, 2 m) by a state's; H (2 m, 18): its slope by
    that."""

    shutter: Shutter
    uv_px: Array
    H: Array
    S: Array

    def named(self, t_s: float, spots: Spots, light: Index) -> View | None:
        """Return as a view at t_s those of the spots that are where their light (n,) is expected, and the only ones.

        None where there is none, or together they fit the motion too badly.
        """
        kept, seen = np.empty(len(self.uv_px) + 1, np.intp), (spots.uv_px, spots.covariance_px2)
        n, chi2 = choose((self.uv_px, self.S), light, seen, GATE_SIGMA**2, kept)
        if not n or not chi2 < _most_chi2(2 * n):
            return None
        rows = kept[:n]
        return self.shutter.view(t_s, light[rows], spots.uv_px[rows], spots.covariance_px2[rows])


def expect(setup: Setup, state: MotionState, shutter: Shutter) -> Expected | None:
    """Return where the lights will be seen; None where one of them would be behind the camera."""
    packed, X = setup.packed, setup.model.xyz_m
    m = len(X)
    uv, H, tau = np.empty((m, 2)), np.empty((2 * m, N)), np.full(m, shutter.late_s)
    for _ in range(2 if shutter.timing.rolling else 1):
        if not observe_all(state.x, packed.camera(shutter.side), X, tau, uv, H):
            return None
        tau = shutter.tau_s(uv[:, 1])
    return Expected(shutter=shutter, uv_px=uv, H=H, S=H @ state.C @ H.T)


@cache
def _most_chi2(dof: int) -> float:
    return float(chi2_isf(VIEW_CHANCE, dof))


def links(a: Array, b: Array) -> list[tuple[Index, Index]]:
    """Return which of the spots a (n, 2) are which of b (m, 2), under the shifts that explain most of them best."""
    if not (FEWEST_SPOTS <= len(a) <= MAX_SPOTS and FEWEST_SPOTS <= len(b) <= MAX_SPOTS):
        return []
    found: dict[tuple[int, ...], tuple[int, float, Index, Index]] = {}
    for shift in (b[None] - a[:, None]).reshape(-1, 2):
        off = np.linalg.norm(a[:, None] + shift - b[None], axis=2)
        nearest = off.argmin(axis=1)
        rows = np.arange(len(a))
        mutual = (off.argmin(axis=0)[nearest] == rows) & (off[rows, nearest] < ALIKE_PX)
        before, after = np.flatnonzero(mutual), nearest[mutual]
        if len(before) >= FEWEST_SPOTS:
            misfit = float(np.linalg.norm((b[after] - a[before]) - (b[after] - a[before]).mean(axis=0)))
            found[(*before.tolist(), -1, *after.tolist())] = (-len(before), misfit, before, after)
    ways = sorted(found.values(), key=lambda way: way[:2])
    return [(before, after) for _, _, before, after in ways[:MOST_WAYS]]
