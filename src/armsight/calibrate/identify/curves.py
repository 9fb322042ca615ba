"""Arc and line as functions of their parameters and of where on them a reading is, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.kernels import arc_positions
from armsight.geometry.lie import skew

Array = NDArray[np.float64]


def basis(direction: Array) -> Array:
    """Return an orthonormal basis (3, 3) in columns whose third is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, skew(z) @ x, z], axis=1)


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


CIRCLE = ("x_m", "y_m", "z_m", "tilt_u", "tilt_v", "radius_m")
ARC = ("u_m", "v_m", "tilt_u", "tilt_v", "bend_u_1_m", "bend_v_1_m")
STRAIGHT = 1e-5
"""Curvature (1/m) below which an arc is as good as straight."""
LINE = ("u_m", "v_m", "tilt_u", "tilt_v")


def arc(tilt: Tilt, middle: Array, p: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return positions (N, 3) at arc lengths s, derivative (N, 3, 6) by ARC, and (N, 3) by s (kernels.arc_positions).

    A circle told by a point, its tangent there and its curvature: what a short arc knows well. By centre and radius,
    which it hardly knows, a fit creeps along a curved valley.
    """
    n = len(s)
    X, J, Js = np.empty((n, 3)), np.empty((n, 3, 6)), np.empty((n, 3))
    arc_positions(tilt.B, middle, np.array(p), np.array(s), X, J, Js)
    return X, J, Js


def circle_of(tilt: Tilt, middle: Array, p: Array) -> tuple[Array, Array, float, Array]:
    """Return centre (3,), axis (3,), radius of an arc, and the derivative (6, 6) of CIRCLE by ARC.

    The axis turns the tangent towards the centre; its tilts are along basis(axis). STRAIGHT bounds the radius.
    """
    t, dt = tilt.direction(p[2:4])
    across = tilt.B[:, :2]
    g = across @ p[4:6]
    c = g - (g @ t) * t
    dc = np.zeros((3, 6))
    dc[:, 2:4] = -np.outer(t, g @ dt) - (g @ t) * dt
    dc[:, 4:6] = across - np.outer(t, across.T @ t)
    full = np.zeros((3, 6))
    full[:, 2:4] = dt
    bend = max(float(np.linalg.norm(c)), STRAIGHT)
    stretch = c @ dc / bend
    axis = np.cross(t, c) / bend
    daxis = (np.cross(full, c, axis=0) + np.cross(t, dc, axisb=0).T) / bend - np.outer(axis, stretch) / bend
    D = np.empty((6, 6))
    D[:3] = dc / bend**2 - 2.0 * np.outer(c, stretch) / bend**3
    D[:3, :2] += across
    D[3:5] = basis(axis)[:, :2].T @ daxis
    D[5] = -stretch / bend**2
    return middle + across @ p[:2] + c / bend**2, axis, 1.0 / bend, D


def line(tilt: Tilt, middle: Array, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return positions (N, 3) at t along the line, derivative (N, 3, 4) by LINE, and (N, 3) by t.

    The line goes through middle + B (u, v, 0) along the tilted direction.
    """
    d, dd = tilt.direction(p[2:4])
    J = np.empty((len(t), 3, 4))
    J[:, :, :2] = tilt.B[:, :2]
    J[:, :, 2:] = t[:, None, None] * dd
    return middle + tilt.B[:, :2] @ p[:2] + np.outer(t, d), J, np.tile(d, (len(t), 1))
