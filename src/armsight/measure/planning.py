"""Setting up cameras: what reaches a wanted accuracy at wanted depths, and whether the lights are seen well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Degenerate, Inconsistent
from armsight.fields import Doc
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.settings import SpotSettings
from armsight.optics import PackedRig, Rig, RigKind, at_zoom, mean_axes, triangulate
from armsight.optics.zoom import ZoomLens
from armsight.records import Frame, Spots
from armsight.records.output import Output, output

IMAGE_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Places along each side of the left image at which points are taken: the picture without its outermost tenth."""

BASELINES = np.geomspace(0.25, 16.0, 73)
"""Baselines that are tried, in those of the rig: steps of 6 %."""

LEAST_COMMON = 0.2
"""Share of the left picture that the right camera must see as well: less is a strip, not a volume."""


@output
class Accuracy(Output):
    """How well the worst point of the common view is placed, in its worst direction, as standard deviations.

    common: at the depth where it is least.
    """

    spots_m: Annotated[
        float, Doc("What the spots' noise brings, m; null where both views share nothing.", nullable=True)
    ]
    rig_m: Annotated[float, Doc("What the rig's calibration brings, m; 0 where its file does not tell.", nullable=True)]
    total_m: Annotated[float, Doc("Both, m.", nullable=True)]
    common: Annotated[float, Doc("Share of the left picture, 0 to 1, that the right camera sees as well.")]
    width_m: Annotated[float, Doc("Width of the left picture at the nearest depth, m.")]

    def reaches(self, accuracy_m: float) -> bool:
        """Tell whether the accuracy is reached in a common view."""
        return self.common >= LEAST_COMMON and self.total_m <= accuracy_m


@output
class Choice(Output):
    """One setting of the lenses."""

    zoom_left: Annotated[float | None, Doc("Of the left lens; null without zoom.")]
    zoom_right: Annotated[float | None, Doc("Of the right lens; null without zoom.")]
    focal_px: Annotated[float, Doc("Focal length of the left camera, px.")]
    now: Annotated[Accuracy, Doc("With the rig's own baseline.")]
    reached: Annotated[bool, Doc("Whether that reaches the wanted accuracy.")]
    baseline_m: Annotated[float | None, Doc("The shortest baseline that reaches it, m; null where none does.")]
    at_baseline: Annotated[Accuracy | None, Doc("What that baseline gives; null where none does.")]


def plan(rig: Rig, accuracy_m: float, depths_m: Sequence[float], sigma_px: float) -> tuple[Choice, ...]:
    """Return what each setting of a rig's lenses reaches at depths, and the baseline that it needs.

    Depths count along the mean optical axis from the middle of the two cameras. A rig with another baseline has the
    right camera moved along it, turned to look at the same distance, and is as well calibrated as this one. Raises
    Inconsistent for values that are not positive and for mirror rigs.
    """
    if not (accuracy_m > 0.0 and sigma_px > 0.0 and depths_m and min(depths_m) > 0.0):
        raise Inconsistent("accuracy, depths and the spots' standard deviation must be positive, and a depth be given")
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent("the baseline of a mirror rig is built into its mirrors", cure="Give a rig of two cameras")
    choices = []
    for zoom in zooms_of(rig):
        here = at_zoom(rig, zoom).rig
        now = accuracy(here, depths_m, sigma_px)
        found = _shortest(here, accuracy_m, depths_m, sigma_px)
        choices.append(
            Choice(
                zoom_left=zoom[0],
                zoom_right=zoom[1],
                focal_px=float(here.left.intrinsics[0]),
                now=now,
                reached=now.reaches(accuracy_m),
                baseline_m=None if found is None else found[0],
                at_baseline=None if found is None else found[1],
            )
        )
    return tuple(choices)


def zooms_of(rig: Rig) -> tuple[tuple[float | None, float | None], ...]:
    """Return the settings worth asking for: the left lens's, and the right one's of nearly the same focal length."""
    left, right = rig.zoom
    if left is None:
        if right is None:
            return ((None, None),)
        return tuple((None, value) for value in _settings(right.lens))
    pairs: list[tuple[float | None, float | None]] = []
    for value in _settings(left.lens):
        focal = left.lens.at(value).camera.intrinsics[0]
        pairs.append((value, None if right is None else _of_focal(right.lens, float(focal))))
    return tuple(pairs)


def _settings(lens: ZoomLens) -> list[float]:
    """Return the calibrated settings and the middles between them; those alone of fewer than three."""
    zooms = lens.zooms
    middles = 0.5 * (zooms[1:] + zooms[:-1]) if len(zooms) >= 3 else np.empty(0)
    return sorted([*zooms.tolist(), *middles.tolist()])


def _of_focal(lens: ZoomLens, focal_px: float) -> float:
    """Return the one of a lens's settings and their middles whose focal length is nearest."""
    return min(_settings(lens), key=lambda value: abs(np.log(lens.at(value).camera.intrinsics[0] / focal_px)))


def accuracy(rig: Rig, depths_m: Sequence[float], sigma_px: float) -> Accuracy:
    """Return how well a rig without zoom settings places points at depths, over its common view.

    NaN deviations and common 0 where no point is seen by both cameras.
    """
    packed, worst, common = PackedRig.of(rig), np.zeros(3), 1.0
    width = 0.0
    for depth_m in sorted(depths_m):
        points, share = _common_points(rig, depth_m)
        common = min(common, share)
        width = width or _width(rig, depth_m)
        if not len(points):
            return Accuracy(spots_m=np.nan, rig_m=np.nan, total_m=np.nan, common=0.0, width_m=width)
        worst = np.maximum(worst, _deviations(rig, packed, points, sigma_px))
    return Accuracy(
        spots_m=float(worst[0]), rig_m=float(worst[1]), total_m=float(worst[2]), common=common, width_m=width
    )


def _common_points(rig: Rig, depth_m: float) -> tuple[Array, float]:
    """Return points (n, 3) at a depth in rig axes that both cameras see, and the share of those of the left one."""
    u, v = np.meshgrid(np.array(IMAGE_SHARES) * (rig.left.width - 1), np.array(IMAGE_SHARES) * (rig.left.height - 1))
    rays = rig.left.rays(np.stack([u.ravel(), v.ravel()], axis=1))
    rays = rays[np.isfinite(rays).all(axis=1)]
    T = rig.T_rig_left
    directions = T.rotation.apply(np.column_stack([rays, np.ones(len(rays))]))  # (n, 3)
    axis = mean_axes(rig)[:, 2]
    origin = np.asarray(T.translation)
    middle = 0.5 * (origin + np.asarray(rig.T_rig_right.translation))
    reach = (depth_m + (middle - origin) @ axis) / (directions @ axis)
    points = origin + reach[:, None] * directions
    uv = rig.project(points)[1]
    size = np.array([rig.right.width, rig.right.height]) - 1.0
    seen = (reach > 0.0) & np.isfinite(uv).all(axis=1) & (uv >= 0.0).all(axis=1) & (uv <= size).all(axis=1)
    return points[seen], float(seen.mean()) if len(seen) else 0.0


def _width(rig: Rig, depth_m: float) -> float:
    """Return how wide the left picture is at a distance."""
    row = 0.5 * (rig.left.height - 1)
    ends = rig.left.rays([[0.0, row], [rig.left.width - 1.0, row]])
    return float(depth_m * (ends[1, 0] - ends[0, 0]))


def _deviations(rig: Rig, packed: PackedRig, points: Array, sigma_px: float) -> Array:
    """Return the largest standard deviations (3,) of points (n, 3) in any direction: of spots, of the rig, of both."""
    left, right = rig.project(points)
    cov = sigma_px**2 * np.eye(2)
    try:
        spots = triangulate(rig, left, right, cov, cov).require_all().covariance_m2
    except Degenerate:  # the rays are parallel within their noise: no depth
        return np.full(3, np.inf)
    of_rig = np.zeros_like(spots)
    if packed.covariance.size:
        A = np.empty((len(points), 3, len(packed.covariance)))
        both = np.tile(cov, (len(points), 2, 1, 1))
        rig_covariance.point_slopes(packed.arrays, both, points, spots, A)
        of_rig = A @ packed.covariance @ A.transpose(0, 2, 1)
    parts = (spots, of_rig, spots + of_rig)
    return np.array([np.sqrt(max(float(np.linalg.eigvalsh(part)[:, -1].max()), 0.0)) for part in parts])


def _shortest(rig: Rig, accuracy_m: float, depths_m: Sequence[float], sigma_px: float) -> tuple[float, Accuracy] | None:
    """Return the shortest of the BASELINES that reaches the accuracy, and what it gives; None where none does."""
    for factor in BASELINES:
        found = accuracy(with_baseline(rig, float(factor)), depths_m, sigma_px)
        if found.reaches(accuracy_m):
            return float(factor) * rig.baseline_m, found
    return None


def with_baseline(rig: Rig, factor: float) -> Rig:
    """Return a rig with its baseline times a factor; the cameras' axes meet where they met, its covariance stays."""
    y = mean_axes(rig)[:, 1]
    left, right = (T.rotation.as_matrix()[:, 2] for T in (rig.T_rig_left, rig.T_rig_right))
    toe_in = float(np.arctan2(np.cross(left, right) @ y, left @ right))
    turn = Rotation.from_rotvec((factor - 1.0) * toe_in * y)
    origin = np.asarray(rig.T_rig_left.translation)
    moved_m = origin + factor * (np.asarray(rig.T_rig_right.translation) - origin)
    T_right = RigidTransform.from_components(moved_m, turn * rig.T_rig_right.rotation)
    return rig.with_each(T_rig_camera=(rig.T_rig_left, T_right))


# What a person who sets up a camera wants to know: are the lights clipped, faint, blurred, or drowned by the room?

FAINT_LEVELS = 30.0
"""Grey levels above the background under which a light's centre is lost in the noise of a webcam: 0.1 px and more."""
BLURRED_PX = 6.0
"""Gaussian sigma in px beyond which lights are so blurred that near ones run into each other."""
POINT_LIKE_PX = 0.6
"""Gaussian sigma in px under which a light is hardly more than a pixel, whose centre cannot be told finely."""
BRIGHT_ROOM = 0.05
"""Share of clipped pixels in an image beyond which the room outshines the lights."""


class Aiming(StrEnum):
    """What to do about a camera, the most urgent first."""

    NOTHING_SEEN = "nothing_seen"
    ROOM_TOO_BRIGHT = "room_too_bright"
    CLIPPED = "clipped"
    FAINT = "faint"
    BLURRED = "blurred"
    TOO_SHARP = "too_sharp"
    GOOD = "good"


@dataclass(frozen=True, slots=True, kw_only=True)
class AimingHint:
    """advice: what to do. background: median grey level. brightest: of the lights' fitted heights above it; clipped:
    how many lights hold clipped pixels. sigma_px: their median width. None where no light is seen."""

    advice: Aiming
    background: float
    n_clipped: int = 0
    brightest: float | None = None
    sigma_px: float | None = None


def aiming_hint(frame: Frame, spots: Spots, settings: SpotSettings) -> AimingHint:
    """Return what to change on a camera, from one frame and the lights found in it."""
    image = frame.image if frame.image.ndim == 2 else frame.image.max(axis=2)
    sample = image[::4, ::4]
    background, clipped = float(np.median(sample)), float((sample >= settings.saturation).mean())
    if len(spots) == 0:
        advice = Aiming.ROOM_TOO_BRIGHT if clipped > BRIGHT_ROOM else Aiming.NOTHING_SEEN
        return AimingHint(advice=advice, background=background)
    n_clipped = sum(
        _holds_clipped(image, u, v, s, settings) for (u, v), s in zip(spots.uv_px, spots.size_px, strict=True)
    )
    sigma_px, brightest = float(np.median(spots.size_px)), float(spots.peak.max())
    return AimingHint(
        advice=_advice(clipped, n_clipped, float(np.median(spots.peak)), sigma_px),
        background=background,
        n_clipped=n_clipped,
        brightest=brightest,
        sigma_px=sigma_px,
    )


def _holds_clipped(image: np.ndarray, u_px: float, v_px: float, sigma_px: float, settings: SpotSettings) -> bool:
    reach = max(1, round(sigma_px))
    row, column = round(v_px), round(u_px)
    window = image[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return bool(window.size and window.max() >= settings.saturation)


def _advice(clipped_share: float, n_clipped: int, peak: float, sigma_px: float) -> Aiming:
    if clipped_share > BRIGHT_ROOM:
        return Aiming.ROOM_TOO_BRIGHT
    if n_clipped:
        return Aiming.CLIPPED
    if 0.0 < peak < FAINT_LEVELS:
        return Aiming.FAINT
    if sigma_px > BLURRED_PX:
        return Aiming.BLURRED
    return Aiming.TOO_SHARP if sigma_px < POINT_LIKE_PX else Aiming.GOOD
