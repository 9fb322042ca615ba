"""Where base and tools are, in closed form, so that a fit starts near its answer."""

from __future__ import annotations

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
RIDGE_M = 1e-9
"""Keeps the tool's place where no reading tells it (square root of its weight beside rows of size 1)."""


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
    base = RigidTransform.identity()
    rms = np.inf
    for _ in range(TURNS):
        local = np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3]
        base = placed(xyz_m, local)
        R, t = base.rotation.as_matrix(), base.translation
        wanted = (xyz_m - t) @ R - F[:, :3, 3]  # what the tool's points should add, in base axes
        at = np.stack([_point(F[which == k, :3, :3], wanted[which == k], at[k]) for k in range(len(at))])
        local = np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3]
        before, rms = rms, float(np.sqrt(np.mean((local @ R.T + t - xyz_m) ** 2)))
        if before - rms < 1e-7 * rms:
            break
    return base, at, rms


def _point(R: Array, wanted: Array, before: Array) -> Array:
    """Return the point x with R x nearest to wanted; what is not told stays as before."""
    A = R.reshape(-1, 3)
    off = np.append((wanted - R @ before).ravel(), np.zeros(3))
    return np.asarray(before + np.linalg.lstsq(np.vstack([A, RIDGE_M * np.eye(3)]), off, rcond=None)[0])
