"""The algebra of rotations: what a small turn does to a vector, and the matrix of the cross product."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """Return the matrices (..., 3, 3) that take the cross product with v (..., 3) from the left: skew(v) w = v x w."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    o = np.zeros_like(x)
    return np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1))
