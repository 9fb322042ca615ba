"""Compiled checks of poses, so that checking costs less than solving."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import kernel

FINE, NOT_FINITE, NO_ROTATION = 0, 1, 2


@kernel
def check_poses(T, tolerance):
    """Return what is wrong with the first bad one of T (m, 4, 4), its row, and how far it is from a rotation."""
    for i in range(T.shape[0]):
        R = T[i]
        for r in range(4):
            for c in range(4):
                if not np.isfinite(R[r, c]):
                    return NOT_FINITE, i, np.nan
        off = 0.0
        for a in range(3):
            for b in range(a + 1):
                dot = R[0, a] * R[0, b] + R[1, a] * R[1, b] + R[2, a] * R[2, b]
                off = max(off, abs(dot - (1.0 if a == b else 0.0)))
        det = (
            R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
            - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
            + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
        )
        off = max(off, abs(det - 1.0))
        off = max(off, abs(R[3, 0]) + abs(R[3, 1]) + abs(R[3, 2]) + abs(R[3, 3] - 1.0))  # a transposed pose has t there
        if off > tolerance:
            return NO_ROTATION, i, off
    return FINE, -1, 0.0


@kernel
def farthest(T, chain):
    """Return the largest distance of a pose of T (m, 4, 4) from the chain's base in m, and its row."""
    worst = -1.0
    row = -1
    for i in range(T.shape[0]):
        x, y, z = T[i, 0, 3] - chain[0, 3], T[i, 1, 3] - chain[0, 7], T[i, 2, 3] - chain[0, 11]
        distance = sqrt(x * x + y * y + z * z)
        if distance > worst:
            worst = distance
            row = i
    return worst, row
