"""Sums over the pixels of a patch: what a fit of a light spends its time on."""

from __future__ import annotations

from armsight._numba import lean_kernel, lean_sum_kernel


@lean_sum_kernel
def dot(a, b):
    """Return the sum of the products of a and b."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@lean_sum_kernel
def subtract_model(values, background, m, r):
    """Fill r with values less background and light m."""
    for i in range(r.shape[0]):
        r[i] = values[i] - background - m[i]


@lean_sum_kernel
def products(a, b, ab):
    """Fill ab with the products of a and b."""
    for i in range(a.shape[0]):
        ab[i] = a[i] * b[i]


@lean_sum_kernel
def sums_of(m, r):
    """Return the sums of m, m^2, r and r m."""
    of_m = of_mm = of_r = of_rm = 0.0
    for i in range(m.shape[0]):
        of_m += m[i]
        of_mm += m[i] * m[i]
        of_r += r[i]
        of_rm += r[i] * m[i]
    return of_m, of_mm, of_r, of_rm


@lean_sum_kernel
def two_dots(a0, a1, b):
    """Return the sums of the products of a0 and b, a1 and b."""
    t0 = 0.0
    t1 = 0.0
    for i in range(b.shape[0]):
        t0 += a0[i] * b[i]
        t1 += a1[i] * b[i]
    return t0, t1


@lean_sum_kernel
def four_dots(a0, a1, b0, b1):
    """Return the sums of the products of a0 and b0, a0 and b1, a1 and b0, a1 and b1."""
    t00 = 0.0
    t01 = 0.0
    t10 = 0.0
    t11 = 0.0
    for i in range(a0.shape[0]):
        t00 += a0[i] * b0[i]
        t01 += a0[i] * b1[i]
        t10 += a1[i] * b0[i]
        t11 += a1[i] * b1[i]
    return t00, t01, t10, t11


@lean_kernel
def gram(J, n, H):
    """Fill H (n, n) = J J', in blocks of two rows and two columns: each number is loaded half as often."""
    for a in range(0, n - 1, 2):
        for b in range(0, a + 1, 2):
            t00, t01, t10, t11 = four_dots(J[a], J[a + 1], J[b], J[b + 1])
            H[a, b] = t00
            H[b, a] = t00
            H[a + 1, b] = t10
            H[b, a + 1] = t10
            H[a + 1, b + 1] = t11
            H[b + 1, a + 1] = t11
            if b < a:
                H[a, b + 1] = t01
                H[b + 1, a] = t01
    if n % 2 == 1:
        for b in range(0, n - 1, 2):
            H[n - 1, b], H[n - 1, b + 1] = two_dots(J[b], J[b + 1], J[n - 1])
            H[b, n - 1] = H[n - 1, b]
            H[b + 1, n - 1] = H[n - 1, b + 1]
        H[n - 1, n - 1] = dot(J[n - 1], J[n - 1])


@lean_kernel
def normal_equations(J, r, n, H, g):
    """Fill H (n, n), g (n,) of a patch that was differentiated."""
    gram(J, n, H)
    for a in range(0, n - 1, 2):
        t0, t1 = two_dots(J[a], J[a + 1], r)
        g[a] = -t0
        g[a + 1] = -t1
    if n % 2 == 1:
        g[n - 1] = -dot(J[n - 1], r)
