"""Compiled: by how much a stretch of motion goes beyond each limit, and what the joints may do within them."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import fast_kernel, inner_fast_kernel
from armsight.fitting.kernels import invert_spd, solve_damped

TOOL = 4
"""Entries of the table of depths for the tool: speed, turning, and the accelerations of both. Each joint has three
behind them: below its lower end, above its upper one, too fast, n of each kind; then come the faces and boxes."""
FACES = 6
"""Of the workspace, for each of two points: below and above in x, y, z."""
ROUNDING = 1e-12
"""Share of its trace by which J J^T is known worse than it is computed."""
BELOW_ACCELERATION = 0.85
"""Share of a limit of acceleration or jerk that is aimed at: the turning Jacobian adds to it."""


class Motion(NamedTuple):
    """A motion in m positions: readings q (m, n), qd and qdd; T (m, 4, 4) and J (m, 6, n) of the tool in world axes."""

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


@inner_fast_kernel
def clear_square(J, lengths, least, square):
    """Fill square (r, r) with J J^T of the first r rows of J (6, n), each divided by its length, lengths (r,).

    Returns whether it is positive definite less the square of least: no singular value is below that.
    """
    rows = len(lengths)
    trace = 0.0
    less = np.empty((rows, rows))
    for a in range(rows):
        for b in range(a + 1):
            total = 0.0
            for j in range(J.shape[1]):
                total += J[a, j] * J[b, j]
            square[a, b] = total / (lengths[a] * lengths[b])
            square[b, a] = square[a, b]
            less[a, b] = square[a, b]
        trace += square[a, a]
    # A is positive definite less t I just where all its eigenvalues, squares of the singular values, are above t
    for a in range(rows):
        less[a, a] -= least * least + ROUNDING * trace
    return invert_spd(less, less.copy())


@fast_kernel
def clear_of_singularities(J, lengths, least):
    """Tell of Jacobians (m, 6, n) whether none has a singular value below least; lengths as clear_square has them."""
    square = np.empty((len(lengths), len(lengths)))
    clear = True
    for i in range(len(J)):
        clear = clear and clear_square(J[i], lengths, least, square)
    return clear


@fast_kernel
def least_motion(J, lengths, least, wanted, out):
    """Fill out (n,) with the least joint motion of the tool's motion wanted (r,); False near a singularity (least)."""
    rows = len(lengths)
    square, g, weights = np.empty((rows, rows)), np.empty(rows), np.empty(rows)
    if not clear_square(J, lengths, least, square):
        return False
    for a in range(rows):
        g[a] = -wanted[a] / lengths[a]
    # qd = J' (J J')^-1 wanted
    solve_damped(square, g, 0.0, weights)
    for j in range(len(out)):
        out[j] = 0.0
        for a in range(rows):
            out[j] += J[a, j] / lengths[a] * weights[a]
    return True


@fast_kernel
def ceilings(J, way, joints, tool, out):
    """Fill out (k, n) with what the joints may do so that the tool keeps its limits: whatever signs their motions have.

    J (6, n); joints (k, n): their own limits, of acceleration and jerk; tool (k, 2): of its motion and its turning. way
    (n,): where all joints change their motion along it together, and so may do more; none where it is zero.
    """
    far = np.abs(way).max()
    for k in range(len(joints)):
        worst, most = 1e-12, 1e-12 * far
        for half in range(2):
            apart, together = 0.0, np.zeros(3)
            for j in range(len(way)):
                # apart: each joint by itself, their motions of the tool all in one direction at the worst
                square = 0.0
                for r in range(3):
                    square += J[3 * half + r, j] ** 2
                    together[r] += J[3 * half + r, j] * way[j]
                apart += sqrt(square) * joints[k, j]
                most = max(most, abs(way[j]) / joints[k, j])
            worst = max(worst, apart / tool[k, half])
            most = max(most, sqrt((together**2).sum()) / tool[k, half])
        for j in range(len(way)):
            out[k, j] = joints[k, j] * min(1.0, BELOW_ACCELERATION / worst)
            if far > 0.0:
                out[k, j] = max(out[k, j], abs(way[j]) * BELOW_ACCELERATION / most)
