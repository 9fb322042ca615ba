"""Which joint positions to measure next: those that shrink the uncertainty of the arm most (D-optimal, greedy)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import choose
from armsight.calibrate.arm.fit import ArmFit, Tolerance, is_tool_turn
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import NotEnoughData
from armsight.optics import Rig

CANDIDATES = 1500
"""Joint positions looked at, drawn evenly within the limits."""
OPEN_RAD = np.pi
"""Range of a joint without limits, to either side."""
OPEN_M = 0.3
"""Range of a slide without limits, to either side."""
PROPOSAL_SEED = 5
"""The same measurements give the same proposal."""

Visible = Callable[[Array], NDArray[np.bool_]]
"""Positions (m, 3) in the frame of the measurements -> which of them two cameras see."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """Joint values q (n, joints) in the order of their worth, and the standard deviations expected with all of them, by
    name."""

    q: Array
    expected_std: dict[str, float]
    std_now: dict[str, float]


def in_view(rig: Rig, T_frame_rig: RigidTransform) -> Visible:
    """Return the test whether positions (m, 3) in a frame are in the images of two cameras of a rig that stands there,
    or of its only one."""

    def seen(xyz_m: Array) -> NDArray[np.bool_]:
        local = T_frame_rig.inv().apply(xyz_m)
        with np.errstate(invalid="ignore", divide="ignore"):
            views = rig.project(local)
        n = np.zeros(len(xyz_m), np.intp)
        for one, uv in zip(rig.cameras, views, strict=True):  # NaN behind a camera is in none
            n += ((uv >= 0.0) & (uv <= [one.camera.width - 1, one.camera.height - 1])).all(axis=1)
        return np.asarray(n >= min(len(rig.cameras), 2))

    return seen


def propose(
    model: ArmModel,
    fitted: ArmFit,
    points: ArmPoints,
    n: int,
    *,
    tolerance: Tolerance | None = None,
    visible: Visible | None = None,
) -> Proposal:
    """Return n further joint positions for the geometry's parameters.

    Each is the candidate within the limits (and seen, where visible is given) that adds most to the determinant of
    the information on what positions at all candidates could tell. Raises NotEnoughData where no candidate is seen.
    """
    tolerance = tolerance or Tolerance()
    there = _candidates(model, fitted, points, visible)
    noise = points.typical_m(fitted.sigma_m), fitted.sigma_rad
    plain = ArmModel(arm=model.arm, labels=model.labels, turned=False)
    names = choose(plain, there, fitted.p, model.geometry, tolerance, noise).free
    wanted = (*names, *(name for name in plain.mounts if not is_tool_turn(name)))
    index = [plain.names.index(name) for name in wanted]
    scale = np.array([tolerance.of(name) if name in names else 1.0 for name in wanted])
    J = plain.evaluate(fitted.p, there, *noise).shared[0][:, index].reshape(len(there.q), 3, -1) * scale
    seen_J = model.evaluate(fitted.p, points, fitted.sigma_m, fitted.sigma_rad).shared[0][:, index] * scale
    H = seen_J.T @ seen_J + np.diag([1.0 if name in names else 1e-6 for name in wanted])
    order, H_then = _by_information(J, H, n)
    expected = _std(H_then, wanted, scale)
    return Proposal(q=there.q[order], expected_std=expected, std_now=_std(H, wanted, scale))


def _candidates(model: ArmModel, fitted: ArmFit, points: ArmPoints, visible: Visible | None) -> ArmPoints:
    """Return random joint positions within the limits, with the positions to expect there; only those that are seen."""
    rng = np.random.default_rng(PROPOSAL_SEED)
    low, high = _ranges(model, points)
    q = rng.uniform(low, high, (CANDIDATES, model.arm.n))
    at = ArmPoints(q=q, xyz_m=np.zeros((len(q), 3)), point=(points.point[0],) * len(q))
    position, _ = model.errors(fitted.p, at)
    there = ArmPoints(q=q, xyz_m=position, point=at.point)
    if visible is None:
        return there
    seen = np.flatnonzero(visible(position))
    if not len(seen):
        raise NotEnoughData(
            "no joint position within the limits puts the tool where both cameras see it",
            consequence="No measurement is proposed",
            cure="Check the rig's place (world.yaml), or move the cameras",
        )
    return there.take(seen)


def _by_information(J: Array, H: Array, n: int) -> tuple[list[int], Array]:
    """Return the candidates, J (m, 3, P), in the order of what they add to H (P, P), and H with all of them."""
    order: list[int] = []
    for _ in range(min(n, len(J))):
        # det(H + J'J) = det H det(1 + J H^-1 J'): a 3 x 3 determinant a candidate in place of one of all parameters
        gain = np.linalg.slogdet(np.eye(3) + J @ np.linalg.solve(H, J.transpose(0, 2, 1)))[1]
        gain[order] = -np.inf
        best = int(gain.argmax())
        order.append(best)
        H = H + J[best].T @ J[best]
    return order, H


def _ranges(model: ArmModel, points: ArmPoints) -> tuple[Array, Array]:
    reach = np.where(model.arm.revolute, OPEN_RAD, OPEN_M)
    middle = points.q.mean(axis=0)
    low = np.where(np.isfinite(model.arm.lower), model.arm.lower, middle - reach)
    high = np.where(np.isfinite(model.arm.upper), model.arm.upper, middle + reach)
    return low, high


def _std(H: Array, names: Sequence[str], scale: Array) -> dict[str, float]:
    deviations = np.sqrt(np.diag(np.linalg.inv(H))) * scale
    return dict(zip(names, deviations.tolist(), strict=True))
