"""Where base and tools are, in closed form, so that a fit starts near its answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate
from armsight.geometry import align_points
from armsight.kinematics import fk

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
    base, at = mounts_by_turns(F, points.xyz_m, which, firsts)
    turn = model.arm.T_flange_tool.rotation  # positions do not tell it, and what they do not tell stays nominal
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


def mounts_by_turns(
    F: Array, xyz_m: Array, which: NDArray[np.intp], firsts: Sequence[Array]
) -> tuple[RigidTransform, Array]:
    """Return the base and the tool's points (k, 3) in flange axes that fit positions best.

    F (m, 4, 4): base to flange. xyz_m (m, 3): positions of the points which (m,), counted from 0. firsts, each (k, 3):
    where searches begin; the best of them counts. Raises Degenerate for positions on one line.
    """
    sums = _Sums.of(F, xyz_m, which, len(firsts[0]))

    def carried(at: Array) -> Array:
        return np.asarray(np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3])

    def misfit(at: Array) -> float:
        x, y = xyz_m - xyz_m.mean(axis=0), carried(at)
        y = y - y.mean(axis=0)
        return float(((y @ _kabsch(x.T @ y).T - x) ** 2).sum())

    at = min(sums.turns(np.array(firsts)), key=misfit)
    return placed(xyz_m, carried(at)), at


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sums:
    """All that turns need of the rows: both problems are linear in sums over them, which are made once.

    Positions x and the flange's p are counted from their means; R is the flange's rotation, k the tool's point. rows
    (3 k,): of each point, three times; r (3, 3 k): of R; rp (3 k,): of R' p; xp (9,): of x p'; xr (9, 3 k): of
    x_i R_jl; xx, pp: of squares.
    """

    rows: Array
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
            rows=np.repeat(member.sum(axis=0), 3),
            r=np.einsum("mk,mij->ikj", member, R).reshape(3, -1),
            rp=np.einsum("mk,mji,mj->ki", member, R, p).ravel(),
            xp=(x.T @ p).ravel(),
            xr=np.einsum("mk,mijl->ijkl", member, np.einsum("mi,mjl->mijl", x, R)).reshape(9, -1),
            xx=float((x**2).sum()),
            pp=float((p**2).sum()),
        )

    def turns(self, firsts: Array) -> Array:
        """Return the points (s, k, 3) after TURNS from each of s firsts, or as many as bring its RMS down.

        Each half of a turn is the exact minimum in its own unknowns, so that the misfit never rises.
        """
        a, n = firsts.reshape(len(firsts), -1), float(self.rows[::3].sum())
        out, going, rms = a.copy(), np.arange(len(a)), np.full(len(a), np.inf)
        cross, total = self._carried(a)
        for _ in range(TURNS):
            R = _kabsch(cross)
            # R' R is one, so each point is a mean, R' t being -total / n; one without rows stays as before
            sums = R.reshape(-1, 9) @ self.xr + (total / n) @ self.r - self.rp
            a = np.where(self.rows > 0.0, sums / np.maximum(self.rows, 1.0), a)
            t, (cross, total) = total, self._carried(a)
            # of fits to 1e-8 of the positions' spread only its size
            moved = (a * a) @ self.rows + 2.0 * (a @ self.rp) + self.pp + ((t - 2.0 * total) * t).sum(axis=1) / n
            squares = moved - 2.0 * (R * cross).sum(axis=(1, 2)) + self.xx
            before, rms = rms, np.sqrt(np.maximum(squares, 0.0) / (3.0 * n))
            out[going] = a
            live = before - rms >= 1e-7 * rms
            if not live.any():
                break
            if not live.all():
                a, cross, total, rms, going = a[live], cross[live], total[live], rms[live], going[live]
        return out.reshape(len(out), -1, 3)

    def _carried(self, a: Array) -> tuple[Array, Array]:
        """Return of what the flange carries the sums (s, 3, 3) of x times it, and its sums (s, 3)."""
        return (self.xp + a @ self.xr.T).reshape(-1, 3, 3), a @ self.r.T


def _kabsch(cross: Array) -> Array:
    """Return the rotations (..., 3, 3) that fit sums of products best (Kabsch 1976), the reflection excluded."""
    U, _, Vt = np.linalg.svd(cross)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)
