"""Compiled: by how much a stretch of motion goes beyond each limit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from armsight._numba import fast_kernel, inner_fast_kernel

TOOL = 4
"""Entries of the table of depths for the tool: speed, turning, and the accelerations of both. Each joint has three
behind them: below its lower end, above its upper one, too fast, n of each kind; then come the faces and boxes."""
FACES = 6
"""Of the workspace, for each of two points: below and above in x, y, z."""


class Motion(NamedTuple):
    """A motion in m positions: joint readings q (m, n), moving at qd and qdd (m, n).

    T (m, 4, 4), J (m, 6, n): pose and Jacobian of the tool in world axes there.
    """

    T: Any
    J: Any
    q: Any
    qd: Any
    qdd: Any


class LimitsK(NamedTuple):
    """What a motion must keep, in base axes, which base (3, 4) = T_base_world leads to.

    offset (3,) m: the flange in tool axes. joints (3, n): lower, upper, speed. most (4,): speed (m/s) and turning
    (rad/s) of the tool, its acceleration and that of its turning. boxes (1 + b, 6) m: lower and upper corners, the
    workspace first, then forbidden ones; margin m: to be kept from all their faces.
    """

    base: Any
    offset: Any
    joints: Any
    most: Any
    boxes: Any
    margin: Any


@fast_kernel
def depths(motion, dt, limits, outside, out):
    """Fill out (TOOL + 3 n + 2 FACES + 2 b,) with the largest excess over each limit along m places; 0, below: kept.

    Each limit has an entry of its own: what is broken of one must not excuse another.

    motion, limits: plain tuples, as Motion, LimitsK; dt s from place to place. Between two places the tool goes no
    further than from one to the other; walls keep half of that beside the margin, but those of outside (2 FACES + 2
    b,), whose limit is broken already: there only the places count, or there was no way back.
    """
    T, J, q, qd, qdd = motion
    base, offset, joints, most, _, _ = limits
    m, n = q.shape
    points = np.empty((m, 2, 3))
    twist = np.zeros(6)
    out[:] = -np.inf
    for i in range(m):
        for half in range(2):
            fast, pushed, turned = 0.0, 0.0, 0.0
            for r in range(3 * half, 3 * half + 3):
                value, change = 0.0, 0.0
                for j in range(n):
                    value += J[i, r, j] * qd[i, j]
                    change += J[i, r, j] * qdd[i, j]
                fast += value * value
                pushed += change * change
                if i > 0 and dt > 0.0:  # with what the turning Jacobian adds
                    turned += ((value - twist[r]) / dt) ** 2
                twist[r] = value
            out[half] = max(out[half], np.sqrt(fast) - most[half])
            out[2 + half] = max(out[2 + half], np.sqrt(max(pushed, turned)) - most[2 + half])
        for j in range(n):
            out[TOOL + j] = max(out[TOOL + j], joints[0, j] - q[i, j])
            out[TOOL + n + j] = max(out[TOOL + n + j], q[i, j] - joints[1, j])
            out[TOOL + 2 * n + j] = max(out[TOOL + 2 * n + j], abs(qd[i, j]) - joints[2, j])
        for r in range(3):
            tool = base[r, 3]
            flange = 0.0
            for k in range(3):
                tool += base[r, k] * T[i, k, 3]
                for c in range(3):
                    flange += base[r, k] * T[i, k, c] * offset[c]
            points[i, 0, r] = tool
            points[i, 1, r] = tool + flange
    stride = 0.0
    for i in range(1, m):
        for p in range(2):
            square = 0.0
            for r in range(3):
                square += (points[i, p, r] - points[i - 1, p, r]) ** 2
            stride = max(stride, square)
    # at every moment the tool is no further than that from one of the two places it goes between
    way = 0.5 * np.sqrt(stride)
    wall_depths(points, way, limits, outside, out[TOOL + 3 * n :])


@inner_fast_kernel
def wall_depths(points, way, limits, outside, out):
    """Raise out (2 FACES + 2 b,) to the depths of points (m, 2, 3) in faces and boxes; way m: see depths."""
    _, _, _, _, boxes, margin = limits
    for i in range(points.shape[0]):
        for p in range(2):
            for r in range(3):
                for side in range(2):
                    entry = FACES * p + 2 * r + side
                    inside = points[i, p, r] - boxes[0, r] if side == 0 else boxes[0, 3 + r] - points[i, p, r]
                    keep = margin if outside[entry] else margin + way
                    out[entry] = max(out[entry], keep - inside)
            for b in range(1, len(boxes)):
                entry = 2 * FACES + 2 * (b - 1) + p
                # how deep in a box: the least of the distances from its six faces
                inside = np.inf
                for r in range(3):
                    inside = min(inside, points[i, p, r] - boxes[b, r], boxes[b, 3 + r] - points[i, p, r])
                keep = margin if outside[entry] else margin + way
                out[entry] = max(out[entry], keep + inside)


@fast_kernel
def depths_each(motion, limits, outside, out):
    """Fill out (m, ...) with the depths at each of m places by itself; the rest as depths has it."""
    T, J, q, qd, qdd = motion
    for i in range(len(q)):
        at = slice(i, i + 1)
        depths((T[at], J[at], q[at], qd[at], qdd[at]), 0.0, limits, outside, out[i])
