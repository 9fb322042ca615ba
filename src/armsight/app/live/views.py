"""One moment measured, as a screen shows it; a position's uncertainty and a track's colours in a 3-D scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.arrays import Array
from armsight.fields import Doc
from armsight.geometry import euler_rad
from armsight.measure.planning import aiming_hint
from armsight.measure.poses.pipeline import Measured
from armsight.measure.settings import SpotSettings
from armsight.optics import SIDES, Rig
from armsight.optics.triangulate import epipolar_curve
from armsight.records import Frame, Spots, TargetPose
from armsight.records.output import Output, output

DEPTHS_M = np.geomspace(0.15, 30.0, 24)
"""Where along a pixel's ray its epipolar curve is drawn: from a hand before the lens to a hall's other end."""


@output
class SpotView(Output):
    """A light in one picture."""

    name: Annotated[str, Doc("Of the target's light; empty where it was found and not named.")]
    u_px: Annotated[float, Doc("Column of its centre, px.")]
    v_px: Annotated[float, Doc("Row of its centre, px.")]
    residual_px: Annotated[
        tuple[float, float] | None, Doc("Seen minus where the pose has it, px; null without a pose.")
    ]
    view: Annotated[str | None, Doc("left or right: the view it belongs to, in a picture that holds both.")] = None


@output
class SideView(Output):
    """One camera's picture and how the camera should be aimed."""

    width: Annotated[int, Doc("Columns of the camera's image.")]
    height: Annotated[int, Doc("Rows of the camera's image.")]
    spots: Annotated[list[SpotView], Doc("Lights found.")]
    epipolar: Annotated[
        list[list[tuple[float, float]]],
        Doc("In this picture the epipolar curve of every named light of the other one: (u, v) along it, px."),
    ]
    epipolar_views: Annotated[
        list[str] | None, Doc("left or right: the view that each curve is in, where a picture holds both.")
    ] = None
    advice: Annotated[
        str, Doc("What to change: nothing_seen, room_too_bright, clipped, faint, blurred, too_sharp or good.")
    ]
    background: Annotated[float, Doc("Median grey level.")]
    brightest: Annotated[float | None, Doc("Grey levels of the brightest light above the background.")]
    sigma_px: Annotated[float | None, Doc("Median width of the lights (Gaussian sigma), px.")]
    n_clipped: Annotated[int | None, Doc("Lights that hold clipped pixels.")] = None
    exposure_s: Annotated[float | None, Doc("Exposure, s, where the camera tells it.")] = None
    lost: Annotated[str | None, Doc("Why the camera gives no picture any more; null while it does.")] = None
    left_out: Annotated[str | None, Doc("Why its lights do not count, though they are seen; null where they do.")] = (
        None
    )

    @property
    def names(self) -> set[str]:
        """Names of the lights that it shows."""
        return {spot.name for spot in self.spots if spot.name}


@output
class Counts(Output):
    """Moments since the start."""

    ok: Annotated[int, Doc("With a whole pose.")]
    doubtful: Annotated[int, Doc("With a whole pose that does not fit the claims.")]
    position_only: Annotated[int, Doc("With a position only.")]
    lost: Annotated[int, Doc("Without.")]


@output
class LiveView(Output):
    """One moment of live measurement."""

    sequence: Annotated[int, Doc("Moments measured so far.")]
    t_s: Annotated[float, Doc("Time of the frames, on the measuring clock.")]
    fps: Annotated[float, Doc("Moments measured a second, over the last second.")]
    latency_s: Annotated[float, Doc("From the exposure (for files: the moment it is played) to the pose.")]
    measuring_s: Annotated[float, Doc("Time that measuring this moment took.")]
    status: Annotated[str, Doc("ok, doubtful, position_only or lost.")]
    why: Annotated[str, Doc("Why there is no whole pose; else empty.")]
    parent: Annotated[str, Doc("Frame that the pose is in: rig, or the world's name.")]
    xyz_m: Annotated[tuple[float, float, float] | None, Doc("Position of the target.")]
    euler_rad: Annotated[tuple[float, float, float] | None, Doc("rx, ry, rz with R = Rz Ry Rx.")]
    quat_xyzw: Annotated[tuple[float, float, float, float] | None, Doc("Orientation, scalar last.")]
    std: Annotated[tuple[float, ...] | None, Doc("Standard deviations: x, y, z in m, then rotation vector, rad.")]
    covariance_m2: Annotated[
        list[list[float]] | None, Doc("Covariance of the position (3, 3), m squared, where it is known.")
    ] = None
    residual_px: Annotated[float | None, Doc("RMS of the 2-D residual of lights in views known to 1 px, px.")]
    counts: Annotated[Counts, Doc("Since the start.")]
    cameras: Annotated[dict[str, SideView], Doc("By camera, in the rig's order; of mirrors by view.")]
    n_lights: Annotated[int | None, Doc("Lights of the target; null without one.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunView:
    """What a screen shows of the run itself, as LiveView has it."""

    fps: float
    latency_s: float
    measuring_s: float
    counts: Counts
    residual_px: float | None = None


def live_view(pose: TargetPose, run: RunView, cameras: Mapping[str, SideView], n_lights: int | None = None) -> LiveView:
    """Return what a screen shows of one moment: the pose in its frame, and the pictures by camera."""
    T, covariance = pose.pose, pose.covariance
    whole = pose.status.size == 6 and T is not None
    return LiveView(
        sequence=run.counts.ok + run.counts.doubtful + run.counts.position_only + run.counts.lost,
        t_s=pose.t_s,
        fps=run.fps,
        latency_s=run.latency_s,
        measuring_s=run.measuring_s,
        status=pose.status.value,
        why=pose.why,
        parent=pose.parent,
        xyz_m=None if T is None else _three(T.translation),
        euler_rad=_three(euler_rad(T.rotation)) if whole and T is not None else None,
        quat_xyzw=_four(T.rotation.as_quat(canonical=True)) if whole and T is not None else None,
        std=None if covariance is None else tuple(np.sqrt(np.diag(covariance)).tolist()),
        covariance_m2=None if covariance is None else np.asarray(covariance)[:3, :3].tolist(),
        residual_px=run.residual_px,
        counts=run.counts,
        cameras=dict(cameras),
        n_lights=n_lights,
    )


def side_view(
    rig: Rig | None, settings: SpotSettings, side: int, frame: Frame, measured: Measured, *, overlaid: bool = False
) -> SideView:
    """Return what a screen shows of the picture of a rig's camera; side: its place; overlaid: it holds both views.

    Epipolar curves are a pair's: those of three others and more would hide the picture.
    """
    seen = measured.seen[side]
    other = () if rig is None or not rig.is_pair else measured.spots[1 - side].uv_px
    hint = aiming_hint(frame, seen, settings)
    return SideView(
        width=frame.width,
        height=frame.height,
        spots=list(_spots(measured, side, seen, overlaid=overlaid)),
        epipolar=[] if rig is None else [_curve(rig, SIDES[1 - side], px) for px in other],
        advice=hint.advice.value,
        background=hint.background,
        brightest=hint.brightest,
        sigma_px=hint.sigma_px,
        n_clipped=hint.n_clipped,
        exposure_s=frame.exposure_s or None,
    )


def complex_view(view: LiveView) -> SideView:
    """Return what a screen shows of the one picture that holds both views: the spots and curves of both."""
    views = view.cameras
    named = [replace(spot, view=side) for side, one in views.items() for spot in one.spots if spot.name]
    others = {(spot.u_px, spot.v_px): spot for one in views.values() for spot in one.spots if not spot.name}
    return replace(
        views[SIDES[0]],
        spots=[*named, *others.values()],
        epipolar=[curve for one in views.values() for curve in one.epipolar],
        epipolar_views=[side for side, one in views.items() for _ in one.epipolar],
    )


def _spots(measured: Measured, side: int, seen: Spots, *, overlaid: bool) -> Iterator[SpotView]:
    """Yield the named spots with their residuals, then those that nobody named; overlaid: in neither view."""
    matched, residuals = measured.spots[side], -measured.residuals_px(side)  # the record has model minus measured
    if len(residuals) != len(matched):
        residuals = np.full((len(matched), 2), np.nan)
    for name, (u, v), (du, dv) in zip(measured.names_in(side), matched.uv_px, residuals, strict=True):
        known = bool(np.isfinite(du))
        yield SpotView(name=name, u_px=float(u), v_px=float(v), residual_px=(float(du), float(dv)) if known else None)
    known_px = np.concatenate([one.uv_px for one in measured.spots]) if overlaid else matched.uv_px
    named = {(float(u), float(v)) for u, v in known_px}
    for u, v in seen.uv_px:
        if (float(u), float(v)) not in named:
            yield SpotView(name="", u_px=float(u), v_px=float(v), residual_px=None)


def _curve(rig: Rig, side: str, px: NDArray[np.float64]) -> list[tuple[float, float]]:
    uv = epipolar_curve(rig, side, px, DEPTHS_M)
    return [(round(float(u), 1), round(float(v), 1)) for u, v in uv[np.isfinite(uv).all(axis=1)]]


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _four(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return cast("tuple[float, float, float, float]", tuple(float(v) for v in values))


SCALES = (5000.0, 2000.0, 1000.0, 500.0, 200.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0)
LARGEST_M = 0.06
"""Longest semi-axis that an ellipsoid is drawn with: it must not hide the target."""
USELESS_M = 1.0
"""Standard deviation of a position that says nothing of it: its ellipsoid would hold the whole scene."""
THINNEST = 0.02
"""Share of the longest semi-axis that the others are drawn with at least: a flat one is not seen from its side."""
BEST, WORST = np.array([0.0, 0.447, 0.698]), np.array([0.835, 0.369, 0.0])
"""Okabe and Ito's blue and vermillion, as (r, g, b) in 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnEllipsoid:
    """semi_axes_m (3,) as drawn, along the columns of R (3, 3); scale: how many times as large as 1 sigma."""

    semi_axes_m: Array
    R: Array
    scale: float


def drawn_ellipsoid(covariance_m2: ArrayLike) -> DrawnEllipsoid | None:
    """Return the 1 sigma ellipsoid of a position's covariance (3, 3) m^2, enlarged by a round figure to be seen.

    R is a rotation. None for a covariance that is not finite or that is zero, and for one beyond USELESS_M.
    """
    covariance = np.asarray(covariance_m2, dtype=float)
    if not np.isfinite(covariance).all():
        return None
    values, vectors = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(values, 0.0))
    longest = float(sigma.max())
    if not 0.0 < longest <= USELESS_M:
        return None
    scale = next((one for one in SCALES if one * longest <= LARGEST_M), 1.0)
    if np.linalg.det(vectors) < 0.0:
        vectors = vectors * [1.0, 1.0, -1.0]
    return DrawnEllipsoid(semi_axes_m=np.maximum(scale * sigma, THINNEST * scale * longest), R=vectors, scale=scale)


def track_colours(std_m: ArrayLike) -> Array:
    """Return (n, 3): r, g, b in 0 to 1 of a track's points by their standard deviations (n,), in m.

    From blue at the least to vermillion at the greatest; a point whose standard deviation is not known (NaN) is blue.
    """
    std = np.asarray(std_m, dtype=float)
    known = std[np.isfinite(std)]
    if not len(known):
        return np.tile(BEST, (len(std), 1))
    span = float(np.ptp(known))
    share = np.zeros(len(std)) if span <= 0.0 else np.nan_to_num((std - known.min()) / span)
    return np.asarray(BEST + share[:, None] * (WORST - BEST))
