"""calibrate camera, calibrate stereo, calibrate mirrors; the noise of a camera."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from armsight.app.schemas.base import Output, RejectedFile, absent


class NoiseCorrelation(Output):
    """Correlation of a pixel's noise with that of its neighbours."""

    x: tuple[float, float] = Field(description="With the pixels 1 and 2 px away along x.")
    y: tuple[float, float] = Field(description="With the pixels 1 and 2 px away along y.")
    diagonal: float = Field(description="With the next pixel along the diagonals.")
    std_x: tuple[float, float] = Field(description="Standard deviations of `x`.")
    std_y: tuple[float, float] = Field(description="Standard deviations of `y`.")
    std_diagonal: float = Field(description="Standard deviation of `diagonal`.")


class LinearCamera(Output):
    """The line of variance over grey level of a linear camera (EMVA 1288)."""

    read_noise_levels: float = Field(description="Noise in the dark, grey levels.")
    gain_levels: float = Field(description="Grey levels for each electron.")


class CameraNoise(Output):
    """The noise of a camera as a file holds it."""

    linear: LinearCamera | None = Field(description="The line, null where the variance is none over the level.")
    levels: list[float] = Field(description="Grey levels, 0 to 255, increasing.")
    variance_levels2: list[float] = Field(description="Variance of a pixel from frame to frame at these levels.")
    std_levels2: list[float] = Field(description="Standard deviations of these variances.")
    correlation: NoiseCorrelation = Field(description="What neighbours share.")
    n_frames: int = Field(description="Still frames used.")
    widening: tuple[float, float] = Field(
        description="Factors along u and v on the variance of a wide light's centre, for what neighbours share."
    )


class MeasuredNoise(CameraNoise):
    """The noise of a camera as still frames show it, and how it was found."""

    n_given: int = Field(description="Still frames given.")
    n_copies: int = Field(description="Frames equal to the one before, left out.")
    brightness_rms: float = Field(description="Relative change of brightness between frames, RMS, taken off.")
    shift_px_rms: float = Field(
        description="Shift of the image between frames, RMS, px, taken off.", json_schema_extra={"unit": "px"}
    )
    moving: float = Field(description="Share of the image, 0 to 1, left out because something moves in it.")
    frozen: float = Field(description="Share of the image, 0 to 1, left out because it does not change at all.")
    unusable: float = Field(description="Share of the pixels, 0 to 1, that are black or clipped.")
    frame_ratio: float = Field(
        description="Mean square change over two frames relative to that over one; 1 for independent frames."
    )
    line_deviation: float | None = Field(description="Largest relative deviation from the line.")
    advice: list[str] = Field(description="What to know about it.")


class NoiseOutput(Output):
    """armsight calibrate camera --noise, without a board."""

    noise: MeasuredNoise | CameraNoise = Field(
        description="The camera's noise; the keys from n_given on of still frames, not of a file."
    )


class LeftOutSetting(Output):
    """A setting of a zoom lens predicted from all others."""

    zoom: float = Field(description="The setting.")
    focal_error_px: float = Field(description="Focal length along x, predicted minus calibrated, px.")
    focal_std_px: float | None = Field(description="What was claimed for it, px; null where two others are left.")
    image_rms_px: float = Field(description="Distance of the pixels of equal rays over the image, RMS, px.")


class ZoomOutput(Output):
    """The zoom lens whose setting was calibrated."""

    zoom: float = Field(description="The setting that was calibrated.")
    settings: list[float] = Field(description="All settings in the file, increasing.")
    focal_lengths_px: list[float] = Field(description="Focal length along x at these, px.")
    left_out: list[LeftOutSetting] = Field(
        description="Each setting but the first and last, predicted from the others; empty with fewer than three."
    )
    focal_error_rms: float | None = Field(description="RMS of the relative errors of these focal lengths.")
    advice: list[str] = Field(description="What to know about the curve between the settings.")


class CameraOutput(Output):
    """armsight calibrate camera."""

    rms_px: float = Field(description="Reprojection residual of the fit, RMS, px.")
    n_images: int = Field(description="Images read.")
    n_used: int = Field(description="Images that the result rests on.")
    rejected: list[RejectedFile] = Field(description="Images left out.")
    fx_px: float = Field(description="Focal length along x, px.")
    fy_px: float = Field(description="Focal length along y, px.")
    cx_px: float = Field(description="Column of the principal point, px from the centre of the top left pixel.")
    cy_px: float = Field(description="Row of the principal point, px from the centre of the top left pixel.")
    distortion: tuple[float, float, float, float, float] | tuple[float, float, float, float] = Field(
        description="k1, k2, p1, p2, k3 (Brown); of a fisheye lens k1, k2, k3, k4."
    )
    lens: Literal["fisheye"] | None = Field(
        None, exclude_if=absent, description="Where the lens is a fisheye; a pinhole is not named."
    )
    std: dict[str, float] = Field(description="Standard deviations by name: fx_px, fy_px, cx_px, cy_px, k1 ... k3.")
    holdout_rms_px: float | None = Field(description="Reprojection residual on images left out of the fit, RMS, px.")
    advice: list[str] = Field(description="What would make the result surer.")
    noise: MeasuredNoise | CameraNoise | None = Field(
        None,
        exclude_if=absent,
        description="The camera's noise, with --noise; the keys from n_given on of still frames, not of a file.",
    )
    zoom: ZoomOutput | None = Field(None, exclude_if=absent, description="The zoom lens, with --zoom.")


class ZoomRigOutput(Output):
    """armsight calibrate zoom-rig."""

    settings: dict[str, list[float]] = Field(description="Settings of each camera that zooms, by left and right.")
    at: dict[str, float] = Field(description="The zoom at which the rig was calibrated, by left and right.")
    pupils: bool = Field(description="Whether all settings say where the pupil stands.")
    advice: list[str] = Field(description="What to know about the rig at other settings.")


class AlignmentOutput(Output):
    """How parallel the two views of a rig stand, the right one against the left one."""

    convergence_rad: float = Field(description="How far the optical axes turn towards each other, rad.")
    vertical_rad: float = Field(description="How far the right axis points below the left one, rad.")
    vertical_px: float = Field(description="The same as rows at infinity, right minus left, px.")
    roll_rad: float = Field(description="Turn of the right image about its axis, rad.")
    height_m: float = Field(description="How far the right centre of projection is below the left one, m.")
    advance_m: float = Field(description="How far the right centre of projection is before the left one, m.")


class StereoOutput(Output):
    """armsight calibrate stereo."""

    rms_px: float = Field(description="Reprojection residual of the fit, RMS, px.")
    epipolar_rms_px: float = Field(description="Distance of the corners from their epipolar lines, RMS, px.")
    baseline_m: float = Field(description="Distance of the two centres of projection, m.")
    n_pairs: int = Field(description="Pairs of images read.")
    n_used: int = Field(description="Pairs that the result rests on.")
    rejected: list[RejectedFile] = Field(description="Images left out.")
    std: dict[str, float] = Field(
        description="Standard deviations by name: left.fx_px ... right.k3, right.tx_m ... right.rz_rad, baseline_m."
    )
    holdout_rms_px: float | None = Field(description="Reprojection residual on pairs left out of the fit, RMS, px.")
    holdout_epipolar_rms_px: float | None = Field(description="Epipolar distance on pairs left out, RMS, px.")
    metric: dict[Literal["expected_m", "mean_m", "rms_m", "board_rms_m"], float | None] = Field(
        description="Distance of neighbouring corners after triangulation, m: as built, mean, RMS of the error; "
        "board_rms_m: RMS distance from the printed board laid onto them."
    )
    metric_is_left_out: bool = Field(description="Whether `metric` is of pairs left out of the fit.")
    alignment: AlignmentOutput = Field(description="How parallel the two views stand.")
    advice: list[str] = Field(description="What would make the result surer.")


class PlateOutput(Output):
    """The glass plate of a mirror rig (Pachidis), whose shift moves the left view."""

    m_m: float = Field(description="Shift m of the left view's chief ray, m.")
    l_m: float = Field(description="The l that goes with it, m.")
    thickness_m: float = Field(description="Thickness, m; 0 without a plate.")
    index: float | None = Field(description="Refractive index, null without a plate.")
    seen_thickness_m: float | None = Field(description="Thickness as the views show it, m; null where it was given.")
    seen_thickness_std_m: float | None = Field(description="Standard deviation of the thickness seen, m.")


class MirrorAlignment(AlignmentOutput):
    """How parallel the two views of a mirror rig stand, and its plate."""

    plate: PlateOutput = Field(description="The glass plate.")


class FormOutput(Output):
    """How far one form of the paper's equations is off with this rig, largest from 0.4 to 0.8 m."""

    name: str = Field(description="Which form.")
    x_m: float = Field(description="Along x, m.")
    y_m: float = Field(description="Along y, m.")
    z_m: float = Field(description="In depth, m.")
    epipolar_px: float = Field(description="Distance from the epipolar line, px.")


class MirrorsOutput(StereoOutput):
    """armsight calibrate mirrors."""

    alignment: MirrorAlignment = Field(description="How parallel the two views stand, and the plate.")
    one_lens: bool = Field(description="Whether one lens explains both views.")
    forms: list[FormOutput] = Field(description="How far the paper's equations are off; empty without a plate.")


class CheckedAlignment(Output):
    """How parallel the two views stand now, the right one against the left one."""

    convergence_rad: float = Field(description="How far the optical axes turn towards each other, rad.")
    vertical_px: float = Field(description="Row at infinity, right minus left, px.")
    vertical_rad: float = Field(description="How far the right axis points below the left one, rad.")
    roll_rad: float = Field(description="Turn of the right image about its axis, rad.")
    std: dict[str, float] | None = Field(description="Standard deviations of the alignment by name.")


class PoseChange(Output):
    """A change of T_left_right, in axes of the left view."""

    dx_m: float = Field(description="Along x, m.")
    dy_m: float = Field(description="Along y, m.")
    dz_m: float = Field(description="Along z, m.")
    drx_rad: float = Field(description="Rotation vector, x, rad.")
    dry_rad: float = Field(description="Rotation vector, y, rad.")
    drz_rad: float = Field(description="Rotation vector, z, rad.")


class SuspectMirror(Output):
    """A mirror that may have moved."""

    mirror: int = Field(description="Which, 1 to 4.")
    turn_rad: float = Field(description="How far about the vertical, rad.")
    tilt_rad: float = Field(description="How far about the line in its face square to the vertical, rad.")
    chi2: float = Field(description="Chi-square that it leaves.")


class MirrorTurnOutput(Output):
    """How a mirror is to be turned so that the virtual optical axes become parallel."""

    mirror: int = Field(description="1 to 4.")
    turn_rad: float = Field(description="About the vertical y (down): positive is clockwise seen from above.")
    tilt_rad: float = Field(
        description="About the line in its face square to y: positive brings its upper edge back, to the camera's side."
    )


class MirrorCheckOutput(Output):
    """armsight calibrate mirrors --check."""

    alignment: CheckedAlignment = Field(description="How parallel the two views stand now.")
    change: PoseChange = Field(description="What has changed since the calibration.")
    change_std: PoseChange = Field(description="Standard deviations of the change.")
    moved: bool = Field(description="Whether anything has moved beyond the views' noise.")
    certain: bool = Field(description="Whether one mirror alone explains the change.")
    suspects: list[SuspectMirror] = Field(description="Mirrors that may have moved, the likeliest first.")
    turns: list[MirrorTurnOutput] | None = Field(
        None, exclude_if=absent, description="Against the design: turns of mirrors 2 and 4 that make the axes parallel."
    )
    advice: list[str] = Field(description="Which mirror to turn, and how.")
    n_views: int = Field(description="Images that the answer rests on.")
    missed: list[str] = Field(description="Images without the board in both views, and why.")
