"""Compiled closed-form inverse kinematics of two families of six revolute joints.

Both have a plane arm: axis 2 square to axis 1 and parallel to axis 3. They differ in the wrist:

  offset wrist (MATH 2.2, Universal Robots): axis 4 parallel to 2 and 3, axes 5 and 6 square to their neighbours,
    axes 5 and 6 meet; offsets a4, d2..d5 allowed;
  spherical wrist (Puma, IRB 120): axes 4, 5, 6 meet in one point, each square to the next; a1, a3, d2..d4 allowed.

All twists are quarter or half turns, so that family (29,), filled by `armsight.kinematics.closed_form`, holds only
signs and lengths: 0 wrist (1 offset, 2 spherical), 1 sin alpha1, 2 cos alpha2, 3 cos alpha3 (offset) or sin alpha3
(spherical), 4 sin alpha4, 5 sin alpha5, 6 a1, 7 d1, 8 a2, 9 second link of the plane arm, 10 its bend, 11 offset along
axis 2, 12 a4, 13 d5, 14..19 theta offsets, 20..25 one over the signs, 26 scale of lengths, 27 base is the world,
28 nothing behind joint 6.

Angles inside are DH angles theta, not joint values. In the frame behind joint 1: x1 = (C1, S1, 0), z1 = axis 2.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import fast_kernel, inner_fast_kernel, kernel
from armsight.kinematics.kernels.chain import TWO_PI, arc_tangent, sin_cos, wrap
from armsight.kinematics.kernels.numeric import pose_error

ELBOW_MERGED = 1e-7
"""Sine of the elbow below which its two branches are one: rounding of the reach, under a square root, makes 2e-8."""

WRIST_FREE = 1e-10
"""Sine of joint 5 below which only a sum of angles is fixed; calling it zero turns the tool by that many rad."""

SHOULDER_FREE = 1e-10
"""Distance of the wrist from axis 1, over the reach, below which theta 1 is free."""

REACH_SLACK = 1e-12
"""Share of the reach by which rounding may put a reachable point outside."""

LEFT, DOWN, FLIP, AT_SHOULDER, AT_ELBOW, AT_WRIST = 1, 2, 4, 8, 16, 32
"""Bits of a solution's code: branches, and which singularity it stands in."""


class Shoulder(NamedTuple):
    """One of the two ways to turn joint 1: theta1, its cosine and sine, and the bits of it for a solution's code."""

    theta1: Any
    cosine: Any
    sine: Any
    bits: Any


class Solutions(NamedTuple):
    """All solutions: Q (8, 6) joint values, code (8,) their branches and singularities."""

    Q: Any
    code: Any


@inner_fast_kernel
def wrist_pose(family, base, tool, T, W):
    """Fill W (12,) with the axes x, y, z and the origin of frame 6 before its own d, a, alpha, in base axes.

    base, tool (12,): rows of the inverse of frame 0's pose in world, and of the inverse of all that comes after joint
    6's turn.
    """
    for c in range(4):
        for r in range(3):
            W[3 * c + r] = T[r, c]
    if family[28] == 0.0:
        for r in range(3):
            x, y, z = T[r, 0], T[r, 1], T[r, 2]
            for c in range(4):
                W[3 * c + r] = x * tool[c] + y * tool[4 + c] + z * tool[8 + c]
            W[9 + r] += T[r, 3]
    if family[27] == 0.0:
        for c in range(4):
            x, y, z = W[3 * c], W[3 * c + 1], W[3 * c + 2]
            for r in range(3):
                v = base[4 * r] * x + base[4 * r + 1] * y + base[4 * r + 2] * z
                W[3 * c + r] = v + base[4 * r + 3] if c == 3 else v


@inner_fast_kernel
def _store(family, solutions, k, theta, bits):
    """Store one solution of angles theta (6,) as joint values, each turned into [-pi, pi] (over the joint's scale)."""
    Q, code = solutions
    t1, t2, t3, t4, t5, t6 = theta
    Q[k, 0] = wrap(t1 - family[14]) * family[20]
    Q[k, 1] = wrap(t2 - family[15]) * family[21]
    Q[k, 2] = wrap(t3 - family[16]) * family[22]
    Q[k, 3] = wrap(t4 - family[17]) * family[23]
    Q[k, 4] = wrap(t5 - family[18]) * family[24]
    Q[k, 5] = wrap(t6 - family[19]) * family[25]
    code[k] = bits


@inner_fast_kernel
def _elbow(a2, link, x, y, out):
    """Solve the plane arm for (x, y): out = (theta2 base, its bend, elbow angle); return 0, 1 or 2 branches.

    theta2 = out[0] - e out[1] and elbow = e out[2] for e = +1 and -1.
    """
    Q = x * x + y * y
    far = (a2 + link) * (a2 + link)
    near = (a2 - link) * (a2 - link)
    # the sine by a product: 1 - c3^2 would cancel where the arm is stretched or folded (MATH 2.2)
    product = (far - Q) * (Q - near)
    scale = 2.0 * a2 * link
    c3 = (Q - a2 * a2 - link * link) / scale
    if product < 0.0:
        if abs(c3) > 1.0 + REACH_SLACK * max(far, near) / abs(scale):
            return 0
        product = 0.0
    s3 = sqrt(product) / abs(scale)
    out[0] = arc_tangent(y, x)
    out[1] = arc_tangent(link * s3, a2 + link * c3)
    out[2] = arc_tangent(s3, c3)
    return 1 if s3 < ELBOW_MERGED else 2


@inner_fast_kernel
def _offset_wrist(family, W, near, shoulder, k, solutions, work):
    """Add the solutions of an arm with offset wrist for one theta 1; return their number so far."""
    t1, C1, S1, bits = shoulder
    sa1, k2, k23 = family[1], family[2], family[2] * family[3]
    sa4, sa5 = family[4], family[5]
    xx, xy, xz, yx, yy, yz = W[0], W[1], W[2], W[3], W[4], W[5]
    zx, zy, zz = W[6], W[7], W[8]
    # sin 5 cos 6 and sin 5 sin 6 of MATH 2.2; the plane arm's sum of angles, phi, follows from them
    g = k23 * sa4 * sa1  # axis 2 is sa1 (S1, -C1, 0)
    x6 = g * (S1 * xx - C1 * xy)  # sin5 cos6
    y6 = -g * (S1 * yx - C1 * yy)  # sin5 sin6
    c5 = -g * sa5 * (S1 * zx - C1 * zy)
    s5 = sqrt(x6 * x6 + y6 * y6)
    wrists = 2
    if s5 < WRIST_FREE:
        wrists = 1
        bits |= AT_WRIST
        s5 = 0.0
        c5 = 1.0 if c5 > 0.0 else -1.0
        t5 = 0.0 if c5 > 0.0 else np.pi
        phi = near[1] + k2 * near[2] + k23 * near[3]
        sp, cp = sin_cos(phi)
        rx, ry, rz = cp * C1, cp * S1, sp * sa1  # x of link 4 as it was
        t6 = arc_tangent(-c5 * (rx * yx + ry * yy + rz * yz), c5 * (rx * xx + ry * xy + rz * xz))
    else:
        t5 = arc_tangent(s5, c5)
        t6 = arc_tangent(y6, x6)
        c6 = x6 / s5
        s6 = y6 / s5
        cp = C1 * (c5 * (c6 * xx - s6 * yx) + s5 * sa5 * zx) + S1 * (c5 * (c6 * xy - s6 * yy) + s5 * sa5 * zy)
        sp = sa1 * (c5 * (c6 * xz - s6 * yz) + s5 * sa5 * zz)
        size = 1.0 / sqrt(cp * cp + sp * sp)
        cp *= size
        sp *= size
        phi = arc_tangent(sp, cp)
    x = C1 * W[9] + S1 * W[10] - family[6]
    y = sa1 * (W[11] - family[7])
    side = k23 * sa4 * family[13]
    ox = family[12] * cp + side * sp
    oy = family[12] * sp - side * cp
    up = -family[8] * family[9] * sa1 * (-1.0 if bits & LEFT else 1.0)
    for flip in range(wrists):
        sign = 1.0 if flip == 0 else -1.0
        branches = _elbow(family[8], family[9], x - sign * ox, y - sign * oy, work)
        turn = 0.0 if flip == 0 else np.pi
        for e in range(branches):
            h = 1.0 if e == 0 else -1.0
            t3 = h * work[2]
            t2 = work[0] - h * work[1]
            b = bits | (FLIP if flip else 0) | (DOWN if h * up < 0.0 else 0)
            if branches == 1:
                b |= AT_ELBOW
            t4 = k23 * (phi + turn - t2 - t3)
            _store(family, solutions, k, (t1, t2, k2 * t3, t4, sign * t5, t6 + turn), b)
            k += 1
    return k


@inner_fast_kernel
def _spherical_wrist(family, W, near, shoulder, k, solutions, work):
    """Add the solutions of an arm with spherical wrist for one theta 1; return their number so far."""
    t1, C1, S1, bits = shoulder
    sa1, k2, sa4, sa5 = family[1], family[2], family[4], family[5]
    s23 = family[2] * family[3]
    x = C1 * W[9] + S1 * W[10] - family[6]
    y = sa1 * (W[11] - family[7])
    branches = _elbow(family[8], family[9], x, y, work)
    up = -family[8] * family[9] * sa1 * (-1.0 if bits & LEFT else 1.0)
    for e in range(branches):
        h = 1.0 if e == 0 else -1.0
        bend = h * work[2] - family[10]
        t2 = work[0] - h * work[1]
        b = bits | (DOWN if h * up < 0.0 else 0)
        if branches == 1:
            b |= AT_ELBOW
        sp, cp = sin_cos(t2 + bend)
        # axes of link 3: x3 along the plane, y3 along axis 2, z3 = x3 x y3
        x3x, x3y, x3z = cp * C1, cp * S1, sp * sa1
        y3x, y3y = s23 * sa1 * S1, -s23 * sa1 * C1
        z3x, z3y, z3z = s23 * sp * C1, s23 * sp * S1, -s23 * cp * sa1
        # axis 6 in the axes of link 3: cos 4 sin 5, sin 4 sin 5 and cos 5 but for signs
        m02 = x3x * W[6] + x3y * W[7] + x3z * W[8]
        m12 = y3x * W[6] + y3y * W[7]
        m22 = z3x * W[6] + z3y * W[7] + z3z * W[8]
        s5 = sqrt(m02 * m02 + m12 * m12)
        wrists = 2
        if s5 < WRIST_FREE:
            wrists = 1
            b |= AT_WRIST
            t4 = near[3]
            s4, c4 = sin_cos(t4)
            t5 = 0.0 if -sa4 * sa5 * m22 > 0.0 else np.pi
        else:
            s4 = sa5 * m12 / s5
            c4 = sa5 * m02 / s5
            t4 = arc_tangent(s4, c4)
            t5 = arc_tangent(s5, -sa4 * sa5 * m22)
        ux, uy, uz = s4 * x3x - c4 * y3x, s4 * x3y - c4 * y3y, s4 * x3z
        g = sa4 * sa5
        t6 = arc_tangent(g * (ux * W[0] + uy * W[1] + uz * W[2]), g * (ux * W[3] + uy * W[4] + uz * W[5]))
        for flip in range(wrists):
            turn = 0.0 if flip == 0 else np.pi
            sign = 1.0 if flip == 0 else -1.0
            theta = t1, t2, k2 * bend, t4 + turn, sign * t5, t6 + turn
            _store(family, solutions, k, theta, b | (FLIP if flip else 0))
            k += 1
    return k


@fast_kernel
def solve_closed(chain, family, base, tool, T, here, Q, code):
    """Fill Q (8, 6) with all solutions and code (8,) with their branches for T_world_tool (4, 4); return how many.

    here (6,): joint values that decide where a singular pose leaves one free. Limits are not looked at.
    """
    return _solve(family, base, tool, T, _dh_angles(chain, here), Solutions(Q, code), np.empty(12), np.empty(3))


@inner_fast_kernel
def _dh_angles(chain, q):
    """Return the DH angles theta (6,) of turning joints at q (6,)."""
    theta = np.empty(6)
    for i in range(6):
        theta[i] = chain[i + 1, 1] * q[i] + chain[i + 1, 2]
    return theta


@inner_fast_kernel
def _solve(family, base, tool, T, near, solutions, W, work):
    """Do what `solve_closed` says, with room to work in: W (12,), work (3,)."""
    wrist_pose(family, base, tool, T, W)
    wx, wy, sa1 = W[9], W[10], family[1]
    offset = sa1 * family[11]
    rho2 = wx * wx + wy * wy
    free = SHOULDER_FREE * family[26]
    g2 = rho2 - offset * offset
    sides = 2
    bits = 0
    if rho2 < free * free and abs(offset) < free:
        sides, bits = 1, AT_SHOULDER
    elif g2 < free * free:
        if g2 < -REACH_SLACK * family[26] * family[26]:
            return 0
        sides, bits, g2 = 1, AT_SHOULDER, 0.0
    root = sqrt(max(g2, 0.0))
    k = np.int64(0)  # typed: a bare 0 would have every callee compiled once more for the literal
    for side in range(sides):
        g = root if side == 0 else -root
        if rho2 < free * free and abs(offset) < free:
            t1 = near[0]
            S1, C1 = sin_cos(t1)
        else:
            C1 = (g * wx - offset * wy) / rho2
            S1 = (offset * wx + g * wy) / rho2
            size = 1.0 / sqrt(C1 * C1 + S1 * S1)
            C1 *= size
            S1 *= size
            t1 = arc_tangent(S1, C1)
        shoulder = Shoulder(t1, C1, S1, bits | (LEFT if side == 1 else 0))
        if family[0] == 1.0:
            k = _offset_wrist(family, W, near, shoulder, k, solutions, work)
        else:
            k = _spherical_wrist(family, W, near, shoulder, k, solutions, work)
    return k


@kernel
def solve_closed_many(chain, family, base, tool, T, here, Q, code, count):
    """Solve each T (m, 4, 4): Q (m, 8, 6), code (m, 8), count (m,); see `solve_closed`."""
    near = _dh_angles(chain, here)
    W = np.empty(12)
    work = np.empty(3)
    for i in range(T.shape[0]):
        count[i] = _solve(family, base, tool, T[i], near, Solutions(Q[i], code[i]), W, work)


@kernel
def nearest_turns(chain, q, here, slack):
    """Move turning joints of q (n,) by whole turns: within limits where that is possible, and nearest to here (n,).

    Return whether all joints are within their limits, give or take slack.
    """
    inside = True
    for i in range(q.shape[0]):
        row = chain[i + 1]
        low, high = row[9] - slack, row[10] + slack
        if row[0] == 0.0:
            turn = TWO_PI / abs(row[1])
            k = np.floor((here[i] - q[i]) / turn + 0.5)
            first = np.ceil((low - q[i]) / turn)
            last = np.floor((high - q[i]) / turn)
            if first <= last:
                k = min(max(k, first), last)
            q[i] += k * turn
        inside = inside and low <= q[i] <= high
    return inside


@kernel
def settle(chain, T, count, here, tolerance, Q, code, errors, inside):
    """Bring the first count rows of Q (9, n) near here (n,), and those that reach the pose to the front, nearest first.

    code (9,) goes along; errors (9, 3): off the pose in m and rad, and the largest distance of a joint from here;
    inside (9,): within the limits. tolerance: the slack of limits, and by how many m and rad the pose may be missed;
    return how many keep it.
    """
    slack, most_m, most_rad = tolerance
    n = chain.shape[0] - 2
    F = np.empty((n + 2, 12))
    e = np.empty(6)
    q = np.empty(n)
    kept = np.int64(0)
    for k in range(count):
        q[:] = Q[k]
        bits = code[k]
        fits = nearest_turns(chain, q, here, slack)
        off_m, off_rad = pose_error(chain, T, q, np.int64(6), F, e)
        if not (off_m <= most_m and off_rad <= most_rad):  # also where one is NaN
            continue
        far = np.abs(q - here).max()
        i = kept
        while i > 0 and errors[i - 1, 2] > far:  # insertion: there are nine at most
            Q[i], code[i], errors[i], inside[i] = Q[i - 1], code[i - 1], errors[i - 1], inside[i - 1]
            i -= 1
        Q[i], code[i], inside[i] = q, bits, fits
        errors[i, 0], errors[i, 1], errors[i, 2] = off_m, off_rad, far
        kept += 1
    return kept
