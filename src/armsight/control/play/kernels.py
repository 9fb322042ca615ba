"""Compiled: how fast a path may be gone along, so that acceleration stays within limits all along.

Reachability analysis of Pham and Pham (A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis, IEEE Transactions on Robotics 34, 2018), for a way that begins and ends at rest.
"""

from __future__ import annotations

from math import inf, sqrt

from armsight._numba import fast_kernel, inner_fast_kernel

HALVINGS = 40
"""Of the interval in which the largest square of the speed is looked for: to a part in 1e12."""
NONE = 1e-24
"""A value whose square of the derivative by the path is below this does not change along it."""


@inner_fast_kernel
def accelerations(i, b, first, mixed, second, most):
    """Return the least and largest u'' at place i where u'^2 = b; the first is the larger one where there is none.

    |y' u'' + y'' b| <= most for each of m values y, scalars or vectors alike: a quadratic inequality in u''. first,
    mixed, second (n, m): y'.y', y'.y'', y''.y''; most (n, m).
    """
    low, high = -inf, inf
    for k in range(first.shape[1]):
        p, half, rest = first[i, k], mixed[i, k] * b, second[i, k] * b * b - most[i, k] * most[i, k]
        if p < NONE:
            if rest > 0.0:
                return inf, -inf
            continue
        square = half * half - p * rest
        if square < 0.0:
            return inf, -inf
        root = sqrt(square)
        low, high = max(low, (-half - root) / p), min(high, (root - half) / p)
    return low, high


@fast_kernel
def reachable_speeds(first, mixed, second, most, fastest, du, out):
    """Fill out (n,) with u'^2 of the fastest motion from rest to rest along u, n places du apart.

    first, mixed, second, most: as accelerations; fastest (n,): largest u'^2 at each place by itself.
    """
    n = len(out)
    # backwards: the largest u'^2 from which the next place's can be reached, and so rest at the end
    out[n - 1] = 0.0
    for i in range(n - 2, -1, -1):
        good, bad = 0.0, fastest[i]
        for step in range(HALVINGS):
            b = bad if step == 0 else 0.5 * (good + bad)
            low, high = accelerations(i, b, first, mixed, second, most)
            if max(low, -b / (2.0 * du)) <= min(high, (out[i + 1] - b) / (2.0 * du)):
                good = b
                if step == 0:
                    break
            else:
                bad = b
        out[i] = good
    # forwards: as fast as the limits let it become
    out[0] = 0.0
    for i in range(n - 1):
        _, high = accelerations(i, out[i], first, mixed, second, most)
        out[i + 1] = max(0.0, min(out[i + 1], out[i] + 2.0 * du * max(high, -inf)))
