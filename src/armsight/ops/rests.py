"""Rests of a robot and of what a tracker measured: where each stands still, and the mean of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Mask
from armsight.errors import UsageError
from armsight.store.verify_files import MeasuredFile
from armsight.verify import Measured, Reported

STILL_RAD_S = 2e-3
"""A joint that turns (rad/s) or slides (m/s) slower rests: at one metre it moves its tool by 2 mm a second."""
STILL_ROWS = 3
"""Rows of one rest that are worth a mean."""
SEEN_STILL_M_S, SEEN_STILL_RAD_S = 5e-3, 1e-2
"""What is measured to move slower rests: noise of 1 mm in rows 10 ms apart moves the means that are compared by 2."""
MEAN_S, REST_S = 0.2, 0.4
"""Means of so long are compared with those before; shorter rests are a motion's turning points."""
SAME_M, SAME_RAD = 5e-4, 5e-3
"""Two rests that follow each other nearer together are one that something interrupted."""


def spans(still: Mask, fewest: int) -> list[NDArray[np.intp]]:
    """Return the rows of each stretch of so many rows at least that are still (n,)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    found = [np.arange(first, last) for first, last in zip(ends[::2], ends[1::2], strict=True)]
    return [span for span in found if len(span) >= fewest]


def rests_of_robot(reported: Reported) -> Reported:
    """Return the mean joints of each rest of a log, in order; what has no times, such as a program, as it is."""
    if reported.t_s is None or reported.q is None:
        return reported
    good = np.isfinite(reported.q).all(axis=1)
    q = reported.q[good]
    speed = np.abs(np.gradient(q, reported.t_s[good], axis=0)).max(axis=1)
    return Reported(q=np.array([q[span].mean(axis=0) for span in spans(speed < STILL_RAD_S, STILL_ROWS)]))


def rests_of_measured(file: MeasuredFile) -> MeasuredFile:
    """Return a file with one row for each rest of a recording, its mean, in order. Raises UsageError without times."""
    seen = file.measured
    if seen.t_s is None or len(seen.labels) > 1:
        raise UsageError(
            "the rests of what was measured need its times and one point",
            cure="Give a recording with t_s of one body or point",
        )
    groups = _joined(seen, spans(_still(seen, seen.t_s), STILL_ROWS))
    groups = [group for group in groups if seen.t_s[group[-1]] - seen.t_s[group[0]] >= REST_S]
    R = None if seen.rotation is None else np.array([_mean(seen.rotation[group]) for group in groups])
    own = seen.covariance
    mean = Measured(
        xyz_m=np.array([seen.xyz_m[group].mean(axis=0) for group in groups]).reshape(-1, 3),
        rotation=None if R is None else R.reshape(-1, 3, 3),
        covariance=None if own is None else np.array([own[group].mean(axis=0) for group in groups]).reshape(-1, 6, 6),
        row=np.arange(1, len(groups) + 1),
        point=tuple(seen.point[group[0]] for group in groups) if seen.point else (),
    )
    note = f"{len(groups)} rests of what was measured, each joined in its order"
    repeats = replace(file.repeats, systematic=None)  # of the single rows
    return replace(file, measured=mean, repeats=repeats, pose=None, notes=(*file.notes, note))


def _mean(R: Array) -> Array:
    return np.asarray(Rotation.from_matrix(R).mean().as_matrix())


def _still(seen: Measured, t_s: Array) -> Mask:
    """Return which rows (n,) rest: means of what follows and of what was before differ by no motion."""
    k = max(round(MEAN_S / max(float(np.median(np.diff(t_s))), 1e-6)), 1)
    moved = _apart(seen.xyz_m, k) < SEEN_STILL_M_S * MEAN_S
    if seen.rotation is None:
        return moved
    return np.asarray(moved & (_apart(seen.rotation.reshape(-1, 9), k) < np.sqrt(2.0) * SEEN_STILL_RAD_S * MEAN_S))


def _apart(values: Array, k: int) -> Array:
    """Return how far apart the means of k rows after and before each row (n,) are; infinite near the ends."""
    out = np.full(len(values), np.inf)
    if len(values) <= 2 * k:
        return out
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)])
    at = np.arange(k, len(values) - k + 1)
    step = (sums[at + k] - 2.0 * sums[at] + sums[at - k]) / k
    out[at[:-1]] = np.linalg.norm(step[:-1], axis=1)
    return out


def _joined(seen: Measured, groups: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Return rests with those joined that are one."""
    out: list[NDArray[np.intp]] = []
    for group in groups:
        if out and np.linalg.norm(seen.xyz_m[group].mean(axis=0) - seen.xyz_m[out[-1]].mean(axis=0)) < SAME_M:
            turned = (
                0.0
                if seen.rotation is None
                else float(np.linalg.norm(_mean(seen.rotation[group]) - _mean(seen.rotation[out[-1]])) / np.sqrt(2.0))
            )
            if turned < SAME_RAD:
                out[-1] = np.concatenate([out[-1], group])
                continue
        out.append(group)
    return out
