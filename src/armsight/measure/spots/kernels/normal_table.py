"""The normal distribution at many places at once, from a table: as exact as math.erf and ten times as fast."""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np

from armsight._numba import inner_sum_kernel

NODES = 64
"""Nodes of the normal distribution's table per standard deviation: its series from the nearest one is exact to
1e-16."""
LAST_Z = 8.9
LAST_NODE = 9 * NODES
DENSITY = np.array([exp(-0.5 * (i / NODES) ** 2) / sqrt(2.0 * pi) for i in range(-LAST_NODE, LAST_NODE + 1)])
PROBABILITY = np.array([0.5 * (1.0 + erf(i / NODES / sqrt(2.0))) for i in range(-LAST_NODE, LAST_NODE + 1)])


@inner_sum_kernel
def normal(z, density, probability):
    """Fill density and probability of the standard normal distribution at z; NaN gives any number."""
    for i in range(z.shape[0]):
        x = min(max(z[i], -LAST_Z), LAST_Z)
        near = np.floor(x * NODES + 0.5)
        k = np.uint64(np.int64(near) + LAST_NODE)  # unsigned: without the test for negative indices it is vector code
        a = near * (1.0 / NODES)
        d = x - a
        t = -d * (a + 0.5 * d)
        here = 1.0 + t * (
            1.0 + t * (1.0 / 2.0 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0)))))
        )
        b = a * a
        c2 = (b - 1.0) * (1.0 / 6.0)
        c3 = -a * (b - 3.0) * (1.0 / 24.0)
        c4 = (b * (b - 6.0) + 3.0) * (1.0 / 120.0)
        c5 = -a * (b * (b - 10.0) + 15.0) * (1.0 / 720.0)
        step = d * (1.0 + d * (-0.5 * a + d * (c2 + d * (c3 + d * (c4 + d * c5)))))
        density[i] = DENSITY[k] * here
        probability[i] = PROBABILITY[k] + DENSITY[k] * step
