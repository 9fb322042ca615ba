"""Compiled real roots of polynomials in closed form."""

from __future__ import annotations

from math import acos, cos, sqrt

import numpy as np

from armsight._numba import lean_kernel


@lean_kernel
def real_cubic_root(b, c, d):
    """Return the largest real root of x^3 + b x^2 + c x + d."""
    p = c - b * b / 3.0
    q = 2.0 * b**3 / 27.0 - b * c / 3.0 + d
    disc = 0.25 * q * q + p**3 / 27.0
    if disc > 0.0:
        root = sqrt(disc)
        u, v = -0.5 * q + root, -0.5 * q - root
        x = np.cbrt(u) + np.cbrt(v)
    elif p == 0.0:
        x = 0.0
    else:
        x = 2.0 * sqrt(-p / 3.0) * cos(acos(min(max(1.5 * q / p * sqrt(-3.0 / p), -1.0), 1.0)) / 3.0)
    return x - b / 3.0


@lean_kernel
def real_quartic_roots(a, roots):
    """Fill roots with the real ones of a[4] x^4 + ... + a[0] (Ferrari), each polished by Newton; return how many."""
    if not abs(a[4]) > 0.0:
        return 0
    b, c, d, e = a[3] / a[4], a[2] / a[4], a[1] / a[4], a[0] / a[4]
    p = c - 0.375 * b * b
    q = d - 0.5 * b * c + 0.125 * b**3
    r = e - 0.25 * b * d + b * b * c / 16.0 - 3.0 * b**4 / 256.0
    m = real_cubic_root(p, 0.25 * p * p - r, -0.125 * q * q)  # of the resolvent
    n = 0
    if m > 1e-14:
        root = sqrt(2.0 * m)
        for sign in (-1.0, 1.0):
            square = -(2.0 * p + 2.0 * m + sign * 2.0 * q / root)
            # a double root is hardly ever exactly one: what is a little below zero counts as such
            if square > -1e-9 * (abs(p) + m):
                half = 0.5 * sqrt(max(square, 0.0))
                roots[n] = 0.5 * sign * root - half
                roots[n + 1] = 0.5 * sign * root + half
                n += 2
    else:  # biquadratic
        disc = 0.25 * p * p - r
        if disc >= 0.0:
            for sign in (-1.0, 1.0):
                square = -0.5 * p + sign * sqrt(disc)
                if square >= 0.0:
                    roots[n] = -sqrt(square)
                    roots[n + 1] = sqrt(square)
                    n += 2
    for i in range(n):
        x = roots[i] - 0.25 * b
        for _ in range(3):
            slope = ((4.0 * x + 3.0 * b) * x + 2.0 * c) * x + d
            if slope != 0.0:
                x -= ((((x + b) * x + c) * x + d) * x + e) / slope
        roots[i] = x
    return n
