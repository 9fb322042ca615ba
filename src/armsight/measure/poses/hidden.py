"""Lights that something covers in part: told by their outlines, taken with more doubt, or left out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.kernels import hidden as kernels
from armsight.measure.poses.pose import Solved
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.solving import solve_spots
from armsight.records import Frame, PoseStatus, Spots

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

JOINT = "joint"
"""The model of lights that touch: the outline of one of them is that of all."""


class Seen(NamedTuple):
    """Spots with their names, and what is solved from them. hidden: names of lights that were left out."""

    names: tuple[str, ...]
    left: Spots
    right: Spots
    solved: Solved
    hidden: tuple[str, ...] = ()


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
    out = np.zeros((2, n, kernels.FINDING))
    verdict = kernels.compare_lights(
        channels(frames[0]),
        channels(frames[1]),
        setup.settings.options,
        setup.packed.R,
        setup.packed.t,
        solved.points.xyz_m,
        left.uv_px,
        left.covariance_px2,
        sizes(left),
        right.uv_px,
        right.covariance_px2,
        sizes(right),
        out,
    )
    if verdict == kernels.NO_DOUBT:
        return Seen(names, left, right, solved)
    left, right = widened(left, out[0]), widened(right, out[1])
    odd = out[:, :, kernels.ODD].any(axis=0)
    hidden = tuple(name for name, is_odd in zip(names, odd.tolist(), strict=True) if is_odd)
    if hidden:
        kept = np.flatnonzero(~odd)
        names, left, right = tuple(names[i] for i in kept.tolist()), left.take(kept), right.take(kept)
    if not names:
        return Seen(names, left, right, solved, hidden)
    return Seen(names, left, right, solve_spots(setup, t_s, names, left, right), hidden)


def widened(spots: Spots, found: Array) -> Spots:
    """Return the spots with what may be hidden of each, found (n, FINDING), in their covariances."""
    return replace(
        spots, covariance_px2=spots.covariance_px2 + found[:, [[kernels.UU, kernels.UV], [kernels.UV, kernels.VV]]]
    )


def channels(frame: Frame) -> Image:
    """Return a frame's image as (h, w, channels)."""
    return frame.image if frame.image.ndim == 3 else frame.image[:, :, None]


def sizes(spots: Spots) -> Array:
    """Return the spots' sizes (n,); 0 for lights that touch, whose outline is not their own."""
    if JOINT not in spots.model:
        return spots.size_px
    size = np.where([kind == JOINT for kind in spots.model], 0.0, spots.size_px)
    size.setflags(write=False)  # as the others: one compilation serves both
    return size


def why_hidden(hidden: tuple[str, ...], status: PoseStatus) -> str:
    """Return why a pose is not given, or not of all lights."""
    which = f"light {hidden[0]} is" if len(hidden) == 1 else f"lights {' and '.join(hidden)} are"
    left = "nothing is known" if status is PoseStatus.LOST else "only the position of the others is known"
    return f"half hidden: {which} not as wide as the others and left out; {left}"
