"""What the calibrations of cameras and mirror rigs come to, and the noise of a camera."""

from __future__ import annotations

from typing import Annotated, Literal

from armsight.calibrate.mirrors.adjustment import MirrorTurn
from armsight.calibrate.mirrors.diagnosis import Suspect
from armsight.fields import Doc
from armsight.optics.mirrors import FormError
from armsight.optics.parallelism import Parallelism
from armsight.optics.zoom import LeftOut
from armsight.records.output import Output, output
from armsight.records.result_parts import RejectedFile


@output
class NoiseCorrelation(Output):
    """Correlation of a pixel's noise with that of its neighbours."""

    x: Annotated[tuple[float, float], Doc("With the pixels 1 and 2 px away along x.")]
    y: Annotated[tuple[float, float], Doc("With the pixels 1 and 2 px away along y.")]
    diagonal: Annotated[float, Doc("With the next pixel along the diagonals.")]
    std_x: Annotated[tuple[float, float], Doc("Standard deviations of `x`.")]
    std_y: Annotated[tuple[float, float], Doc("Standard deviations of `y`.")]
    std_diagonal: Annotated[float, Doc("Standard deviation of `diagonal`.")]


@output
class LinearCamera(Output):
    """The line of variance over grey level of a linear camera (EMVA 1288)."""

    read_noise_levels: Annotated[float, Doc("Noise in the dark, grey levels.")]
    gain_levels: Annotated[float, Doc("Grey levels for each electron.")]


@output
class CameraNoise(Output):
    """The noise of a camera as a file holds it."""

    linear: Annotated[LinearCamera | None, Doc("The line, null where the variance is none over the level.")]
    levels: Annotated[list[float], Doc("Grey levels, 0 to 255, increasing.")]
    variance_levels2: Annotated[list[float], Doc("Variance of a pixel from frame to frame at these levels.")]
    std_levels2: Annotated[list[float], Doc("Standard deviations of these variances.")]
    correlation: Annotated[NoiseCorrelation, Doc("What neighbours share.")]
    n_frames: Annotated[int, Doc("Still frames used.")]
    widening: Annotated[
        tuple[float, float],
        Doc("Factors along u and v on the variance of a wide light's centre, for what neighbours share."),
    ]


@output
class MeasuredNoise(CameraNoise):
    """The noise of a camera as still frames show it, and how it was found."""

    n_given: Annotated[int, Doc("Still frames given.")]
    n_copies: Annotated[int, Doc("Frames equal to the one before, left out.")]
    brightness_rms: Annotated[float, Doc("Relative change of brightness between frames, RMS, taken off.")]
    shift_px_rms: Annotated[float, Doc("Shift of the image between frames, RMS, px, taken off.", unit="px")]
    moving: Annotated[float, Doc("Share of the image, 0 to 1, left out because something moves in it.")]
    frozen: Annotated[float, Doc("Share of the image, 0 to 1, left out because it does not change at all.")]
    unusable: Annotated[float, Doc("Share of the pixels, 0 to 1, that are black or clipped.")]
    frame_ratio: Annotated[
        float, Doc("Mean square change over two frames relative to that over one; 1 for independent frames.")
    ]
    line_deviation: Annotated[float | None, Doc("Largest relative deviation from the line.")]
    advice: Annotated[list[str], Doc("What to know about it.")]


@output
class NoiseOutput(Output):
    """armsight calibrate camera --noise, without a board."""

    noise: Annotated[
        MeasuredNoise | CameraNoise, Doc("The camera's noise; the keys from n_given on of still frames, not of a file.")
    ]


@output
class ZoomOutput(Output):
    """The zoom lens whose setting was calibrated."""

    zoom: Annotated[float, Doc("The setting that was calibrated.")]
    settings: Annotated[list[float], Doc("All settings in the file, increasing.")]
    focal_lengths_px: Annotated[list[float], Doc("Focal length along x at these, px.")]
    left_out: Annotated[
        list[LeftOut],
        Doc("Each setting but the first and last, predicted from the others; empty with fewer than three."),
    ]
    focal_error_rms: Annotated[float | None, Doc("RMS of the relative errors of these focal lengths.")]
    advice: Annotated[list[str], Doc("What to know about the curve between the settings.")]


@output
class CameraOutput(Output):
    """armsight calibrate camera."""

    rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    n_images: Annotated[int, Doc("Images read.")]
    n_used: Annotated[int, Doc("Images that the result rests on.")]
    rejected: Annotated[list[RejectedFile], Doc("Images left out.")]
    fx_px: Annotated[float, Doc("Focal length along x, px.")]
    fy_px: Annotated[float, Doc("Focal length along y, px.")]
    cx_px: Annotated[float, Doc("Column of the principal point, px from the centre of the top left pixel.")]
    cy_px: Annotated[float, Doc("Row of the principal point, px from the centre of the top left pixel.")]
    distortion: Annotated[
        tuple[float, float, float, float, float] | tuple[float, float, float, float],
        Doc("k1, k2, p1, p2, k3 (Brown); of a fisheye lens k1, k2, k3, k4."),
    ]
    lens: Annotated[Literal["fisheye"] | None, Doc("Where the lens is a fisheye; a pinhole is not named.")] = None
    std: Annotated[dict[str, float], Doc("Standard deviations by name: fx_px, fy_px, cx_px, cy_px, k1 ... k3.")]
    holdout_rms_px: Annotated[float | None, Doc("Reprojection residual on images left out of the fit, RMS, px.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]
    noise: Annotated[
        MeasuredNoise | CameraNoise | None,
        Doc("The camera's noise, with --noise; the keys from n_given on of still frames, not of a file."),
    ] = None
    zoom: Annotated[ZoomOutput | None, Doc("The zoom lens, with --zoom.")] = None


@output
class ZoomRigOutput(Output):
    """armsight calibrate zoom-rig."""

    settings: Annotated[dict[str, list[float]], Doc("Settings of each camera that zooms, by left and right.")]
    at: Annotated[dict[str, float], Doc("The zoom at which the rig was calibrated, by left and right.")]
    pupils: Annotated[bool, Doc("Whether all settings say where the pupil stands.")]
    advice: Annotated[list[str], Doc("What to know about the rig at other settings.")]


@output
class StereoOutput(Output):
    """armsight calibrate stereo."""

    rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    epipolar_rms_px: Annotated[float, Doc("Distance of the corners from their epipolar lines, RMS, px.")]
    baseline_m: Annotated[float, Doc("Distance of the two centres of projection, m.")]
    n_pairs: Annotated[int, Doc("Pairs of images read.")]
    n_used: Annotated[int, Doc("Pairs that the result rests on.")]
    rejected: Annotated[list[RejectedFile], Doc("Images left out.")]
    std: Annotated[
        dict[str, float],
        Doc("Standard deviations by name: left.fx_px ... right.k3, right.tx_m ... right.rz_rad, baseline_m."),
    ]
    holdout_rms_px: Annotated[float | None, Doc("Reprojection residual on pairs left out of the fit, RMS, px.")]
    holdout_epipolar_rms_px: Annotated[float | None, Doc("Epipolar distance on pairs left out, RMS, px.")]
    metric: Annotated[
        dict[Literal["expected_m", "mean_m", "rms_m", "board_rms_m"], float | None],
        Doc(
            "Distance of neighbouring corners after triangulation, m: as built, mean, RMS of the error; "
            "board_rms_m: RMS distance from the printed board laid onto them."
        ),
    ]
    metric_is_left_out: Annotated[bool, Doc("Whether `metric` is of pairs left out of the fit.")]
    alignment: Annotated[Parallelism, Doc("How parallel the two views stand.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]


@output
class PlateOutput(Output):
    """The glass plate of a mirror rig (Pachidis), whose shift moves the left view."""

    m_m: Annotated[float, Doc("Shift m of the left view's chief ray, m.")]
    l_m: Annotated[float, Doc("The l that goes with it, m.")]
    thickness_m: Annotated[float, Doc("Thickness, m; 0 without a plate.")]
    index: Annotated[float | None, Doc("Refractive index, null without a plate.")]
    seen_thickness_m: Annotated[float | None, Doc("Thickness as the views show it, m; null where it was given.")]
    seen_thickness_std_m: Annotated[float | None, Doc("Standard deviation of the thickness seen, m.")]


@output
class MirrorAlignment(Parallelism):
    """How parallel the two views of a mirror rig stand, and its plate."""

    plate: Annotated[PlateOutput, Doc("The glass plate.")]


@output
class MirrorsOutput(StereoOutput):
    """armsight calibrate mirrors."""

    alignment: Annotated[MirrorAlignment, Doc("How parallel the two views stand, and the plate.")]
    one_lens: Annotated[bool, Doc("Whether one lens explains both views.")]
    forms: Annotated[list[FormError], Doc("How far the paper's equations are off; empty without a plate.")]


@output
class CheckedAlignment(Output):
    """How parallel the two views stand now, the right one against the left one."""

    convergence_rad: Annotated[float, Doc("How far the optical axes turn towards each other, rad.")]
    vertical_px: Annotated[float, Doc("Row at infinity, right minus left, px.")]
    vertical_rad: Annotated[float, Doc("How far the right axis points below the left one, rad.")]
    roll_rad: Annotated[float, Doc("Turn of the right image about its axis, rad.")]
    std: Annotated[dict[str, float] | None, Doc("Standard deviations of the alignment by name.")]


@output
class PoseChange(Output):
    """A change of T_left_right, in axes of the left view."""

    dx_m: Annotated[float, Doc("Along x, m.")]
    dy_m: Annotated[float, Doc("Along y, m.")]
    dz_m: Annotated[float, Doc("Along z, m.")]
    drx_rad: Annotated[float, Doc("Rotation vector, x, rad.")]
    dry_rad: Annotated[float, Doc("Rotation vector, y, rad.")]
    drz_rad: Annotated[float, Doc("Rotation vector, z, rad.")]


@output
class MirrorCheckOutput(Output):
    """armsight calibrate mirrors --check."""

    alignment: Annotated[CheckedAlignment, Doc("How parallel the two views stand now.")]
    change: Annotated[PoseChange, Doc("What has changed since the calibration.")]
    change_std: Annotated[PoseChange, Doc("Standard deviations of the change.")]
    moved: Annotated[bool, Doc("Whether anything has moved beyond the views' noise.")]
    certain: Annotated[bool, Doc("Whether one mirror alone explains the change.")]
    suspects: Annotated[list[Suspect], Doc("Mirrors that may have moved, the likeliest first.")]
    turns: Annotated[
        list[MirrorTurn] | None, Doc("Against the design: turns of mirrors 2 and 4 that make the axes parallel.")
    ] = None
    advice: Annotated[list[str], Doc("Which mirror to turn, and how.")]
    n_views: Annotated[int, Doc("Images that the answer rests on.")]
    missed: Annotated[list[str], Doc("Images without the board in both views, and why.")]
