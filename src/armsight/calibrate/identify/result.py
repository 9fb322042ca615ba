"""What an identification returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.chain import Axis, ChainModel
from armsight.kinematics import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFound:
    """One joint.

    axis: with all joints at zero, in rig axes. measured: as its sweep saw it, with centre or a point of the line.
    radius_m: of the circle, 0 of a line. p_line: probability that a line leaves as much. decided: whether the type is
    beyond doubt. std: of the table's entries, NaN where an entry is chosen and not measured. rows: of its sweep, kept;
    discarded: (row, why).
    """

    axis: Axis
    measured: Axis
    radius_m: float
    p_line: float
    decided: bool
    std: dict[str, float]
    travel: tuple[float, float]
    rows: NDArray[np.intp]
    discarded: tuple[tuple[int, str], ...]
    residual_rms_m: float
    residual_rms_px: float | None


USELESS = 5.0
"""Misfit in standard deviations of the noise from which an arm does not explain its readings."""
USELESS_SHARE = 2e-3
"""And its share of how far the beacon moved: below, readings almost without noise would be refused for nothing."""
NOTHING = 1e-11
"""Eigenvalues of the scaled information below this mean that the readings say nothing of a combination."""
FELT = 1e-4
"""A place that hangs on such a combination by more than this share is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterUncertainty:
    """What the readings say of the arm's parameters: the model, their values p (P,), the information (P, P)."""

    model: ChainModel
    p: Array
    information: Array

    def positions(self, q: Array) -> tuple[Array, Array]:
        """Return the beacon (m, 3) in rig axes at joint values q (m, n) and its covariance (m, 3, 3) in m^2.

        Infinite where the place hangs on something that the readings leave open.
        """
        X, J = self.model.predict(self.p, np.asarray(q, float))
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        values, vectors = np.linalg.eigh(self.information * np.outer(scale, scale))
        known = values > NOTHING * values[-1]
        G = J @ (scale[:, None] * vectors)
        C = np.einsum("mik,k,mjk->mij", G[:, :, known], 1.0 / values[known], G[:, :, known])
        lost = np.linalg.norm(G[:, :, ~known], axis=(1, 2)) > FELT * np.linalg.norm(G, axis=(1, 2))
        C[lost] = np.diag([np.inf] * 3)
        return X, C


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """The arm, its joints, and what to know about them.

    sigma: noise found, px with a rig, else m (or a factor on the given covariances). predicted_m: (m, 3) where the
    result puts the beacon at each reading. beacon_m: with all joints at zero, in rig axes. uncertainty: of the beacon's
    place anywhere, where the whole arm was fitted at once. misfit: RMS of the kept readings' distances from the arm, in
    standard deviations of the noise: about 1 of an arm that explains them.
    """

    arm: Arm
    joints: tuple[JointFound, ...]
    method: str
    notes: tuple[str, ...]
    sigma: float
    predicted_m: Array
    beacon_m: Array
    misfit: float
    uncertainty: ParameterUncertainty | None = None

    @property
    def useless(self) -> bool:
        """Whether the arm misses its own readings by far."""
        reach_m = float(np.linalg.norm(np.ptp(self.predicted_m, axis=0)))
        worst_m = max(joint.residual_rms_m for joint in self.joints)
        return self.misfit > USELESS and worst_m > USELESS_SHARE * reach_m
