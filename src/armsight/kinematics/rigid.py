"""The rigid arm that is nearest to one that is not quite, for formats that know no others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.kinematics.arm import Arm
from armsight.kinematics.forward_kinematics import fk, moved, parameter_jacobian, parameter_names
from armsight.kinematics.joints import Coupling
from armsight.kinematics.kernels.derivatives import PER_JOINT

POSTURES = 500
"""Drawn in the joints' ranges: ten times as many numbers as an arm has parameters."""

MOST = 2.0 * np.pi
"""Of joints' ranges, rad or m, which some files have for no limit; where there is none, half of it."""

ROUNDS = 5
"""Steps of Gauss and Newton; two settle what an arm gives way, some milliradians."""

WEAK = 1e-6
"""Share of the strongest direction of the parameters below which one is left as it is, such as a joint's height."""

FAR = 0.02
"""Of the arm's reach: one whose nearest rigid arm misses by more (RMS) is another mechanism, such as a parallelogram
whose readings are coupled by one; sagging arms and errors of gears are below 0.005."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rigid:
    """A rigid arm, and how far its tool is from the other's over the joints' ranges, rms_m and most_m.

    lost: what to know of it; '' where it is the other arm itself.
    """

    arm: Arm
    rms_m: float = 0.0
    most_m: float = 0.0
    lost: str = ""


def require_rigid(arm: Arm, kind: str) -> None:
    """Raise Inconsistent for an arm that files of a kind such as URDF cannot hold."""
    if any(beyond_rigid(arm)):
        raise Inconsistent(
            f"of {arm.name} {' and '.join(beyond_rigid(arm))}",
            consequence=f"{kind} has no place for it",
            cure="Take the nearest rigid arm: armsight convert arm FILE --rigid -o rigid.yaml",
        )


def followers(arm: Arm, kind: str) -> dict[str, Coupling]:
    """Return what each joint without a drive of a rigid arm follows, by its name; Inconsistent where it is several."""
    found = {one.joint: one for one in arm.couplings}
    if len(found) < len(arm.couplings):
        raise Inconsistent(
            f"a joint of {arm.name} follows several others",
            consequence=f"{kind} has no place for it",
            cure="Keep this arm as arm.yaml",
        )
    return found


def as_rigid(arm: Arm) -> Rigid:
    """Return the arm itself where it is rigid and its readings are the joints' own, else the nearest such arm."""
    return nearest_rigid(arm) if any(beyond_rigid(arm)) else Rigid(arm=arm)


def nearest_rigid(arm: Arm) -> Rigid:
    """Return the rigid arm on the same base whose tool is nearest to that of an arm at the same readings.

    Left out are what its joints give way under its weight, scales, and couplings of readings to other joints'. Least
    squares of the tool's pose, a turn counted by the mean link, over postures drawn in the joints' ranges. Raises
    Inconsistent where no rigid arm is near.
    """
    q = drawn_postures(arm)
    wanted = fk(arm, arm.values(q))
    driven = {joint.name for joint in arm.joints if joint.driven}
    near = replace(
        arm,
        joints=tuple(replace(joint, compliance=0.0, sign=float(np.sign(joint.sign))) for joint in arm.joints),
        couplings=tuple(one for one in arm.couplings if one.joint not in driven),
        covariance=None,
    )
    values, names = near.values(q), parameter_names(arm)
    near = fitted(
        near, wanted, values, [*names[: PER_JOINT * arm.n], *names[-6:]]
    )  # all but the base, the model's root
    off = np.linalg.norm(fk(near, values)[:, :3, 3] - wanted[:, :3, 3], axis=1)
    rms_m, most_m = float(np.sqrt(np.mean(off**2))), float(off.max())
    what = " and ".join(beyond_rigid(arm))
    if rms_m > FAR * arm.reach_m:
        raise Inconsistent(
            f"{what}, and the nearest rigid arm misses this one's tool by {1e3 * rms_m:.3g} mm RMS over the ranges",
            consequence="It would be another arm",
            cure="Keep this arm as arm.yaml",
        )
    lost = (
        f"the nearest rigid arm is written, for {what}: its tool is {1e3 * rms_m:.3g} mm RMS, {1e3 * most_m:.3g} mm at "
        "most, from this one's over the ranges"
    )
    return Rigid(arm=near, rms_m=rms_m, most_m=most_m, lost=lost)


def drawn_postures(arm: Arm) -> Array:
    """Return readings (POSTURES, n) drawn evenly in the joints' ranges; 0 of joints without a drive."""
    low = np.where(np.isinf(arm.lower), -np.pi, np.clip(arm.lower, -MOST, MOST))
    high = np.maximum(low, np.where(np.isinf(arm.upper), np.pi, np.clip(arm.upper, -MOST, MOST)))
    q = np.random.default_rng(0).uniform(low, high, (POSTURES, arm.n))
    q[:, list(arm.undriven)] = 0.0
    return q


def fitted(near: Arm, wanted: Array, values: Array, free: Sequence[str]) -> Arm:
    """Return the arm with those of its parameters changed that are free, its tool nearest to wanted (m, 4, 4).

    values (m, n): of its joints. Least squares of the tool's pose, a turn counted by the mean link; of parameters that
    do the same the change is shared between them, and what no posture shows stays.
    """
    names = parameter_names(near)
    columns = [names.index(name) for name in free]
    for _ in range(ROUNDS):
        T, J = parameter_jacobian(near, values)
        turned = Rotation.from_matrix(wanted[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)).as_rotvec()
        r = np.concatenate([wanted[:, :3, 3] - T[:, :3, 3], near.length_m * turned], axis=1)
        J[:, 3:] *= near.length_m
        step = np.linalg.lstsq(J[:, :, columns].reshape(-1, len(columns)), r.ravel(), rcond=WEAK)[0]
        near = moved(near, {name: float(by) for name, by in zip(free, step, strict=True)})
    return near


def beyond_rigid(arm: Arm) -> Iterator[str]:
    """Yield what a rigid arm has no place for."""
    soft = [joint.name for joint in arm.joints if joint.compliance]
    scaled = [f"{joint.name} by {abs(joint.sign):.6g}" for joint in arm.joints if abs(joint.sign) != 1.0]
    coupled = [one.joint for one in arm.couplings if next(j for j in arm.joints if j.name == one.joint).driven]
    if soft:
        yield f"joints give way under the weight ({', '.join(soft)})"
    if scaled:
        yield f"readings have scales ({', '.join(scaled)})"
    if coupled:
        yield f"readings are coupled to other joints' ({', '.join(coupled)})"
