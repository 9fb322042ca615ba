"""Whether measured rotations are those of the arm's tool: hand-eye's questions, with the arm's flange as the robot.

Where the flange is turned to is known from the positions and the nominal arm alone, so that rotations which say
something else (inverted, w written first, in another frame, of something else) are seen before they are weighed. A fit
would take them for noise of a radian, use none of them and not say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.fit import LEAST_TURN_RAD, ArmFit, start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import coupled
from armsight.calibrate.arm.plausibility import MOST_SHARE, exceeded, spread_m
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.handeye.consensus import LEAST_SHARE, MUCH_BETTER, NEAR, RIGHT, UNRELATED, rolled, samples
from armsight.calibrate.handeye.kernels.closed_forms import MEDIAN_NORM, rotation_consensus
from armsight.calibrate.handeye.pairs import LEAST_TURN_RAD as TURNED_RAD
from armsight.errors import Degenerate, Inconsistent
from armsight.fitting.quantiles import MEDIAN_3, chi2_ppf
from armsight.kinematics import fk
from armsight.units import DEG, MM

ENOUGH_ROWS = 400
"""Rows that the question is asked with."""
ZEROS_RAD = 5.0 * DEG
"""Rotations that are off by less may be those of an arm whose zeros are off: 2 degrees in all joints make about 3."""
FRAME_MISSES = 0.1
"""Share of the tool's motion that positions miss by with the base turned as the rotations want it, from which on the
two are of different frames: nominal arms miss by 0.04 at most."""
GROSS_TURN = float(np.sqrt(chi2_ppf(0.99999, 3)))
"""Rotations beyond so many standard deviations are gross."""
COMPUTED_RAD = 1e-5
"""Rotations that follow the nominal arm to two arc seconds are its own, not a measurement's: no arm has such zeros."""
COMPUTED_M = 2e-5
"""Positions that miss the nominal arm by less do not tell an exact arm (a simulation's) from computed rotations."""
TOLD_ROWS = 8
"""Rows named; more are counted."""


def check_rotations(model: ArmModel, points: ArmPoints) -> None:
    """Raise Inconsistent where measured rotations are not those of the tool at these readings, as given."""
    if points.rotation is None:
        return
    if len(points) > ENOUGH_ROWS:
        points = points.take(np.linspace(0, len(points) - 1, ENOUGH_ROWS).astype(np.intp))
    plain, positions = ArmModel(arm=model.arm, labels=points.labels, turned=False), replace(points, rotation=None)
    try:
        p, _ = coupled(plain, positions, start(plain, positions))
    except Degenerate:
        return  # told by what is fitted next
    bare = replace(model.arm, T_world_base=RigidTransform.identity(), T_flange_tool=RigidTransform.identity())
    F = fk(bare, plain.values(p, points.q))
    measured = np.asarray(points.rotation)
    turn = _spread(F[:, :3, :3])
    if turn < TURNED_RAD:
        return
    if exceeded(np.linalg.norm(plain.errors(p, positions)[0], axis=1)) > MOST_SHARE * spread_m(points.xyz_m):
        return  # positions are not of this arm either, and are told first
    given = _reading(F, measured, points)
    usual = {
        "they are inverted (matrices transposed, or base and tool exchanged)": measured.transpose(0, 2, 1),
        "their quaternions are written w, x, y, z": rolled(measured),
    }
    readings = {text: _reading(F, R, points) for text, R in usual.items()}
    fitting = {text: x for text, x in readings.items() if x.fits(turn, RIGHT)}
    text = min(fitting, key=lambda name: fitting[name].off_rad, default="")
    if text and (not given.fits(turn, UNRELATED) or fitting[text].off_rad < MUCH_BETTER * given.off_rad):
        raise _not_of_the_tool(
            f"do not follow the arm as given, but do to {fitting[text].off_rad / DEG:.2g} degrees if {text}"
        )
    _check_given(
        given, turn, same=float(Rotation.from_matrix(measured[0].T @ measured).magnitude().max()) < LEAST_TURN_RAD
    )


def without_computed(model: ArmModel, points: ArmPoints) -> tuple[ArmPoints, tuple[str, ...]]:
    """Return the points without rotations that are the nominal arm's own at these readings, and what to say of it."""
    bare = replace(model.arm, T_world_base=RigidTransform.identity(), T_flange_tool=RigidTransform.identity())
    told = "" if points.rotation is None else computed(fk(bare, points.q), points)
    return (replace(points, rotation=None), (told,)) if told else (points, ())


def computed(F: Array, points: ArmPoints) -> str:
    """Return what to say of rotations that are those of F (m, 4, 4), base to flange, to the last digits; else nothing.

    A controller reports where it believes its tool to be: taken as measured, that proves the nominal arm right.
    """
    if len(points) > ENOUGH_ROWS:
        rows = np.linspace(0, len(points) - 1, ENOUGH_ROWS).astype(np.intp)
        F, points = F[rows], points.take(rows)
    if points.rotation is None or _spread(F[:, :3, :3]) < TURNED_RAD:
        return ""
    given = _reading(F, np.asarray(points.rotation), points)
    if given.off_rad > COMPUTED_RAD or given.off_m < COMPUTED_M:
        return ""
    return (
        "The rotations are those of the nominal arm to the last digits, while the positions miss it by "
        f"{given.off_m / MM:.2g} mm: they were computed, not measured, and are left out"
    )


def _check_given(given: _Reading, turn: float, *, same: bool) -> None:
    """Raise Inconsistent where no reading explains rotations that are off as given. same: all are one."""
    if given.agree < LEAST_SHARE or given.off_rad > max(UNRELATED * turn, ZEROS_RAD):
        raise _not_of_the_tool(
            "are the same in all rows though the arm turned its tool"
            if same
            else f"do not follow the arm: {given.agree:.0%} of the rows agree, and the others are off by as "
            f"much as the tool turns ({turn / DEG:.3g} degrees)"
        )
    if not given.fits(turn, UNRELATED):
        raise _not_of_the_tool(
            "are not in the positions' frame: with the base turned as they say the positions miss by "
            f"{given.off_m / MM:.3g} mm"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """How far rotations are off, one component in rad, the share of the rows that agree, and how far the positions are
    off with the base turned as they want it, in m; spread_m: of the positions."""

    off_rad: float
    agree: float
    off_m: float
    spread_m: float

    def fits(self, turn: float, share: float) -> bool:
        """Whether rotations are off by less than a share of the turn, and say what the positions say of the base."""
        near = self.off_rad <= max(share * turn, ZEROS_RAD) and self.agree >= LEAST_SHARE
        return near and self.off_m <= FRAME_MISSES * self.spread_m


def _reading(F: Array, R: Array, points: ArmPoints) -> _Reading:
    """Return how well R = B F X holds for most rows, and the positions with the base turned by B.

    Frames alone do not tell inverted rotations from quaternions that begin with w: one is the other but for two turns.
    """
    m, labels = len(F), points.labels
    # hand-eye's F X B = Z: flange to base, the tool in the flange, the measured rotation back, the base
    flange, back = (np.ascontiguousarray(x) for x in (F[:, :3, :3], R.transpose(0, 2, 1)))
    off_rad = np.empty(m)
    _, Z, sigma = rotation_consensus(flange, back, samples(m), np.ones(m, bool), off_rad)
    near = off_rad <= max(NEAR * _spread(flange), ZEROS_RAD)
    A = np.zeros((m, 3, 3 + 3 * len(labels)))  # Z x - t = R p + c: linear in c and in each point p of the tool
    A[:, :, :3] = np.eye(3)
    for i, label in enumerate(points.point):
        at = 3 + 3 * labels.index(label)
        A[i, :, at : at + 3] = flange[i]
    wanted = points.xyz_m @ Z.T - F[:, :3, 3]
    found = np.linalg.lstsq(A.reshape(3 * m, -1), wanted.ravel(), rcond=None)[0]
    off = float(np.median(np.linalg.norm(wanted - A @ found, axis=1)))
    return _Reading(off_rad=float(sigma), agree=float(near.mean()), off_m=off, spread_m=spread_m(points.xyz_m))


def _not_of_the_tool(what: str) -> Inconsistent:
    return Inconsistent(
        f"the measured rotations {what}",
        consequence="They cannot be used, and nothing is written",
        cure="Give the tool's rotation in the positions' frame, quaternions as x, y, z, w (R turns tool axes into the "
        "frame's); or leave the columns qx .. qw out, to calibrate from the positions alone",
    )


def _spread(R: Array) -> float:
    """Return how far rotations (m, 3, 3) typically are from their mean, one component in rad."""
    turned = Rotation.from_matrix(R)
    return float(np.median((turned.mean().inv() * turned).magnitude()) / MEDIAN_NORM)


def turn_note(model: ArmModel, points: ArmPoints) -> tuple[str, ...]:
    """Return where the tool's rotation is from, if not from the rows and not none."""
    if points.rotation is not None or not model.arm.T_flange_tool.rotation.magnitude():
        return ()
    return ("Positions tell nothing of how the tool is turned on the flange: its rotation is the nominal arm's",)


def rotation_notes(model: ArmModel, points: ArmPoints, fitted: ArmFit) -> tuple[str, ...]:
    """Return what to know of how rotations were used."""
    if points.rotation is None:
        return ()
    turn = model.errors(fitted.p, points)[1]
    size = np.linalg.norm(turn, axis=1)
    told = []
    if fitted.sigma_rad <= LEAST_TURN_RAD:
        own = float(np.sqrt(np.median(size**2) / MEDIAN_3))
        told.append(
            f"The rotations agree to {own / DEG:.2g} degrees, better than any arm turns its tool, and are weighed as "
            f"if they were good to {LEAST_TURN_RAD / DEG:.2g}"
        )
    gross = np.flatnonzero(size > GROSS_TURN * fitted.sigma_rad)
    if len(gross):
        rows = ", ".join(str(i + 1) for i in gross[:TOLD_ROWS]) + (" and more" if len(gross) > TOLD_ROWS else "")
        told.append(
            f"The rotation{'s' * (len(gross) > 1)} of row{'s' * (len(gross) > 1)} {rows} ({len(gross)} of "
            f"{len(points)}) miss by up to {size.max() / DEG:.3g} degrees and count little"
        )
    return tuple(told)
