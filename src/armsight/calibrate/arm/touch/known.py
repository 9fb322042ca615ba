"""Which of an arm's parameters touches tell, which are open whatever is touched, and what would make them known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import STILL, WORTH, orthonormal_basis
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.touch.fit import TouchFit
from armsight.calibrate.arm.touch.model import TouchModel

OPEN = 1e-3
"""Share of the parameters' effect that must be their own, not the tip's and the features': of open directions the
scatter of the touches leaves 3e-4 (0.1 mm at 0.3 m), of those that are told 1e-2."""
SCATTERS = 5.0
"""... and so many times the touches' scatter over the arm's length."""
NOTHING = 1e-9
"""Share of the largest effect that is none: of the weight on an axis that stands upright."""
PART = 0.1
"""Share of an open direction from which a parameter is in it."""
SCALE = 0.9
"""Alike (cosine) with the change of all lengths by one factor from which an open direction is that."""

BASE = (
    "where the arm stands takes that up, and what it touches moves with it: measure positions of the tool (--points) "
    "in a frame of the base"
)
TIP = "the tip's place takes that up: measure the tool's orientation too (--points with qx .. qw)"
LENGTHS = "no length was measured, and touches tell lengths by their ratios alone: measure one (--length A,B,270mm)"
SAG = "its load turns it too little, or alike in all postures: touch with the arm stretched out and drawn in"
WEAK = "the touches tell it no better than to half its tolerance: touch from more postures, further apart"


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """known: names that touches tell. fixed: (name, why) of the others, in words. hidden: of those the ones that no
    touch of these tells anything of. condition: of the known ones' own effects, each scaled by its tolerance."""

    known: tuple[str, ...]
    fixed: tuple[tuple[str, str], ...]
    hidden: frozenset[str]
    condition: float


def told(model: TouchModel, fitted: TouchFit, candidates: Sequence[str], tolerance: Tolerance) -> Told:
    """Return which candidates the touches tell: to half their tolerance, whatever they were believed to before.

    A direction in which tip and features can follow is open: its parameters get no number.
    """
    names = list(model.names)
    J = model.evaluate(fitted.p, fitted.whiten).shared[0]
    Q = orthonormal_basis(J[:, [names.index(name) for name in model.mounts]])
    sigma = np.array([tolerance.of(name) for name in candidates])
    C = J[:, [names.index(name) for name in candidates]] * sigma
    # what tip and features can follow is no sign of the arm
    own = C - Q @ (Q.T @ C)
    size = np.linalg.norm(C, axis=0)
    size = np.maximum(size, NOTHING * size.max())
    _, s, Vt = np.linalg.svd(own / size, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(Vt) - len(s))])
    scatter = fitted.scatter_m / model.arm_model.arm.length_m
    open_ = Vt[s < max(OPEN, SCATTERS * scatter)] / size  # (k, c) in tolerances
    open_ = np.linalg.qr(open_.T)[0].T if len(open_) else open_
    inside = np.linalg.norm(open_, axis=0) > PART
    # posterior deviations hold the priors of all
    std = fitted.fit.std()
    known, fixed, hidden = [], [], set()
    for k, name in enumerate(candidates):
        spread = std.get(name, np.inf)
        # what the rows say without what was believed of this one: 1 / s^2 = 1 / posterior - 1 / prior
        more = spread**-2 - sigma[k] ** -2
        if inside[k]:
            hidden.add(name)
            fixed.append((name, _why(model, name, k, open_, candidates, sigma)))
        elif more * sigma[k] ** 2 < WORTH**2:
            fixed.append((name, WEAK))
        else:
            known.append(name)
    at = [k for k, name in enumerate(candidates) if name in known]
    condition = float(np.linalg.cond(own[:, at])) if at else 1.0
    return Told(known=tuple(known), fixed=tuple(fixed), hidden=frozenset(hidden), condition=condition)


def _why(model: TouchModel, name: str, k: int, open_: Array, candidates: Sequence[str], sigma: Array) -> str:
    """Return what keeps a parameter open, and what would make it known."""
    arm = model.arm_model.arm
    joint, key = name.rsplit(".", 1)
    moved = np.ptp(model.touches.q, axis=0) > STILL * np.where(arm.revolute, 1.0, arm.length_m)
    resting = [one.name for one, moves in zip(arm.joints, moved, strict=True) if not moves]
    if joint in resting:
        return f"joint {joint} did not move: touch with it in other places"
    if key == "sag":
        return SAG
    if joint == arm.joints[0].name and key != "scale":
        return BASE
    if joint == arm.joints[-1].name and key != "scale":
        return TIP
    # all lengths by one factor, tip and features too, miss nothing
    scale = np.array([_length(model, one) for one in candidates]) / sigma
    along = open_ @ (scale / max(float(np.linalg.norm(scale)), 1e-300))
    if name.endswith("_m") and np.linalg.norm(along) > SCALE:
        return LENGTHS
    mine = open_.T @ open_[:, k]
    others = [one for one, part in zip(candidates, np.abs(mine), strict=True) if part > PART and one != name]
    beside = f" from {', '.join(others[:4])}" if others else ""
    return f"these touches do not tell it apart{beside}: touch more features, from more different postures"


def _length(model: TouchModel, name: str) -> float:
    """Return the nominal length that a parameter is, 0 for an angle."""
    joint, key = name.rsplit(".", 1)
    if not key.endswith("_m"):
        return 0.0
    return float(next(getattr(one, key) for one in model.arm_model.arm.joints if one.name == joint))
