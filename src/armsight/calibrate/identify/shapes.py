"""Circle and line as functions of their parameters and of where on them a reading is, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def basis(direction: Array) -> Array:
    """Return an orthonormal basis (3, 3) in columns whose third is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, skew(z) @ x, z], axis=1)


def skew(a: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with a."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tilt:
    """Directions near B's third column as normalise(B (u, v, 1)), with derivative by (u, v)."""

    B: Array

    def direction(self, uv: Array) -> tuple[Array, Array]:
        """Return the direction (3,) and its derivative (3, 2)."""
        b = self.B @ np.array([uv[0], uv[1], 1.0])
        size = np.linalg.norm(b)
        n = b / size
        return n, (self.B[:, :2] - np.outer(n, n @ self.B[:, :2])) / size

    def frame(self, uv: Array) -> tuple[Array, Array]:
        """Return e1, e2, n as columns (3, 3) and their derivatives (3, 3, 2) [coordinate, column, parameter]."""
        n, dn = self.direction(uv)
        ex = self.B[:, 0]
        w = ex - (ex @ n) * n
        dw = -np.outer(n, ex @ dn) - (ex @ n) * dn
        size = np.linalg.norm(w)
        e1 = w / size
        de1 = (dw - np.outer(e1, e1 @ dw)) / size
        e2 = skew(n) @ e1
        de2 = skew(n) @ de1 - skew(e1) @ dn
        return np.stack([e1, e2, n], axis=1), np.stack([de1, de2, dn], axis=1)


CIRCLE = ("x_m", "y_m", "z_m", "tilt_u", "tilt_v", "radius_m")
LINE = ("u_m", "v_m", "tilt_u", "tilt_v")


def circle(tilt: Tilt, p: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return places (N, 3) at angles phi, derivative (N, 3, 6) by CIRCLE, and (N, 3) by phi."""
    E, dE = tilt.frame(p[3:5])
    c, s, r = np.cos(phi), np.sin(phi), p[5]
    ring = np.outer(c, E[:, 0]) + np.outer(s, E[:, 1])
    J = np.empty((len(phi), 3, 6))
    J[:, :, :3] = np.eye(3)
    J[:, :, 3:5] = r * (c[:, None, None] * dE[:, 0] + s[:, None, None] * dE[:, 1])
    J[:, :, 5] = ring
    return p[:3] + r * ring, J, r * (np.outer(-s, E[:, 0]) + np.outer(c, E[:, 1]))


def line(tilt: Tilt, middle: Array, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return places (N, 3) at t along the line, derivative (N, 3, 4) by LINE, and (N, 3) by t.

    The line goes through middle + B (u, v, 0) along the tilted direction.
    """
    d, dd = tilt.direction(p[2:4])
    J = np.empty((len(t), 3, 4))
    J[:, :, :2] = tilt.B[:, :2]
    J[:, :, 2:] = t[:, None, None] * dd
    return middle + tilt.B[:, :2] @ p[:2] + np.outer(t, d), J, np.tile(d, (len(t), 1))
