"""Compiled forward kinematics, Jacobian and parameter derivatives of a serial chain.

chain (n + 2, 12): row 0 is the first frame's pose in world as its upper three rows, row n + 1 is T_flange_tool
likewise; row i is joint i: prismatic (0 or 1), sign, theta, d, a, cos alpha, sin alpha, cos beta, sin beta, lower,
upper, alpha. A joint's step is Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). All lengths in m, angles in rad.

One pose is computed in scalars. Many poses are computed BLOCK at a time with one value of each pose side by side in one
buffer, so that the compiler uses vector instructions; one joint's constants are then read once per block.
"""

from __future__ import annotations

from math import pi

import numpy as np

from armsight._numba import fast_kernel, inner_fast_kernel, inner_kernel, parallel_kernel, prange

BLOCK = 32
"""Poses per block: 16 and 64 were slower (0.08 and 0.07 against 0.06 us a pose)."""

X, Y, Z, P, S, C, D, A, B, V, W = 0, 3, 6, 9, 12, 13, 14, 15, 18, 21, 24
"""Slots of the buffer: columns of the rotation and origin (three slots each); sine, cosine and d of the joint at work;
its axis and the axis' origin; the linear and the angular part of its column of the Jacobian."""

STATE = 27


@fast_kernel
def joint_frames(chain, q, F):
    """Fill F (n + 2, 12) with the frames base, after each joint, tool: columns x, y, z, origin in world axes."""
    n = chain.shape[0] - 2
    for c in range(4):
        for r in range(3):
            F[0, 3 * c + r] = chain[0, 4 * r + c]
    for i in range(n):
        row = chain[i + 1]
        if row[0] == 0.0:
            s, c = sin_cos(row[1] * q[i] + row[2])
            d = row[3]
        else:
            s, c = sin_cos(row[2])
            d = row[1] * q[i] + row[3]
        # on columns, no matrix products: Rz turns x and y, Tz and Tx move the origin, Rx turns y and z, Ry then z and x
        a, ca, sa, cb, sb = row[4], row[5], row[6], row[7], row[8]
        for r in range(3):
            x = F[i, r] * c + F[i, 3 + r] * s
            y = F[i, 3 + r] * c - F[i, r] * s
            z = F[i, 6 + r]
            F[i + 1, 9 + r] = F[i, 9 + r] + z * d + x * a
            F[i + 1, 3 + r] = y * ca + z * sa
            z = z * ca - y * sa
            F[i + 1, r] = x * cb - z * sb
            F[i + 1, 6 + r] = x * sb + z * cb
    for r in range(3):
        x = F[n, r]
        y = F[n, 3 + r]
        z = F[n, 6 + r]
        for c in range(4):
            v = x * chain[n + 1, c] + y * chain[n + 1, 4 + c] + z * chain[n + 1, 8 + c]
            F[n + 1, 3 * c + r] = v + F[n, 9 + r] if c == 3 else v


@inner_fast_kernel
def frames_jacobian(chain, F, J):
    """Fill J (6, n), linear over angular velocity of the tool in world axes, from the frames F (n + 2, 12)."""
    n = chain.shape[0] - 2
    for i in range(n):
        # turning: z x (p - o) over z; sliding: z over 0 (Siciliano et al. 2009, equation 3.30), times the reading's
        # sign
        zx, zy, zz = F[i, 6], F[i, 7], F[i, 8]
        g = chain[i + 1, 1]
        if chain[i + 1, 0] == 0.0:
            px = F[n + 1, 9] - F[i, 9]
            py = F[n + 1, 10] - F[i, 10]
            pz = F[n + 1, 11] - F[i, 11]
            J[0, i] = g * (zy * pz - zz * py)
            J[1, i] = g * (zz * px - zx * pz)
            J[2, i] = g * (zx * py - zy * px)
            J[3, i] = g * zx
            J[4, i] = g * zy
            J[5, i] = g * zz
        else:
            J[0, i] = g * zx
            J[1, i] = g * zy
            J[2, i] = g * zz
            J[3, i] = 0.0
            J[4, i] = 0.0
            J[5, i] = 0.0


@fast_kernel
def one_pose(chain, q, T):
    """Fill T (4, 4) with T_world_tool at the joint values q (n,)."""
    n = chain.shape[0] - 2
    F = np.empty((n + 2, 12))
    joint_frames(chain, q, F)
    frame_matrix(F[n + 1], T)


@inner_kernel
def frame_matrix(frame, T):
    """Fill T (4, 4) from one frame (12,): columns x, y, z, origin."""
    for c in range(4):
        for r in range(3):
            T[r, c] = frame[3 * c + r]
        T[3, c] = 0.0
    T[3, 3] = 1.0


@fast_kernel
def one_pose_jacobian(chain, q, T, J):
    """Fill T (4, 4) and J (6, n) in world axes at the joint values q (n,)."""
    n = chain.shape[0] - 2
    F = np.empty((n + 2, 12))
    joint_frames(chain, q, F)
    frame_matrix(F[n + 1], T)
    frames_jacobian(chain, F, J)


@inner_fast_kernel
def _start_block(chain, w):
    """Set every pose of the block to the first frame's."""
    for c in range(4):
        for r in range(3):
            value = chain[0, 4 * r + c]
            at = (3 * c + r) * BLOCK
            for b in range(BLOCK):
                w[at + b] = value


@inner_fast_kernel
def _joint_block(row, q, first, count, i, w):
    """Carry the block over joint i, whose values are q[first : first + count, i]."""
    for b in range(BLOCK):
        # the last block may be short: its idle lanes go through the same loops, on zeros
        w[D * BLOCK + b] = 0.0
    for b in range(count):
        w[D * BLOCK + b] = q[first + b, i]
    if row[0] == 0.0:
        for b in range(BLOCK):
            s, c = sin_cos(row[1] * w[D * BLOCK + b] + row[2])
            w[S * BLOCK + b] = s
            w[C * BLOCK + b] = c
            w[D * BLOCK + b] = row[3]
    else:
        s0, c0 = sin_cos(row[2])
        for b in range(BLOCK):
            w[S * BLOCK + b] = s0
            w[C * BLOCK + b] = c0
            w[D * BLOCK + b] = row[1] * w[D * BLOCK + b] + row[3]
    a, ca, sa = row[4], row[5], row[6]
    for r in range(3):
        for b in range(BLOCK):
            s = w[S * BLOCK + b]
            c = w[C * BLOCK + b]
            x0 = w[(X + r) * BLOCK + b]
            y0 = w[(Y + r) * BLOCK + b]
            z0 = w[(Z + r) * BLOCK + b]
            x = x0 * c + y0 * s
            y = y0 * c - x0 * s
            w[(P + r) * BLOCK + b] += z0 * w[D * BLOCK + b] + x * a
            w[(X + r) * BLOCK + b] = x
            w[(Y + r) * BLOCK + b] = y * ca + z0 * sa
            w[(Z + r) * BLOCK + b] = z0 * ca - y * sa
    # sine of beta: only axes that are nearly parallel have one (Hayati's form, MATH 4.5)
    if row[8] != 0.0:
        cb, sb = row[7], row[8]
        for r in range(3):
            for b in range(BLOCK):
                x = w[(X + r) * BLOCK + b]
                z = w[(Z + r) * BLOCK + b]
                w[(X + r) * BLOCK + b] = x * cb - z * sb
                w[(Z + r) * BLOCK + b] = x * sb + z * cb


@inner_fast_kernel
def _tool_block(tool, w):
    """Carry the block over the fixed T_flange_tool, given as row (12,) of the chain."""
    for r in range(3):
        for b in range(BLOCK):
            x = w[(X + r) * BLOCK + b]
            y = w[(Y + r) * BLOCK + b]
            z = w[(Z + r) * BLOCK + b]
            w[(X + r) * BLOCK + b] = x * tool[0] + y * tool[4] + z * tool[8]
            w[(Y + r) * BLOCK + b] = x * tool[1] + y * tool[5] + z * tool[9]
            w[(Z + r) * BLOCK + b] = x * tool[2] + y * tool[6] + z * tool[10]
            w[(P + r) * BLOCK + b] += x * tool[3] + y * tool[7] + z * tool[11]


@inner_kernel
def is_identity(frame):
    """Tell whether a fixed transform, given as row (12,) of the chain, does nothing."""
    different = 0
    for k in range(12):
        different += frame[k] != (1.0 if k in (0, 5, 10) else 0.0)
    return different == 0


@inner_kernel
def _write_block(w, first, count, T):
    """Store the block's poses in T[first : first + count] (., 4, 4)."""
    for b in range(count):
        out = T[first + b]
        for r in range(3):
            for c in range(4):
                out[r, c] = w[(3 * c + r) * BLOCK + b]
        out[3, 0] = 0.0
        out[3, 1] = 0.0
        out[3, 2] = 0.0
        out[3, 3] = 1.0


@fast_kernel
def many_poses(chain, q, T):
    """Fill T (m, 4, 4) with T_world_tool at each row of q (m, n)."""
    m, n = q.shape
    w = np.empty(STATE * BLOCK)
    tool = not is_identity(chain[n + 1])
    for first in range(0, m, BLOCK):
        count = min(BLOCK, m - first)
        _start_block(chain, w)
        for i in range(n):
            _joint_block(chain[i + 1], q, first, count, i, w)
        if tool:
            _tool_block(chain[n + 1], w)
        _write_block(w, first, count, T)


@inner_fast_kernel
def _jacobian_block(prismatic, g, w):
    """Fill the slots V, W with one joint's column for each pose, from its axis in the slots A (z), B (origin)."""
    if prismatic:
        for k in range(3 * BLOCK):
            w[V * BLOCK + k] = g * w[A * BLOCK + k]
            w[W * BLOCK + k] = 0.0
        return
    for b in range(BLOCK):
        zx = g * w[A * BLOCK + b]
        zy = g * w[(A + 1) * BLOCK + b]
        zz = g * w[(A + 2) * BLOCK + b]
        px = w[P * BLOCK + b] - w[B * BLOCK + b]
        py = w[(P + 1) * BLOCK + b] - w[(B + 1) * BLOCK + b]
        pz = w[(P + 2) * BLOCK + b] - w[(B + 2) * BLOCK + b]
        w[V * BLOCK + b] = zy * pz - zz * py
        w[(V + 1) * BLOCK + b] = zz * px - zx * pz
        w[(V + 2) * BLOCK + b] = zx * py - zy * px
        w[W * BLOCK + b] = zx
        w[(W + 1) * BLOCK + b] = zy
        w[(W + 2) * BLOCK + b] = zz


@fast_kernel
def many_poses_jacobians(chain, q, T, J):
    """Fill T (m, 4, 4) and J (m, 6, n) in world axes at each row of q (m, n)."""
    m, n = q.shape
    w = np.empty(STATE * BLOCK)
    axes = np.empty((n, 6 * BLOCK))
    tool = not is_identity(chain[n + 1])
    for first in range(0, m, BLOCK):
        count = min(BLOCK, m - first)
        _start_block(chain, w)
        for i in range(n):
            for k in range(6 * BLOCK):
                axes[i, k] = w[Z * BLOCK + k]  # z and the origin lie side by side
            _joint_block(chain[i + 1], q, first, count, i, w)
        if tool:
            _tool_block(chain[n + 1], w)
        _write_block(w, first, count, T)
        # only now: a column needs the origin of the tool, which stands in P at the end of the chain
        for i in range(n):
            for k in range(6 * BLOCK):
                w[A * BLOCK + k] = axes[i, k]
            _jacobian_block(chain[i + 1, 0] != 0.0, chain[i + 1, 1], w)
            for b in range(count):
                for r in range(6):
                    J[first + b, r, i] = w[(V + r) * BLOCK + b]


# On all cores: these take longer to compile, and only big batches need them.

CHUNK = 4096
"""Poses handed to a core at a time: about a quarter of a millisecond of work."""


@parallel_kernel
def many_poses_on_all_cores(chain, q, T):
    """Fill T (m, 4, 4) with T_world_tool at each row of q (m, n), chunks spread over the cores."""
    m = q.shape[0]
    for k in prange((m + CHUNK - 1) // CHUNK):
        stop = min(m, (k + 1) * CHUNK)
        many_poses(chain, q[k * CHUNK : stop], T[k * CHUNK : stop])


@parallel_kernel
def many_poses_jacobians_on_all_cores(chain, q, T, J):
    """Fill T (m, 4, 4) and J (m, 6, n) in world axes at each row of q (m, n), chunks spread over the cores."""
    m = q.shape[0]
    for k in prange((m + CHUNK - 1) // CHUNK):
        stop = min(m, (k + 1) * CHUNK)
        many_poses_jacobians(chain, q[k * CHUNK : stop], T[k * CHUNK : stop], J[k * CHUNK : stop])


# Sine, cosine and arc tangent without branches, so that the compiler can run several of them at once.
#
# Range reduction after Cody and Waite, polynomials of fdlibm (Sun Microsystems 1993, k_sin.c, k_cos.c, s_atan.c), exact
# to about one unit in the last place for angles up to 1e6 rad. The arguments must be finite.

TWO_PI = 2.0 * pi
PER_TURN = 1.0 / TWO_PI
TAN_PI_8 = 0.41421356237309503
QUARTER = 0.25 * pi
HALF = 0.5 * pi


@inner_fast_kernel
def sin_cos(x):
    """Return (sin x, cos x) of a finite angle in radians."""
    k = np.floor(x * 0.6366197723675814 + 0.5)
    r = x - k * 1.5707963267341256  # pi / 2 in three parts of 33 bits
    r = r - k * 6.077100506303966e-11
    r = r - k * 2.0222662487959506e-21
    z = r * r
    p = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    p = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * p))
    s = r + r * z * (-1.66666666666666324348e-01 + z * p)
    p = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    p = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * p))
    c = 1.0 - 0.5 * z + z * z * p
    n = np.int64(k)
    odd = (n & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    if n & 2:
        sine = -sine
    if (n + 1) & 2:
        cosine = -cosine
    return sine, cosine


@inner_fast_kernel
def arc_tangent(y, x):
    """Return the angle of the direction (x, y) in (-pi, pi]; zero where both are zero."""
    ax = abs(x)
    ay = abs(y)
    large = max(ax, ay)
    small = min(ax, ay)
    steep = small > TAN_PI_8 * large
    top = small - large if steep else small
    bottom = small + large if steep else large
    t = top / bottom if bottom > 0.0 else 0.0
    z = t * t
    p = 4.97687799461593236017e-02 + z * (-3.65315727442169155270e-02 + z * 1.62858201153657823623e-02)
    p = 6.66107313738753120669e-02 + z * (-5.83357013379057348645e-02 + z * p)
    p = 9.09088713343650656196e-02 + z * (-7.69187620504482999495e-02 + z * p)
    p = 1.42857142725034663711e-01 + z * (-1.11111104054623557880e-01 + z * p)
    p = 3.33333333333329318027e-01 + z * (-1.99999999998764832476e-01 + z * p)
    angle = t - t * z * p
    if steep:
        angle += QUARTER
    if ay > ax:
        angle = HALF - angle
    if x < 0.0:
        angle = pi - angle
    return -angle if y < 0.0 else angle


@inner_kernel
def wrap(x):
    """Return the angle x brought into [-pi, pi]."""
    return x - TWO_PI * np.floor(x * PER_TURN + 0.5)
