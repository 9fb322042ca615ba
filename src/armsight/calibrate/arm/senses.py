"""Joints that count the other way than the nominal arm has it, or whose readings are exchanged: what explains the rows.

Home-made and retrofitted arms, and models typed by hand, have it: a reading that falls where the model's rises. Base,
tool and the zeros of joints are free beside the senses, so that zeros that were set elsewhere hide nothing. Where axes
before and behind a joint can make its reversal by half turns, as in wrists, either is told with the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.fit import Tolerance, fit_arm, start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate, Inconsistent, NotConverged
from armsight.kinematics import Arm, fk_jacobian
from armsight.units import DEG, MM

ROWS = 60
"""Rows that senses are looked for with; fewer than FEWEST fit one of so many choices by chance."""
FEWEST = 12
MOST_JOINTS = 7
"""Joints of which all choices are tried."""
STEPS = 25
"""Of one choice: those that fit need ten."""
FARTHEST = 10.0
"""Of one step: a radian of a joint, or half a metre of the tool. Zeros that base or tool make have no bound."""
SETTLED = 1e-6
"""Share of the sum of squares by which no choice's step changes it any more."""
FITS = 0.05
"""Share of how far the tool moved that may be left: lengths of a home-made arm, not the next best choice of senses."""
FITS_ALIKE = 0.02
"""The same where zeros alone, or readings exchanged, explain the rows: no choice of senses is the worse for it."""
NEXT = 0.3
"""... and of what choices leave that reverse others."""
MOST_CLOSE = 16
"""Choices that are told apart by lengths corrected too: a wrist that flips, a mirror image, a last joint make eight."""
LEAST_LEFT_M = 1e-5
"""What choices leave below it is alike: nothing is measured better."""
TOLD_ZERO_RAD = 2.0 * DEG
COARSE_ZERO_RAD = 5.0 * DEG
"""Zeros alone are no other arm below it, three of their tolerances: they take up lengths, to 2.8 degrees as seen."""

LeftOf = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Senses:
    """Joints that run the other way, zeros (n,) by which the others are then off, and what is left, RMS in m.

    exchanged: two joints whose readings stand in each other's place. alike: joints that run the other way and zeros
    that explain the rows as well. reflected: positions of a reflection do so too.
    """

    joints: tuple[str, ...]
    zeros_rad: Array
    left_m: float
    exchanged: tuple[str, ...] = ()
    alike: tuple[tuple[tuple[str, ...], Array], ...] = ()
    reflected: bool = False

    def refusal(self, arm: Arm, given_m: float, what_missed: str = "the positions") -> Inconsistent:
        """Return the refusal of an arm's file whose joints have other senses, zeros or places than its readings."""
        named, both, off = ", ".join(self.joints), " and ".join(self.exchanged), _off(arm, self.zeros_rad)
        many, add = len(self.joints) > 1, f"add to theta_rad there {_to_add(arm, off)}"
        what = _words(arm, self.joints, self.zeros_rad)
        if self.exchanged:
            what = f"the readings of {both} exchanged{_zeros(off)}"
            consequence = f"The columns of {both} stand in each other's place"
            cure = f"Exchange the columns of {both} in the table" + (f"; in an arm.yaml {add}" if off else "")
        elif self.joints:
            consequence = f"The reading{'s' * many} of {named} run{'s' * (not many)} the other way than in the model"
            cure = (
                f"Change the sign of {named} in the arm's file: {_signs(arm, self.joints)} there in an arm.yaml "
                f"(`armsight convert arm` writes one){f', and {add}' if off else ''}; in a URDF reverse the axis"
            )
        else:
            consequence = "The readings count from other places than in the model"
            cure = f"In an arm.yaml (`armsight convert arm` writes one) {add}"
        alike = "".join(f", and as well with {_words(arm, *one)}" for one in self.alike)
        if self.reflected:
            alike += ", and as well where the positions are a reflection (one of their axes has the wrong sign)"
        return Inconsistent(
            f"the nominal arm misses {what_missed} by {given_m / MM:.3g} mm (root mean square); with {what} it fits "
            f"them to {self.left_m / MM:.2g} mm{alike}",
            consequence=f"{consequence}{', or as the others say' if alike else ''}, and nothing is written",
            cure=cure,
        )


def _off(arm: Arm, zeros_rad: Array) -> list[tuple[str, float]]:
    """Return the joints whose zeros are off by more than what is told, and by how much."""
    each = zip(arm.joints, zeros_rad.tolist(), strict=True)
    return [(joint.name, zero) for joint, zero in each if abs(zero) > TOLD_ZERO_RAD]


def _to_add(arm: Arm, off: list[tuple[str, float]]) -> str:
    """Return what makes up for zeros of readings: theta counts the other way where a joint's sign is -1."""
    sign = {joint.name: joint.sign for joint in arm.joints}
    return ", ".join(f"{zero * sign[name]:.3f} ({name})" for name, zero in off)


def _signs(arm: Arm, names: tuple[str, ...]) -> str:
    """Return how the signs of joints that run the other way are written."""
    new = {joint.name: "`sign: -1`" if joint.sign > 0.0 else "`sign: 1`" for joint in arm.joints}
    each = [new[name] for name in names]
    return each[0] if len(set(each)) == 1 else ", ".join(f"{new[name]} ({name})" for name in names)


def changed(arm: Arm, signs: Array, zeros_rad: Array) -> Arm:
    """Return the arm with senses (n,), 1 or -1, and zeros (n,) of its readings."""
    joints = tuple(
        replace(joint, sign=joint.sign * sign, theta_rad=joint.theta_rad + joint.sign * zero)
        for joint, sign, zero in zip(arm.joints, signs.tolist(), zeros_rad.tolist(), strict=True)
    )
    return replace(arm, joints=joints, covariance=None)


def _words(arm: Arm, names: tuple[str, ...], zeros_rad: Array) -> str:
    senses = f"{', '.join(names)} counted the other way" if names else "the senses as they are"
    return senses + _zeros(_off(arm, zeros_rad))


def _zeros(off: list[tuple[str, float]]) -> str:
    return f" (and zeros off: {', '.join(f'{x} by {z / DEG:.1f}' for x, z in off)} degrees)" if off else ""


def other_senses(arm: Arm, points: ArmPoints) -> tuple[Senses, float] | None:
    """Return the senses, zeros or exchange of two joints that explain the rows where the given ones do not, and the RMS
    error with these in m; else None."""
    turning = np.flatnonzero(arm.revolute)
    if not 1 <= len(turning) <= MOST_JOINTS or len(points) < FEWEST or len(points.labels) > 1 or arm.couplings:
        return None
    rows = np.unique(np.linspace(0, len(points) - 1, ROWS).astype(np.intp))
    q, xyz_m = points.q[rows], points.xyz_m[rows]
    spread = float(np.sqrt(((xyz_m - xyz_m.mean(axis=0)) ** 2).sum(axis=1).mean()))
    left_of = partial(_left, arm, turning, xyz_m)
    choices = all_choices(len(turning))
    left, found = fit_choices(arm, turning, choices, q, left_of)
    if left.min() > FITS * spread:
        return _exchanged(arm, turning, q, xyz_m, FITS_ALIKE * spread, left)
    given_m = float(_rms(left_of(q[None], _start(arm, turning)[None])[0])[0])
    senses = judged(arm, turning, choices, left, found, FITS_ALIKE * spread, partial(_refined, points.take(rows)))
    if senses is not None and len(senses.joints) > 1:  # of an arm with a plane of symmetry a reflection is one fault
        mirrored = partial(_left, arm, turning, xyz_m * [-1.0, 1.0, 1.0])
        reflected = bool(fit_choices(arm, turning, choices[:1], q, mirrored)[0][0] * NEXT <= left.min())
        senses = replace(senses, reflected=reflected)
    return None if senses is None else (senses, given_m if senses.alike else float(left[0]))


def all_choices(k: int) -> Array:
    """Return the senses (2^k, k) that k joints can have, 1 as given or -1, those that reverse fewest first."""
    return np.array(sorted(product((1.0, -1.0), repeat=k), key=lambda s: s.count(-1.0)))


def _refined(points: ArmPoints, arm: Arm) -> float:
    """Return what an arm leaves of the positions once its lengths and angles are fitted within tolerance, RMS in m."""
    model = ArmModel(arm=arm, labels=points.labels, turned=False)
    points = replace(points, rotation=None)
    try:
        p = fit_arm(model, points, start(model, points), model.geometry, Tolerance()).p
    except (NotConverged, Degenerate):
        return float("inf")
    return float(np.sqrt((model.errors(p, points)[0] ** 2).sum(axis=1).mean()))


def judged(
    arm: Arm,
    turning: NDArray[np.intp],
    choices: Array,
    left: Array,
    found: Array,
    most_m: float,
    refined: Callable[[Arm], float],
) -> Senses | None:
    """Return what of choices (c, k) explains the rows, with all that does so as well; None where nothing is to be told.

    left (c,), found (c, k): what each leaves, RMS in m, and its zeros. most_m: may be left where several are alike.
    refined: what an arm leaves with its lengths corrected too, by which those that leave about as much are told apart.
    """
    close = np.flatnonzero(left * NEXT <= left.min())
    if len(close) > 1:
        fine = np.full(len(left), np.inf)
        for i in close[np.argsort(left[close], kind="stable")][:MOST_CLOSE]:
            signs = np.ones(arm.n)
            signs[turning] = choices[i]
            fine[i] = refined(changed(arm, signs, _of_joints(arm, turning, found[i])))
        left = np.where(np.isfinite(fine), np.maximum(fine, LEAST_LEFT_M), np.inf) if np.isfinite(fine).any() else left
    alike = np.flatnonzero(left * NEXT <= left.min())
    zeros = [_of_joints(arm, turning, one) for one in found]
    size = [float(np.abs(one).sum().round(1)) for one in zeros]
    # of those that fit alike the one of the smallest zeros that reverses fewest
    best, *others = sorted(alike, key=lambda i: (size[i], (choices[i] < 0.0).sum()))
    # a joint that turns the tool about itself, or a wrist that flips, fits both ways: the others are known all the same
    common = np.all([choices[i] < 0.0 for i in alike], axis=0)
    ambiguous = alike[0] == 0 or not np.array_equal(common, choices[best] < 0.0)
    if ambiguous and left[best] > most_m:
        return None
    names = _reversed(arm, turning, choices[best])
    if not names and np.abs(zeros[best]).max() < COARSE_ZERO_RAD:
        return None
    told = [best]
    back = choices < 0.0
    for i in others:  # not those that reverse one more joint beside what is told, such as the last; a mirror image two
        if (size[i] == size[best] or i == 0) and all(
            (back[k] & ~back[i]).any() or back[i].sum() > back[k].sum() + 1 for k in told
        ):
            told.append(i)
    same = tuple((_reversed(arm, turning, choices[i]), zeros[i]) for i in told[1:])
    return Senses(joints=names, zeros_rad=zeros[best], left_m=left[best], alike=same)


def _reversed(arm: Arm, turning: NDArray[np.intp], signs: Array) -> tuple[str, ...]:
    return tuple(arm.joints[j].name for j, sign in zip(turning, signs, strict=True) if sign < 0.0)


def _exchanged(
    arm: Arm, turning: NDArray[np.intp], q: Array, xyz_m: Array, most_m: float, left: Array
) -> tuple[Senses, float] | None:
    """Return the two joints whose readings stand in each other's place, where one pair explains the rows; else None.

    left: of all choices of senses, RMS in m.
    """
    pairs = list(combinations(range(arm.n), 2))
    swapped = np.stack([_swapped(q, pair) for pair in pairs])
    signs = np.ones((len(pairs), len(turning)))
    found_m, zeros = fit_choices(arm, turning, signs, swapped, partial(_left, arm, turning, xyz_m))
    order = np.argsort(found_m)
    best_m = float(found_m[order[0]])
    nearest = min([left.min(), *found_m[order[1:2]]])
    if best_m > min(most_m, NEXT * nearest):
        return None
    names = tuple(arm.joints[j].name for j in pairs[order[0]])
    return Senses(
        joints=(), zeros_rad=_of_joints(arm, turning, zeros[order[0]]), left_m=best_m, exchanged=names
    ), float(left[0])


def _centred(a: Array, axis: int = -2) -> Array:
    return np.asarray(a - a.mean(axis=axis, keepdims=True))


def _swapped(q: Array, pair: tuple[int, int]) -> Array:
    out = q.copy()
    out[:, pair] = q[:, pair[::-1]]
    return out


def _of_joints(arm: Arm, turning: NDArray[np.intp], zeros_rad: Array) -> Array:
    """Return zeros (n,) of all joints: base and tool take up those of the first and the last one that turn."""
    out = np.zeros(arm.n)
    out[turning[1:-1]] = zeros_rad[1:-1]
    return out


def fit_choices(arm: Arm, turning: NDArray[np.intp], signs: Array, q: Array, left_of: LeftOf) -> tuple[Array, Array]:
    """Return what each choice leaves, RMS in m (c,), and its zeros of the turning joints (c, k); the tool is free too.

    signs (c, k). q: readings (m, n), or (c, m, n) each choice's own. left_of: of readings (c, m, n), zeros and tool (c,
    k + 3), with its derivative. Levenberg-Marquardt of all choices at once.
    """
    k, scale = len(turning), np.array([0.1] * len(turning) + [0.05] * 3)
    read = np.broadcast_to(q, (len(signs), *q.shape[-2:])).copy()
    read[..., turning] *= signs[:, None]
    x = np.tile(_start(arm, turning), (len(signs), 1))
    r, J = left_of(read, x)
    damping = np.full(len(signs), 1e-3)
    for _ in range(STEPS):
        by_scale = J * scale
        normal = by_scale.mT @ by_scale + damping[:, None, None] * np.eye(k + 3)
        step = np.linalg.solve(normal, by_scale.mT @ r[..., None])[..., 0]
        step *= np.minimum(1.0, FARTHEST / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
        trial = x - scale * step
        r_trial, J_trial = left_of(read, trial)
        before, after = (r**2).sum(axis=1), (r_trial**2).sum(axis=1)
        better = after < before
        x[better], r[better], J[better] = trial[better], r_trial[better], J_trial[better]
        damping = np.clip(damping * np.where(better, 0.1, 10.0), 1e-8, 1e8)
        if (np.abs(before - after) <= SETTLED * before).all():
            break
    return _rms(r), np.remainder(x[:, :k] + np.pi, 2.0 * np.pi) - np.pi


def _start(arm: Arm, turning: NDArray[np.intp]) -> Array:
    return np.concatenate([np.zeros(len(turning)), arm.T_flange_tool.translation])


def _rms(left: Array) -> Array:
    return np.asarray(np.sqrt(3.0 * (left**2).mean(axis=1)))


def tool_points(arm: Arm, turning: NDArray[np.intp], read: Array, x: Array) -> tuple[Array, Array]:
    """Return where choices x (c, k + 3) of zeros and tool put the tool, (c, m, 3), and the derivative (c, m, 3, k + 3).

    read: (c, m, n) or (1, m, n) readings with the choices' senses.
    """
    k, shape = len(turning), read.shape
    values = read.copy()
    values[..., turning] += x[:, None, :k]
    T, J = (a.reshape(*shape[:2], *a.shape[1:]) for a in fk_jacobian(arm, values.reshape(-1, shape[-1])))
    flange = T @ np.linalg.inv(arm.T_flange_tool.as_matrix())
    by_tool, tool = flange[..., :3, :3], x[:, None, k:, None]
    arm_of = by_tool @ (tool - arm.T_flange_tool.translation[:, None])  # from the origin that J is of
    by_zeros = J[..., :3, turning] + np.cross(J[..., 3:, turning], arm_of, axis=-2)
    there = (by_tool @ tool)[..., 0] + flange[..., :3, 3]
    return there, np.concatenate([by_zeros, by_tool], axis=-1)


def _left(arm: Arm, turning: NDArray[np.intp], xyz_m: Array, read: Array, x: Array) -> tuple[Array, Array]:
    """Return what choices x (c, k + 3) of zeros and tool leave, (c, 3 m), and its derivatives (c, 3 m, k + 3).

    The base that fits best (Kabsch 1976) goes with every choice and turns along with x: sum(there x around) stays zero.
    """
    there, by_x = tool_points(arm, turning, read, x)
    there, around = _centred(there), _centred(xyz_m)
    U, _, Vt = np.linalg.svd(around.T @ there)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    base = U @ Vt
    there = there @ base.mT
    moved = base[:, None] @ _centred(by_x, axis=1)
    B = there.mT @ around
    spin = np.trace(B, axis1=1, axis2=2)[:, None, None] * np.eye(3) - B
    turned = np.linalg.pinv(spin, hermitian=True) @ np.cross(moved, around[None, ..., None], axis=-2).sum(axis=1)
    moved -= np.cross(there[..., None], turned[:, None], axis=-2)
    return (there - around).reshape(len(x), -1), moved.reshape(len(x), -1, x.shape[1])
