"""Whether measurements are of the arm at all, and of one place on its tool: else they are refused, with rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.fit import mounts_by_turns, start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.other_arm import explained
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.arm.senses import other_senses
from armsight.errors import Degenerate, Inconsistent
from armsight.kinematics import Arm, fk
from armsight.units import MM

MOST_SHARE = 0.1
"""Errors of a larger share of how far the tool moved are not of this arm: 2 degrees of all zeros give 0.02 to 0.04."""
WRONG = 0.2
"""Share of rows with such errors that is borne, as outliers by name; a robust fit goes astray at about a third."""
PLAUSIBILITY_TRIES = 60
"""Draws of joint positions: at half the rows wrong, one draw of four without a wrong one is missed once in 48."""
AGREEING = 0.4
"""Share of the rows that must agree before the others are named: half of them swapped leaves a half, and the nominal
arm's own errors put some of those beyond the limit."""
DRAWN = 4
"""Joint positions per draw: the fewest that base and one tool point do not fit whatever they are."""
REFITS = 4
"""Fits to the rows that agree, and counts again."""
PLAUSIBILITY_SEED = 7
"""The same measurements give the same answer."""


def spread_m(xyz_m: Array) -> float:
    """Return how far positions (m, 3) typically are from their middle, in m; medians, which few wrong rows leave
    alone."""
    return float(np.median(np.linalg.norm(xyz_m - np.median(xyz_m, axis=0), axis=1)))


def check_fit(model: ArmModel, points: ArmPoints, error_m: Array) -> None:
    """Raise Inconsistent where the best fit's errors (m,) say that the measurements are not of this arm."""
    spread = spread_m(points.xyz_m)
    if exceeded(error_m) > MOST_SHARE * spread:
        senses = other_senses(model.arm, points)
        if senses is not None:
            raise senses[0].refusal(model.arm, senses[1])
        other = explained(model, points)
        raise senseless(error_m, spread, () if other else _disagreeing(model, points, MOST_SHARE * spread), other)


def exceeded(error_m: Array) -> float:
    """Return what the share WRONG of errors (m,) exceeds, in m."""
    return float(np.quantile(error_m, 1.0 - WRONG))


def senseless(error_m: Array, spread: float, rows: Sequence[int] = (), other: str = "") -> Inconsistent:
    """Return the refusal; rows from 0 that do not agree with the majority, none where there is no majority.

    other: why they are of another arm, where that is known.
    """
    told = f": row{'s' * (len(rows) > 1)} {ranges(rows)} do not agree with the others" if len(rows) else ""
    cure = "Leave those rows out, or measure them again" if len(rows) else "Give the file of this arm"
    if other:
        return Inconsistent(
            f"the nominal arm misses a fifth of the positions by {1e3 * exceeded(error_m):.3g} mm or more, and the "
            f"tool moved by {1e3 * spread:.3g} mm",
            consequence="Nothing is written",
            cure=other,
        )
    return Inconsistent(
        f"the best fit misses a fifth of the positions by {1e3 * exceeded(error_m):.3g} mm or more, and the tool moved "
        f"by {1e3 * spread:.3g} mm{told}",
        consequence="The measurements are not of this arm at these readings, and nothing is written",
        cure=f"{cure}; look for another arm's rows, readings and positions out of step, positions of a reflection, "
        "rows of several places on the tool without a column `point`",
    )


def ranges(rows: Sequence[int] | NDArray[np.intp]) -> str:
    """Return rows counted from 0 as text counted from 1, neighbours joined: '3-7, 9'."""
    parts = np.split(np.asarray(rows), np.flatnonzero(np.diff(rows) > 1) + 1)
    told = [f"{part[0] + 1}" + (f"-{part[-1] + 1}" if len(part) > 1 else "") for part in parts]
    return ", ".join(told[:12]) + (" and more" if len(told) > 12 else "")


def _disagreeing(model: ArmModel, points: ArmPoints, limit_m: float) -> list[int]:
    """Return the rows that miss by more than a limit what the most rows agree on; none where too few do."""
    rng = np.random.default_rng(PLAUSIBILITY_SEED)
    position = points.position
    like = model.vector(RigidTransform.identity(), [model.arm.T_flange_tool] * len(model.labels))
    best = np.zeros(len(points), bool)
    for _ in range(PLAUSIBILITY_TRIES):
        drawn = rng.choice(position.max() + 1, DRAWN, replace=False)
        rows = np.flatnonzero(np.isin(position, drawn))
        try:
            p = start(model, points.take(rows), like=like)
        except Degenerate:
            continue
        agree = _within(model, p, points, limit_m)
        best = agree if agree.sum() > best.sum() else best
    for _ in range(REFITS):  # from all that agree, base and tool are better known than from the draw
        if len(np.unique(position[best])) < DRAWN:
            return []
        best = _within(model, start(model, points.take(np.flatnonzero(best)), like=like), points, limit_m)
    return [] if best.mean() < AGREEING else np.flatnonzero(~best).tolist()


def _within(model: ArmModel, p: Array, points: ArmPoints, limit_m: float) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(model.errors(p, points)[0], axis=1) <= limit_m)


def check_apart(points: ArmPoints, holdout: ArmPoints) -> None:
    """Raise Inconsistent where rows of the holdout are rows of the measurements, to the last digit."""
    fitted = set(map(bytes, np.column_stack([points.q, points.xyz_m])))
    same = sum(bytes(row) in fitted for row in np.column_stack([holdout.q, holdout.xyz_m]))
    if same:
        raise Inconsistent(
            f"{same} of {len(holdout)} rows of the holdout are rows of the measurements too",
            consequence="They would judge the geometry that was fitted to them, and call it better than it is",
            cure="Give rows that are in one file only, or leave the holdout away: rows left out in turn judge then",
        )


# Whether rows without names are of one place on the tool, or of several that nobody told apart.

Labels = NDArray[np.intp]

MOST_PLACES = 8
"""Places looked for among rows of equal readings; a beacon has three or four lights."""
MOST_MIXED = 4
"""Places looked for where each row has readings of its own: the arm's errors are in the way, and look like more."""
APART = 0.3
"""Rows are of several places where these leave less than this share of the scatter about one: noise that is parted at
will leaves 0.45 with eight places, and the errors of a nominal arm 0.5 with four."""
FURTHER = 0.6
"""One place more is believed where it takes the scatter below this share."""
SEPARATE = 5.0
"""Places are further apart than so many times the scatter about them; what varies evenly and is cut up is not."""
LEAST_SCATTER_M = 2e-3
"""Rows that scatter by less about one place are of one, or of lights that are nearly one."""
FEWEST_EACH = 4
"""Rows of each place; fewer could be gross ones."""
ENOUGH_ROWS = 240
"""Rows that the question is asked with."""
STARTS = 6
"""Draws of first places, far from each other."""
PLACE_TURNS = 30
"""Of giving rows to places and placing them anew."""
MOUNT_TURNS = 6
"""The same with the base placed anew too."""
PLACES_SEED = 13
"""The same measurements give the same answer."""


def check_one_position(arm: Arm, points: ArmPoints) -> None:
    """Raise Inconsistent where rows of one name, or rows without names, are of several places on the tool.

    Where joint positions have several rows each, those rows are looked at about their middle, in flange axes: the arm's
    errors are the same in all of them. Else the place of the tool's point that each row wants, with the nominal arm.
    """
    named = np.array(points.point)
    for label in points.labels:
        _check_rows(arm, points.take(np.flatnonzero(named == label)), label)


def _check_rows(arm: Arm, points: ArmPoints, label: str) -> None:
    """Raise Inconsistent where rows, all of one name or none, are of several places."""
    if len(points) < 2 * FEWEST_EACH:
        return
    if len(points) > ENOUGH_ROWS:
        points = points.take(np.arange(ENOUGH_ROWS))
    model = ArmModel(arm=arm, labels=points.labels, turned=False)
    try:
        p = start(model, points)
    except Degenerate:
        return  # told by what is fitted next
    F = arm.T_world_base.inv().as_matrix() @ fk(arm, points.q) @ arm.T_flange_tool.inv().as_matrix()
    local = np.asarray(model.pose(p, 0).inv().apply(points.xyz_m))
    which = points.position
    count = np.bincount(which)
    if (count > 1).mean() > 0.5:
        middle = np.stack([np.bincount(which, column) for column in local.T], axis=1) / count[:, None]
        rows = np.flatnonzero(count[which] > 1)
        off = np.einsum("mji,mj->mi", F[rows, :3, :3], (local - middle[which])[rows])
        if _about_one(off) > LEAST_SCATTER_M:
            _check(label, _about_one(off), [_parted_into(off, _parted(off, k)) for k in range(2, MOST_PLACES + 1)])
        return
    at = model.pose(p, 1).translation
    wanted = np.einsum("mji,mj->mi", F[:, :3, :3], local - F[:, :3, 3])
    if _about_one(wanted - at) > LEAST_SCATTER_M:
        parts = [_mounted(F, points.xyz_m, wanted, k) for k in range(2, MOST_MIXED + 1)]
        _check(label, _about_one(wanted - at), parts)


def _about_one(off_m: Array) -> float:
    """Return the RMS size of offsets (m, 3) in m, freed of what one place takes up."""
    return float(np.sqrt((off_m**2).sum() / max(len(off_m) - 1, 1)))


_Parting = tuple[Labels, Array, float]
"""Rows (m,) given to places (k, 3) in m, and the RMS distance in m that they keep from them."""


def _check(label: str, one_m: float, parts: list[_Parting]) -> None:
    """Raise Inconsistent where rows are of several places.

    label: their name, "" where they have none; one_m: their scatter about one in m; parts: them in 2, 3 .. places.
    """
    best, least_m = None, one_m
    for labels, positions, left_m in parts:
        if np.bincount(labels, minlength=len(positions)).min() < FEWEST_EACH:
            break
        if left_m < min(APART * one_m, FURTHER * least_m) and pdist(positions).min() > SEPARATE * left_m:
            best, least_m = positions, left_m
    if best is None:
        return
    distance = pdist(best)
    rows, by, cure = "rows", "no column `point` names them", "Name the place of each row in a column `point`"
    if label:
        rows, by, cure = f"rows of point {label!r}", "all have its name", "Give each place a name of its own"
    raise Inconsistent(
        f"the {rows} are of {len(best)} places on the tool, {distance.min() / MM:.3g} to "
        f"{distance.max() / MM:.3g} mm apart, and {by}; about one place they scatter by {one_m / MM:.3g} mm",
        consequence="They cannot be one place at these readings, and nothing is written",
        cure=f"{cure}, for instance A, B, C; or give the rows of one place",
    )


def _means(off_m: Array, labels: Labels) -> Array:
    """Return the middle (k, 3) of each place's offsets."""
    return np.stack([off_m[labels == j].mean(axis=0) for j in range(labels.max() + 1)])


def _parted_into(off_m: Array, labels: Labels) -> _Parting:
    """Return offsets (m, 3) given to the middles of theirs."""
    positions = _means(off_m, labels)
    left = np.square(off_m - positions[labels]).sum() / max(len(off_m) - len(positions), 1)
    return labels, positions, float(np.sqrt(left))


def _nearest(off_m: Array, positions: Array) -> Labels:
    return np.asarray(np.square(off_m[:, None] - positions[None]).sum(axis=2).argmin(axis=1))


def _parted(off_m: Array, k: int) -> Labels:
    """Return to which of k places each offset (m, 3) belongs, by k-means from several draws; every place has some."""
    rng = np.random.default_rng(PLACES_SEED)
    best, least = np.arange(len(off_m)) % k, np.inf
    for _ in range(STARTS):
        positions = off_m[rng.choice(len(off_m), 1)]
        while len(positions) < k:
            distance = np.square(off_m[:, None] - positions[None]).sum(axis=2).min(axis=1)
            positions = np.vstack([positions, off_m[rng.choice(len(off_m), 1, p=distance / distance.sum())]])
        labels = _nearest(off_m, positions)
        for _ in range(PLACE_TURNS):
            if len(np.unique(labels)) < k:
                break
            positions = _means(off_m, labels)
            labels = _nearest(off_m, positions)
        cost = float(np.square(off_m - positions[labels]).sum())
        if cost < least and len(np.unique(labels)) == k:
            best, least = labels, cost
    return best


def _mounted(F: Array, xyz_m: Array, wanted_m: Array, k: int) -> _Parting:
    """Return the rows given to k places on the tool.

    F (m, 4, 4): base to flange; wanted_m (m, 3): the place in flange axes that each row wants, with the base placed as
    if it were one; the base is placed anew with every giving.
    """
    labels = _parted(wanted_m, k)
    at, left = _means(wanted_m, labels), np.inf
    for _ in range(MOUNT_TURNS):
        base, at = mounts_by_turns(F, xyz_m, labels, (_means(wanted_m, labels),))
        wanted_m = np.einsum("mji,mj->mi", F[:, :3, :3], np.asarray(base.inv().apply(xyz_m)) - F[:, :3, 3])
        left = float(np.sqrt(np.square(wanted_m - at[labels]).sum() / max(len(labels) - k - 2, 1)))
        now = _nearest(wanted_m, at)
        if np.array_equal(now, labels) or len(np.unique(now)) < k:
            break
        labels = now
    return labels, at, left
