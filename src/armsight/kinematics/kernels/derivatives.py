"""Compiled derivatives of the tool's pose by every geometric parameter of the chain, and torques of its weight."""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.kinematics.kernels.chain import frame_matrix, joint_frames

PER_JOINT = 5
"""a, alpha, d, theta, beta."""


@inner_kernel
def _turn(ux, uy, uz, frame, at, T, J, column):
    """Fill one column of J (6, .) with the motion of the tool by a turn about the axis u through frame[at : at + 3]."""
    px = T[0, 3] - frame[at]
    py = T[1, 3] - frame[at + 1]
    pz = T[2, 3] - frame[at + 2]
    J[0, column] = uy * pz - uz * py
    J[1, column] = uz * px - ux * pz
    J[2, column] = ux * py - uy * px
    J[3, column] = ux
    J[4, column] = uy
    J[5, column] = uz


@inner_kernel
def _shift(ux, uy, uz, J, column):
    """Fill one column of J (6, .) with a shift along u."""
    J[0, column] = ux
    J[1, column] = uy
    J[2, column] = uz
    J[3, column] = 0.0
    J[4, column] = 0.0
    J[5, column] = 0.0


@inner_kernel
def parameter_columns(chain, q, T, J):
    """Fill T (4, 4) and J (6, 5 n + 12), the derivative (dt, dw) in world axes of the tool's pose.

    Columns: a, alpha, d, theta, beta of each joint; then the first frame by (dt, dw) in world axes; then T_flange_tool
    by (dt, dw) in flange axes.
    """
    n = chain.shape[0] - 2
    F = np.empty((n + 2, 12))
    joint_frames(chain, q, F)
    frame_matrix(F[n + 1], T)
    for i in range(n):
        row = chain[i + 1]
        k = PER_JOINT * i
        after = F[i + 1]
        cb, sb = row[7], row[8]
        # x of the link before beta: beta turns about the final y, so x_link = x cos beta + z sin beta
        xx = after[0] * cb + after[6] * sb
        xy = after[1] * cb + after[7] * sb
        xz = after[2] * cb + after[8] * sb
        _shift(xx, xy, xz, J, k)
        _turn(xx, xy, xz, after, 9, T, J, k + 1)
        _shift(F[i, 6], F[i, 7], F[i, 8], J, k + 2)
        _turn(F[i, 6], F[i, 7], F[i, 8], F[i], 9, T, J, k + 3)
        _turn(after[3], after[4], after[5], after, 9, T, J, k + 4)
    k = PER_JOINT * n
    for c in range(3):
        e0 = 1.0 if c == 0 else 0.0
        e1 = 1.0 if c == 1 else 0.0
        e2 = 1.0 if c == 2 else 0.0
        _shift(e0, e1, e2, J, k + c)
        _turn(e0, e1, e2, F[0], 9, T, J, k + 3 + c)
        f0, f1, f2 = F[n, 3 * c], F[n, 3 * c + 1], F[n, 3 * c + 2]
        _shift(f0, f1, f2, J, k + 6 + c)
        _turn(f0, f1, f2, F[n + 1], 9, T, J, k + 9 + c)


@kernel
def many_parameter_columns(chain, q, T, J):
    """Fill T (m, 4, 4) and J (m, 6, 5 n + 12) for each row of q (m, n)."""
    for k in range(q.shape[0]):
        parameter_columns(chain, q[k], T[k], J[k])


# Torques of the links' weight about the joints, and how far soft joints give way to them.
#
# weight (n, 4): of each link what it weighs in N and where its centre of mass is in the frame behind its joint (m).

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
