"""calibrate handeye, calibrate tooltip, calibrate pivot, calibrate target."""

from __future__ import annotations

from typing import Annotated

from scipy.spatial.transform import RigidTransform

from armsight.records.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import PointStd, PoseStd, RejectedRow

Vector = tuple[float, float, float]


@output
class RejectedPair(Output):
    """A pair, image or robot pose that was left out."""

    row: Annotated[int | None, Doc("Its row, from 1; null for what made no pair.")]
    name: Annotated[str, Doc("Its name: of the row or of the image.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class NoisePart(Output):
    """One noise, as the standard deviation of one component, in the unit of its key."""

    value: Annotated[float | None, Doc("The noise, null where the data cannot tell it from another.")]
    std: Annotated[float | None, Doc("Standard deviation of the noise, where known.")] = None
    at_most: Annotated[float | None, Doc("Its upper bound, where it is not known.")] = None


@output
class HandEyeNoise(Output):
    """Noise of one component of the poses."""

    translation_m: Annotated[NoisePart, Doc("Of positions, robot and camera together, m, at the target.")]
    robot_m: Annotated[NoisePart, Doc("Of the robot's positions, m.")]
    camera_m: Annotated[NoisePart, Doc("Of the camera's positions, m.")]
    robot_rad: Annotated[NoisePart, Doc("Of the robot's orientations, rad.")]
    camera_rad: Annotated[NoisePart, Doc("Of the camera's orientations, rad.")]


@output
class TargetScale(Output):
    """True over assumed size of the target, as the robot's motion says."""

    factor: Annotated[float, Doc("True size over assumed size.")]
    std: Annotated[float, Doc("Standard deviation of the factor.")]
    p: Annotated[float, Doc("Chance of so large a difference from 1 if there is none.")]


@output
class ProposedPose(Output):
    """A further pose that would make the result surer."""

    T_base_flange: Annotated[RigidTransform, Doc("Where to move the flange, in base axes.")]
    expected_std_m: Annotated[float, Doc("Standard deviation of the camera's place to expect with it, m.")]


@output
class ImagesLeftOut(Output):
    """Errors of one calibration at images left out, RMS."""

    position_m: Annotated[float | None, Doc("Of T_camera_target's position, m; null where not all were predicted.")]
    orientation_rad: Annotated[float | None, Doc("Of T_camera_target's orientation, rad.")]
    points_m: Annotated[float | None, Doc("Of the board's points in space, m.")]
    reprojection_px: Annotated[float | None, Doc("Of the corners in the image, px.")]


@output
class ImageCrossval(Output):
    """Calibrations from the same images, each judged by images it never saw (nested folds)."""

    kept: Annotated[str, Doc("What the result is from: poses, corners, or corners and camera (freed).")]
    n_images: Annotated[int, Doc("Images left out that they are judged by.")]
    poses: Annotated[ImagesLeftOut | None, Doc("From the target's poses; null where no image can be judged.")]
    corners: Annotated[ImagesLeftOut | None, Doc("From the corners (bundle adjustment).")]
    corners_and_camera: Annotated[
        ImagesLeftOut | None, Doc("From the corners, the camera freed; with --free-camera.")
    ] = None
    why: Annotated[str, Doc("Why it was kept, in words.")]


@output
class HandEyeOutput(Output):
    """armsight calibrate handeye."""

    setup: Annotated[str, Doc("eye-in-hand or eye-to-hand.")]
    T_flange_camera: Annotated[RigidTransform | None, Doc("The camera; eye-in-hand only.")] = None
    T_base_target: Annotated[RigidTransform | None, Doc("The target; eye-in-hand only.")] = None
    T_base_camera: Annotated[RigidTransform | None, Doc("The camera; eye-to-hand only.")] = None
    T_flange_target: Annotated[RigidTransform | None, Doc("The target; eye-to-hand only.")] = None
    std: Annotated[PoseStd, Doc("Standard deviations of the camera's pose, in axes of flange or base.")]
    std_target: Annotated[PoseStd, Doc("Standard deviations of the target's pose, in axes of base or flange.")]
    n_pairs: Annotated[int, Doc("Pairs, images and robot poses given.")]
    n_used: Annotated[int, Doc("Pairs that the result rests on.")]
    n_effective: Annotated[float | None, Doc("Independent pairs that they are worth; of streams only.")] = None
    correlation_time_s: Annotated[
        float | None, Doc("After which a drift of the errors is forgotten, s; of streams only.")
    ] = None
    rejected: Annotated[list[RejectedPair], Doc("What was left out.")]
    residual_rms_m: Annotated[float, Doc("Residual of T_camera_target's position, RMS, m.")]
    residual_rms_rad: Annotated[float, Doc("Residual of T_camera_target's orientation, RMS, rad.")]
    loo_rms_m: Annotated[float, Doc("Position error of each pair predicted from the others, RMS, m.")]
    loo_rms_rad: Annotated[float, Doc("Orientation error of each pair predicted from the others, RMS, rad.")]
    noise: Annotated[HandEyeNoise, Doc("Noise of robot and camera.")]
    covariance_factor: Annotated[
        float | None, Doc("On the covariances of the camera's poses, by which pairs are weighed; where they are known.")
    ] = None
    turning_rms_rad: Annotated[Vector, Doc("Turns of the hand about its principal axes, falling, RMS, rad.")]
    verdict: Annotated[str, Doc("Whether the result can be trusted, in words.")]
    concerns: Annotated[list[str], Doc("The advice to follow before the result can be trusted; empty: it can be.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]
    target_scale: Annotated[TargetScale | None, Doc("Whether the target's size is true.")] = None
    reprojection_rms_px: Annotated[
        float | None, Doc("Reprojection residual of the images, RMS, px; with images only.")
    ] = None
    crossval: Annotated[ImageCrossval | None, Doc("Result from poses against that from corners; with images only.")] = (
        None
    )
    camera_file: Annotated[str | None, Doc("The freed camera that the result belongs to, where it was kept.")] = None
    time_offset_s: Annotated[
        float | None, Doc("Add it to the camera's times to get the robot's, s; with streams only.")
    ] = None
    time_offset_std_s: Annotated[float | None, Doc("Standard deviation of the time offset, s; with streams only.")] = (
        None
    )
    proposals: Annotated[list[ProposedPose] | None, Doc("Further poses, with --propose.")] = None


@output
class TipOutput(Output):
    """armsight calibrate tooltip."""

    tip_m: Annotated[Vector, Doc("The tool's tip in the axes of the turned frame, target or flange, m.")]
    point_m: Annotated[Vector, Doc("The point on which it rested, in the poses' parent frame, m.")]
    std: Annotated[PointStd, Doc("Standard deviations of the tip.")]
    residual_rms_m: Annotated[float, Doc("Distance of the tip from the point, RMS over the used poses, m.")]
    loo_rms_m: Annotated[
        float | None, Doc("The same by the tip of the other poses, RMS, m; with times: of those further away in time.")
    ] = None
    n_used: Annotated[int, Doc("Poses that the result rests on.")]
    n_effective: Annotated[float | None, Doc("Independent poses that they are worth; of poses with times only.")] = None
    correlation_time_s: Annotated[
        float | None, Doc("After which a drift of the errors is forgotten, s; with times only.")
    ] = None
    rejected: Annotated[list[RejectedRow], Doc("Poses left out.")]
    turning_rms_rad: Annotated[Vector, Doc("Turns of the tool about its principal axes, falling, RMS, rad.")]
    mean_tip_m: Annotated[Vector | None, Doc("The mean of Pachidis eq. (13), m; where the point was measured.")] = None
    notes: Annotated[list[str], Doc("What to know of the result, and to do.")]


@output
class PivotOutput(TipOutput):
    """armsight calibrate pivot."""

    goal_m: Annotated[float, Doc("Standard deviation of the tip that was good enough, m.")]
    reached: Annotated[bool, Doc("Whether the tip is known so well.")]


@output
class RejectedFrame(Output):
    """A frame that was left out."""

    frame: Annotated[str, Doc("The frame's file or source.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class LightDistance(Output):
    """The distance of two lights."""

    value_m: Annotated[float, Doc("The distance, m.")]
    std_m: Annotated[float, Doc("Its standard deviation, m.")]


@output
class LightTargetOutput(Output):
    """armsight calibrate target."""

    spots_m: Annotated[dict[str, Vector], Doc("Place of each light by name, in the target's frame, m.")]
    std: Annotated[dict[str, Vector], Doc("Standard deviations of these positions, m.", unit="m")]
    distances_m: Annotated[dict[str, LightDistance], Doc("Distances of the lights by pair of names.")]
    n_frames: Annotated[int, Doc("Pairs of frames read.")]
    n_used: Annotated[int, Doc("Pairs that the result rests on.")]
    rejected: Annotated[list[RejectedFrame], Doc("Frames left out.")]
    residual_rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    loo_rms_px: Annotated[float, Doc("Reprojection residual of each frame by the shape of the others, RMS, px.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]
