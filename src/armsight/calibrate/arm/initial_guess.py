"""Where base and tools are, in closed form, so that a fit starts near its answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate
from armsight.geometry import align_points
from armsight.kinematics import fk

Array = NDArray[np.float64]

TURNS = 60
"""Turns of placing the base with the tools held, then the tools with the base held."""
ENOUGH = 200
"""Rows that a start is looked for with."""


def start(model: ArmModel, points: ArmPoints, like: Array | None = None) -> Array:
    """Return the parameters of the nominal geometry with base and tools put where they fit the positions best.

    By turns: base by Kabsch with the tool's points held, points by linear least squares with the base held; from the
    nominal tool, from the flange's origin and from points beside it, the best of all; or from the tools of `like` only.
    """
    if len(points) > ENOUGH:
        rows = np.linspace(0, len(points) - 1, ENOUGH).astype(np.intp)
        part = points.take(rows)
        points = part if part.labels == points.labels else points
    bare = model.arm_at(model.vector(RigidTransform.identity(), [RigidTransform.identity()] * len(model.labels)))
    F = fk(bare, points.q)  # base to flange
    which = np.array([model.labels.index(label) for label in points.point])
    size = max(model.arm.length_m, 1e-3)
    nominal, n = np.asarray(model.arm.T_flange_tool.translation), len(model.labels)
    beside = [nominal, np.zeros(3), *(0.5 * size * np.eye(3)), *(-0.5 * size * np.eye(3))]
    firsts = [np.tile(first, (n, 1)) for first in beside]
    if like is not None:
        firsts = [np.stack([model.pose(like, k + 1).translation for k in range(n)])]
    tries = [mounts_by_turns(F, points.xyz_m, which, first) for first in firsts]
    base, at, _ = min(tries, key=lambda found: found[2])
    turn = Rotation.identity()
    if points.rotation is not None:
        turn = Rotation.from_matrix(
            np.swapaxes(base.rotation.as_matrix() @ F[:, :3, :3], 1, 2) @ points.rotation
        ).mean()
    return model.vector(base, [RigidTransform.from_components(x, turn) for x in at])


def placed(there_m: Array, here_m: Array) -> RigidTransform:
    """Return the pose that takes positions (m, 3) to others. Raises Degenerate, in an arm's words."""
    try:
        return align_points(there_m, here_m).T_a_b
    except Degenerate:
        raise Degenerate(
            "the tool's positions lie on one line, or all in one place",
            consequence="The turn of the base about that line cannot be known",
            cure="Move at least two joints, or one far along an arc",
        ) from None


def mounts_by_turns(F: Array, xyz_m: Array, which: NDArray[np.intp], at: Array) -> tuple[RigidTransform, Array, float]:
    """Return the base, the tool's points (k, 3) in flange axes and the RMS per coordinate in m that fit positions best.

    F (m, 4, 4): base to flange. xyz_m (m, 3): positions of the points which (m,), counted from 0. at (k, 3): where the
    search begins. Raises Degenerate for positions on one line.
    """
    placed(xyz_m, xyz_m)
    sums, rms = _Sums.of(F, xyz_m, which, len(at)), np.inf
    # each half of a turn is the exact minimum in its own unknowns, so that the misfit never rises
    for _ in range(TURNS):
        R, t = sums.base(at)
        at = sums.points(R, t, at)
        before, rms = rms, sums.rms(R, t, at)
        if before - rms < 1e-7 * rms:
            break
    local = np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3]
    base = placed(xyz_m, local)
    return base, at, float(np.sqrt(np.mean((base.apply(local) - xyz_m) ** 2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sums:
    """All that turns need of the rows: both problems are linear in sums over them, which are made once.

    Positions x and the flange's p are counted from their means; R is the flange's rotation, k the tool's point. n (k,):
    rows; r (k, 3, 3): of R; rp (k, 3): of R' p; xp (3, 3): of x p'; xr (k, 3, 3, 3): of x_i R_jl; xx, pp: of squares.
    """

    n: Array
    r: Array
    rp: Array
    xp: Array
    xr: Array
    xx: float
    pp: float

    @classmethod
    def of(cls, F: Array, xyz_m: Array, which: NDArray[np.intp], k: int) -> _Sums:
        x, R = xyz_m - xyz_m.mean(axis=0), F[:, :3, :3]
        p = F[:, :3, 3] - F[:, :3, 3].mean(axis=0)
        member = (which[:, None] == np.arange(k)).astype(np.float64)
        return cls(
            n=member.sum(axis=0),
            r=np.einsum("mk,mij->kij", member, R),
            rp=np.einsum("mk,mji,mj->ki", member, R, p),
            xp=x.T @ p,
            xr=np.einsum("mk,mijl->kijl", member, np.einsum("mi,mjl->mijl", x, R)),
            xx=float((x**2).sum()),
            pp=float((p**2).sum()),
        )

    def base(self, at: Array) -> tuple[Array, Array]:
        """Return rotation (3, 3) and translation (3,) from the flange's to the positions' origin, by Kabsch."""
        U, _, Vt = np.linalg.svd(self._cross(at))
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        return R, -R @ self._total(at) / self.n.sum()

    def points(self, R: Array, t: Array, before: Array) -> Array:
        """Return the points (k, 3) that fit best: R' R is one, so each is a mean; one without rows stays as before."""
        total = np.einsum("kijl,ij->kl", self.xr, R) - (R.T @ t) @ self.r - self.rp
        return np.where(self.n[:, None] > 0.0, total / np.maximum(self.n, 1.0)[:, None], before)

    def rms(self, R: Array, t: Array, at: Array) -> float:
        """Return the RMS per coordinate in m; of fits to 1e-8 of the positions' spread only its size."""
        local = float(self.n @ (at**2).sum(axis=1)) + 2.0 * float((at * self.rp).sum()) + self.pp
        moved = local + 2.0 * float(R.T @ t @ self._total(at)) + float(self.n.sum() * (t @ t))
        squares = moved - 2.0 * float((R * self._cross(at)).sum()) + self.xx
        return float(np.sqrt(max(squares, 0.0) / (3.0 * self.n.sum())))

    def _cross(self, at: Array) -> Array:
        """Return the sum (3, 3) of x times what the flange carries."""
        return np.asarray(self.xp + np.einsum("kijl,kl->ij", self.xr, at))

    def _total(self, at: Array) -> Array:
        """Return the sum (3,) of what the flange carries."""
        return np.asarray(np.einsum("kij,kj->i", self.r, at))
