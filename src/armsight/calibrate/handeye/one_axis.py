"""Hand-eye of arms that turn their hand about one axis alone (SCARA, palletiser, gantry): what the pairs tell of it.

Where F X B = Z and every F turns about the same axis, camera and target can go along it together and nothing shows it;
all else is told, the camera's tilt by the axis that it sees. One measured height closes it. A hand that never turns
leaves all three coordinates of the camera's place open, and its orientation told by the translations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.noise import Noise, Part
from armsight.calibrate.handeye.pairs import (
    LEAST_TURN_RAD,
    TURN_CURE,
    Arrays,
    PosePairs,
    Poses,
    Setup,
    pose,
    rotation_excitation,
)
from armsight.calibrate.handeye.result import NAMES, HandEyeResult, RejectedPair
from armsight.calibrate.handeye.solution import residuals
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Prior, Problem, Settings, solve
from armsight.fitting.groups import leave_one_out
from armsight.fitting.quantiles import chi2_isf, chi2_ppf, t_ppf
from armsight.geometry.poses import skew, stepped
from armsight.records import NamedCovariance
from armsight.units import DEG, MM, displayed_name

FEWEST = 6
"""Pairs: four of one axis fix eleven unknowns, and single ones must be contradicted."""
TURNS = 72
"""Turns of the camera about the axis that the closed form is tried at."""
ROUNDS = 6
"""Fits with the noises of the one before."""
FALSE_ALARM = 1e-5
BEYOND = 1.5
"""A target is not higher than so many times the hand's way from the base and the camera's to the target."""
MOST_WRONG = 0.2
MOST_M, MOST_RAD = 0.01, 2.0 * DEG
"""Noise of positions and orientations beyond which the pairs have no common answer."""
LEAST_M, LEAST_RAD = 1e-7, 1e-7
OPEN = 1e-6
"""Share of the strongest direction's information below which a direction is open; turns of 2.5 degrees leave 1e-3."""
PART = 0.05
"""Share of an open direction (m and rad alike) from which a parameter is in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetHeight:
    """z of the target in the frame that carries it (base for a camera on the hand, else flange), m, as measured."""

    z_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    fit: Fit
    noise: tuple[float, float]
    keep: NDArray[np.bool_]
    open_names: tuple[str, ...]
    covariance: Array


def calibrate_about_one_axis(
    pairs: PosePairs, setup: Setup, why: Degenerate, height: TargetHeight | None
) -> HandEyeResult:
    """Return the calibration of a hand that turned about one axis, from one measured height of the target.

    why: the refusal of a full calibration. Without the height, or where it is not enough, raises that with what is
    known and its deviations. Raises Inconsistent for pairs without a common answer.
    """
    if len(pairs) < FEWEST:
        raise why
    arrays = pairs.arrays(setup)
    _check_height(pairs, height)
    found = _robust(arrays, height)
    if found.open_names:
        raise _told(found, setup, why)
    # a hand that turned too little, about whichever axes: noise would decide what the rows seem to tell
    if height is None or rotation_excitation(pairs.T_base_flange.rotation).rms_rad[0] < LEAST_TURN_RAD:
        raise why
    return _result(pairs, setup, arrays, found, height)


def _check_height(pairs: PosePairs, height: TargetHeight | None) -> None:
    """Raise Inconsistent for a height beyond all that hand and camera reach: of millimetres taken as metres."""
    reach_m = sum(
        float(np.linalg.norm(T.translation, axis=1).max()) for T in (pairs.T_base_flange, pairs.T_camera_target)
    )
    if height is not None and abs(height.z_m) > BEYOND * reach_m:
        raise Inconsistent(
            f"the target's height is given as {height.z_m:g} m; hand and camera reach {reach_m:.2g} m",
            consequence="The camera would stand as far off, and no pair would show it",
            cure="Give metres, or the unit with the number (12mm)",
        )


def _robust(arrays: Arrays, height: TargetHeight | None) -> _Found:
    """Return the fit to the pairs that belong to it."""
    n = len(arrays[0])
    keep = np.ones(n, np.bool_)
    start = _start(arrays)
    for _ in range(ROUNDS):
        found = _fitted(arrays, keep, start, height)
        r = residuals(arrays, *_poses(found.fit.shared))
        size = ((r / np.repeat(found.noise, 3)) ** 2).sum(axis=1)
        fine = size <= float(chi2_isf(FALSE_ALARM / n, 6))
        if fine.sum() < max(FEWEST, (1.0 - MOST_WRONG) * n) or found.noise[0] > MOST_M or found.noise[1] > MOST_RAD:
            raise Inconsistent(
                f"the hand turned about one axis, and {int((~fine).sum())} of {n} pairs do not agree with the others "
                f"(positions {found.noise[0] / MM:.2g} mm, orientations {found.noise[1] / DEG:.2g} degrees off)",
                consequence="No calibration is given",
                cure="Check --setup, which way round the poses are, which belong together, and that nothing moved",
            )
        if (fine == keep).all():
            break
        keep, start = fine, found.fit.shared
    return found


def _fitted(arrays: Arrays, keep: NDArray[np.bool_], start: Array, height: TargetHeight | None) -> _Found:
    used: Arrays = tuple(a[keep] for a in arrays)  # type: ignore[assignment]  # four stay four
    n, at, noise = int(keep.sum()), start, (1e-3, 2e-3)
    z = NAMES.index("target.z_m")
    priors = {} if height is None else {NAMES[z]: Prior(mean=height.z_m, sigma=height.sigma_m)}
    for _ in range(ROUNDS):

        def evaluate(p: Array, _: Array, s: tuple[float, float] = noise) -> Evaluation:
            r, J = _linear(used, p)
            weight = np.repeat(1.0 / np.array(s), 3)
            return Evaluation.of_one(r * weight, J * weight[:, None])

        problem = Problem(
            names=NAMES,
            guess=at,
            evaluate=evaluate,
            n_residuals=6 * n,
            priors=priors,
            loss=Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chi2_ppf(0.99, 6))), block=6),
            retract=_retract,
        )
        fit = solve(problem, Settings(allow_undetermined=True, max_iterations=200))
        at = fit.shared
        r, J = _linear(used, at)
        weight = np.repeat(1.0 / np.array(noise), 3)
        information, A = _information(J * weight[:, None], height)
        C, open_names = _inverse(information)
        hat = np.einsum("nia,ab,nib->ni", A, C, A)
        before, noise = noise, _noise(r, hat)
        if max(abs(np.log(np.divide(noise, before)))) < 1e-3:
            break
    return _Found(fit=fit, noise=noise, keep=keep, open_names=open_names, covariance=C)


def _noise(r: Array, hat: Array) -> tuple[float, float]:
    """Return the noises of positions and of orientations of residuals (n, 6); hat: what the fit took of each."""
    # each residual has lost the share that the fit took of it
    left = 1.0 - hat
    parts = [float(np.sqrt((r[:, s] ** 2).sum() / max(left[:, s].sum(), 1.0))) for s in (slice(3), slice(3, 6))]
    return max(parts[0], LEAST_M), max(parts[1], LEAST_RAD)


def _information(J: Array, height: TargetHeight | None) -> tuple[Array, Array]:
    information = np.einsum("nia,nib->ab", J, J)
    if height is not None:
        z = NAMES.index("target.z_m")
        information[z, z] += height.sigma_m**-2
    return information, J


def _inverse(information: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the covariance of what is told, and the names of what is not."""
    values, vectors = np.linalg.eigh(information)
    there = values > OPEN * values[-1]
    # what moves along these shows in no pair
    open_ = vectors[:, ~there]
    inside = np.linalg.norm(open_, axis=1) > PART
    C = (vectors[:, there] / values[there]) @ vectors[:, there].T
    return C, tuple(name for name, is_open in zip(NAMES, inside, strict=True) if is_open)


def _poses(p: Array) -> Poses:
    RX, RZ = (Rotation.from_rotvec(np.array(p[k : k + 3])).as_matrix() for k in (3, 9))
    return RX, p[:3], RZ, p[6:9]


def _retract(p: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
    return stepped(p, step, (3, 9)), local + step_local


def _linear(arrays: Arrays, p: Array) -> tuple[Array, Array]:
    """Return residuals (n, 6) and their derivative (n, 6, 12) by steps (dt, dw) of camera and target."""
    RF, tF, RB, _ = arrays
    RX, tX, RZ, tZ = _poses(p)
    # steps are Exp(dw) R, t + dt in the parent's axes; a small turn's own curvature is left out
    J = np.zeros((len(RF), 6, 12))
    y = np.einsum("nji,nj->ni", RF, tZ - tF) - tX  # the target from the camera, in axes of what carries this
    J[:, :3, :3] = RX.T
    J[:, :3, 3:6] = -RX.T @ skew(y)
    J[:, :3, 6:9] = -RX.T @ RF.mT
    by_target = RB @ RZ.T
    J[:, 3:, 9:] = -by_target
    J[:, 3:, 3:6] = by_target @ RF
    return residuals(arrays, RX, tX, RZ, tZ), J


def _start(arrays: Arrays) -> Array:
    """Return a first guess: the axis that both see, the turn about it at which the places agree best."""
    RF, tF, RB, tB = arrays
    n = len(RF)
    i, k = np.triu_indices(n, 1)
    a = Rotation.from_matrix(RF[k].mT @ RF[i]).as_rotvec()  # A X = X B of F_k^-1 F_i and B_k B_i^-1
    b = Rotation.from_matrix(RB[k] @ RB[i].mT).as_rotvec()
    if np.sqrt((a**2).sum(axis=1).mean()) > LEAST_TURN_RAD:
        U, _, Vt = np.linalg.svd(a.T @ b)
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        first, axis = U @ Vt, np.linalg.svd(a, full_matrices=False)[2][0]
        tried = [
            Rotation.from_rotvec(angle * axis).as_matrix() @ first for angle in np.arange(TURNS) * 2 * np.pi / TURNS
        ]
    else:  # translations alone: RF0 RX tB + tF is the same in all
        moved = np.einsum("nji,nj->ni", RF, tF - tF.mean(axis=0))
        U, _, Vt = np.linalg.svd(-moved.T @ (tB - tB.mean(axis=0)))
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        tried = [U @ Vt]
    best: tuple[float, Array] = (np.inf, np.zeros(12))
    for RX in tried:
        A = np.concatenate([RF, np.tile(-np.eye(3), (n, 1, 1))], axis=2).reshape(-1, 6)
        y = -(np.einsum("nij,jk,nk->ni", RF, RX, tB) + tF).ravel()
        x = np.linalg.lstsq(A, y, rcond=1e-6)[0]
        # single wrong pairs must not decide the turn: lengths, not squares
        miss = float(np.abs(A @ x - y).sum())
        if miss < best[0]:
            RZ = Rotation.from_matrix(RF @ RX @ RB).mean().as_rotvec()
            best = (miss, np.concatenate([x[:3], Rotation.from_matrix(RX).as_rotvec(), x[3:], RZ]))
    return best[1]


def _told(found: _Found, setup: Setup, why: Degenerate) -> Degenerate:
    """Return the refusal with what is known all the same, and what would make the rest known."""
    std = np.sqrt(np.diag(found.covariance))
    carriers = ("flange", "base") if setup is Setup.EYE_IN_HAND else ("base", "flange")
    known = []
    for who, carrier in zip(("camera", "target"), carriers, strict=True):
        cells = []
        for name, value, spread in zip(NAMES, found.fit.shared, std, strict=True):
            if name.startswith(who) and name not in found.open_names:
                stem, unit, size = displayed_name(name.split(".")[1])
                cells.append(f"{stem} {value / size:.4g} +- {spread / size:.2g} {unit}")
        known.append(f"of the {who} in the {carrier} {', '.join(cells) or 'nothing'}")
    open_ = ", ".join(name.replace(".", " ").removesuffix("_m") for name in found.open_names)
    cure = f"Measure the height of the target (its z in the {carriers[1]}'s axes) and give it with --target-height"
    if (
        len([name for name in found.open_names if name.startswith("target")]) > 1
        or "target.z_m" not in found.open_names
    ):
        cure = "Turn the hand about its axis between poses, then one measured height of the target is enough"
    return Degenerate(
        f"{why.cause}. Known are (one standard deviation) {'; '.join(known)}; open are {open_}",
        consequence="What is open can be anything along the axis, and nothing is written",
        cure=f"{cure}. {TURN_CURE}",
    )


def _result(
    pairs: PosePairs, setup: Setup, arrays: Arrays, found: _Found, height: TargetHeight | None
) -> HandEyeResult:
    keep, p = found.keep, found.fit.shared
    r, J = _linear(arrays, p)
    weight = np.repeat(1.0 / np.array(found.noise), 3)
    steps, _ = leave_one_out(r * weight, J * weight[:, None], found.covariance, keep)
    left_out = r + np.einsum("nia,na->ni", J, steps)
    if not np.isfinite(left_out).all():
        row = int(np.argmax(~np.isfinite(left_out).all(axis=1)))
        raise NotEnoughData(
            f"without {pairs.names[row]} the other pairs do not fix the answer",
            consequence="An error in it would go unseen; no calibration is given",
            cure="Add poses turned and moved as that one is",
        )
    dof = 6 * int(keep.sum()) - 11
    widen = float(t_ppf(0.975, dof) / t_ppf(0.975, np.inf))
    open_m, open_rad = (Part(size=size, deviation=float("inf")) for size in found.noise)
    RX, tX, RZ, tZ = _poses(p)
    return HandEyeResult(
        setup=setup,
        T_parent_camera=pose(RX, tX),
        T_parent_target=pose(RZ, tZ),
        covariance=NamedCovariance(names=NAMES, matrix=found.covariance * widen**2),
        dof=float(dof),
        noise=_noises(open_m, open_rad, arrays),
        rotation_excitation=rotation_excitation(pairs.T_base_flange[np.flatnonzero(keep)].rotation),
        pairs=pairs,
        used=keep,
        rejected_pairs=_rejected(pairs, keep, left_out),
        residuals=r,
        left_out=left_out,
        concerns=(),
        advice=(_advice(height),),
    )


def _rejected(pairs: PosePairs, keep: NDArray[np.bool_], left_out: Array) -> tuple[RejectedPair, ...]:
    rows = np.flatnonzero(~keep).tolist()
    return tuple(RejectedPair(row=i + 1, name=pairs.names[i], why=f"off by {_off(left_out[i])}") for i in rows)


def _advice(height: TargetHeight | None) -> str:
    given = "" if height is None else f" ({height.z_m / MM:.5g} +- {height.sigma_m / MM:.2g} mm)"
    return (
        f"The hand turned about one axis: along it the camera's place rests on the target's measured height{given}, "
        "and is off as that is."
    )


def _noises(open_m: Part, open_rad: Part, arrays: Arrays) -> Noise:
    return Noise(
        translation_m=Part(size=open_m.size, deviation=0.0),
        robot_m=open_m,
        camera_m=open_m,
        robot_rad=open_rad,
        camera_rad=open_rad,
        lever_m=float(np.linalg.norm(arrays[3], axis=1).mean()),
    )


def _off(error: Sequence[float] | Array) -> str:
    move, turn = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    return f"{move / MM:.3g} mm and {turn / DEG:.3g} degrees"
