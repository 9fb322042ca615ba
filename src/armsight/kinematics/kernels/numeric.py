"""Compiled numeric inverse kinematics of any chain: Newton-Raphson, and damped least squares within limits."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from armsight._numba import inner_fast_kernel, inner_kernel, kernel
from armsight.kinematics.kernels.chain import arc_tangent, frames_jacobian, joint_frames

CONVERGED, STEPS, MINIMUM, LIMITS, SINGULAR, DIVERGED = 0, 1, 2, 3, 4, 5
"""Why a run stopped: tolerance reached; out of steps; the error has a local minimum; ... against a limit; the Jacobian
has no inverse (Newton); the values ran away (Newton)."""

RUN_AWAY = 1e3
"""Newton's values beyond this many rad or m have diverged."""

LARGEST_STEP = 1.0
"""Longest step of one joint in rad or m: beyond a radian the linear model says nothing."""

FLAT = 1e-12
"""A gradient this small against the error itself means a local minimum."""

DAMPING_FLOOR = 1e-14
DAMPING_SHARE = 0.3
"""Damping in proportion to the squared error keeps steps sane far off and vanishes at the solution (Sugihara 2011)."""

NEARLY_HALF_TURN = 1e-6


@inner_kernel
def rotation_error(T, frame, e):
    """Fill e[3:6] with the rotation vector, in world axes, from the frame (12,) to T (4, 4)."""
    # E = R_target R_now^T
    E = np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            E[r, c] = T[r, 0] * frame[c] + T[r, 1] * frame[3 + c] + T[r, 2] * frame[6 + c]
    x = 0.5 * (E[2, 1] - E[1, 2])
    y = 0.5 * (E[0, 2] - E[2, 0])
    z = 0.5 * (E[1, 0] - E[0, 1])
    s = sqrt(x * x + y * y + z * z)
    c = 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0)
    # the antisymmetric part holds the axis times the sine, which vanishes at half a turn too: there E + 1 = 2 a a'
    if s < NEARLY_HALF_TURN:
        if c > 0.0:
            scale = 1.0
        else:  # half a turn: the axis is the largest column of E + 1
            k = 0
            for i in range(1, 3):
                if E[i, i] > E[k, k]:
                    k = i
            x, y, z = E[0, k], E[1, k], E[2, k]
            x += 1.0 if k == 0 else 0.0
            y += 1.0 if k == 1 else 0.0
            z += 1.0 if k == 2 else 0.0
            scale = pi / sqrt(x * x + y * y + z * z)
    else:
        scale = arc_tangent(s, c) / s
    e[3] = x * scale
    e[4] = y * scale
    e[5] = z * scale


@inner_kernel
def pose_error(chain, T, q, rows, F, e):
    """Fill F and e (6,) with the error of T_world_tool at q; return its size in m and in rad (0 where rows is 3)."""
    n = chain.shape[0] - 2
    joint_frames(chain, q, F)
    for r in range(3):
        e[r] = T[r, 3] - F[n + 1, 9 + r]
    m = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if rows == 3:
        return m, 0.0
    rotation_error(T, F[n + 1], e)
    return m, sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@inner_fast_kernel
def _normal_equations(J, e, rows, weight, H, g):
    """Fill H (n, n) = J^T W J and g (n,) = J^T W e, W = weight on the first three rows."""
    n = J.shape[1]
    for i in range(n):
        s = weight * (J[0, i] * e[0] + J[1, i] * e[1] + J[2, i] * e[2])
        if rows == 6:
            s += J[3, i] * e[3] + J[4, i] * e[4] + J[5, i] * e[5]
        g[i] = s
        for j in range(i + 1):
            s = weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j] + J[2, i] * J[2, j])
            if rows == 6:
                s += J[3, i] * J[3, j] + J[4, i] * J[4, j] + J[5, i] * J[5, j]
            # the lower half: the Cholesky factor reads no other
            H[i, j] = s


@inner_fast_kernel
def _damped_step(H, g, damping, held, L, step):
    """Solve (H + damping) step = g over the joints that are not held; return False where that has no answer."""
    n = g.shape[0]
    for i in range(n):
        if held[i]:
            continue
        for j in range(i + 1):
            if held[j]:
                continue
            s = H[i, j]
            if i == j:
                s += damping
            for k in range(j):
                if not held[k]:
                    s -= L[i, k] * L[j, k]
            if i == j:
                # a pivot that cancels to rounding: the Jacobian is singular, and the damping does not lift it
                if not s > 1e-15 * H[i, i]:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        if held[i]:
            step[i] = 0.0
            continue
        s = g[i]
        for k in range(i):
            if not held[k]:
                s -= L[i, k] * step[k]
        step[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        if held[i]:
            continue
        s = step[i]
        for k in range(i + 1, n):
            if not held[k]:
                s -= L[k, i] * step[k]
        step[i] = s / L[i, i]
    return True


@inner_kernel
def _hold_joints(chain, q, g, held):
    """Hold the joints that stand at a limit and are pulled beyond it; return whether any is."""
    any_held = False
    for i in range(q.shape[0]):
        low, high = chain[i + 1, 9], chain[i + 1, 10]
        held[i] = (q[i] <= low and g[i] < 0.0) or (q[i] >= high and g[i] > 0.0)
        any_held = any_held or held[i]
    return any_held


@inner_kernel
def _trial_values(chain, q, step, trial):
    """Fill trial with q + step, cut to LARGEST_STEP and to the limits."""
    longest = 0.0
    for i in range(q.shape[0]):
        longest = max(longest, abs(step[i]))
    scale = LARGEST_STEP / longest if longest > LARGEST_STEP else 1.0
    for i in range(q.shape[0]):
        value = q[i] + scale * step[i]
        trial[i] = min(max(value, chain[i + 1, 9]), chain[i + 1, 10])


@kernel
def solve_damped_least_squares(chain, T, rows, weight, tol_m, tol_rad, max_steps, q, errors):
    """Improve q (n,) in place until the tool stands at T (4, 4); return (reason, steps), errors (2,) in m and rad.

    rows: 6 for the pose, 3 for the position alone. weight: 1 / m^2 that makes metres and radians comparable.
    Levenberg-Marquardt with damping in proportion to the squared error (Sugihara 2011); joints at a limit are held
    while the error pulls them beyond it.
    """
    n = q.shape[0]
    F = np.empty((n + 2, 12))
    J = np.empty((6, n))
    H = np.empty((n, n))
    L = np.empty((n, n))
    vectors = np.empty((5, 6 if n < 6 else n))
    g, step, trial, e, e_trial = vectors[0, :n], vectors[1, :n], vectors[2, :n], vectors[3], vectors[4]
    held = np.zeros(n, np.bool_)
    for i in range(n):
        q[i] = min(max(q[i], chain[i + 1, 9]), chain[i + 1, 10])
    m, rad = pose_error(chain, T, q, rows, F, e)
    cost = weight * m * m + rad * rad
    extra = 0.0
    for steps in range(max_steps + 1):
        errors[0] = m
        errors[1] = rad
        if m <= tol_m and rad <= tol_rad:
            return CONVERGED, steps
        if steps == max_steps:
            break
        frames_jacobian(chain, F, J)
        _normal_equations(J, e, rows, weight, H, g)
        any_held = _hold_joints(chain, q, g, held)
        slope = 0.0
        for i in range(n):
            if not held[i]:
                slope = max(slope, abs(g[i]))
        # against the error itself: the gradient shrinks with it, at a solution as well
        if slope * slope <= FLAT * cost * (1.0 + weight):
            return (LIMITS if any_held else MINIMUM), steps
        better = False
        for _ in range(12):
            damping = DAMPING_SHARE * cost * (1.0 + extra) + DAMPING_FLOOR + extra * 1e-9
            if _damped_step(H, g, damping, held, L, step):
                _trial_values(chain, q, step, trial)
                m_trial, rad_trial = pose_error(chain, T, trial, rows, F, e_trial)
                cost_trial = weight * m_trial * m_trial + rad_trial * rad_trial
                if cost_trial < cost:
                    better = True
                    break
            # the linear model failed: more damping until it holds, a tenth of it after each step that helped
            extra = max(8.0 * extra, 1.0)
        if not better:
            return (LIMITS if any_held else MINIMUM), steps
        # steps that gain so little end in a minimum, or against limits, unless the pose is reached by them
        small = cost - cost_trial <= 1e-6 * cost and cost_trial > 0.0
        extra *= 0.1
        for i in range(n):
            q[i] = trial[i]
        for i in range(6):
            e[i] = e_trial[i]
        m, rad, cost = m_trial, rad_trial, cost_trial
        if small and not (m <= tol_m and rad <= tol_rad):
            errors[0] = m
            errors[1] = rad
            return (LIMITS if any_held else MINIMUM), steps + 1
    return STEPS, max_steps


@kernel
def solve_newton(chain, T, rows, weight, tol_m, tol_rad, max_steps, q, errors):
    """Newton-Raphson on q (n,) in place: full steps, no damping, no limits (Kapucu 2005 sections 1 and 3).

    A chain with more or fewer joints than rows takes the Gauss-Newton step. Returns and fills as
    `solve_damped_least_squares`.
    """
    n = q.shape[0]
    F = np.empty((n + 2, 12))
    J = np.empty((6, n))
    H = np.empty((n, n))
    L = np.empty((n, n))
    g = np.empty(n)
    step = np.empty(n)
    e = np.empty(6)
    held = np.zeros(n, np.bool_)
    for steps in range(max_steps + 1):
        m, rad = pose_error(chain, T, q, rows, F, e)
        errors[0] = m
        errors[1] = rad
        if m <= tol_m and rad <= tol_rad:
            return CONVERGED, steps
        frames_jacobian(chain, F, J)
        _normal_equations(J, e, rows, weight, H, g)
        if not _damped_step(H, g, 0.0, held, L, step):
            return SINGULAR, steps
        for i in range(n):
            q[i] += step[i]
            if not abs(q[i]) < RUN_AWAY:
                return DIVERGED, steps + 1
    return STEPS, max_steps


@kernel
def solve_many(chain, T, rows, weight, tol_m, tol_rad, max_steps, q, errors, reasons):
    """Improve each row of q (m, n) for its T (m, 4, 4) by damped least squares; errors (m, 2), reasons (m, 2)."""
    for i in range(q.shape[0]):
        reason, steps = solve_damped_least_squares(
            chain, T[i], rows, weight, tol_m, tol_rad, max_steps, q[i], errors[i]
        )
        reasons[i, 0] = reason
        reasons[i, 1] = steps


# Checks of poses, so that checking costs less than solving.

FINE, NOT_FINITE, NO_ROTATION = 0, 1, 2


@kernel
def check_poses(T, tolerance):
    """Return what is wrong with the first bad one of T (m, 4, 4), its row, and how far it is from a rotation."""
    for i in range(T.shape[0]):
        R = T[i]
        for r in range(4):
            for c in range(4):
                if not np.isfinite(R[r, c]):
                    return NOT_FINITE, i, np.nan
        off = 0.0
        for a in range(3):
            for b in range(a + 1):
                dot = R[0, a] * R[0, b] + R[1, a] * R[1, b] + R[2, a] * R[2, b]
                off = max(off, abs(dot - (1.0 if a == b else 0.0)))
        det = (
            R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
            - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
            + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
        )
        off = max(off, abs(det - 1.0))
        off = max(off, abs(R[3, 0]) + abs(R[3, 1]) + abs(R[3, 2]) + abs(R[3, 3] - 1.0))  # a transposed pose has t there
        if off > tolerance:
            return NO_ROTATION, i, off
    return FINE, -1, 0.0


@kernel
def farthest(T, chain):
    """Return the largest distance of a pose of T (m, 4, 4) from the chain's base in m, and its row."""
    worst = -1.0
    row = -1
    for i in range(T.shape[0]):
        x, y, z = T[i, 0, 3] - chain[0, 3], T[i, 1, 3] - chain[0, 7], T[i, 2, 3] - chain[0, 11]
        distance = sqrt(x * x + y * y + z * z)
        if distance > worst:
            worst = distance
            row = i
    return worst, row
