"""Compiled: sums over sparse rows whose columns lie within a band."""

from __future__ import annotations

from armsight._numba import kernel


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
def transposed_times(columns, values, y, out):
    """Add the transposed rows times y (m, q) to out (size, q)."""
    m, k = columns.shape
    for r in range(m):
        for i in range(k):
            for c in range(y.shape[1]):
                out[columns[r, i], c] += values[r, i] * y[r, c]
