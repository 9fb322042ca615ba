"""Maximum likelihood of both unknowns, with the noises of robot and camera, from pose pairs.

The errors of poses of one recording drift, and are alike for a while.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.correlation import Correlation, fit_averaged, time_blocks
from armsight.calibrate.handeye.kernels import closed_forms as starts
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.kernels import noise as noise_kernels
from armsight.calibrate.handeye.known_noise import (
    BELIEVED,
    CONDITION,
    Fitted,
    Weighing,
    fit_weighed,
    left_out,
    moved,
    residuals_after,
)
from armsight.calibrate.handeye.pairs import Arrays, Poses, Setup
from armsight.errors import NotConverged
from armsight.fitting.groups import leave_one_out, whitener
from armsight.fitting.quantiles import student_factor

FLOOR = np.array([1e-22, 1e-22, 1e-24])
"""Variances are kept above (0.01 nm)^2 and (1e-11 rad)^2, so that exact data can be fitted as well."""

LEAST_OWN = 0.1
"""At least this share of the position's residual variance is the positions' own: what turns about the flange moves
the target across the lever, never along it. Half a dozen poses could else be fitted with no noise of position."""

TOLERANCE = 5e-3
"""The fit is settled when parameters move by less than this share of their standard deviation, variances of their
size."""

LIMIT = 100


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """The fit of F X B = Z.

    RX, tX, RZ, tZ: the unknowns. gamma: distances seen by the camera over distances moved by the robot, 1 unless
    free. variances (3,): of the translation (robot's and camera's together), of the camera's orientation and of the
    robot's. C (m, m): covariance of (dtX, dwX, dtZ, dwZ[, gamma]). e (n, 6), J (n, 6, m), lever (n,): whitened
    residuals and derivatives in the lever's axes. log_likelihood: restricted.
    weighed: where the camera's poses brought covariances; variances are then (4,), the last the factor on these.
    """

    setup: Setup
    arrays: Arrays
    keep: NDArray[np.bool_]
    R_X: Array
    t_x: Array
    R_Z: Array
    t_z: Array
    gamma: float
    variances: Array
    C: Array
    e: Array
    J: Array
    lever: Array
    log_likelihood: float
    iterations: int
    weighed: Weighing | None = None

    @classmethod
    def of(
        cls, setup: Setup, arrays: Arrays, keep: NDArray[np.bool_], fitted: Fitted, weighed: Weighing | None = None
    ) -> Solution:
        """Return the solution of a fit to the kept pairs (n,)."""
        (RX, tX), (RZ, tZ), gamma, variances, C, (e, J, lever), likelihood, iterations = fitted
        return cls(
            setup=setup,
            arrays=arrays,
            keep=keep,
            R_X=RX,
            t_x=tX,
            R_Z=RZ,
            t_z=tZ,
            gamma=gamma,
            variances=variances,
            C=C,
            e=e,
            J=J,
            lever=lever,
            log_likelihood=likelihood,
            iterations=iterations,
            weighed=weighed,
        )

    @property
    def poses(self) -> Poses:
        """RX, tX, RZ, tZ."""
        return self.R_X, self.t_x, self.R_Z, self.t_z

    @property
    def n_used(self) -> int:
        """Pairs in the fit."""
        return int(self.keep.sum())

    def residuals(self) -> Array:
        """Return (n, 6): every pair, also those left out, against the fit: camera axes, m and rad."""
        return residuals(self.arrays, self.R_X, self.t_x, self.R_Z, self.t_z, self.gamma)

    def left_out(self) -> tuple[Array, Array]:
        """Return the error (n, 6) of each pair as predicted from the other used ones, and its chi-square (n,)."""
        X, Z, to_hand = (self.R_X, self.t_x), (self.R_Z, self.t_z), self.setup is Setup.EYE_TO_HAND
        if self.weighed is not None:
            return left_out(self.arrays, X, Z, self.gamma, self.weighed.V, self.keep, self.C, to_hand=to_hand)
        n = len(self.keep)
        e, J, all_pairs = np.empty((n, 6)), np.empty((n, 6, len(self.C))), np.ones(n, np.bool_)
        observed = self.arrays, all_pairs, to_hand
        kernels.weigh((X, Z, self.gamma), observed, self.variances, e, J, np.empty(n))
        steps, q = leave_one_out(e, J, self.C, self.keep)
        return residuals_after(self.arrays, X, Z, self.gamma, steps), q


def solve_pairs(
    arrays: Arrays,
    setup: Setup,
    *,
    keep: NDArray[np.bool_] | None = None,
    start: Poses | None = None,
    variances: Array | None = None,
    free_scale: bool = False,
    known: Array | None = None,
) -> Solution:
    """Return the maximum-likelihood X, Z of F X B = Z, the noises by restricted maximum likelihood.

    arrays: of PosePairs.arrays. keep (n,): the pairs to use. start: RX, tX, RZ, tZ, by default Shah's closed form.
    variances (3,): known and held, else estimated. free_scale: the camera's distances carry a common factor gamma.
    known (n, 6, 6): covariances of the camera's poses, in its axes; the others are then what they leave unexplained.
    Raises NotConverged. Model of the noise: the robot's pose is off by N(0, s_t) m and N(0, s_r) rad about the
    flange, which reaches the target through its lever; the camera's by N(0, c_t) m and N(0, c_r) rad; s_t and c_t
    act alike and only their sum is known.
    """
    keep = np.ones(len(arrays[0]), bool) if keep is None else keep
    (RX, tX, RZ, tZ), gamma = _closed_form(arrays, keep, free_scale) if start is None else (start, 1.0)
    X, Z, m = (RX, tX), (RZ, tZ), 13 if free_scale else 12
    if known is not None:
        least, settled = (FLOOR, LEAST_OWN), (TOLERANCE, LIMIT)
        to_hand = setup is Setup.EYE_TO_HAND
        found = fit_weighed(arrays, known, keep, (X, Z, gamma), least, to_hand=to_hand, n_free=m, settled=settled)
        if found is None:
            raise _not_converged("no minimum with the camera poses' covariances")
        return Solution.of(setup, arrays, keep, *found)
    first = kernels.first_variances((X, Z, gamma), arrays, keep, FLOOR) if variances is None else variances
    theta, floor = np.maximum(first, FLOOR), FLOOR.copy()
    if variances is None:
        floor[0] = max(floor[0], LEAST_OWN * theta[0])
    observed, noise = (arrays, keep, setup is Setup.EYE_TO_HAND), (theta, floor, variances is None)
    ok, *fitted = kernels.fit_pairs((X, Z, gamma), observed, noise, m, (TOLERANCE, LIMIT))
    if not ok:
        raise _not_converged(f"no minimum after {fitted[-1]} iterations")
    return Solution.of(setup, arrays, keep, tuple(fitted))


def _closed_form(arrays: Arrays, keep: NDArray[np.bool_], free_scale: bool) -> tuple[Poses, float]:
    """Return RX, tX, RZ, tZ by Shah's closed form, and gamma: 1 unless free."""
    RX, RZ = starts.shah_rotations(arrays[0], arrays[2], keep)
    ok, tX, tZ, gamma = starts.translations(RX, arrays[0], arrays[1], arrays[3], keep, free_scale)
    if not ok:
        raise _not_converged("the translations are not determined")
    return (RX, tX, RZ, tZ), gamma


def residuals(arrays: Arrays, RX: Array, tX: Array, RZ: Array, tZ: Array, gamma: float = 1.0) -> Array:
    """Return (n, 6): the measured T_camera_target against X^-1 F^-1 Z, camera axes, m and rad."""
    RF, tF, RB, tB = arrays
    P = RX.T @ RF.transpose(0, 2, 1)  # (n, 3, 3)
    t = np.einsum("nij,nj->ni", P, tZ - tF) - RX.T @ tX
    out = np.empty((len(RF), 6))
    out[:, :3] = tB - gamma * t
    out[:, 3:] = starts.rotvecs(RB @ (P @ RZ).transpose(0, 2, 1))
    return out


def uncertainty(solution: Solution) -> tuple[Array, Array, Array]:
    """Return what noises that were estimated from the fit's own residuals leave uncertain.

    std (m,): standard deviations with what wrong weights cost (Kenward, Roger 1997), widened by Student's factor, so
    that +- 1.96 std holds 95 %. dof (m,): effective degrees of freedom behind each parameter's variance (Satterthwaite
    1946). covariance (k, k): of the variances.
    """
    Q = _shapes(solution)  # (k, n, 6, 6) whitened derivative of the noise by each variance
    J, C = solution.J, solution.C
    M = J @ C @ J.transpose(0, 2, 1)  # (n, 6, 6)
    m = len(C)
    B = np.stack([J.reshape(-1, m).T @ QJ.reshape(-1, m) for QJ in Q @ J])  # (k, m, m)
    flat, turned = Q.reshape(len(Q), -1), (Q @ M).swapaxes(2, 3).reshape(len(Q), -1)
    information = flat @ flat.T - 2.0 * flat @ turned.T  # tr Qk Qj, tr Qk Qj M
    CB = C @ B
    information = 0.5 * (information + np.einsum("kab,jba->kj", CB, CB))
    if solution.weighed is not None:
        information[-1, -1] += 1.0 / (BELIEVED * solution.variances[-1]) ** 2
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))  # variances are in m2, rad2 and none
    both = np.outer(scale, scale)
    covariance = both * np.linalg.pinv(both * information, rcond=1e-12, hermitian=True)
    slope = np.diagonal(CB @ C, axis1=1, axis2=2)  # (k, m): dC / d variance
    spread = ((covariance @ slope) * slope).sum(axis=0)
    QJ, every = (Q @ J).reshape(len(Q), -1, m), range(len(Q))
    lost = sum(covariance[k, j] * (QJ[k].T @ QJ[j] - B[k] @ C @ B[j]) for k in every for j in every)
    variance = np.diag(C)
    grown = variance + 2.0 * np.maximum(np.diag(C @ lost @ C), 0.0)
    dof = np.clip(2.0 * variance**2 / np.maximum(spread, 1e-300), 1.0, 1e6)
    factor = student_factor(dof)
    return np.sqrt(grown) * factor, dof, covariance


def warm_up() -> None:
    """Compile the kernels, or load them from disk, so that the first calibration is not kept waiting."""
    turns = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.2, 0.3], [0.2, -0.3, 0.1]])
    R = np.ascontiguousarray(Rotation.from_rotvec(turns).as_matrix())
    back = np.ascontiguousarray(R.transpose(0, 2, 1))
    arrays = (R, np.zeros((5, 3)), back, 0.5 * turns + np.array([0.0, 0.0, 0.5]))
    solve_pairs(arrays, Setup.EYE_IN_HAND, variances=np.array([1e-4, 1e-4, 0.0])).left_out()


def _shapes(solution: Solution) -> Array:
    """Return (k, n, 6, 6): the derivative of the whitened noise by each variance, zero for pairs not used."""
    if solution.weighed is not None:
        return solution.weighed.Q
    n = len(solution.keep)
    Q = np.zeros((3, n, 6, 6))
    w, q = np.empty(5), np.empty((3, 5))
    for i in np.flatnonzero(solution.keep):
        noise_kernels.shapes(solution.lever[i], solution.variances, w, q)
        for k in range(3):
            block = np.array([[q[k, 0], q[k, 1]], [q[k, 1], q[k, 2]]])
            Q[k, i, :2, :2] = Q[k, i, 2:4, 2:4] = block
            Q[k, i, 4, 4], Q[k, i, 5, 5] = q[k, 3], q[k, 4]
    return Q


def _not_converged(why: str) -> NotConverged:
    return NotConverged(
        f"the hand-eye fit found no answer: {why}",
        consequence="No calibration is given",
        cure="Check which robot pose belongs to which image, and record poses that turn the hand about two axes",
    )


STEP = 1e-6
"""Of the numerical derivatives, m and rad."""


def fit_drifting(
    arrays: Arrays, keep: NDArray[np.bool_], start: Poses, t_s: Array, noise: Array | None = None
) -> tuple[Poses, Array, Correlation]:
    """Return the fit to the kept pairs whose errors are white noise and a drift that is forgotten exponentially.

    With its covariance (12, 12) of (dtX, dwX, dtZ, dwZ), turns from the left, and how the errors hang together.

    arrays: of PosePairs.arrays, start: RX, tX, RZ, tZ near the answer, t_s (n,): times of the pairs. In the camera's
    axes all components drift alike, positions and turns each by their own size, or each pair by its noise (n, 6, 6).
    """
    used: Arrays = tuple(a[keep] for a in arrays)  # type: ignore[assignment]  # four stay four
    r, J = _linear(used, start)  # (n, 6), (n, 6, 12)
    if noise is None:
        size = np.repeat(np.sqrt([np.mean(r[:, :3] ** 2), np.mean(r[:, 3:] ** 2)]), 3)
        size = np.maximum(size, 1e-12)
        r, J = r / size, J / size[:, None]
    else:
        W = whitener(noise[keep], CONDITION)
        r, J = np.einsum("nij,nj->ni", W, r), W @ J
    found = fit_averaged(r, J, t_s[keep])
    return _moved(start, found.step), found.C, found.correlation


def _linear(arrays: Arrays, start: Poses) -> tuple[Array, Array]:
    """Return the residuals (n, 6) in camera axes, and their derivative (n, 6, 12) by steps of `_moved`."""
    r = residuals(arrays, *start)
    J = np.empty((len(r), 6, 12))
    for a in range(12):
        step = np.zeros(12)
        step[a] = STEP
        J[:, :, a] = (residuals(arrays, *_moved(start, step)) - residuals(arrays, *_moved(start, -step))) / (2.0 * STEP)
    return r, J


def _moved(start: Poses, step: Array) -> Poses:
    """Return RX, tX, RZ, tZ after a step (12,) of (dtX, dwX, dtZ, dwZ)."""
    (RX, tX), (RZ, tZ), _ = moved(start[:2], start[2:], 1.0, step)
    return RX, tX, RZ, tZ


def left_out_blocks(
    arrays: Arrays,
    keep: NDArray[np.bool_],
    start: Poses,
    t_s: Array,
    correlation: Correlation,
    noise: Array | None = None,
) -> Array:
    """Return the error (n, 6) of each pair against the fit to the pairs further away in time than a drift lasts.

    The recording is parted into blocks of equal time; each is left out with what lies within a correlation time.
    """
    out = residuals(arrays, *start)
    for inside, away in time_blocks(t_s, correlation):
        others = keep & away
        if others.sum() < 4:
            continue
        at, _, _ = fit_drifting(arrays, others, start, t_s, noise)
        there: Arrays = tuple(a[inside] for a in arrays)  # type: ignore[assignment]  # four stay four
        out[inside] = residuals(there, *at)
    return out
