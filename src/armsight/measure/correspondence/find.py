"""A picked pixel found in the other view: searched along its epipolar line, refined as a piece of a plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.defaults import PICK_STD_PX
from armsight.errors import Ambiguous, DataRefused, Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.measure.correspondence.refine import Patch, Refined, StereoViews, correlation, refined
from armsight.optics import triangulate
from armsight.optics.triangulate import epipolar_curve

LEAST_CONTRAST = 4.0
"""Standard deviation of a patch in grey levels; noise of ordinary cameras is 1 to 2."""
COARSE, FINE = 0.6, 0.85
"""Least correlation on the search, where the patch is taken to face the camera, and as a piece of a plane."""
RIVAL = 0.15
"""A second place whose correlation is less than this below the best cannot be told from it."""
STEP_PX = 0.5
LEAST_STEPS = 8
BACK_PX = 1.0
"""How far from the pick the way back from the other view may end."""
LARGEST_STD_PX = 0.5
DEPTHS = (3.0, 300.0)
"""Nearest and furthest depth where none are given, in baselines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchSettings:
    """half_px: a patch's half side; near_m, far_m: depths along the camera's axis; None: DEPTHS baselines.

    pick_std_px: standard deviation of a pick in its own view; epipolar_std_px: of the other view's rows, by the rig's
    calibration.
    """

    half_px: int = 7
    near_m: float | None = None
    far_m: float | None = None
    pick_std_px: float = PICK_STD_PX
    epipolar_std_px: float = 0.3

    def __post_init__(self) -> None:
        if not 3 <= self.half_px <= 50:
            raise UsageError(f"a patch of half {self.half_px} px is too small or too large", cure="Use 3 to 50")
        for key in ("near_m", "far_m", "pick_std_px", "epipolar_std_px"):
            value = getattr(self, key)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{key} is {value:g}, which is not positive", consequence="No point is looked for")

    def depths_m(self, baseline_m: float) -> tuple[float, float]:
        """Return the nearest and the furthest depth; raises UsageError where they are swapped."""
        near = DEPTHS[0] * baseline_m if self.near_m is None else self.near_m
        far = DEPTHS[1] * baseline_m if self.far_m is None else self.far_m
        if not near < far:
            raise UsageError(f"the nearest depth {near:g} m is not below the furthest {far:g} m", cure="Swap them")
        return near, far


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correspondence:
    """A pick (2,) px and its place other_px (2,) in the other view; the point xyz_m (3,) in rig axes.

    covariance_m2 (3, 3): of the pick in its view, along the patch's plane, and of the match; not of the rig.
    correlation: of the patch there; second: of the best other place on the line. std_px: of the match along the line.
    """

    px: Array
    other_px: Array
    std_px: float
    correlation: float
    second: float
    xyz_m: Array
    covariance_m2: Array


def find_in_other_view(
    views: StereoViews, side: str, px: Array, settings: PatchSettings | None = None
) -> Correspondence:
    """Return where a pixel px (2,) of one view is in the other, and the point.

    Raises Inconsistent where it is outside the image or its line misses the other, Degenerate without texture along
    the line, Ambiguous where a second place looks like it, NotEnoughData where none does. Each says which.
    """
    settings = PatchSettings() if settings is None else settings
    px = np.asarray(px, dtype=np.float64)
    patch = _patch(views, side, px, settings)
    depth, second = _search(views, patch, settings)
    fit = refined(views, patch, 1.0 / depth, settings.epipolar_std_px)
    if fit.correlation < FINE:
        raise NotEnoughData(
            f"the place that looks most like {_at(side, px)} does not look enough like it "
            f"(correlation {fit.correlation:.2f}, {FINE:g} is needed)",
            consequence="No point is given",
            cure="Something may hide it, or reflect; pick another place",
        )
    if fit.std_px > LARGEST_STD_PX:
        raise Degenerate(
            f"{_at(side, px)} has too little texture along its epipolar line: +-{fit.std_px:.2g} px",
            consequence="No point is given",
            cure="Pick a place with texture, or an edge across the line; or give a larger patch",
        )
    _require_way_back(views, patch.other, fit, px, settings)
    return _point(views, side, patch, fit, max(second, 0.0), settings)


def _patch(views: StereoViews, side: str, px: Array, settings: PatchSettings) -> Patch:
    if px.shape != (2,) or not np.isfinite(px).all():
        raise UsageError("a pick is two finite pixels", consequence="No point is looked for")
    patch = Patch(views, side, px, settings.half_px)
    if not patch.seen:
        raise Inconsistent(
            f"{_at(side, px)} is outside the image, or nearer than {settings.half_px} px to its border",
            consequence="No point is given",
            cure="Pick inside, or give a smaller patch",
        )
    contrast = float(np.std(patch.grey))
    if contrast < LEAST_CONTRAST:
        raise Degenerate(
            f"{_at(side, px)} has no texture: {contrast:.1f} grey levels, {LEAST_CONTRAST:g} are needed",
            consequence="No point is given",
            cure="Pick a place with texture, or an edge; or give a larger patch",
        )
    return patch


def _search(views: StereoViews, patch: Patch, settings: PatchSettings) -> tuple[float, float]:
    """Return the depth in m of the best place on the line, and the correlation of the best other one."""
    px, side = patch.uv_px[patch.middle], "left" if patch.other == "right" else "right"
    w = _inverse_depths(views, side, px, settings)
    uv = patch.in_other(np.broadcast_to(w[:, None], (len(w), len(patch.grey))))  # (m, n, 2)
    seen = views.grey_fast(patch.other, uv.reshape(-1, 2)).reshape(len(w), -1)
    score = correlation(seen, patch.grey)
    known = np.isfinite(score)
    if not known.any():
        raise Inconsistent(
            f"the epipolar line of {_at(side, px)} runs outside the {patch.other} image at these depths",
            consequence="No point is given",
            cure="Pick what both views see, or widen the depths",
        )
    score = np.where(known, score, -1.0)
    k = int(np.argmax(score))
    best = float(score[k])
    if best < COARSE:
        raise NotEnoughData(
            f"nothing on the epipolar line of {_at(side, px)} looks like it (correlation {best:.2f})",
            consequence="No point is given",
            cure="It may be hidden or outside the other image, or the depths or the rig are not those of the pictures",
        )
    first, last = _lobe(score, k)
    _require_texture_along(patch, w[[first, last]], side, settings)
    if first == 0 or last == len(score) - 1:
        raise Inconsistent(
            f"{_at(side, px)} looks most like the end of its line, at {1.0 / w[k]:.3g} m",
            consequence="No point is given: it may be beyond the depths",
            cure="Widen the depths (--near, --far)",
        )
    second = float(np.concatenate([score[:first], score[last + 1 :], [-1.0]]).max())
    if second > best - RIVAL:
        raise Ambiguous(
            f"{_at(side, px)} looks like two places on its epipolar line (correlations {best:.2f} and {second:.2f})",
            consequence="No point is given: either may be it",
            cure="Give the depths more narrowly (--near, --far) or a larger patch, or pick what is there once",
        )
    return float(1.0 / w[k]), second


def _require_texture_along(patch: Patch, w: Array, side: str, settings: PatchSettings) -> None:
    """Raise Degenerate where all between two inverse depths w (2,), which looks the same, is wide on the line."""
    px = patch.uv_px[patch.middle]
    ends = patch.in_other(np.repeat(w[:, None], len(patch.grey), axis=1))[:, patch.middle]
    if float(np.linalg.norm(ends[1] - ends[0])) > 4.0 * settings.half_px:
        raise Degenerate(
            f"{_at(side, px)} has no texture along its epipolar line: it looks the same over "
            f"{np.linalg.norm(ends[1] - ends[0]):.0f} px",
            consequence="No point is given",
            cure="Pick an edge across the line, or give a larger patch",
        )


def _inverse_depths(views: StereoViews, side: str, px: Array, settings: PatchSettings) -> Array:
    """Return inverse depths (m,) whose places on the line are STEP_PX apart."""
    near, far = settings.depths_m(views.rig.baseline_m)
    w = np.linspace(1.0 / far, 1.0 / near, 256)
    curve = epipolar_curve(views.rig, side, px, 1.0 / w)
    step = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(step), step, 0.0))])
    steps = min(max(LEAST_STEPS, math.ceil(along[-1] / STEP_PX)), 20_000)
    return np.interp(np.linspace(0.0, along[-1], steps + 1), along + 1e-12 * np.arange(len(along)), w)


def _lobe(score: Array, k: int) -> tuple[int, int]:
    """Return the first and the last place round k that cannot be told from it."""
    low = np.flatnonzero(score < score[k] - RIVAL)
    before, after = low[low < k], low[low > k]
    return int(before[-1]) + 1 if len(before) else 0, int(after[0]) - 1 if len(after) else len(score) - 1


def _require_way_back(views: StereoViews, other: str, fit: Refined, px: Array, settings: PatchSettings) -> None:
    """Raise Ambiguous where what was found in the other view is, searched from there, another place than the pick."""
    try:
        back = _patch(views, other, fit.other_px, settings)
        depth, _ = _search(views, back, settings)
        found = refined(views, back, 1.0 / depth, settings.epipolar_std_px).other_px
        off = float(np.linalg.norm(found - px))
    except DataRefused as error:
        raise type(error)(
            f"on the way back from the {other} view: {error.cause}", consequence=error.consequence, cure=error.cure
        ) from None
    if off > BACK_PX:
        raise Ambiguous(
            f"{_at(other, fit.other_px)}, which was found, looks more like a place {off:.1f} px beside the pick",
            consequence="No point is given",
            cure="It may be hidden in one view; pick another place",
        )


def _point(
    views: StereoViews, side: str, patch: Patch, fit: Refined, second: float, settings: PatchSettings
) -> Correspondence:
    """Return the point with its covariance: of the match by triangulation, of the pick along the patch's plane."""
    px, nothing = patch.uv_px[patch.middle], 1e-6 * np.eye(2)
    pair, cov = [px[None], fit.other_px[None]], [nothing, fit.covariance_px2]
    if side == "right":
        pair, cov = pair[::-1], cov[::-1]
    made = triangulate(views.rig, *pair, *cov).require_all()
    along = patch.on_plane(fit.inverse_depth, fit.slopes)  # (3, 2) m per px
    R = views.rig.T_rig_camera(side).rotation.as_matrix()
    spread = settings.pick_std_px * R @ along
    return Correspondence(
        px=px,
        other_px=fit.other_px,
        std_px=fit.std_px,
        correlation=fit.correlation,
        second=second,
        xyz_m=made.xyz_m[0],
        covariance_m2=made.covariance_m2[0] + spread @ spread.T,
    )


def _at(side: str, px: Array) -> str:
    return f"({px[0]:.1f}, {px[1]:.1f}) of the {side} view"
