"""Compiled step of the poses of all views."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel


@kernel
def move_poses(poses, steps, out):
    """Fill out (G, 6) with poses (t, rotation vector) moved by steps (dt, dw): t + dt, log(Exp(dw) Exp(w))."""
    q1 = np.empty(4)
    q2 = np.empty(4)
    for g in range(poses.shape[0]):
        for m in range(3):
            out[g, m] = poses[g, m] + steps[g, m]
        _quaternion(steps[g, 3:], q1)
        _quaternion(poses[g, 3:], q2)
        w = q1[3] * q2[3] - q1[0] * q2[0] - q1[1] * q2[1] - q1[2] * q2[2]
        x = q1[3] * q2[0] + q1[0] * q2[3] + q1[1] * q2[2] - q1[2] * q2[1]
        y = q1[3] * q2[1] - q1[0] * q2[2] + q1[1] * q2[3] + q1[2] * q2[0]
        z = q1[3] * q2[2] + q1[0] * q2[1] - q1[1] * q2[0] + q1[2] * q2[3]
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        s = sqrt(x * x + y * y + z * z)
        f = 2.0 if s < 1e-12 else 2.0 * atan2(s, w) / s
        out[g, 3] = f * x
        out[g, 4] = f * y
        out[g, 5] = f * z


@inner_kernel
def _quaternion(w, q):
    """Fill q (4,), scalar last, with the quaternion of the rotation vector w (3,)."""
    t = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    f = 0.5 - t * t / 48.0 if t < 1e-4 else np.sin(0.5 * t) / t
    q[0], q[1], q[2], q[3] = f * w[0], f * w[1], f * w[2], np.cos(0.5 * t)
