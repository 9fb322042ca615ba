"""Robust losses: how much a residual may pull."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent

Array = NDArray[np.float64]


class LossKind(StrEnum):
    """Plain squares, Huber (linear tails) or Cauchy (logarithmic tails)."""

    SQUARES = "squares"
    HUBER = "huber"
    CAUCHY = "cauchy"


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """kind, the scale in standard deviations where the pull starts to fall, and the rows that belong together.

    block: consecutive residuals that form one observation (2 for an image point): they are kept or doubted
    together, by the norm of the block.
    """

    kind: LossKind = LossKind.SQUARES
    scale: float = 2.0
    block: int = 1

    def __post_init__(self) -> None:
        if not self.scale > 0.0 or self.block < 1:
            raise Inconsistent(f"a loss of scale {self.scale} over blocks of {self.block} is meaningless")

    def cost(self, residuals: Array) -> float:
        """Return half the sum of rho over all blocks of residuals (G, m)."""
        if self.kind is LossKind.SQUARES:
            return 0.5 * float(np.vdot(residuals, residuals))
        s = self._squares(residuals)
        k2 = self.scale**2
        # rho of a block's squared norm s: Huber's (1964) is s up to k^2 and then 2 k sqrt(s) - k^2, Cauchy's k^2 log(1
        # + s / k^2)
        if self.kind is LossKind.HUBER:
            rho = np.where(s <= k2, s, 2.0 * self.scale * np.sqrt(s) - k2)
        else:
            rho = k2 * np.log1p(s / k2)
        return 0.5 * float(rho.sum())

    def weights(self, residuals: Array) -> Array | None:
        """Return the weight (G, m) of each row in the normal equations, None where all are one."""
        if self.kind is LossKind.SQUARES:
            return None
        s = self._squares(residuals)
        # rho'(s): iteratively reweighted least squares. The second-order term of Triggs and others 1999, section 3.3,
        # is left out: where rho bends down it can make the normal equations indefinite
        if self.kind is LossKind.HUBER:
            w = np.minimum(1.0, self.scale / np.sqrt(np.maximum(s, 1e-300)))
        else:
            w = 1.0 / (1.0 + s / self.scale**2)
        return np.repeat(w, self.block, axis=1)

    def _squares(self, residuals: Array) -> Array:
        """Return the squared norm of each block, (G, m / block)."""
        groups, m = residuals.shape
        return np.asarray((residuals**2).reshape(groups, m // self.block, self.block).sum(axis=2))
