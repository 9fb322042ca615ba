"""What live measurement tells a screen, picture by picture."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output


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


@output
class Counts(Output):
    """Pairs of frames since the start."""

    ok: Annotated[int, Doc("With a whole pose.")]
    doubtful: Annotated[int, Doc("With a whole pose that does not fit the claims.")]
    position_only: Annotated[int, Doc("With a position only.")]
    lost: Annotated[int, Doc("Without.")]


@output
class LiveView(Output):
    """One moment of live measurement."""

    sequence: Annotated[int, Doc("Pairs measured so far.")]
    t_s: Annotated[float, Doc("Time of the frames, on the measuring clock.")]
    fps: Annotated[float, Doc("Pairs measured a second, over the last second.")]
    latency_s: Annotated[float, Doc("From the exposure (for files: the moment it is played) to the pose.")]
    measuring_s: Annotated[float, Doc("Time that measuring this pair took.")]
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
    covariance: Annotated[
        list[list[float]] | None, Doc("Covariance of a whole pose (6, 6): x, y, z in m, then rotation vector, rad.")
    ] = None
    systematic_covariance: Annotated[
        list[list[float]] | None, Doc("The part of it that repeats from pair to pair, of rig and target.")
    ] = None
    residual_px: Annotated[float | None, Doc("RMS of the reprojection residuals.")]
    counts: Annotated[Counts, Doc("Since the start.")]
    left: Annotated[SideView, Doc("Left picture.")]
    right: Annotated[SideView, Doc("Right picture.")]
