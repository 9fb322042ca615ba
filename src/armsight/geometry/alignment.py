"""The rigid motion that best carries one set of points onto another (Kabsch, weighted)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.errors import Degenerate, NotEnoughData
from armsight.geometry.poses import pose_from_matrix

COLLINEAR_RATIO = 1e-6
"""Points whose second principal spread is below this share of the first lie on one line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """The rigid motion that carries one set of points onto another.

    T_a_b: p_a = T_a_b.apply(p_b). rms_m: root mean square of the 3-D residual norms.
    """

    T_a_b: RigidTransform
    rms_m: float


def align_points(points_a: ArrayLike, points_b: ArrayLike, weights: ArrayLike | None = None) -> Alignment:
    """Return the rigid motion from frame b to frame a that minimises the weighted squared distances.

    points_a, points_b: (n, 3) in m, n >= 3, same order. weights: (n,) positive. Kabsch 1976 with the
    reflection excluded. Raises NotEnoughData below three points, Degenerate where they lie on one line.
    """
    a, b = np.asarray(points_a, float), np.asarray(points_b, float)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3:
        raise ValueError(f"need two (n, 3) arrays of the same shape, not {a.shape} and {b.shape}")
    if len(a) < 3:
        raise NotEnoughData(
            f"{len(a)} points do not fix a pose", consequence="No orientation can be given", cure="Show three"
        )
    w = np.ones(len(a)) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    mean_a, mean_b = w @ a, w @ b  # (3,)
    da, db = a - mean_a, b - mean_b
    for centred in (da, db):
        spread = np.linalg.svd(centred, compute_uv=False)
        if spread[1] <= COLLINEAR_RATIO * spread[0] or spread[0] == 0.0:
            raise Degenerate(
                "the points lie on one line",
                consequence="The turn about that line cannot be known",
                cure="Use a target whose spots form a triangle",
            )
    U, _, Vt = np.linalg.svd(da.T @ (w[:, None] * db))  # (3, 3)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ D @ Vt
    residual = da - db @ R.T
    rms = float(np.sqrt(w @ (residual**2).sum(axis=1)))
    return Alignment(T_a_b=pose_from_matrix(R, mean_a - R @ mean_b), rms_m=rms)
