"""Compiled core of fits so small and so frequent that Python would dominate, and sums over sparse rows of a band."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel


@inner_kernel
def solve_damped(H, g, damping, step):
    """Solve (H + damping diag H) step = -g by Cholesky for small dense H (n, n); return False where not SPD."""
    n = g.shape[0]
    L = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j]
            if i == j:
                # Marquardt (1963): the damping multiplies the diagonal, so that no step hangs on a parameter's unit
                s *= 1.0 + damping
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        s = -g[i]
        for k in range(i):
            s -= L[i, k] * step[k]
        step[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = step[i]
        for k in range(i + 1, n):
            s -= L[k, i] * step[k]
        step[i] = s / L[i, i]
    return True


@inner_kernel
def invert_spd(H, out):
    """Fill out (n, n) with the inverse of the symmetric positive definite H; return False where it is not."""
    n = H.shape[0]
    L = np.empty((n, n))  # Cholesky factor below the diagonal, turned into its inverse column by column
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                L[i, i] = 1.0 / sqrt(s)
            else:
                L[i, j] = s * L[j, j]
    for j in range(n):
        for i in range(j + 1, n):
            s = 0.0
            for k in range(j, i):
                s -= L[i, k] * L[k, j]
            L[i, j] = s * L[i, i]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += L[k, i] * L[k, j]
            out[i, j] = s
            out[j, i] = s
    return True


SWEEPS = 12
"""Of the rotations about all pairs of axes; each squares what is left beside the diagonal, and four or five do."""


@lean_kernel
def diagonalise(A, V):
    """Turn the symmetric A (n, n) into its eigenvalues on the diagonal; the columns of V (n, n) are their vectors.

    Jacobi's rotations, in no order of size: for matrices of a handful of rows, where LAPACK's call costs ten times it.
    """
    n = A.shape[0]
    size = 0.0
    for i in range(n):
        for j in range(n):
            V[i, j] = 1.0 if i == j else 0.0
            size += A[i, j] * A[i, j]
    for _ in range(SWEEPS):
        beside = 0.0
        for i in range(n):
            for j in range(i):
                beside += A[i, j] * A[i, j]
        # a relative error of 1e-17: less than the last digit of the largest
        if beside <= 1e-34 * size:
            return
        for i in range(n):
            for j in range(i):
                if A[i, j] == 0.0:
                    continue
                # the smaller one of the two rotations that leave nothing between the axes (Rutishauser 1966)
                half = 0.5 * (A[j, j] - A[i, i]) / A[i, j]
                t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + sqrt(half * half + 1.0))
                c = 1.0 / sqrt(t * t + 1.0)
                s = t * c
                for k in range(n):
                    a, b = A[k, i], A[k, j]
                    A[k, i], A[k, j] = c * a - s * b, s * a + c * b
                for k in range(n):
                    a, b = A[i, k], A[j, k]
                    A[i, k], A[j, k] = c * a - s * b, s * a + c * b
                    a, b = V[k, i], V[k, j]
                    V[k, i], V[k, j] = c * a - s * b, s * a + c * b


@kernel
def schur_complement(C, c, W, floor, x, X):
    """Fill x (G, L) = C^-1 c and X (G, L, F) = C^-1 W' for symmetric C (G, L, L) that is positive (semi-)definite.

    Cholesky of C scaled to a unit diagonal; pivots below floor are raised to it, so that a direction without
    information gets a finite, large answer.
    """
    n_groups, n, n_free = C.shape[0], C.shape[1], W.shape[1]
    L = np.empty((n, n))
    s = np.empty(n)
    y = np.empty((n, n_free + 1))
    for g in range(n_groups):
        for i in range(n):
            # by the unit diagonal a pivot is the share of a parameter that those before it leave open
            s[i] = 1.0 / sqrt(C[g, i, i])
        for i in range(n):
            for j in range(i + 1):
                v = C[g, i, j] * s[i] * s[j]
                for k in range(j):
                    v -= L[i, k] * L[j, k]
                if i == j:
                    L[i, i] = sqrt(max(v, floor))
                else:
                    L[i, j] = v / L[j, j]
        for i in range(n):
            y[i, 0] = s[i] * c[g, i]
            for f in range(n_free):
                y[i, f + 1] = s[i] * W[g, f, i]
            for k in range(i):
                for f in range(n_free + 1):
                    y[i, f] -= L[i, k] * y[k, f]
            for f in range(n_free + 1):
                y[i, f] /= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                for f in range(n_free + 1):
                    y[i, f] -= L[k, i] * y[k, f]
            for f in range(n_free + 1):
                y[i, f] /= L[i, i]
        for i in range(n):
            x[g, i] = s[i] * y[i, 0]
            for f in range(n_free):
                X[g, i, f] = s[i] * y[i, f + 1]


@kernel
def add_rows(columns, values, right, band, b):
    """Add rows (m, k), columns ascending, to J'J as band (width + 1, size), lower form, and J'right (size,)."""
    m, k = columns.shape
    for r in range(m):
        for i in range(k):
            ci, vi = columns[r, i], values[r, i]
            b[ci] += vi * right[r]
            for j in range(i + 1):
                cj = columns[r, j]
                # lower form of LAPACK's banded Cholesky: row i - j of the band holds the element (i, j), and columns
                # ascend, so that none falls above the diagonal
                band[ci - cj, cj] += vi * values[r, j]


@kernel
def rows_times(columns, values, x, out):
    """Set out (m, q) to the rows times x (size, q)."""
    m, k = columns.shape
    for r in range(m):
        for c in range(x.shape[1]):
            s = 0.0
            # a spline's row has k entries beside each other: the dense product would touch all of size
            for i in range(k):
                s += values[r, i] * x[columns[r, i], c]
            out[r, c] = s


@kernel
def add_transposed_times(columns, values, y, out):
    """Add the transposed rows times y (m, q) to out (size, q)."""
    m, k = columns.shape
    for r in range(m):
        for i in range(k):
            for c in range(y.shape[1]):
                out[columns[r, i], c] += values[r, i] * y[r, c]
