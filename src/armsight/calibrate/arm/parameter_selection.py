"""Which parameters the measurements can tell, by pivoting in the order of what they tell most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints

WORTH = 2.0
"""A parameter is freed where the measurements alone would know it to a half of its tolerance."""
STILL = 1e-3
"""A joint whose readings stay within so much (rad, or of the mean link) did not move."""
APART = 0.02
"""Share of a parameter's effect that must be its own, not that of base, tool and the parameters freed before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What of an arm's geometry is to be fitted, and why not the rest.

    free: names in the order of what the measurements tell. fixed: (name, why) of all other candidates. condition: of
    the freed columns, each scaled by its tolerance, beside base and tools.
    """

    free: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    condition: float


def choose(
    model: ArmModel,
    points: ArmPoints,
    p: Array,
    candidates: Sequence[str],
    tolerance: Tolerance,
    noise: tuple[float, float],
) -> Choice:
    """Return which candidates can be told from each other and from base and tools by these measurements."""
    J = model.evaluate(p, points, *noise).shared[0]
    mounts = J[:, model.n_geometry :]
    # What base and tools can take up is no sign of the geometry: only what is square to their columns counts
    Q = orthonormal_basis(mounts)
    index = [model.names.index(name) for name in candidates]
    # A whitened column times its tolerance is as long as the correction of one tolerance is in standard deviations: 1 /
    # length is what the measurements alone would know it to, in tolerances
    columns = J[:, index] * np.array([tolerance.of(name) for name in candidates])
    size_before = np.linalg.norm(columns, axis=0)
    left = columns - Q @ (Q.T @ columns)
    free: list[int] = []
    open_ = list(range(len(candidates)))
    # Gram-Schmidt with column pivoting (Golub, Van Loan, QR with column pivoting): free what has most of its own left,
    # take that out of all others, and go on until nothing has enough. The order so goes by what is told, not by the
    # joints' numbers
    while open_:
        size = np.linalg.norm(left[:, open_], axis=0)
        fit = (size >= WORTH) & (size >= APART * size_before[open_])
        if not fit.any():
            break
        best = open_[int(np.argmax(np.where(fit, size, -1.0)))]
        free.append(best)
        open_.remove(best)
        v = left[:, best] / np.linalg.norm(left[:, best])
        left = left - np.outer(v, v @ left)
    resting = still(model, points)
    fixed = tuple(
        (candidates[i], _why(candidates[i], resting, size_before[i], np.linalg.norm(left[:, i]))) for i in open_
    )
    own = columns[:, free] - Q @ (Q.T @ columns[:, free])
    condition = float(np.linalg.cond(own)) if free else 1.0
    return Choice(free=tuple(candidates[i] for i in free), fixed=fixed, condition=condition)


def orthonormal_basis(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span."""
    size = np.linalg.norm(columns, axis=0)
    U, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]])


def still(model: ArmModel, points: ArmPoints) -> tuple[str, ...]:
    """Return the names of the joints that did not move."""
    size = np.where(model.arm.revolute, 1.0, model.arm.length_m)
    moved = np.ptp(points.q, axis=0) > STILL * size
    return tuple(joint.name for joint, m in zip(model.arm.joints, moved, strict=True) if not m)


def _why(name: str, resting: Sequence[str], size_before: float, left: float | np.floating) -> str:
    joint = name.rsplit(".", 1)[0]
    if joint in resting:
        return f"joint {joint} did not move"
    if size_before < WORTH:
        return "the measurements tell less of it than its tolerance"
    if left < APART * size_before:
        return "cannot be told apart from base, tool and the parameters that were freed"
    return "what it does apart from the freed parameters is lost in the noise"
