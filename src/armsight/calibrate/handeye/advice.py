"""What a hand-eye calibration rests on: a camera and a target that stay where they are; and what to do next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.handeye.result import FEW_PAIRS, HandEyeResult
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
    concerns = (*_scale(result, pitch_m), *_outliers(result), *_poses(result), *_drift(result))
    advice = (*concerns, *_copies(result), *_weights(result), result.noise.explanation() + ".")
    return replace(result, concerns=concerns, advice=advice)


def _drift(result: HandEyeResult) -> list[str]:
    return [] if result.correlation is None else list(result.correlation.warnings(result.n_used))


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
