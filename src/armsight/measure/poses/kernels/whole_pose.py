"""Compiled pose of named spots with all that is in its covariance: noise, misfit, other tilts, rig and target.

And whether it is known well enough to be one.
"""

from __future__ import annotations

from math import sqrt

from armsight._numba import inner_kernel, kernel
from armsight.measure.poses.kernels.pose import SOLVED, solve_named
from armsight.measure.poses.kernels.pose_ambiguity import PLAIN, depth_chi2, fold, one_astray, scale
from armsight.measure.poses.kernels.rig_covariance import carry_to_pose

UNLIKE, UNCERTAIN = 6, 7
"""States beside those of solve_named: the spots do not fit the target, or leave the rotation open."""

NO_DOUBT, ONE_OFF, FOLDED = 0, 1, 2
"""What is in doubt: nothing, one of the spots, or to which side of the line of sight the target is tilted."""

MAX_ROTATION_SIGMA = 0.3
"""A rotation less certain than this (rad; 17 degrees) is none: its covariance, taken to first order, means nothing."""

MAX_DOUBTFUL_SIGMA = 0.07
"""The same (4 degrees) where another tilt fits as well, or a spot is of something else: the truth then lies in one of
several places, not about one."""

FOLDED_FROM = 1.05
"""Squared Mahalanobis distance of another tilt over what its residuals allow, from which that is the case."""

MISFIT_SIGMA = 2.326
"""Residuals further out than this normal deviation (1 %) widen the pose: cameras' noise models are off by up to a
factor of two in variance, so that a frame alone proves little."""


@inner_kernel
def misfit_factor(chi2, n_spots):
    """Return the factor on a pose's variance for residuals of n spots with this chi-square: 1 where they can be noise.

    From the point that one frame in a hundred passes by noise alone it grows with chi-square (4 n - 6 degrees of
    freedom; Wilson-Hilferty).
    """
    dof = max(4 * n_spots - 6, 1)
    spread = 2.0 / (9.0 * dof)
    usual = dof * (1.0 - spread + MISFIT_SIGMA * sqrt(spread)) ** 3
    return max(1.0, chi2 / usual)


@kernel
def solve_whole(rig, views, rules, lights, covariance, points, pose, residual):
    """Pose of a target from its n named spots; arguments and what is filled as of solve_named, and of carry_to_pose.

    rules: slack in px^2, and the largest chi-square, slack included, that is believed. covariance: of size 0 where rig
    and target are exact. Filled are points (P, S) and pose (T, C, systematic), of which C (6, 6) holds all, systematic
    (6, 6) the part of rig and target. Returns the state, the factor of misfit that is in C, and what is in doubt.
    """
    slack2, limit = rules
    P, S = points
    T, C, systematic = pose
    state, wide, chi2 = solve_named(rig, views, slack2, lights, P, S, T, C, residual)
    if state != SOLVED:
        return state, 1.0, NO_DOUBT
    if not wide <= limit:
        return UNLIKE, 1.0, NO_DOUBT
    X, radius, normal = lights
    if covariance.size > 0:
        chi2 = carry_to_pose(rig, views[1], X, T, covariance, C, residual, systematic)
    lights = (X.copy(), radius, normal)  # writable as in solve_named: one compilation serves both
    factor = misfit_factor(chi2, X.shape[0])
    doubt = NO_DOUBT
    for i in range(6):
        scale(C[i], factor)
    if factor > 1.0:
        one_astray(rig, lights, views, T, chi2, C)
        doubt = ONE_OFF
    if depth_chi2(P, S) < PLAIN * factor:
        folded = fold(rig, lights, views, T, factor, C)
        if doubt == NO_DOUBT and folded > FOLDED_FROM:
            doubt = FOLDED
    if covariance.size > 0:
        for i in range(6):
            for j in range(6):
                C[i, j] += systematic[i, j]
    most = MAX_ROTATION_SIGMA if doubt == NO_DOUBT else MAX_DOUBTFUL_SIGMA
    certain = max(C[3, 3], C[4, 4], C[5, 5]) <= most * most
    return SOLVED if certain else UNCERTAIN, factor, doubt
