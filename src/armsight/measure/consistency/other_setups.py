"""Where the lights seen do not fit rig and target: the usual mistakes in the two files undone, and which one fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import DataRefused
from armsight.measure.consistency.causes import RECALIBRATE, REMEASURE
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pairs import Pairs, pair_spots
from armsight.measure.poses.setup import Setup
from armsight.optics import SIDES, Camera
from armsight.records import PoseStatus
from armsight.records.checks import LARGEST_BASELINE_M

MOST = 0.7
"""Share of the moments that another setup must fit to be named; ... and"""
MORE = 2.0
"""... by this factor more than the setup as it is given."""
FEWEST = 3
"""Moments that must fit: three lights fit another triangle once by chance."""
SCALED = 0.004
"""Scale from which it is tried: smaller ones the residuals of poses tell, with their deviations."""
MOST_PAIRS = 60
"""Pairs of spots among which triangles are looked for: 34,000 of them."""
SHAPE = 0.015
"""Logarithms of three sides' ratios that differ by more are of another shape: places 0.8 m away scatter by 0.5 %."""
SAME_SCALE = 0.004
"""Scales of two moments that are nearer are one."""
NEAR_SCALE = 0.1
"""Logarithm of a scale beyond which triangles among other lights say nothing: too many of them are there by chance."""
MOVED_M = 0.02
"""A triangle that moved less between moments may be of lamps of the room."""
EDGE = 0.25
"""A principal point nearer to an image's edge than this share of its width is not that of a whole image."""
UNITS = {"centimetres": 0.01, "inches": 0.0254, "millimetres": 0.001}
"""In which rigs come."""
SIZES = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 2, 2.0, 3.0, 4.0)
"""Ratios of image sizes that drivers offer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherSetup:
    """A setup in place of the given one; words: what is then wrong with that one, cure: what to change."""

    setup: Setup
    words: str
    cure: str


def what_fits(setup: Setup, moments: Sequence[Measured]) -> OtherSetup | None:
    """Return the setup that fits most of the moments where the given one does not; None where none does."""
    if setup.target.is_board or not setup.target.model_known or len(setup.model) < 3 or len(moments) < FEWEST:
        return None
    others = _others(setup, moments)
    counts = [_fitting(other.setup, moments) for other in others]
    best = int(np.argmax(counts)) if counts else -1
    if best < 0 or counts[best] < max(FEWEST, MOST * len(moments), MORE * _fitting(setup, moments)):
        return _among_others(setup, moments)
    return others[best]


def _fitting(setup: Setup, moments: Sequence[Measured]) -> int:
    """Return in how many moments all lights of the target are found."""
    fits = 0
    for one in moments:
        try:
            found = measure_spots(setup, one.pose.t_s, one.left_seen, one.right_seen)
        except DataRefused:
            continue
        fits += found.pose.status is PoseStatus.OK and len(found.names) == len(setup.model)
    return fits


def _others(setup: Setup, moments: Sequence[Measured]) -> list[OtherSetup]:
    """Return the usual mistakes undone, the plainest first."""
    wide = setup.rig.baseline_m > LARGEST_BASELINE_M
    mirrored = _with_target(setup, np.array([1.0, -1.0, 1.0]))
    out = [*_of_other_size(setup), *(_in_units(setup) if wide else [])]
    out.append(
        OtherSetup(
            setup=mirrored,
            words="The lights are the target's mirror image: its y is measured upwards, or its z towards the camera",
            cure="Change the sign of y of every light in the target's file: x goes to the right, y down, z away from "
            "the camera",
        )
    )
    factor = _scale(setup, moments)
    if factor is not None and abs(factor - 1.0) > SCALED and not (wide and factor * max(UNITS.values()) > 0.5):
        out += [_rescaled(setup, factor), _rescaled(mirrored, factor, MIRRORED)]
    return out


MIRRORED = ", and they are its mirror image: its y is measured upwards"


def _rescaled(setup: Setup, factor: float, more: str = "") -> OtherSetup:
    """Return the setup with a target that many times as large."""
    words = f"The lights stand {factor:.3g} times as far apart, seen with this rig, as the target's file says{more}"
    cure = (
        f"Check the target's measures and their unit with a calliper, or {REMEASURE}; if they hold, {RECALIBRATE}, "
        "with the board's true square size"
    )
    return OtherSetup(setup=_with_target(setup, np.full(3, factor)), words=words, cure=cure)


def _in_units(setup: Setup) -> list[OtherSetup]:
    """Return a rig wider than any with its lengths in the units that rigs come in."""
    rig, out = setup.rig, list[OtherSetup]()
    for unit, size_m in UNITS.items():
        left, right = (
            RigidTransform.from_components(T.translation * size_m, T.rotation)
            for T in (rig.T_rig_left, rig.T_rig_right)
        )
        narrower = replace(rig.with_each(T_rig_camera=(left, right)), covariance=None)
        out.append(
            OtherSetup(
                setup=replace(setup, rig=narrower),
                words=f"The rig's cameras stand {rig.baseline_m:.4g} m apart, and with {narrower.baseline_m:.4g} m the "
                f"target fits: the rig's lengths are {unit}, given as metres",
                cure=f"Multiply xyz_m of both cameras in the rig's file by {size_m:g}, or calibrate the rig anew with "
                "the board's square in metres",
            )
        )
    return out


def _with_target(setup: Setup, factors: Array) -> Setup:
    """Return the setup with the target's coordinates (x, y, z) multiplied."""
    return replace(setup, target=replace(setup.target, xyz_m=setup.target.xyz_m * factors, covariance=None))


def _scale(setup: Setup, moments: Sequence[Measured]) -> float | None:
    """Return how much larger the triangles seen are than the target's, over the moments that show as many lights."""
    m = len(setup.model)
    given = np.sort(setup.model.distance_m[np.triu_indices(m, 1)])
    found = []
    for pairs in _pairs(setup, moments):
        if len(pairs.index) == m and all(len(np.unique(pairs.index[:, side])) == m for side in range(2)):
            apart = np.linalg.norm(pairs.xyz_m[:, None] - pairs.xyz_m[None], axis=2)[np.triu_indices(m, 1)]
            found.append(float(np.median(np.sort(apart) / given)))
    return float(np.median(found)) if len(found) >= FEWEST else None


def _pairs(setup: Setup, moments: Sequence[Measured]) -> list[Pairs]:
    """Return what could be a light in each moment."""
    seen = ((one.left_seen, one.right_seen) for one in moments)
    return [pair_spots(setup.packed, *spots, setup.slack_px, overlaid=setup.overlaid) for spots in seen]


def _among_others(setup: Setup, moments: Sequence[Measured]) -> OtherSetup | None:
    """Return the target of the scale at which most moments have its triangle, beside whatever else is bright.

    That triangle moves, as no lamp of a room does, and is seldom there at the scale that was given.
    """
    few = [pairs for pairs in _pairs(setup, moments) if 3 <= len(pairs.index) <= MOST_PAIRS]
    among = [_similar(pairs, setup.model.distance_m[:3, :3]) for pairs in few]
    every = np.concatenate([np.zeros((0, 4)), *among])
    every = every[(np.abs(np.log(every[:, 0])) < NEAR_SCALE) & (np.abs(np.log(every[:, 0])) > SCALED)]
    counts = np.array([_with_scale(among, s) for s in every[:, 0]])
    if not len(counts) or counts.max() < max(FEWEST, MOST * len(moments), MORE * _with_scale(among, 1.0)):
        return None
    best = every[np.abs(every[:, 0] - every[int(counts.argmax()), 0]) < SAME_SCALE]
    if np.ptp(best[:, 1:], axis=0).max() < MOVED_M:
        return None
    return _rescaled(setup, float(np.median(best[:, 0])))


def _with_scale(among: Sequence[Array], scale: float) -> int:
    """Return in how many moments a triangle has a scale."""
    return sum(bool((np.abs(one[:, 0] - scale) < SAME_SCALE).any()) for one in among)


def _similar(pairs: Pairs, distance_m: Array) -> Array:
    """Return scale and middle (k, 4) of the triangles of pairs that are of the shape of the target's first lights."""
    rows = np.array(list(combinations(range(len(pairs.index)), 3)))
    spots = pairs.index[rows]  # (k, 3, 2)
    apart = np.all([(spots[:, i] != spots[:, j]).all(axis=1) for i, j in ((0, 1), (0, 2), (1, 2))], axis=0)
    x = pairs.xyz_m[rows[apart]]
    sides = np.sort(np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2), axis=1)
    ratio = np.log(sides / np.sort(distance_m[np.triu_indices(3, 1)]))
    alike = np.ptp(ratio, axis=1) < SHAPE
    return np.column_stack([np.exp(ratio[alike].mean(axis=1)), x[alike].mean(axis=1)])


def _of_other_size(setup: Setup) -> list[OtherSetup]:
    """Return the rig with intrinsics of images of another size, where a principal point says so."""
    rig, off = setup.rig, dict[str, float]()
    for side in SIDES:
        camera = rig.camera(side)
        share = camera.intrinsics[2] / camera.width
        if not EDGE <= share <= 1.0 - EDGE:
            off[side] = SIZES[int(np.argmin(np.abs(np.log(np.array(SIZES) * 2.0 * max(share, 1e-3)))))]
    if not off:
        return []
    left, right = (_resized(rig.camera(side), off.get(side, 1.0)) for side in SIDES)
    first, factor = next(iter(off.items()))
    camera = rig.camera(first)
    return [
        OtherSetup(
            setup=replace(setup, rig=replace(rig.with_each(camera=(left, right)), covariance=None)),
            words=f"The principal point lies at the image's edge (cx {camera.intrinsics[2]:.1f} of {camera.width} px, "
            f"{' and '.join(off)}): the intrinsics are of images {1.0 / factor:.3g} times as large",
            cure=f"Multiply fx, fy, cx and cy of the {' and '.join(off)} camera in the rig's file by {factor:.4g}, or "
            "calibrate at this size of image",
        )
    ]


def _resized(camera: Camera, factor: float) -> Camera:
    """Return the camera of images that many times as large, pixel (0, 0) in the middle of the first one."""
    intrinsics = camera.intrinsics.copy()
    intrinsics[:5] *= factor
    return replace(camera, intrinsics=intrinsics)
