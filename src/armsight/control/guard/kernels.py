"""Compiled: by how much a stretch of motion goes beyond each limit."""

from __future__ import annotations

import numpy as np

from armsight._numba import fast_kernel

SPEED, TURNING, ACCELERATION, TURNING_ACCELERATION, RANGE, JOINT_SPEED, WORKSPACE, BOXES = 0, 1, 2, 3, 4, 5, 6, 7
"""Places in the table of depths; forbidden boxes follow from BOXES on."""


@fast_kernel
def depths(T, J, q, qd, qdd, dt, base, offset, joints, most, boxes, margin, outside, out):
    """Fill out (BOXES + b,) with the largest excess over each limit along m places; 0 and below: kept.

    T (m, 4, 4) and J (m, 6, n) of the tool in world axes at readings q (m, n), moving at qd and qdd (m, n), dt s from
    place to place. base (3, 4): T_base_world. offset (3,): the flange in tool axes. joints (3, n): lower, upper,
    speed. most (4,): speed (m/s) and turning (rad/s) of the tool, its acceleration and that of its turning. boxes
    (1 + b, 6): lower and upper corners in base axes, the workspace first. Between two places the tool goes no further
    than from one to the other; boxes keep half of that beside the margin, but those of outside (1 + b,), whose limit
    is broken already: there only the places count, or there was no way back.
    """
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
            out[RANGE] = max(out[RANGE], joints[0, j] - q[i, j], q[i, j] - joints[1, j])
            out[JOINT_SPEED] = max(out[JOINT_SPEED], abs(qd[i, j]) - joints[2, j])
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
    for i in range(m):
        for p in range(2):
            for b in range(len(boxes)):
                inside = np.inf
                for r in range(3):
                    low, high = points[i, p, r] - boxes[b, r], boxes[b, 3 + r] - points[i, p, r]
                    inside = min(inside, low, high)
                keep = margin if outside[b] else margin + 0.5 * np.sqrt(stride)
                depth = keep - inside if b == 0 else keep + inside
                out[WORKSPACE + b] = max(out[WORKSPACE + b], depth)
