"""Compiled filter of a moving target: pose, velocity and acceleration, from the spots of one view at a time.

State: position p (m), rotation R, velocity v, angular velocity w, acceleration a, angular acceleration b of the target,
all in rig axes. Its error (18,): dp, dw with Exp(dw) R, then those of v, w, a, b. Acceleration and angular acceleration
are driven by white noise (jerk) of power spectral density s: for each axis the covariance added over dt is
s [[dt^5/20, dt^4/8, dt^3/6], [., dt^3/3, dt^2/2], [., ., dt]] (Bar-Shalom, Li and Kirubarajan 2001, section 6.2.3).

A state travels as x (24,): p, the rows of R, v, w, a, b.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.geometry.kernels import rotation_from_rotvec, rotvec_of

N = 18
"""Errors of a state."""
STATE = 24
P, R, V, W, A, B = 0, 3, 12, 15, 18, 21
"""Where each part of a state begins."""


@inner_kernel
def turned(x, tau, E):
    """Fill E (3, 3) with the turn that the state makes in tau."""
    phi = np.empty(3)
    for i in range(3):
        phi[i] = tau * x[W + i] + 0.5 * tau * tau * x[B + i]
    rotation_from_rotvec(phi, E)


@kernel
def state_at(x, tau, out):
    """Fill out with the state tau later, without noise."""
    E = np.empty((3, 3))
    turned(x, tau, E)
    for i in range(3):
        out[P + i] = x[P + i] + tau * x[V + i] + 0.5 * tau * tau * x[A + i]
        out[V + i] = x[V + i] + tau * x[A + i]
        out[W + i] = x[W + i] + tau * x[B + i]
        out[A + i] = x[A + i]
        out[B + i] = x[B + i]
        for j in range(3):
            out[R + 3 * i + j] = E[i, 0] * x[R + j] + E[i, 1] * x[R + 3 + j] + E[i, 2] * x[R + 6 + j]


@kernel
def transition(x, tau, F):
    """Fill F (18, 18): how the error of a state becomes that of the state tau later."""
    E = np.empty((3, 3))
    turned(x, tau, E)
    h = 0.5 * tau * tau
    F[:] = 0.0
    phi = np.empty(3)
    for i in range(3):
        phi[i] = tau * x[W + i] + h * x[B + i]
    for i in range(3):
        F[i, i] = 1.0
        F[i, 6 + i] = tau
        F[i, 12 + i] = h
        # velocities and accelerations carry on by themselves; the turn E carries the rotation's error with it
        for k in (6, 9, 12, 15):
            F[k + i, k + i] = 1.0
        F[6 + i, 12 + i] = tau
        F[9 + i, 15 + i] = tau
        for j in range(3):
            F[3 + i, 3 + j] = E[i, j]
    # the left Jacobian of the turn to first order: I + [phi] / 2
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        F[3 + i, 9 + i] = tau
        F[3 + i, 9 + j] = -0.5 * tau * phi[k]
        F[3 + i, 9 + k] = 0.5 * tau * phi[j]
        for c in range(3):
            F[3 + i, 15 + c] = 0.5 * tau * F[3 + i, 9 + c]


@lean_kernel
def multiply(X, Y, out):
    """Fill out with X Y, leaving out what is zero in X."""
    n, m, p = X.shape[0], Y.shape[1], X.shape[1]
    for i in range(n):
        for j in range(m):
            out[i, j] = 0.0
        for k in range(p):
            f = X[i, k]
            if f != 0.0:
                for j in range(m):
                    out[i, j] += f * Y[k, j]


@lean_kernel
def multiply_t(X, Y, out):
    """Fill out with X Y'."""
    n, m, p = X.shape[0], Y.shape[0], X.shape[1]
    for i in range(n):
        for j in range(m):
            s = 0.0
            for k in range(p):
                s += X[i, k] * Y[j, k]
            out[i, j] = s


@lean_kernel
def transposed(X, out):
    """Fill out with X'."""
    for i in range(X.shape[0]):
        for j in range(X.shape[1]):
            out[j, i] = X[i, j]


@kernel
def add_jerk(C, tau, jerk, angular_jerk):
    """Add to C (18, 18) what jerk (m^2/s^5) and angular jerk (rad^2/s^5) leave open over tau."""
    t2 = tau * tau
    t3 = t2 * tau
    for axis in range(6):
        s = jerk if axis < 3 else angular_jerk
        p, v, a = axis, 6 + axis, 12 + axis
        C[p, p] += s * t3 * t2 / 20.0
        C[p, v] += s * t2 * t2 / 8.0
        C[v, p] += s * t2 * t2 / 8.0
        C[p, a] += s * t3 / 6.0
        C[a, p] += s * t3 / 6.0
        C[v, v] += s * t3 / 3.0
        C[v, a] += s * t2 / 2.0
        C[a, v] += s * t2 / 2.0
        C[a, a] += s * tau


@kernel
def predict(x, C, tau, jerk, angular_jerk, out, D, F):
    """Fill the state out, its covariance D (18, 18) tau later, and F, how errors got there."""
    G = np.empty((N, N))
    E = np.empty((N, N))
    transition(x, tau, F)
    multiply(F, C, G)
    transposed(G, E)
    multiply(F, E, D)  # F (F C)' = F C F', and F is mostly zeros
    add_jerk(D, tau, jerk, angular_jerk)
    state_at(x, tau, out)


@inner_kernel
def move(x, d):
    """Move a state by an error (18,)."""
    E = np.empty((3, 3))
    S = np.empty((3, 3))
    rotation_from_rotvec(d[3:6], E)
    for i in range(3):
        x[P + i] += d[i]
        x[V + i] += d[6 + i]
        x[W + i] += d[9 + i]
        x[A + i] += d[12 + i]
        x[B + i] += d[15 + i]
        for j in range(3):
            S[i, j] = E[i, 0] * x[R + j] + E[i, 1] * x[R + 3 + j] + E[i, 2] * x[R + 6 + j]
    for i in range(3):
        for j in range(3):
            x[R + 3 * i + j] = S[i, j]


@kernel
def difference(x, y, d):
    """Fill d (18,) with the error that moves y to x."""
    S = np.empty((3, 3))
    for i in range(3):
        d[i] = x[P + i] - y[P + i]
        d[6 + i] = x[V + i] - y[V + i]
        d[9 + i] = x[W + i] - y[W + i]
        d[12 + i] = x[A + i] - y[A + i]
        d[15 + i] = x[B + i] - y[B + i]
        for j in range(3):
            S[i, j] = (
                x[R + 3 * i] * y[R + 3 * j] + x[R + 3 * i + 1] * y[R + 3 * j + 1] + x[R + 3 * i + 2] * y[R + 3 * j + 2]
            )
    # S = R_x R_y': applied from the left, as move does
    rotvec_of(S, d[3:6])
