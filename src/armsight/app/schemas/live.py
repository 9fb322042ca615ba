"""What live measurement tells a screen, picture by picture."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, absent


class SpotView(Output):
    """A light in one picture."""

    name: str = Field(description="Of the target's light; empty where it was found and not named.")
    u_px: float = Field(description="Column of its centre, px.")
    v_px: float = Field(description="Row of its centre, px.")
    residual_px: tuple[float, float] | None = Field(
        description="Seen minus where the pose has it, px; null without a pose."
    )
    view: str | None = Field(
        None, exclude_if=absent, description="left or right: the view it belongs to, in a picture that holds both."
    )


class SideView(Output):
    """One camera's picture and how the camera should be aimed."""

    width: int = Field(description="Columns of the camera's image.")
    height: int = Field(description="Rows of the camera's image.")
    spots: list[SpotView] = Field(description="Lights found.")
    epipolar: list[list[tuple[float, float]]] = Field(
        description="In this picture the epipolar curve of every named light of the other one: (u, v) along it, px."
    )
    epipolar_views: list[str] | None = Field(
        None,
        exclude_if=absent,
        description="left or right: the view that each curve is in, where a picture holds both.",
    )
    advice: str = Field(
        description="What to change: nothing_seen, room_too_bright, clipped, faint, blurred, too_sharp or good."
    )
    background: float = Field(description="Median grey level.")
    brightest: float | None = Field(description="Grey levels of the brightest light above the background.")
    sigma_px: float | None = Field(description="Median width of the lights (Gaussian sigma), px.")
    n_clipped: int | None = Field(None, exclude_if=absent, description="Lights that hold clipped pixels.")
    exposure_s: float | None = Field(None, exclude_if=absent, description="Exposure, s, where the camera tells it.")


class Counts(Output):
    """Pairs of frames since the start."""

    ok: int = Field(description="With a whole pose.")
    doubtful: int = Field(description="With a whole pose that does not fit the claims.")
    position_only: int = Field(description="With a position only.")
    lost: int = Field(description="Without.")


class LiveView(Output):
    """One moment of live measurement."""

    sequence: int = Field(description="Pairs measured so far.")
    t_s: float = Field(description="Time of the frames, on the measuring clock.")
    fps: float = Field(description="Pairs measured a second, over the last second.")
    latency_s: float = Field(description="From the exposure (for files: the moment it is played) to the pose.")
    measuring_s: float = Field(description="Time that measuring this pair took.")
    status: str = Field(description="ok, doubtful, position_only or lost.")
    why: str = Field(description="Why there is no whole pose; else empty.")
    parent: str = Field(description="Frame that the pose is in: rig, or the world's name.")
    xyz_m: tuple[float, float, float] | None = Field(description="Position of the target.")
    euler_rad: tuple[float, float, float] | None = Field(description="rx, ry, rz with R = Rz Ry Rx.")
    quat_xyzw: tuple[float, float, float, float] | None = Field(description="Orientation, scalar last.")
    std: tuple[float, ...] | None = Field(description="Standard deviations: x, y, z in m, then rotation vector, rad.")
    covariance_m2: list[list[float]] | None = Field(
        None, exclude_if=absent, description="Covariance of the position (3, 3), m squared, where it is known."
    )
    covariance: list[list[float]] | None = Field(
        None,
        exclude_if=absent,
        description="Covariance of a whole pose (6, 6): x, y, z in m, then rotation vector, rad.",
    )
    systematic_covariance: list[list[float]] | None = Field(
        None, exclude_if=absent, description="The part of it that repeats from pair to pair, of rig and target."
    )
    residual_px: float | None = Field(description="RMS of the reprojection residuals.")
    counts: Counts = Field(description="Since the start.")
    left: SideView = Field(description="Left picture.")
    right: SideView = Field(description="Right picture.")
