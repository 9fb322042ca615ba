"""A known shape laid onto points of unequal certainty, in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.geometry.lie import skew

Array = NDArray[np.float64]

ALIGN_STEPS = 6
"""Gauss-Newton steps from the unweighted answer; each gains two digits."""

HELD = 1e-9
"""Share of the largest information that holds a turn nothing is known about (lights on one line)."""


def align(X: Array, P: Array, W: Array) -> tuple[Array, Array, Array]:
    """Return R (b, 3, 3), t (b, 3), chi2 (b,) of the least (P - R X - t)' W (P - R X - t).

    X (n, 3) or (b, n, 3), P (b, n, 3), W (b, n, 3, 3) the inverse covariances. R is a rotation, never a mirror.
    """
    X = np.broadcast_to(X, P.shape)
    R, t = _kabsch(X, P)
    for _ in range(ALIGN_STEPS):
        q = np.einsum("bij,bnj->bni", R, X)
        e = P - q - t[:, None]
        J = np.concatenate([np.broadcast_to(np.eye(3), (*q.shape, 3)), -skew(q)], axis=-1)  # (b, n, 3, 6)
        WJ = W @ J
        H = np.einsum("bnia,bnic->bac", J, WJ)
        g = np.einsum("bnia,bni->ba", WJ, e)
        scale = 1.0 / np.sqrt(np.einsum("baa->ba", H) + 1e-300)
        H = H * scale[:, :, None] * scale[:, None, :] + HELD * np.eye(6)
        step = np.linalg.solve(H, (g * scale)[:, :, None])[:, :, 0] * scale
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        t = t + step[:, :3]
    e = P - np.einsum("bij,bnj->bni", R, X) - t[:, None]
    return R, t, np.einsum("bni,bnij,bnj->b", e, W, e)


def _kabsch(X: Array, P: Array) -> tuple[Array, Array]:
    x0, p0 = X.mean(axis=1), P.mean(axis=1)
    M = np.einsum("bni,bnj->bij", P - p0[:, None], X - x0[:, None])
    U, _, Vt = np.linalg.svd(M)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    R = U @ Vt
    return R, p0 - np.einsum("bij,bj->bi", R, x0)
