"""Where the rig stands to the arm's base (Kapucu and Baysec 2005, section 2: the displacement matrix), and whether its
scale is the arm's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import stdtr

from armsight.arrays import Array
from armsight.calibrate.arm.covariance import ALIKE, FEWEST_TIMED
from armsight.calibrate.arm.fit import added_noise, placed
from armsight.calibrate.arm.plausibility import MOST_SHARE, check_one_position, ranges, senseless, spread_m
from armsight.calibrate.arm.points import ArmPoints, check_points, in_order, of_places
from armsight.calibrate.arm.result import RobotWorldResult
from armsight.calibrate.correlation import Correlation, fit_averaged
from armsight.columns import POSE6
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.fitting import Evaluation, Loss, LossKind, Problem, Settings, solve
from armsight.fitting.quantiles import MEDIAN_3, chi2_ppf, student_factor
from armsight.geometry import align_points
from armsight.geometry.poses import stepped
from armsight.kinematics import Arm, fk
from armsight.kinematics.axes import links_told
from armsight.records import NamedCovariance

_Refined = tuple[RigidTransform, NamedCovariance, tuple[str, ...]]

GROSS = float(np.sqrt(chi2_ppf(1.0 - 1e-7, 3)))
"""Errors beyond so many standard deviations are gross, and left out."""
WORLD_FIT_TRIES = 300
"""Draws of three positions: with half of the rows wrong, one draw in eight is without a wrong one."""
WORLD_FIT_SEED = 11
"""The same measurements give the same answer."""
WEIGHING_ROUNDS = 5
"""Fits with what the one before left unexplained; two or three settle it."""
LEAST_LEFT = 4
"""Rows that must be left: six unknowns, and something to judge them by."""


def calibrate_world(arm: Arm, points: ArmPoints) -> RobotWorldResult:
    """Return where the rig stands in base axes, from the tool's positions in rig axes at joint readings.

    The tool's origin where rows have no name of a point, or one and the same; else the arm's tool points by name.
    Kabsch on the arm's forward kinematics from the triple of positions that half of the rows agree with best, then
    robust least squares with the noise estimated; readings of one place are one row, and the errors of one recording's
    rows may drift. Rows that do not agree are rejected. Raises as check_points,
    NotEnoughData where too few agree, Inconsistent where fewer than half do, Ambiguous where the others agree on
    another position, Degenerate where the positions lie on one line.
    """
    check_points(arm, points)
    points = replace(points, q=arm.sagged(points.q))  # positions were measured at rest
    check_one_position(arm, points)
    local = _positions(arm, points)
    base = np.asarray(arm.T_world_base.inv().apply(local))
    T, kept = _majority(base, points.xyz_m, len(of_places(points)))
    doubts = check_motion_scale(base[kept], points.xyz_m[kept])
    size = np.linalg.norm(T.apply(points.xyz_m) - base, axis=1)
    typical, spread = float(np.median(size[kept])), spread_m(points.xyz_m)
    if 2 * len(kept) < len(points) or typical > MOST_SHARE * spread:
        raise senseless(size, spread)
    out = np.setdiff1d(np.arange(len(points)), kept)
    _check_others(base, points.xyz_m, kept, out)
    notes = (*doubts, *links_told(arm), *((points.unweighed,) if points.unweighed else ()))
    if points.covariance is None:
        found = _refine(T, *_independent(arm, points.take(kept)), 0.0)
    else:
        found, kept, note = _weighed(T, arm, points, kept)
        notes, out = (*notes, note), np.setdiff1d(np.arange(len(points)), kept)
    T, covariance, told = found
    notes = (*notes, *told)
    size = np.linalg.norm(T.apply(points.xyz_m) - base, axis=1)
    rejected = tuple((int(row), f"misses the others' rig by {1e3 * size[row]:.3g} mm") for row in out)
    return RobotWorldResult(
        pose=T, covariance=covariance, residual_m=size, rejected_rows=rejected, notes=notes, doubts=doubts
    )


def _independent(arm: Arm, points: ArmPoints) -> tuple[ArmPoints, Array]:
    """Return one row for all readings of a place, with their order for a time where they follow one motion, and where
    the arm puts them (k, 3) in base axes."""
    rows = in_order(of_places(points))
    if len(rows) < LEAST_LEFT:
        raise NotEnoughData(
            f"the {len(points)} rows that agree are readings of {len(rows)} places, {LEAST_LEFT} are the least",
            consequence="Where the rig stands is not given",
            cure="Measure at more joint positions; further rows at the same ones do not help",
        )
    return rows, np.asarray(arm.T_world_base.inv().apply(_positions(arm, rows)))


def _weighed(
    T: RigidTransform, arm: Arm, points: ArmPoints, kept: NDArray[np.intp]
) -> tuple[_Refined, NDArray[np.intp], str]:
    """Return the rig's pose from rows weighed by their covariances, the rows used, and what to say.

    Rows that are far off only because they are known poorly belong to it.
    """
    base_m = np.asarray(arm.T_world_base.inv().apply(_positions(arm, points)))
    for _ in range(WEIGHING_ROUNDS):
        near, there = _independent(arm, points.take(kept))
        added = added_noise(near.xyz_m - T.inv().apply(there), near)
        found = _refine(T, near, there, added)
        T = found[0]
        off = np.linalg.norm(points.whiten(points.xyz_m - T.inv().apply(base_m), added), axis=1)
        good = np.flatnonzero(off <= GROSS * max(float(np.median(off[kept])) / np.sqrt(MEDIAN_3), 1.0))
        if len(good) < LEAST_LEFT or np.array_equal(good, kept):
            break
        kept = good
    text = (
        f"Rows are weighed by the covariances of their positions and {1e3 * added:.2g} mm that these leave unexplained"
    )
    return found, kept, text


def _positions(arm: Arm, points: ArmPoints) -> Array:
    """Return where the arm puts the rows' points, (m, 3) in world; Inconsistent where it does not know one of them."""
    T = fk(arm, points.q)
    known = {point.name: point for point in arm.tool_points}
    if len(points.labels) == 1 and (not known or points.labels == ("",)):
        return np.asarray(T[:, :3, 3])
    unknown = [label for label in points.labels if label not in known]
    if unknown:
        there = f"its file knows {', '.join(known)}" if known else "its file knows no points by name"
        raise Inconsistent(
            f"the rows are of the tool's points {', '.join(map(repr, points.labels))}, and where "
            f"{', '.join(map(repr, unknown))} is on {arm.name} is not known: {there}",
            consequence="Where the rig stands is not given",
            cure="Give an arm.yaml with these tool_points (calibrate arm writes it), or rows of the tool's own origin",
        )
    in_tool = {name: arm.T_flange_tool.inv().apply(point.xyz_m) for name, point in known.items()}
    at = np.stack([in_tool[label] for label in points.point])
    return np.asarray(np.einsum("mij,mj->mi", T[:, :3, :3], at) + T[:, :3, 3])


def _majority(base_m: Array, rig_m: Array, places: int) -> tuple[RigidTransform, NDArray[np.intp]]:
    """Return the pose of the rig that positions (m, 3) of so many places agree on, and the rows that do.

    What the pose takes up of few places' errors is given back (Rousseeuw and Leroy 1987, p. 202): else good ones of
    nine places, read twelve times each, are gross once in 200 times.
    """
    T = _consensus(base_m, rig_m)
    few = 1.0 + 5.0 / max(3.0 * places - len(POSE6), 1.0)
    size = np.linalg.norm(T.apply(rig_m) - base_m, axis=1)
    kept = np.argsort(size)[: max((len(size) + 1) // 2, LEAST_LEFT)]
    middle = float(chi2_ppf(0.5 * len(kept) / len(size), 3))  # of the nearest half the median is a quarter's quantile
    for _ in range(10):
        size = np.linalg.norm(T.apply(rig_m) - base_m, axis=1)
        sigma = max(few * float(np.median(size[kept]) / np.sqrt(middle)), 1e-9)
        middle = MEDIAN_3
        good = np.flatnonzero(size <= GROSS * sigma)
        if len(good) < LEAST_LEFT:
            raise NotEnoughData(
                f"only {len(good)} of {len(rig_m)} positions agree with the arm",
                consequence="Where the rig stands is not given",
                cure="Check that arm, joint readings and positions belong together, row by row",
            )
        T = placed(base_m[good], rig_m[good])
        if np.array_equal(good, kept):
            break
        kept = good
    return T, kept


def _consensus(base_m: Array, rig_m: Array) -> RigidTransform:
    """Return the pose from the triple of positions that half of all positions miss by least."""
    rng = np.random.default_rng(WORLD_FIT_SEED)
    half = (len(rig_m) + 1) // 2 - 1
    best, least = placed(base_m, rig_m), np.inf  # raises where all positions are on one line
    for _ in range(WORLD_FIT_TRIES):
        rows = rng.choice(len(rig_m), 3, replace=False)
        try:
            T = placed(base_m[rows], rig_m[rows])
        except Degenerate:
            continue
        miss = float(np.partition(np.linalg.norm(T.apply(rig_m) - base_m, axis=1), half)[half])
        if miss < least:
            best, least = T, miss
    return best


def _check_others(base_m: Array, rig_m: Array, kept: NDArray[np.intp], out: NDArray[np.intp]) -> None:
    """Raise Ambiguous where the rows left out agree on another position of the rig, about as many as those kept."""
    if len(out) < max(2 * LEAST_LEFT, 0.8 * len(kept)):
        return
    try:
        T, agree = _majority(base_m[out], rig_m[out], len(out))
    except (NotEnoughData, Degenerate):
        return
    miss = np.linalg.norm(T.apply(rig_m[out]) - base_m[out], axis=1)[agree]
    if len(agree) >= 0.8 * len(kept) and np.median(miss) < MOST_SHARE * spread_m(rig_m):
        raise Ambiguous(
            f"rows {ranges(out[agree])} put the rig elsewhere than rows {ranges(kept)}",
            consequence="Where the rig stands is not given: it moved, or the readings are of two set-ups",
            cure="Give the rows of one of them",
        )


def _refine(T: RigidTransform, points: ArmPoints, base_m: Array, added_m: float) -> _Refined:
    """Return the rig's pose by least squares, its covariance, and what to say of rows that are not independent.

    added_m: to the rows' covariances, if there are.
    """
    sigma = max(float(np.sqrt(np.mean((T.apply(points.xyz_m) - base_m) ** 2))), 1e-9)
    noise_m = sigma if points.covariance is None else added_m
    to_rig = T.rotation.as_matrix().T  # covariances are in rig axes, and so are the whitened residuals

    def evaluate(p: Array, _: Array) -> Evaluation:
        turned = points.xyz_m @ Rotation.from_rotvec(np.array(p[3:])).as_matrix().T
        J = np.zeros((len(points), 3, 6))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:] = np.cross(np.eye(3), turned[:, None, :]).transpose(0, 2, 1)
        r = points.whiten((turned + p[:3] - base_m) @ to_rig.T, noise_m)
        return Evaluation.of_one(r, points.whiten(to_rig @ J, noise_m))

    def retract(p: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
        return stepped(p, step, (3,)), local + step_local

    problem = Problem(
        names=POSE6,
        guess=np.append(T.translation, T.rotation.as_rotvec()),
        evaluate=evaluate,
        retract=retract,
        n_residuals=3 * len(points),
        loss=Loss(kind=LossKind.HUBER, scale=3.0, block=3),
    )
    fit = solve(problem, Settings(estimate_noise=True))
    if fit.covariance is None:
        raise Degenerate("the positions leave the rig's pose open", cure="Move at least two joints")
    p = np.array(fit.shared)
    at, shape = evaluate(p, np.empty((1, 0))), (len(points), 3)
    step, C, told = _believed(points, at.residuals.reshape(shape), at.shared.reshape(*shape, 6), fit.covariance.matrix)
    p, _ = retract(p, np.empty((1, 0)), step, np.empty((1, 0)))
    pose = RigidTransform.from_components(p[:3], Rotation.from_rotvec(p[3:]))
    return pose, NamedCovariance(names=POSE6, matrix=C), told


def _believed(points: ArmPoints, r: Array, J: Array, C: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the step (6,) to the best pose, its covariance, and what to say, where errors r (k, 3) may drift.

    J (k, 3, 6), C (6, 6): their derivative, and the covariance of independent ones. Few rows have Student's intervals.
    """
    step, worth, t_s = np.zeros(len(POSE6)), float(len(points)), points.t_s
    told: tuple[str, ...] = ()
    if t_s is not None and len(points) >= FEWEST_TIMED and np.ptp(t_s) > 0.0:
        drift = fit_averaged(r, J, t_s)
        step, C, worth = drift.step, drift.C, drift.correlation.n_effective
        told = _drift_told(points, t_s, drift.correlation)
    student = float(student_factor(max(3.0 * worth - len(POSE6), 1.0)))
    return step, student**2 * C, told


def _drift_told(points: ArmPoints, t_s: Array, correlation: Correlation) -> tuple[str, ...]:
    """Return what to say of rows of a recording whose errors hang together."""
    if correlation.neighbours(float(np.median(np.diff(np.unique(t_s))))) < ALIKE:
        return ()
    return (
        f"The rows are samples of a stream{' in their order' if points.counted else ''}, and their errors drift: the "
        f"{len(points)} rows are worth {correlation.n_effective:.0f} independent ones",
    )


# Whether positions in the rig's axes are as far apart as the arm moved between them.

SURE = 1e-5
"""Chance below which a wrong scale is believed: one good set in a hundred thousand is accused, as in hand-eye."""
MOST_OFF = 0.01
"""Scales further from one are no print's tolerance (some 0.5 %) and no arm's: lengths of a nominal one are known to
0.2 %, while a wrong square, a wrong baseline or a page fitted to the paper are off by more."""
NOTED_OFF = 0.002
"""Scales further from one are told: those of three real sets of a UR10 by its nominal lengths are within 0.0014."""


def motion_scale(base_m: Array, rig_m: Array) -> tuple[float, float]:
    """Return by what positions (m, 3) are larger than the arm's motion (m, 3), and the standard deviation of that.

    Least squares of rig = k R base + t (Umeyama 1991, equation 42), so that noise of the positions does not shrink it;
    the deviation is by the residuals, with the seven unknowns counted.
    """
    b, x = base_m - base_m.mean(axis=0), rig_m - rig_m.mean(axis=0)
    turned = b @ align_points(rig_m, base_m).T_a_b.rotation.as_matrix().T
    spread = float((b**2).sum())
    k = float((x * turned).sum()) / spread
    variance = float(((x - k * turned) ** 2).sum()) / (3 * len(x) - 7)
    return k, float(np.sqrt(variance / spread))


def check_motion_scale(base_m: Array, rig_m: Array) -> tuple[str, ...]:
    """Return a note where positions (m, 3), four or more, are of a slightly other scale than the arm's motion.

    Raises Inconsistent where they are of another one altogether.
    """
    k, std = motion_scale(base_m, rig_m)
    off, freedom = abs(k - 1.0), 3 * len(rig_m) - 7
    if std * np.sqrt(freedom) > MOST_SHARE:  # no scale makes them the arm's
        return ()
    if off <= NOTED_OFF or 2.0 * float(stdtr(freedom, -off / max(std, 1e-12))) >= SURE:
        return ()
    further = "further" if k > 1.0 else "less far"
    cause = f"the positions are {100.0 * off:.3g} +- {100.0 * std:.2g} % {further} apart than the arm moved its tool"
    check = "the size of the board's squares that the rig was calibrated with, its baseline, and "
    if off <= MOST_OFF:
        wrong = "where the rig stands is wrong by as much of its distance, which no standard deviation here tells"
        return (f"{cause}: {wrong}. Check {check}whether the arm's file is of this arm",)
    raise Inconsistent(
        cause,
        consequence="Where the rig stands would be wrong by as much of its distance, and nothing is written",
        cure=f"Check {check}the unit of the positions; then whether the arm's file is of this arm, and its tool's "
        "point the one that was measured",
    )
