"""Lights that something covers in part: told by their outlines, taken with more doubt, or left out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.kernels import hidden as kernels
from armsight.measure.poses.kernels import pose as pose_kernels
from armsight.measure.poses.pose import Solved
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.solving import solve_spots
from armsight.records import Frame, PoseStatus, Spots

Image = NDArray[np.uint8]

JOINT = "joint"
"""The model of lights that touch: the outline of one of them is that of all."""


class Seen(NamedTuple):
    """Spots with their names, and what is solved from them. hidden: names of lights that were left out; widened: whether
    any is taken with more doubt than its own noise gives it."""

    names: tuple[str, ...]
    left: Spots
    right: Spots
    solved: Solved
    hidden: tuple[str, ...] = ()
    widened: bool = False


def solve_seen(
    setup: Setup,
    t_s: float,
    names: tuple[str, ...],
    left: Spots,
    right: Spots,
    frames: tuple[Frame, Frame] | None,
) -> Seen:
    """Return the pose of named spots (solve_spots), after a look at whether each light is there as a whole.

    frames: the images that they were found in; without them nothing is looked at. A light unlike every other one is left
    out, and one that may be cut off a little is as uncertain as what may be hidden of it is wide.
    """
    solved = solve_spots(setup, t_s, names, left, right)
    n = len(names)
    if frames is None or n < 2 or solved.pose.status is PoseStatus.LOST or len(solved.points) != n:
        return Seen(names, left, right, solved)
    uv, cov = np.empty((n, 2, 2)), np.empty((n, 2, 2, 2))
    pose_kernels.stack_views(left.uv_px, left.covariance_px2, right.uv_px, right.covariance_px2, uv, cov)
    variance, odd = np.zeros((n, 2, 2, 2)), np.zeros((n, 2), np.uint8)
    verdict = kernels.compare_lights(
        channels(frames[0]),
        channels(frames[1]),
        np.uint8(setup.settings.options[1]),
        setup.packed.R,
        setup.packed.t,
        solved.points.xyz_m,
        uv,
        cov,
        np.column_stack([left.size_px, right.size_px]),
        usable(left, right),
        variance,
        odd,
    )
    if verdict == kernels.NO_DOUBT:
        return Seen(names, left, right, solved)
    left = replace(left, covariance_px2=left.covariance_px2 + variance[:, 0])
    right = replace(right, covariance_px2=right.covariance_px2 + variance[:, 1])
    kept = np.flatnonzero(~odd.any(axis=1))
    hidden = tuple(name for name, is_odd in zip(names, odd.any(axis=1), strict=True) if is_odd)
    if hidden:
        names, left, right = tuple(names[i] for i in kept), left.take(kept), right.take(kept)
    if not names:
        return Seen(names, left, right, solved, hidden, widened=True)
    return Seen(names, left, right, solve_spots(setup, t_s, names, left, right), hidden, widened=True)


def channels(frame: Frame) -> Image:
    """Return a frame's image as (h, w, channels)."""
    return frame.image if frame.image.ndim == 3 else frame.image[:, :, None]


def usable(left: Spots, right: Spots) -> NDArray[np.uint8]:
    """Return (n, 2): which spots are alone in their bright area, so that its outline is theirs."""
    out = np.ones((len(left), 2), np.uint8)
    for side, spots in enumerate((left, right)):
        if JOINT in spots.model:
            out[[kind == JOINT for kind in spots.model], side] = 0
    return out


def why_hidden(hidden: tuple[str, ...], status: PoseStatus) -> str:
    """Return why a pose is not given, or not of all lights."""
    which = f"light {hidden[0]} is" if len(hidden) == 1 else f"lights {' and '.join(hidden)} are"
    left = "nothing is known" if status is PoseStatus.LOST else "only the position of the others is known"
    return f"half hidden: {which} not as wide as the others and left out; {left}"
