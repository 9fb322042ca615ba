"""What a hand-eye calibration rests on: a camera and a target that stay where they are; and what to do next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.pairs import Arrays, Setup, components
from armsight.calibrate.handeye.result import FEW_PAIRS, HandEyeResult, Proposal
from armsight.calibrate.tooltip_result import two_settings
from armsight.errors import Inconsistent
from armsight.units import DEG, MM


def require_one_mount(found: HandEyeResult, place: NDArray[np.intp]) -> None:
    """Raise Inconsistent where the pairs, in their order, fall into two parts with a camera and a target each.

    place (n,): at which pose of the robot each was taken; what follows at the same one counts once, by its
    mean: their errors are alike. Where target and robot differ in scale, that explains what is left, and is told.
    """
    if found.scale is not None and found.scale.wrong:
        return
    t_s = np.arange(len(place), dtype=np.float64) if found.pairs.t_s is None else found.pairs.t_s
    rows = np.flatnonzero(found.used)
    rows = rows[np.argsort(t_s[rows], kind="stable")]
    RF, tF, RB, tB = (a[rows] for a in found.pairs.arrays(found.setup))
    at = np.flatnonzero(np.diff(place[rows], prepend=-1))
    count = np.diff(at, append=len(rows))[:, None]
    RFX = RF @ found.T_parent_camera.rotation.as_matrix()
    turns = Rotation.from_matrix(RFX @ RB) * found.T_parent_target.rotation.inv()
    # with X's turn known F X B = Z asks of X's shift what a pivot asks of a tip; of X's small turn likewise
    for values, unit, word in ((np.einsum("nij,nj->ni", RFX, tB) + tF, MM, "mm"), (turns.as_rotvec(), DEG, "degrees")):
        told = two_settings(RF[at], np.add.reduceat(values, at) / count, t_s[rows[at]])
        if told is None:
            continue
        first = found.pairs.names[rows[at[told[0]]]]
        camera, target = (float(np.linalg.norm(v)) / unit for v in np.split(told[1], 2))
        raise Inconsistent(
            f"from {first} on the pairs want the camera elsewhere than those before, by {camera:.3g} {word}, and the "
            f"target, by {target:.3g} {word}",
            consequence="Camera or target slipped in between, or two recordings were put together; no calibration is "
            "given",
            cure=f"Calibrate the pairs before {first} and those from it on apart, or record again with both clamped",
        )


CLAIM_OFF = 1.5
"""Standard deviations of the camera's poses that are right within this factor need no word: 20 pairs tell it to 0.2."""

WEAK_TURN_RAD = 8.0 * DEG
"""Below this second turn (root mean square) more tilt is the cheapest gain: errors shrink in proportion to it."""


def advise(result: HandEyeResult, pitch_m: float | None) -> HandEyeResult:
    """Return the result with its advice, most urgent first."""
    drift = () if result.correlation is None else result.correlation.warnings(result.n_used)
    concerns = (*_scale(result, pitch_m), *_outliers(result), *_poses(result), *drift)
    advice = (*concerns, *_copies(result), *_weights(result), result.noise.explanation() + ".")
    return replace(result, concerns=concerns, advice=advice)


def _scale(result: HandEyeResult, pitch_m: float | None) -> list[str]:
    scale = result.scale
    if scale is None or not scale.wrong:
        return []
    percent = 100.0 * (scale.factor - 1.0)
    uncertainty = 100.0 * scale.std
    text = f"The robot's motion says that the target is {abs(percent):.2f} +- {uncertainty:.2f} % "
    text += "smaller than given" if percent < 0.0 else "larger than given"
    if pitch_m is not None:
        given, true = pitch_m / MM, pitch_m * scale.factor / MM
        text += f": a pitch of {true:.2f} +- {pitch_m * scale.std / MM:.2f} mm, not {given:.4g} mm"
    return [text + ". Measure the target with a calliper over many squares, correct the pitch, and run again."]


def _outliers(result: HandEyeResult) -> list[str]:
    wrong = [one.name for one in result.rejected_pairs if one.why.startswith("off by")]
    if not wrong:
        return []
    named = ", ".join(wrong[:8]) + (", ..." if len(wrong) > 8 else "")
    return [
        f"{len(wrong)} of {len(result.pairs)} poses contradict the others and were left out ({named}): look at these "
        "images and robot poses."
    ]


def _copies(result: HandEyeResult) -> list[str]:
    copies = sum(not one.why.startswith("off by") for one in result.rejected_pairs)
    return [f"{copies} rows repeat others and were left out: copies add no knowledge."] if copies else []


def _weights(result: HandEyeResult) -> list[str]:
    told = [f"{result.pairs.unweighed}."] if result.pairs.unweighed else []
    if result.covariance_factor is not None:
        factor = float(np.sqrt(result.covariance_factor))
        text = "The pairs are weighed by the covariances of the camera's poses"
        if not 1.0 / CLAIM_OFF < factor < CLAIM_OFF:
            text += f", whose standard deviations the residuals say are {factor:.2g} times as large as given"
        told.append(f"{text}.")
    return told


def _poses(result: HandEyeResult) -> list[str]:
    out = []
    behind = result.pairs.T_camera_target.translation[result.used, 2] < 0.0
    if np.mean(behind) > 0.5:
        out.append(
            "The target lies behind the camera (z < 0): if the camera looks along z, both tables are inverted "
            "(T_flange_base and T_target_camera), and the two results have changed places."
        )
    if result.n_used < FEW_PAIRS:
        out.append(f"{result.n_used} poses are few: {FEW_PAIRS} to 30 make the answer and its uncertainty trustworthy.")
    second = float(result.rotation_excitation.rms_rad[1])
    if second < WEAK_TURN_RAD:
        x, y, z = result.rotation_excitation.axes[1]
        out.append(
            f"The hand turns by only {second / DEG:.2g} degrees (root mean square) about its second axis ({x:.2f}, "
            f"{y:.2f}, {z:.2f}): poses tilted by 20 degrees about it help most."
        )
    return out


# Which poses to add: those that would lower the uncertainty most, within reach and with the target in view.

N_CANDIDATES = 600
PROPOSAL_SEED = 1994
TILT_RAD = 35.0 * DEG
"""Candidates are tilted up to this far from the mean view: further, the corners of a flat target get poor."""

ROLL_RAD = 60.0 * DEG
MARGIN = 0.15
"""The flange stays within the box of its poses so far, widened by this share of its size."""

LEAST_BOX_M = 0.05


def propose(
    result: HandEyeResult, n: int, reachable: Callable[[RigidTransform], bool] | None = None
) -> tuple[Proposal, ...]:
    """Return the n next poses that lower the uncertainty of the camera's place most, one after the other (greedy).

    reachable: tells whether the robot can go to T_base_flange; without it the box of the poses so far, a little wider,
    stands for its reach. The target stays where the camera has seen it: between the nearest and furthest distance, and
    within the angles off the optical axis, so far. Raises Inconsistent where no candidate is left.
    """
    if n < 1:
        raise Inconsistent(f"{n} poses cannot be proposed", cure="Ask for one or more")
    flange, camera = _candidates(result, reachable)
    F = flange if result.setup is Setup.EYE_IN_HAND else flange.inv()
    J = _whitened(result, (*components(F), *components(camera)))  # (m, 6, 12)
    information = np.linalg.inv(result.covariance.matrix / result.coverage_factor**2)
    scale = np.sqrt(np.diag(result.covariance.matrix))[:6]
    out = []
    left = np.arange(len(J))
    for _ in range(min(n, len(J))):
        C = np.linalg.inv(information[None] + J[left].transpose(0, 2, 1) @ J[left])  # (m, 12, 12)
        # A-optimal: the sum of the variances of the camera's pose, each over today's, so that m and rad add up
        gain = (np.einsum("maa->ma", C)[:, :6] / scale**2).sum(axis=1)
        best = int(np.argmin(gain))
        k = int(left[best])
        information = information + J[k].T @ J[k]
        out.append(
            Proposal(
                T_base_flange=flange[k],
                T_camera_target=camera[k],
                expected_std_m=float(np.sqrt(np.diag(C[best])[:3].max())),
            )
        )
        left = np.delete(left, best)
    return tuple(out)


def _candidates(
    result: HandEyeResult, reachable: Callable[[RigidTransform], bool] | None
) -> tuple[RigidTransform, RigidTransform]:
    """Return stacks of T_base_flange and T_camera_target."""
    rng = np.random.default_rng(PROPOSAL_SEED)
    seen = result.pairs.T_camera_target[np.flatnonzero(result.used)]
    t = seen.translation
    slope = np.abs(t[:, :2] / t[:, 2:]).max(axis=0)
    z = rng.uniform(t[:, 2].min(), t[:, 2].max(), N_CANDIDATES)
    xyz_m = np.column_stack(
        [rng.uniform(-slope[0], slope[0], N_CANDIDATES) * z, rng.uniform(-slope[1], slope[1], N_CANDIDATES) * z, z]
    )
    direction = rng.uniform(0.0, 2.0 * np.pi, N_CANDIDATES)
    tilt = TILT_RAD * np.sqrt(rng.uniform(0.0, 1.0, N_CANDIDATES))
    tilts = Rotation.from_rotvec(np.column_stack([tilt * np.cos(direction), tilt * np.sin(direction), 0.0 * tilt]))
    rolls = Rotation.from_rotvec(np.outer(rng.uniform(-ROLL_RAD, ROLL_RAD, N_CANDIDATES), [0.0, 0.0, 1.0]))
    camera = RigidTransform.from_components(xyz_m, tilts * seen.rotation.mean() * rolls)
    if result.setup is Setup.EYE_IN_HAND:
        flange = result.T_parent_target * camera.inv() * result.T_parent_camera.inv()
    else:
        flange = result.T_parent_camera * camera * result.T_parent_target.inv()
    if reachable is None:
        visited = result.pairs.T_base_flange.translation
        low, high = visited.min(axis=0), visited.max(axis=0)
        margin = np.maximum(MARGIN * (high - low), LEAST_BOX_M)
        fine = ((flange.translation >= low - margin) & (flange.translation <= high + margin)).all(axis=1)
    else:
        fine = np.array([reachable(flange[i]) for i in range(N_CANDIDATES)])
    index = np.flatnonzero(fine)
    if not len(index):
        raise Inconsistent(
            "no further pose with the target in view is within reach",
            consequence="No pose is proposed",
            cure="Move the target, or give the robot's true reach",
        )
    return flange[index], camera[index]


def _whitened(result: HandEyeResult, arrays: Arrays) -> Array:
    """Return (m, 6, 12): the whitened derivatives of the poses that would be seen."""
    n = len(arrays[0])
    e, J, lever = np.empty((n, 6)), np.empty((n, 6, 12)), np.empty(n)
    noise = result.noise
    theta = np.array([noise.translation_m.size**2, noise.camera_rad.size**2, noise.robot_rad.size**2])
    RX, tX = components(result.T_parent_camera)
    RZ, tZ = components(result.T_parent_target)
    observed = arrays, np.ones(n, bool), result.setup is Setup.EYE_TO_HAND
    kernels.weigh(((RX, tX), (RZ, tZ), 1.0), observed, np.maximum(theta, [1e-14, 1e-14, 0.0]), e, J, lever)
    return J
