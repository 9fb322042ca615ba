"""Errors that grow in the run: an arm that warms up grows, a base or a rig that is loose or warms up moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.fitting.groups import inflation
from armsight.kinematics import fk
from armsight.units import MM
from armsight.verify.evidence import Case, Evidence, by_chance, fit_linear, placement, solved
from armsight.verify.model import Noise

COURSES = (0.2, 0.6, np.inf)
"""Time constants by which a drift is tried to settle, as shares of the run; inf: it goes on evenly."""
UNLIKELY = 1e-4
"""Probability by chance, over all that are tried, below which a drift is one."""
PREDICTED = 0.6
"""Share of the time's variance that the joints predict (rows in the order of their poses) from which on a drift is
not told from errors that hang on the poses."""


Drift = tuple[str, dict[str, tuple[float, float]], float, float]
"""In words; parameters as (value, standard deviation); how far it moved the tool at the most, m; the squares it leaves
beside base and tool."""


def drifting(evidence: Evidence, noise: Noise, case: Case, base: RigidTransform) -> Drift | None:
    """Return the drift that the rows show beside zeros, links and what base and arm are off all the time, else None.

    noise: what the evidence was whitened with. It goes by the rows' times; where they have none, by their order.
    """
    count, rows = evidence.linear.residual.shape
    t = np.arange(count, dtype=float) if case.measured.t_s is None else case.measured.t_s
    share = (t - t.min()) / max(float(np.ptp(t)), 1e-300)
    if _predicted(case.q, share) > PREDICTED:
        return None
    grown = np.zeros((count, rows, 1))
    grown[:, :3, 0] = base.rotation.apply(fk(case.bare, case.q)[:, :3, 3])
    ways = grown, placement(case.measured.xyz_m, rows)
    known = [*map(noise.whiten, ways), evidence.joints]
    plain, found = evidence.with_geometry(*known), []
    for settles in COURSES:
        course = share if np.isinf(settles) else np.expm1(-share / settles) / np.expm1(-1.0 / settles)
        for columns in ways:
            drawn = columns * course[:, None, None]
            rich = evidence.with_geometry(*known, noise.whiten(drawn))
            # neighbouring rows hang together by the drift itself: what counts is how those do that it leaves
            _, theta, X, y, *_ = solved(evidence.linear, noise.whiten(drawn), None)
            linear = replace(evidence.linear, inflation=inflation((y - X @ theta).reshape(count, rows)))
            found.append((by_chance(linear, plain, rich), rich.squares, drawn))
    chance, _, drawn = min(found, key=lambda one: one[:2])
    if len(found) * chance > UNLIKELY:
        return None
    alone = fit_linear(evidence.linear, noise.whiten(drawn))
    moved_m = float(np.linalg.norm((drawn @ alone.values)[:, :3], axis=1).max())
    growth = (float(alone.values[0]), float(np.sqrt(alone.covariance[0, 0]))) if len(alone.values) == 1 else None
    return _words(growth, moved_m), {} if growth is None else {"growth": growth}, moved_m, alone.squares


def _words(growth: tuple[float, float] | None, moved_m: float) -> str:
    far = f"by up to {moved_m / MM:.2g} mm"
    if growth is None:
        return (
            f"From the first row to the last the tool moved {far} as one with the arm's base: base, rig or target is "
            "loose or grew warm in the run. Fasten them, let them warm up, and verify again."
        )
    return (
        f"The arm's lengths grew by {1e6 * growth[0]:.3g} +- {1e6 * growth[1]:.2g} ppm in the run, which moved the "
        f"tool {far}: the arm (or the rig that measures it) grew warm. Let it warm up, and verify again."
    )


def _predicted(q: Array, share: Array) -> float:
    """Return which share of the time's variance a turn's harmonics of the joints predict, beyond chance."""
    columns = np.column_stack([np.ones(len(q)), np.sin(q), np.cos(q)])
    left = share - columns @ np.linalg.lstsq(columns, share, rcond=None)[0]
    free = max(len(q) - columns.shape[1], 1)
    return float(1.0 - (left @ left / free) / np.var(share, ddof=1))
