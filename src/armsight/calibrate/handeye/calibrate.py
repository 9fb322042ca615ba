"""Hand-eye calibration from pose pairs: check, solve, uncertainty, advice; of a recording with its errors' drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.advice import advise, require_one_mount
from armsight.calibrate.handeye.consensus import LEAST_SHARE, Consensus, check_reading, consensus
from armsight.calibrate.handeye.noise import noise_of_pairs
from armsight.calibrate.handeye.one_axis import TargetHeight, calibrate_about_one_axis
from armsight.calibrate.handeye.pairs import (
    MIN_PAIRS,
    Arrays,
    PosePairs,
    Setup,
    components,
    pose,
    require_metres,
    require_turning,
)
from armsight.calibrate.handeye.result import NAMES, HandEyeResult, RejectedPair, Scale
from armsight.calibrate.handeye.solution import (
    Solution,
    fit_drifting,
    left_out_blocks,
    residuals,
    solve_pairs,
    uncertainty,
)
from armsight.errors import DataRefused, Degenerate, Inconsistent
from armsight.fitting.groups import means, repeats
from armsight.fitting.quantiles import chi2_isf, f_isf, t_sf
from armsight.records import NamedCovariance
from armsight.units import DEG, MM

SAME_PLACE = 1e-3
"""Poses of the robot at one place differ by no more (rad, m): what it comes back to is a tenth of it."""

FALSE_ALARM = 1e-5
"""Chance that any pair of a good set is called an outlier, or its scale wrong: one set in a hundred thousand."""

MEDIAN_3 = 1.538
"""Median length of three unit normals."""

MATTERS = 0.5
"""A pair that is off its place's others by its noise alone matters from this share of what places differ by."""

REJECTION_ROUNDS = 10
"""Rounds of naming outliers and fitting again; two or three settle it."""


def calibrate_eye_in_hand(
    pairs: PosePairs, *, target_pitch_m: float | None = None, target_height: TargetHeight | None = None
) -> HandEyeResult:
    """Return T_flange_camera and T_base_target from T_base_flange * T_flange_camera * T_camera_target = T_base_target.

    target_pitch_m: pitch of the printed target, where there is one, so that advice can name the right one.
    target_height: for a hand that turned about one axis alone, see one_axis.
    Raises Degenerate for too little turning, Inconsistent for wrong units, inverted or wrongly paired poses and
    poses without agreement, NotConverged. Zhuang, Roth, Sudhakar 1994 (Pachidis 2005 section 4), by maximum likelihood.
    """
    return _calibrate(pairs, Setup.EYE_IN_HAND, target_pitch_m, target_height)


def calibrate_eye_to_hand(
    pairs: PosePairs, *, target_pitch_m: float | None = None, target_height: TargetHeight | None = None
) -> HandEyeResult:
    """Return T_base_camera and T_flange_target from T_base_camera * T_camera_target = T_base_flange * T_flange_target.

    Raises as calibrate_eye_in_hand.
    """
    return _calibrate(pairs, Setup.EYE_TO_HAND, target_pitch_m, target_height)


def expected_deviation(
    pairs: PosePairs, setup: Setup, *, sigma_m: float = 0.3 * MM, sigma_rad: float = 0.05 * DEG
) -> dict[str, float]:
    """Return the standard deviations that these poses can reach at best, from their geometry alone, by name.

    sigma_m, sigma_rad: noise of one component of a camera pose. Where the pairs are consistent, the residuals play no
    part: the answer is the inverse of the information that such poses carry.
    """
    variances = np.array([sigma_m**2, sigma_rad**2, 0.0])
    solution = solve_pairs(pairs.arrays(setup), setup, variances=variances)
    return dict(zip(NAMES, np.sqrt(np.diag(solution.C)).tolist(), strict=True))


def places_of(T_base_flange: RigidTransform) -> NDArray[np.intp]:
    """Return the first pair (G,) at each pose of the robot."""
    return np.unique(_places(T_base_flange), return_index=True)[1]


def _places(T_base_flange: RigidTransform) -> NDArray[np.intp]:
    """Return (n,) at which pose of the robot each pair was taken."""
    R, t = T_base_flange.rotation.as_matrix().reshape(-1, 9), T_base_flange.translation
    return repeats(np.column_stack([R / np.sqrt(2.0), t]), SAME_PLACE)


def _calibrate(pairs: PosePairs, setup: Setup, pitch_m: float | None, height: TargetHeight | None) -> HandEyeResult:
    require_metres(pairs)
    place = np.arange(len(pairs)) if pairs.t_s is not None else _places(pairs.T_base_flange)
    repeated = {row: why for row, _, why in pairs.duplicates()}
    rows = np.array([i for i in range(len(pairs)) if i not in repeated], dtype=np.intp)
    chosen = pairs.take(rows) if repeated else pairs
    if (told := _about_one_axis(chosen, setup, height)) is not None:
        return told
    solution, left_out, keep = _solve_places(chosen, setup, np.unique(place[rows], return_inverse=True)[1])
    _require_others(chosen, np.flatnonzero(keep & ~np.isfinite(left_out).all(axis=1)))
    used = np.zeros(len(pairs), bool)
    used[rows[keep]] = True
    turned = require_turning(pairs.take(np.flatnonzero(used)))
    std, dof, of_variances = uncertainty(solution)
    found = residuals(pairs.arrays(setup), *solution.poses)
    errors = found.copy()
    errors[rows] = left_out
    widen = std / np.sqrt(np.diag(solution.C))
    finished = HandEyeResult(
        setup=setup,
        T_parent_camera=pose(solution.R_X, solution.t_x),
        T_parent_target=pose(solution.R_Z, solution.t_z),
        covariance=NamedCovariance(names=NAMES, matrix=solution.C * np.outer(widen, widen)),
        dof=float(dof[:6].min()),
        noise=noise_of_pairs(solution, of_variances),
        scale=true_scale(solution),
        rotation_excitation=turned,
        pairs=pairs,
        used=used,
        rejected_pairs=_rejected(pairs, repeated, used, errors),
        residuals=found,
        left_out=errors,
        concerns=(),
        advice=(),
        covariance_factor=None if solution.weighed is None else float(solution.variances[3]),
    )
    if pairs.t_s is not None:
        finished = _of_a_recording(finished, pairs.t_s, _noise(solution, rows[chosen.canonical_order()], len(pairs)))
    require_one_mount(finished, place)
    return advise(finished, pitch_m)


def _about_one_axis(pairs: PosePairs, setup: Setup, height: TargetHeight | None) -> HandEyeResult | None:
    """Return the calibration of a hand that turned about one axis; None of one that turned about two.

    Raises Degenerate without a height, Inconsistent for one that is not needed.
    """
    try:
        require_turning(pairs)
    except Degenerate as why:
        return calibrate_about_one_axis(pairs, setup, why, height)
    if height is not None:
        raise Inconsistent(
            "a target's height is given, and the hand turned about two axes",
            consequence="The poses tell it, and the height would not be used",
            cure="Leave --target-height away, and compare it with the target's z in the result",
        )
    return None


def _require_others(pairs: PosePairs, alone: NDArray[np.intp]) -> None:
    """Raise Degenerate where there are pairs (k,) without which the others do not tell the whole answer."""
    if alone.size:
        raise Degenerate(
            f"without {pairs.names[alone[0]]} the other pairs do not fix the whole answer",
            consequence="An error in that pose would go unseen; no calibration is given",
            cure="Add poses that tilt the hand about two axes as that one does, five in all at least",
        )


def _noise(solution: Solution, rows: NDArray[np.intp], n: int) -> Array | None:
    """Return the noise (n, 6, 6) of each pair of a weighed fit to some rows; None where all are alike."""
    if solution.weighed is None:
        return None
    noise = np.tile(solution.weighed.V.mean(axis=0), (n, 1, 1))  # of rows that repeat others: any
    noise[rows] = solution.weighed.V
    return noise


def _of_a_recording(found: HandEyeResult, t_s: Array, noise: Array | None) -> HandEyeResult:
    """Return the calibration with the errors' drift in it: weighed, claimed and left out by it.

    noise (n, 6, 6): of each pair up to a factor; None where all are alike.
    """
    arrays = found.pairs.arrays(found.setup)
    X, Z = found.T_parent_camera, found.T_parent_target
    start = (X.rotation.as_matrix(), np.asarray(X.translation), Z.rotation.as_matrix(), np.asarray(Z.translation))
    at, C, correlation = fit_drifting(arrays, found.used, start, t_s, noise)
    return replace(
        found,
        T_parent_camera=pose(at[0], at[1]),
        T_parent_target=pose(at[2], at[3]),
        covariance=NamedCovariance(names=NAMES, matrix=C),
        residuals=residuals(arrays, *at),
        left_out=left_out_blocks(arrays, found.used, at, t_s, correlation, noise),
        correlation=correlation,
    )


def _solve_places(pairs: PosePairs, setup: Setup, place: NDArray[np.intp]) -> tuple[Solution, Array, NDArray[np.bool_]]:
    """Return the fit to the mean pair of each place, and of each pair the left-out error (n, 6) and whether it is used.

    Pairs (n,) at one place share the robot's error there, which no number of them averages out.
    """
    if place[-1] + 1 == len(pairs):
        solution, left_out, order = _solve_in_order(pairs, setup)
        back = np.argsort(order)
        return solution, left_out[back], solution.keep[back]
    arrays = pairs.arrays(setup)
    given = consensus(arrays)
    check_reading(arrays, setup, given, arrays)
    lengths = _lengths(residuals(arrays, *given.start))
    # the others at a place are held against its middle one by what most agree on
    order, count = np.lexsort([lengths @ [1.0 / given.sigma_m, 1.0 / given.sigma_rad], place]), np.bincount(place)
    middle = order[np.cumsum(count) - count // 2 - 1]
    once, _, order = _solve_in_order(pairs.take(middle), setup)
    r = residuals(arrays, *once.poses)
    lengths = _lengths(r - r[middle[place]])
    own = np.median(np.delete(lengths, middle, axis=0), axis=0) / MEDIAN_3
    of_places = np.sqrt(np.mean(r[middle[order[once.keep]]].reshape(-1, 2, 3) ** 2, axis=(0, 2)))
    size = np.maximum(own, MATTERS * of_places)
    fine = ((lengths / size) ** 2).sum(axis=1) <= chi2_isf(FALSE_ALARM / len(pairs), 6)
    of_each = _means(pairs.take(np.flatnonzero(fine)), place[fine])
    solution, left_out, order = _solve_in_order(of_each, setup)
    back = np.argsort(order)
    off = residuals(arrays, *solution.poses) - residuals(of_each.arrays(setup), *solution.poses)[place]
    return solution, left_out[back][place] + off, fine & solution.keep[back][place]


def _lengths(errors: Array) -> Array:
    """Return how far positions and turns (n, 2) of errors (n, 6) are off."""
    return np.asarray(np.linalg.norm(errors.reshape(-1, 2, 3), axis=2))


def _means(pairs: PosePairs, place: NDArray[np.intp]) -> PosePairs:
    """Return the mean pair of each place (n,), called as its first."""
    poses = []
    for R, t in (components(pairs.T_base_flange), components(pairs.T_camera_target)):
        U, _, Vt = np.linalg.svd(means(R, place))
        poses.append(RigidTransform.from_components(means(t, place), Rotation.from_matrix(U @ Vt)))
    C = pairs.camera_covariance
    return PosePairs(
        T_base_flange=poses[0],
        T_camera_target=poses[1],
        names=tuple(pairs.names[i] for i in np.unique(place, return_index=True)[1]),
        camera_covariance=None if C is None else means(C, place) / np.bincount(place)[:, None, None],
        unweighed=pairs.unweighed,
    )


def _solve_in_order(pairs: PosePairs, setup: Setup) -> tuple[Solution, Array, NDArray[np.intp]]:
    """Return the fit to pairs in an order of their own, the left-out error (n, 6) of each in it, and that order (n,).

    The answer so does not depend on the order in which the pairs are given.
    """
    order = pairs.canonical_order()
    as_given = pairs.arrays(setup)
    arrays: Arrays = tuple(np.ascontiguousarray(a[order]) for a in as_given)  # type: ignore[assignment]  # four stay four
    given = consensus(arrays)
    check_reading(arrays, setup, given, as_given)
    known = None if pairs.camera_covariance is None else pairs.camera_covariance[order]
    solution, left_out = settle(arrays, setup, given, known)
    return solution, left_out, order


def settle(arrays: Arrays, setup: Setup, given: Consensus, known: Array | None = None) -> tuple[Solution, Array]:
    """Return the fit to the pairs that belong to it, and the left-out error (n, 6) of each.

    known (n, 6, 6): covariances of the camera's poses.

    A pair is an outlier where its prediction from the other used pairs is off by more than chance allows in any
    pair of FALSE_ALARM of all good sets (Hotelling's T-square on the left-out error). Raises Inconsistent where fewer
    than LEAST_SHARE of the pairs stay.
    """
    n, keep, start = len(given.keep), given.keep, given.start
    for _ in range(REJECTION_ROUNDS):
        solution = solve_pairs(arrays, setup, keep=keep, start=start, known=known)
        start = solution.poses
        errors, q = solution.left_out()
        # the T-square that a good pair exceeds by chance in FALSE_ALARM of all sets of this size
        limit = 6.0 * float(f_isf(FALSE_ALARM / n, 6, max(3 * solution.n_used - 6, 3)))
        fitting = np.where(np.isfinite(q), q <= limit, keep)
        if (fitting == keep).all():
            break
        if fitting.sum() < max(MIN_PAIRS, LEAST_SHARE * n):
            raise Inconsistent(
                f"only {fitting.sum()} of {n} pairs agree with each other",
                consequence="The rest outvote any answer; no calibration is given",
                cure="Check which robot pose belongs to which image, and that nothing moved during the recording",
            )
        keep = fitting
    return solution, errors


def true_scale(solution: Solution) -> Scale | None:
    """Return the true over the assumed size of the target; None where these poses cannot tell."""
    try:
        free = solve_pairs(
            solution.arrays,
            solution.setup,
            keep=solution.keep,
            start=solution.poses,
            free_scale=True,
            known=None if solution.weighed is None else solution.weighed.known,
        )
    except DataRefused:
        return None
    grown, dof, _ = uncertainty(free)
    std = float(np.sqrt(free.C[12, 12]))
    if not (free.gamma > 0.0 and std < 0.2):
        return None
    p = 2.0 * float(t_sf(abs(free.gamma - 1.0) / std, dof[12]))
    return Scale(factor=1.0 / free.gamma, std=float(grown[12]) / free.gamma**2, p=p)


def _rejected(
    pairs: PosePairs, repeated: dict[int, str], used: NDArray[np.bool_], errors: Array
) -> tuple[RejectedPair, ...]:
    """Return the pairs that were not used, in the order of the file."""
    out = []
    for i in np.flatnonzero(~used).tolist():
        if i in repeated:
            why = repeated[i]
        else:
            move, turn = np.linalg.norm(errors[i, :3]), np.linalg.norm(errors[i, 3:])
            why = f"off by {move / MM:.3g} mm and {turn / DEG:.3g} degrees from what the other pairs say"
        out.append(RejectedPair(row=i + 1, name=pairs.names[i], why=why))
    return tuple(out)
