"""How far readings are from where a model puts the beacon, in standard deviations: by pixels of both cameras, or by
positions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.kernels import see_many
from armsight.calibrate.identify.sweeps import Sweeps
from armsight.optics import PackedRig, Rig
from armsight.optics.parallelism import moved_rig

Array = NDArray[np.float64]

SAME = 1e-12
"""Share of the largest variance below which a direction of a rig's covariance was held fixed: rounding."""
MOST = 0.75
"""Share of the readings whose spots claim no more than what the residuals tell. With it 95 % intervals of an arm seen
in rendered pictures hold 97 to 98 % (benchmarks/identify.py), with a half of them 99."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepResiduals:
    """Readings, and what a residual is.

    With a rig: pixels over sigma (px). Else positions, whitened with their covariances times sigma^2, or over sigma (m)
    where there are none. unit: the sigma with which the positions' covariances were worked out.
    """

    sweeps: Sweeps
    rig: PackedRig | None = None
    sigma: float = 1.0
    whitener: Array | None = field(default=None)
    unit: float = 1.0

    @property
    def rows(self) -> int:
        """Residuals of a reading."""
        return 3 if self.rig is None else 4

    def residuals(self, xyz_m: Array, J: Array) -> tuple[Array, Array]:
        """Return whitened residuals (m, rows) of model positions (m, 3), and derivatives (m, rows, P) from J (m, 3,
        P)."""
        m = len(xyz_m)
        if self.rig is None:
            r = xyz_m - self.sweeps.xyz_m
            W = self.whitener
            if W is None:
                return r / self.sigma, J / self.sigma
            return np.einsum("mij,mj->mi", W, r) / self.sigma, W @ J / self.sigma
        if self.sweeps.uv_px is None:
            raise ValueError("readings without pixels")
        uv, D = np.empty((m, 2, 2)), np.empty((m, 2, 2, 3))
        see_many(self.rig.k, self.rig.R, self.rig.t, np.ascontiguousarray(xyz_m), uv, D)
        r = (uv - self.sweeps.uv_px).reshape(m, 4) / self.sigma
        return r, D.reshape(m, 4, 3) @ J / self.sigma

    @property
    def relative(self) -> float:
        """Standard deviations of the positions over those of their covariances."""
        return self.sigma / self.unit

    def take(self, rows: NDArray[np.intp]) -> SweepResiduals:
        """Return some readings."""
        whitener = None if self.whitener is None else self.whitener[rows]
        return SweepResiduals(
            sweeps=self.sweeps.take(rows), rig=self.rig, sigma=self.sigma, whitener=whitener, unit=self.unit
        )

    def at(self, sigma: float) -> SweepResiduals:
        """Return the same readings with another noise."""
        return SweepResiduals(sweeps=self.sweeps, rig=self.rig, sigma=sigma, whitener=self.whitener, unit=self.unit)


def rig_shifts(kept: SweepResiduals, rig: Rig | None, xyz_m: Array) -> Array:
    """Return whitened residuals' changes (4 m, k) by what a rig's calibration leaves open: k independent directions of
    its covariance, each by one standard deviation; at model positions (m, 3). (.., 0) without a rig or covariance."""
    none = np.empty((kept.rows * len(xyz_m), 0))
    if rig is None or not PackedRig.of(rig).covariance.any():
        return none
    variances, directions = np.linalg.eigh(PackedRig.of(rig).covariance)
    steps = (directions * np.sqrt(np.maximum(variances, 0.0))).T[variances > SAME * variances[-1]]
    ray, uv, D = np.ascontiguousarray(xyz_m), np.empty((len(xyz_m), 2, 2)), np.empty((len(xyz_m), 2, 2, 3))
    seen = []
    for step in (np.zeros(len(directions)), *steps):
        packed = PackedRig.of(moved_rig(rig, step))
        see_many(packed.k, packed.R, packed.t, ray, uv, D)
        seen.append(uv.ravel() / kept.sigma)
    return np.stack(seen[1:], axis=1) - seen[0][:, None]


def position_residuals(sweeps: Sweeps, sigma: float) -> SweepResiduals:
    """Return readings judged by their positions."""
    C = sweeps.covariance_m2
    return SweepResiduals(
        sweeps=sweeps, sigma=sigma, whitener=None if C is None else np.linalg.inv(np.linalg.cholesky(C))
    )


def background_shifts(kept: SweepResiduals) -> Array:
    """Return whitened residuals' changes (4 m, 2 k) by what the spots of k readings claim beyond what MOST of them do.

    That is what is behind the beacon, and the views see nearly the same of it: it shifts both alike, by u or by v. The
    rest of a claim differs from reading to reading, and the residuals tell it. (.., 0) without claims.
    """
    m, std = len(kept.sweeps), kept.sweeps.std_px
    if kept.rig is None or std is None:
        return np.empty((kept.rows * m, 0))
    beyond = np.sqrt(np.maximum(std**2 - np.quantile(std, MOST) ** 2, 0.0)) / kept.sigma
    rows = np.flatnonzero(beyond)
    shifts = np.zeros((m, 2, 2, len(rows), 2))  # reading, view, u or v; which reading, shifted by u or v
    for axis in (0, 1):
        shifts[rows, :, axis, np.arange(len(rows)), axis] = beyond[rows, None]
    return shifts.reshape(4 * m, -1)
