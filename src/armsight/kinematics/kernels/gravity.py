"""Compiled torques of the links' weight about the joints, and how far soft joints give way to them.

weight (n, 4): of each link what it weighs in N and where its centre of mass is in the frame behind its joint (m).
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.kinematics.kernels.chain import joint_frames

ROUNDS = 60
"""Turns from torque to joint value and back; each leaves a twentieth of the error of a soft arm, a half of an absurd
one."""
SETTLED = 1e-13
"""Joint values (rad or m) that change by less have settled."""


@inner_kernel
def _torques(chain, weight, down, q, F, tau):
    """Fill tau (n,), N m or N, by which the weight of all links turns each joint (pushes each slide) forwards at q."""
    n = q.shape[0]
    joint_frames(chain, q, F)
    w = mx = my = mz = 0.0  # of all links from here to the tip: the weight, and the sum of weight times place
    for i in range(n - 1, -1, -1):
        after, here = F[i + 1], F[i]
        own = weight[i, 0]
        x, y, z = weight[i, 1], weight[i, 2], weight[i, 3]
        w += own
        mx += own * (after[9] + after[0] * x + after[3] * y + after[6] * z)
        my += own * (after[10] + after[1] * x + after[4] * y + after[7] * z)
        mz += own * (after[11] + after[2] * x + after[5] * y + after[8] * z)
        zx, zy, zz = here[6], here[7], here[8]
        if chain[i + 1, 0] == 0.0:
            px, py, pz = mx - w * here[9], my - w * here[10], mz - w * here[11]
            turn = zx * (py * down[2] - pz * down[1]) + zy * (pz * down[0] - px * down[2])
            turn += zz * (px * down[1] - py * down[0])
            tau[i] = chain[i + 1, 1] * turn
        else:
            tau[i] = chain[i + 1, 1] * w * (zx * down[0] + zy * down[1] + zz * down[2])


@kernel
def many_torques(chain, weight, down, q, tau):
    """Fill tau (m, n) at each row of q (m, n); down (3,) in world axes."""
    F = np.empty((chain.shape[0], 12))
    for k in range(q.shape[0]):
        _torques(chain, weight, down, q[k], F, tau[k])


@kernel
def settle_under_weight(chain, weight, down, compliance, q, out):
    """Fill out (m, n) with q + compliance * torque(out): where the joints come to rest; tell whether all do."""
    m, n = q.shape
    F = np.empty((n + 2, 12))
    tau = np.empty(n)
    for k in range(m):
        for i in range(n):
            out[k, i] = q[k, i]
        moved = 1.0
        for _ in range(ROUNDS):
            _torques(chain, weight, down, out[k], F, tau)
            moved = 0.0
            for i in range(n):
                value = q[k, i] + compliance[i] * tau[i]
                moved = max(moved, abs(value - out[k, i]))
                out[k, i] = value
            if moved <= SETTLED:
                break
        if not moved <= SETTLED * 100.0:
            return False
    return True
