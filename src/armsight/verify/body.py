"""Three or more named points of one body, seen at each visit, taken together: the body's pose, and how rigid it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Degenerate
from armsight.geometry.poses import align_points
from armsight.units import MM
from armsight.verify.records import Measured, Repeats

FEWEST = 3
"""Points that fix a pose."""
ROUNDS = 20
SETTLED_M = 1e-12
NOT_RIGID = 4.0
"""Residual over what the points' own standard deviations leave (both RMS) from which they are no rigid body."""
OTHER_POINTS = 0.05
"""Share of the body's size by which commanded points may miss its shape: beyond, they are not of these points."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """The body at each visit (v,): measured (its position is the mean of the points, its axes are those of the frame as
    at the first visit) and which repeat it is; commanded (v, 4, 4), NaN where the command is not of these points.

    rms_m: residual of the points against the rigid body, 3-D. expected_m: what their standard deviations leave of it;
    None where nobody says. worst: the point that fits least, with its residual. left_out: visits with too few points.
    """

    measured: Measured
    repeats: Repeats
    commanded: Array
    points: tuple[str, ...]
    rms_m: float
    expected_m: float | None
    worst: tuple[str, float]
    left_out: int

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of it."""
        changed = (
            f"ISO 9283: the points {', '.join(self.points)} are judged as one body, at their mean; they fit it to "
            f"{self.rms_m / MM:.3g} mm RMS"
        )
        notes = [changed]
        if self.expected_m is not None and self.rms_m > NOT_RIGID * self.expected_m:
            notes.append(
                f"the points do not keep their distances: {self.rms_m / MM:.3g} mm where their standard deviations "
                f"leave {self.expected_m / MM:.3g} mm, most at {self.worst[0]} ({self.worst[1] / MM:.3g} mm): a loose "
                "point shows as the arm's scatter"
            )
        if self.left_out:
            notes.append(f"ISO 9283: {self.left_out} visits show fewer than three points and are left out")
        if np.isnan(self.commanded).any():
            notes.append("ISO 9283: what was commanded is not of these points, and accuracy is withheld")
        return tuple(notes)


def bodies_of(
    measured: Measured, repeats: Repeats, index: Index, visit: Index, commanded: Array | None
) -> Bodies | None:
    """Return the body of rows (k,) of visits (k,) at rest; None where no three points are there, or on one line.

    commanded (m, 3): where each measured row should be, NaN where that is not known; None without commands.
    """
    labels = measured.labels
    if measured.rotation is not None or len(labels) < FEWEST or not len(index):
        return None
    keys = list(dict.fromkeys((repeats.at_pose[i], int(v)) for i, v in zip(index, visit, strict=True)))
    rows = {key: [i for i, v in zip(index, visit, strict=True) if (repeats.at_pose[i], int(v)) == key] for key in keys}
    seen = {key: _means(measured.xyz_m, measured.which, rows[key], len(labels)) for key in keys}
    seen_well = [key for key in keys if np.isfinite(seen[key][:, 0]).sum() >= FEWEST]
    complete = [key for key in seen_well if np.isfinite(seen[key]).all()]
    if not complete:
        return None
    try:
        shape = _shape([seen[key] for key in complete])
        T = np.array([_pose(seen[key], shape) for key in seen_well])
        wanted = [_commanded(commanded, measured, rows[key], shape) for key in seen_well]
    except Degenerate:
        return None
    placed = [t[:3, 3] + shape @ t[:3, :3].T for t in T]
    off = np.array([seen[key] - at for key, at in zip(seen_well, placed, strict=True)])  # (v, p, 3)
    squares = (off**2).sum(axis=2)
    each = np.sqrt(np.nanmean(squares, axis=0))
    first = np.array([rows[key][0] for key in seen_well], dtype=np.intp)
    visits = measured.take(first)
    return Bodies(
        measured=replace(visits, xyz_m=T[:, :3, 3], rotation=T[:, :3, :3], std=None, covariance=None, point=()),
        repeats=_of(repeats, first, [str(key[1]) for key in seen_well]),
        commanded=np.array(wanted),
        points=labels,
        rms_m=float(np.sqrt(np.nanmean(squares))),
        expected_m=_expected(measured, [rows[key] for key in seen_well], len(labels)),
        worst=(labels[int(np.argmax(each))], float(each.max())),
        left_out=len(keys) - len(seen_well),
    )


def _means(xyz_m: Array, which: Index, rows: list[int], n: int) -> Array:
    """Return the mean of each point's rows (n, 3), NaN for one that is not there."""
    out = np.full((n, 3), np.nan)
    at = np.array(rows, dtype=np.intp)
    for k in range(n):
        mine = at[which[at] == k]
        if len(mine):
            out[k] = xyz_m[mine].mean(axis=0)
    return out


def _shape(seen: list[Array]) -> Array:
    """Return the points of the body (p, 3) about their mean, in the axes of the first visit: the mean of all visits.

    Raises Degenerate for points on one line.
    """
    shape = seen[0] - seen[0].mean(axis=0)
    for _ in range(ROUNDS):
        before = shape
        shape = np.mean([align_points(shape, points).T_a_b.apply(points) for points in seen], axis=0)
        shape = shape - shape.mean(axis=0)
        if np.abs(shape - before).max() < SETTLED_M:
            break
    return np.asarray(align_points(seen[0] - seen[0].mean(axis=0), shape).T_a_b.rotation.apply(shape))


def _pose(points: Array, shape: Array) -> Array:
    """Return T (4, 4) that carries the body's shape to the points that are there."""
    there = np.isfinite(points).all(axis=1)
    return np.asarray(align_points(points[there], shape[there]).T_a_b.as_matrix())


def _commanded(commanded: Array | None, measured: Measured, rows: list[int], shape: Array) -> Array:
    """Return where the body should be (4, 4); NaN where the commanded points are not those of the body."""
    none = np.full((4, 4), np.nan)
    if commanded is None:
        return none
    points = _means(commanded, measured.which, rows, len(shape))
    there = np.isfinite(points).all(axis=1)
    if there.sum() < FEWEST:
        return none
    try:
        found = align_points(points[there], shape[there])
    except Degenerate:  # one command for all of them
        return none
    size = float(np.sqrt((shape**2).sum(axis=1).mean()))
    return np.asarray(found.T_a_b.as_matrix()) if found.rms_m < OTHER_POINTS * size else none


def _expected(measured: Measured, rows: list[list[int]], n: int) -> float | None:
    """Return the residual that the points' standard deviations leave after 6 of 3 n coordinates are fitted, RMS."""
    if measured.std is None:
        return None
    variance = [
        np.sum(measured.std[at][:, :3] ** 2) / len(at) / max(len(at) / n, 1.0)  # of the mean of a point's rows
        for at in rows
    ]
    return float(np.sqrt(np.mean(variance) * (3 * n - 6) / (3 * n)))


def _of(repeats: Repeats, rows: Index, visit: list[str]) -> Repeats:
    """Return which repeat each body (v,) is, by the first of its rows."""
    names = {
        name: tuple(getattr(repeats, name)[i] for i in rows)
        for name in ("pose", "run", "path", "approach", "arrival", "robot")
    }
    return Repeats(visit=tuple(visit), systematic=None, **names)
