"""calibrate handeye, calibrate tooltip, calibrate pivot, calibrate target."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PointStd, PoseOutput, PoseStd, RejectedRow, absent

Vector = tuple[float, float, float]


class RejectedPair(Output):
    """A pair, image or robot pose that was left out."""

    row: int | None = Field(description="Its row, from 1; null for what made no pair.")
    name: str = Field(description="Its name: of the row or of the image.")
    why: str = Field(description="Why it was left out, in words.")


class NoisePart(Output):
    """One noise, as the standard deviation of one component, in the unit of its key."""

    value: float | None = Field(description="The noise, null where the data cannot tell it from another.")
    std: float | None = Field(None, exclude_if=absent, description="Standard deviation of the noise, where known.")
    at_most: float | None = Field(None, exclude_if=absent, description="Its upper bound, where it is not known.")


class HandEyeNoise(Output):
    """Noise of one component of the poses."""

    translation_m: NoisePart = Field(description="Of positions, robot and camera together, m, at the target.")
    robot_m: NoisePart = Field(description="Of the robot's positions, m.")
    camera_m: NoisePart = Field(description="Of the camera's positions, m.")
    robot_rad: NoisePart = Field(description="Of the robot's orientations, rad.")
    camera_rad: NoisePart = Field(description="Of the camera's orientations, rad.")


class TargetScale(Output):
    """True over assumed size of the target, as the robot's motion says."""

    factor: float = Field(description="True size over assumed size.")
    std: float = Field(description="Standard deviation of the factor.")
    p: float = Field(description="Chance of so large a difference from 1 if there is none.")


class ProposedPose(Output):
    """A further pose that would make the result surer."""

    T_base_flange: PoseOutput = Field(description="Where to move the flange, in base axes.")
    expected_std_m: float = Field(description="Standard deviation of the camera's place to expect with it, m.")


class ImagesLeftOut(Output):
    """Errors of one calibration at images left out, RMS."""

    position_m: float | None = Field(description="Of T_camera_target's position, m; null where not all were predicted.")
    orientation_rad: float | None = Field(description="Of T_camera_target's orientation, rad.")
    points_m: float | None = Field(description="Of the board's points in space, m.")
    reprojection_px: float | None = Field(description="Of the corners in the image, px.")


class ImageCrossval(Output):
    """Calibrations from the same images, each judged by images it never saw (nested folds)."""

    kept: str = Field(description="What the result is from: poses, corners, or corners and camera (freed).")
    n_images: int = Field(description="Images left out that they are judged by.")
    poses: ImagesLeftOut | None = Field(description="From the target's poses; null where no image can be judged.")
    corners: ImagesLeftOut | None = Field(description="From the corners (bundle adjustment).")
    corners_and_camera: ImagesLeftOut | None = Field(
        None, exclude_if=absent, description="From the corners, the camera freed; with --free-camera."
    )
    why: str = Field(description="Why it was kept, in words.")


class HandEyeOutput(Output):
    """armsight calibrate handeye."""

    setup: str = Field(description="eye-in-hand or eye-to-hand.")
    T_flange_camera: PoseOutput | None = Field(None, exclude_if=absent, description="The camera; eye-in-hand only.")
    T_base_target: PoseOutput | None = Field(None, exclude_if=absent, description="The target; eye-in-hand only.")
    T_base_camera: PoseOutput | None = Field(None, exclude_if=absent, description="The camera; eye-to-hand only.")
    T_flange_target: PoseOutput | None = Field(None, exclude_if=absent, description="The target; eye-to-hand only.")
    std: PoseStd = Field(description="Standard deviations of the camera's pose, in axes of flange or base.")
    std_target: PoseStd = Field(description="Standard deviations of the target's pose, in axes of base or flange.")
    n_pairs: int = Field(description="Pairs, images and robot poses given.")
    n_used: int = Field(description="Pairs that the result rests on.")
    n_effective: float | None = Field(
        None, exclude_if=absent, description="Independent pairs that they are worth; of streams only."
    )
    correlation_time_s: float | None = Field(
        None, exclude_if=absent, description="After which a drift of the errors is forgotten, s; of streams only."
    )
    rejected: list[RejectedPair] = Field(description="What was left out.")
    residual_rms_m: float = Field(description="Residual of T_camera_target's position, RMS, m.")
    residual_rms_rad: float = Field(description="Residual of T_camera_target's orientation, RMS, rad.")
    loo_rms_m: float = Field(description="Position error of each pair predicted from the others, RMS, m.")
    loo_rms_rad: float = Field(description="Orientation error of each pair predicted from the others, RMS, rad.")
    noise: HandEyeNoise = Field(description="Noise of robot and camera.")
    covariance_factor: float | None = Field(
        None,
        exclude_if=absent,
        description="On the covariances of the camera's poses, by which pairs are weighed; where they are known.",
    )
    turning_rms_rad: Vector = Field(description="Turns of the hand about its principal axes, falling, RMS, rad.")
    verdict: str = Field(description="Whether the result can be trusted, in words.")
    concerns: list[str] = Field(description="The advice to follow before the result can be trusted; empty: it can be.")
    advice: list[str] = Field(description="What would make the result surer.")
    target_scale: TargetScale | None = Field(None, exclude_if=absent, description="Whether the target's size is true.")
    reprojection_rms_px: float | None = Field(
        None, exclude_if=absent, description="Reprojection residual of the images, RMS, px; with images only."
    )
    crossval: ImageCrossval | None = Field(
        None, exclude_if=absent, description="Result from poses against that from corners; with images only."
    )
    camera_file: str | None = Field(
        None, exclude_if=absent, description="The freed camera that the result belongs to, where it was kept."
    )
    time_offset_s: float | None = Field(
        None, exclude_if=absent, description="Add it to the camera's times to get the robot's, s; with streams only."
    )
    time_offset_std_s: float | None = Field(
        None, exclude_if=absent, description="Standard deviation of the time offset, s; with streams only."
    )
    proposals: list[ProposedPose] | None = Field(None, exclude_if=absent, description="Further poses, with --propose.")


class TipOutput(Output):
    """armsight calibrate tooltip."""

    tip_m: Vector = Field(description="The tool's tip in the axes of the turned frame, target or flange, m.")
    point_m: Vector = Field(description="The point on which it rested, in the poses' parent frame, m.")
    std: PointStd = Field(description="Standard deviations of the tip.")
    residual_rms_m: float = Field(description="Distance of the tip from the point, RMS over the used poses, m.")
    loo_rms_m: float | None = Field(
        None,
        exclude_if=absent,
        description="The same by the tip of the other poses, RMS, m; with times: of those further away in time.",
    )
    n_used: int = Field(description="Poses that the result rests on.")
    n_effective: float | None = Field(
        None, exclude_if=absent, description="Independent poses that they are worth; of poses with times only."
    )
    correlation_time_s: float | None = Field(
        None, exclude_if=absent, description="After which a drift of the errors is forgotten, s; with times only."
    )
    rejected: list[RejectedRow] = Field(description="Poses left out.")
    turning_rms_rad: Vector = Field(description="Turns of the tool about its principal axes, falling, RMS, rad.")
    mean_tip_m: Vector | None = Field(
        None, exclude_if=absent, description="The mean of Pachidis eq. (13), m; where the point was measured."
    )
    notes: list[str] = Field(description="What to know of the result, and to do.")


class PivotOutput(TipOutput):
    """armsight calibrate pivot."""

    goal_m: float = Field(description="Standard deviation of the tip that was good enough, m.")
    reached: bool = Field(description="Whether the tip is known so well.")


class RejectedFrame(Output):
    """A frame that was left out."""

    frame: str = Field(description="The frame's file or source.")
    why: str = Field(description="Why it was left out, in words.")


class LightDistance(Output):
    """The distance of two lights."""

    value_m: float = Field(description="The distance, m.")
    std_m: float = Field(description="Its standard deviation, m.")


class LightTargetOutput(Output):
    """armsight calibrate target."""

    spots_m: dict[str, Vector] = Field(description="Place of each light by name, in the target's frame, m.")
    std: dict[str, Vector] = Field(
        description="Standard deviations of these positions, m.", json_schema_extra={"unit": "m"}
    )
    distances_m: dict[str, LightDistance] = Field(description="Distances of the lights by pair of names.")
    n_frames: int = Field(description="Pairs of frames read.")
    n_used: int = Field(description="Pairs that the result rests on.")
    rejected: list[RejectedFrame] = Field(description="Frames left out.")
    residual_rms_px: float = Field(description="Reprojection residual of the fit, RMS, px.")
    loo_rms_px: float = Field(description="Reprojection residual of each frame by the shape of the others, RMS, px.")
    advice: list[str] = Field(description="What would make the result surer.")
