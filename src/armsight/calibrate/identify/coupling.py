"""Whether a joint's value moves along with another's reading: coupled gears show in what the whole arm's fit leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.chain import ChainModel
from armsight.calibrate.identify.residuals import SweepResiduals, rig_shifts
from armsight.fitting.quantiles import f_sf
from armsight.optics import Rig

Array = NDArray[np.float64]

STEP = 1e-4
"""Share of a joint's reading by which another is moved for the derivative."""
CHANCE = 1e-4
"""Chance, over all pairs of joints, below which a coupling is suggested: one arm in ten thousand without one."""
ALIKE = 10.0
"""Chi-square within which two couplings explain the readings alike."""
OWN = 1e-3
"""Share of a coupling's effect that must be its own, not that of the arm's parameters."""


def suggest_coupling(kept: SweepResiduals, model: ChainModel, p: Array, rig: Rig | None = None) -> list[str]:
    """Return a note of the coupling, or joint's scale, that explains most of what the fit p (P,) leaves of readings.

    rig: what its calibration leaves open explains of it what it can first.

    None where chance would do. Each share is tested alone, to first order beside the arm's parameters (F-test with one
    degree of freedom), for all pairs of joints; Bonferroni's bound over the pairs. Those alike are named.
    """
    q, n = kept.sweeps.q, kept.sweeps.n
    predicted, J = model.predict(p, q)
    r, slopes = (x.reshape(-1, *x.shape[2:]) for x in kept.residuals(predicted, J))
    shifts = rig_shifts(kept, rig, predicted)
    k = shifts.shape[1]  # each a parameter with a reading of its own: 0 +- 1
    r, slopes = np.append(r, np.zeros(k)), np.block([[slopes, shifts], [np.zeros((k, slopes.shape[1])), np.eye(k)]])
    U, s, _ = np.linalg.svd(slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300), full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    left = r - Q @ (Q.T @ r)
    dof = len(r) - Q.shape[1] - 1
    if dof < 1:
        return []
    found: list[tuple[float, int, int, float, float]] = []
    for i in range(n):
        for by in range(n):
            column = np.append(_effect(kept, model, p, i, by), np.zeros(k))
            own = column - Q @ (Q.T @ column)
            size2 = float(own @ own)
            if size2 <= OWN**2 * float(column @ column):
                continue
            share = -float(own @ left) / size2
            rest = float(left @ left) - share**2 * size2
            chance = float(f_sf(share**2 * size2 * dof / max(rest, 1e-300), 1, dof)) * n * n
            found.append((rest, i, by, share, chance))
    if not found:
        return []
    least = min(found)
    if least[4] >= CHANCE:
        return []
    alike = sorted(one for one in found if one[0] <= least[0] * (1.0 + ALIKE / dof))
    return ["; or ".join(_note(i, by, share) for _, i, by, share, _ in alike[:3])]


def _effect(kept: SweepResiduals, model: ChainModel, p: Array, i: int, by: int) -> Array:
    """Return the derivative of the whitened residuals by the share of joint by's reading in joint i's value."""
    sides = []
    for step in (STEP, -STEP):
        q = kept.sweeps.q.copy()
        q[:, i] += step * kept.sweeps.q[:, by]
        sides.append(kept.residuals(*model.predict(p, q))[0].ravel())
    return np.asarray((sides[0] - sides[1]) / (2.0 * STEP))


def _note(i: int, by: int, share: float) -> str:
    if i == by:
        return (
            f"joint {i + 1} moves by about {1.0 + share:.4g} times its readings: what the arm leaves goes with them; "
            "check its gear ratio"
        )
    return (
        f"the readings look coupled: joint {i + 1} moves along by about {share:.3g} of joint {by + 1}'s reading, as "
        "coupled gears do; give values with that taken out, or use calibrate arm with the arm's coupling in its file"
    )
