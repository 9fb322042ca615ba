"""The target's own frame, and the names of its lights by their positions in the images (MATH 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LETTERS = "ABCDEF"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Shape parameters of n lights: spots = (basis @ values) reshaped to (n, 3); basis (3 n, k), names (k,).

    on_line: all lights on the frame's x axis, their mean at the origin: the turn about it is not known.
    """

    names: tuple[str, ...]
    basis: Array
    on_line: bool

    def spots(self, values: Array) -> Array:
        """Return the lights (n, 3) in m."""
        return (self.basis @ values).reshape(-1, 3)


def plane_layout(n: int) -> Layout:
    """Return the frame of Pachidis 2005, eqs. (7)-(8): origin G at the mean of A, B, C, u from A to G, w = (B - G) x
    (A - G), v = w x u. A = (-a, 0, 0), B = (a/2 + s, h, 0), C = (a/2 - s, -h, 0); the other lights are free.
    """
    names = ["a_m", "s_m", "h_m"] + [f"{LETTERS[i]}.{axis}_m" for i in range(3, n) for axis in "xyz"]
    basis = np.zeros((3 * n, len(names)))
    basis[[0, 3, 6], 0] = -1.0, 0.5, 0.5
    basis[[3, 6], 1] = 1.0, -1.0
    basis[[4, 7], 2] = 1.0, -1.0
    basis[9:, 3:] = np.eye(3 * (n - 3))
    return Layout(names=tuple(names), basis=basis, on_line=False)


def line_layout(n: int) -> Layout:
    """Return the frame of lights on one line: positions along x from A on, their mean at the origin."""
    names = [f"{LETTERS[i]}.along_m" for i in range(1, n)]
    basis = np.zeros((3 * n, n - 1))
    basis[3 * np.arange(1, n), np.arange(n - 1)] = 1.0
    basis[3 * np.arange(n)] -= 1.0 / n
    return Layout(names=tuple(names), basis=basis, on_line=True)


def plane_frame(X: Array) -> tuple[Array, Array]:
    """Return R (3, 3), whose columns are u, v, w, and G (3,) of the lights X (n, 3), A, B, C first."""
    G = X[:3].mean(axis=0)
    u = G - X[0]
    w = np.cross(X[1] - G, X[0] - G)
    u, w = u / np.linalg.norm(u), w / np.linalg.norm(w)
    return np.stack([u, np.cross(w, u), w], axis=1), G


def line_frame(X: Array) -> tuple[Array, Array]:
    """Return R (3, 3), whose first column is the direction from the first light on, and the mean (3,) of X (n, 3)."""
    G = X.mean(axis=0)
    axis = np.linalg.svd(X - G)[2][0]
    axis = axis if axis @ (X[-1] - X[0]) > 0.0 else -axis
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([axis, side, np.cross(axis, side)], axis=1), G


def name_order(X: Array, away: Array, u_px: Array) -> Index:
    """Return the order (n,) in which the lights X (n, 3) become A, B, C, D ...

    A is leftmost in the mean of the left images, u_px (n,); B and C make the largest triangle with it, in the sense
    that turns w away from the camera (away (3,), in the axes of X): B lower right, C upper right. The rest follows
    from left to right.
    """
    order = np.argsort(u_px, kind="stable")
    first, rest = order[0], order[1:]
    if len(rest) < 2:
        return np.asarray(order)

    def normal(b: int, c: int) -> Array:
        return np.cross(X[b] - X[first], X[c] - X[first])

    b, c = max(combinations(rest.tolist(), 2), key=lambda pair: float(np.linalg.norm(normal(*pair))))
    # w = (B - G) x (A - G) = -(B - A) x (C - A) / 3
    if normal(b, c) @ away > 0.0:
        b, c = c, b
    return np.array([first, b, c, *(i for i in rest if i not in (b, c))], dtype=np.intp)
