"""measure, demo."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, PoseStd, absent
from armsight.app.schemas.timing import BothCounts, BothSeconds


class FrameTime(Output):
    """How long a pair of frames takes, from the images to the written row."""

    median: float | None = Field(description="Median, ms.")
    p99: float | None = Field(description="99th percentile, ms.")


class Candidates(Output):
    """Bright things in the images of both views, summed over the run."""

    n_seen: int = Field(description="How many were looked at.")
    n_fitted: int = Field(description="How many have the form of a light.")
    n_matched: int = Field(description="How many were matched to a light of the target.")


class PoseDeviations(Output):
    """Median standard deviations of the full poses."""

    total: PoseStd = Field(description="Of all causes together.")
    random: PoseStd = Field(description="Of the spots' noise, anew in each frame.")
    systematic: PoseStd = Field(description="Of rig and target, the same in all frames.")


class SkewOutput(Output):
    """How far apart in time the frames of live pairs were: right minus left."""

    mean_s: float = Field(description="Mean, s.")
    largest_s: float = Field(description="Largest, s.")
    n_dropped: int = Field(description="Frames without a partner.")


class Estimated(Output):
    """One number of a cause."""

    estimate: float = Field(description="Its value, in the unit of the cause.")
    std: float = Field(description="Its standard deviation, in the same unit.")


class OtherCause(Output):
    """A cause that explains the residuals less well than the first."""

    cause: str = Field(description="Its name.")
    estimate: float | None = Field(description="How large it is, in `unit`.")
    std: float | None = Field(description="Standard deviation of the estimate, in `unit`.")
    unit: str | None = Field(description="1, m, rad or s; empty for a cause without one number.")
    effect_m: float = Field(description="What it does to the poses' positions, RMS, m.")
    log_odds: float = Field(description="Natural logarithm of its odds against the first cause.")


class ConsistencyOutput(Output):
    """Whether the residuals of a run agree with rig, target and noise, and what is wrong if not."""

    verdict: str = Field(description="ok, doubtful, inconsistent or unchecked.")
    cause: str | None = Field(description="The likeliest cause, null where nothing is wrong.")
    estimate: float | None = Field(description="How large it is, in `unit`.")
    std: float | None = Field(description="Standard deviation of the estimate, in `unit`.")
    unit: str | None = Field(description="1, m, rad or s; empty for a cause without one number.")
    effect_m: float | None = Field(description="What the cause does to the poses' positions, RMS, m.")
    effect_rad: float | None = Field(description="What the cause does to the poses' orientations, RMS, rad.")
    since_s: float | None = Field(description="When it began, s of t_s, for a cause that came during the run.")
    equally_likely: list[str] = Field(description="Other causes that explain the residuals as well.")
    others: list[OtherCause] = Field(description="The next likely causes, likeliest first.")
    components: dict[str, Estimated] = Field(description="The numbers of the likeliest cause by name.")
    chi2_per_dof: float | None = Field(description="Chi-square of all residuals per degree of freedom.")
    noise_scale: float = Field(description="Noise of the residuals over the claimed noise, as standard deviations.")
    refused: float = Field(description="Share of the frames, 0 to 1, that fit the target in no way.")
    claimed_m: float | None = Field(description="RMS of the claimed standard deviation of a position, 3-D, m.")
    n_frames: int = Field(description="Frames that were judged.")
    undetected_m: dict[str, float] = Field(description="By cause: the largest effect, m, that the run could not tell.")
    sentence: str = Field(description="What is wrong in a sentence; empty where nothing is.")
    advice: str = Field(description="What to do about it; empty where nothing is to be done.")


class FreeRunning(Output):
    """How a moving target was measured by cameras that no wire joins."""

    delay_s: float = Field(description="t_left = t_right + delay_s + 1e-6 drift_ppm t_right, s.")
    drift_ppm: float = Field(description="How much faster the left camera's clock runs, parts in a million.")
    readout_s: BothSeconds = Field(description="From the first line's exposure to the last one's.")
    delay_change_s: float = Field(description="By how much this recording itself moved the calibrated delay.")
    delay_std_s: float | None = Field(description="Standard deviation of the delay in the middle of the recording.")
    n_views: BothCounts = Field(description="Frames in which lights of the target were found.")
    n_starts: int = Field(description="How often the target was found anew.")
    chi2_per_dof: float | None = Field(description="Chi-square of the spots about the motion, per degree of freedom.")
    note: str | None = Field(None, exclude_if=absent, description="Why the poses are to be doubted.")
    speed_m_s: float | None = Field(description="RMS of the target's speed, m/s.")
    nearest_pairs_m: float | None = Field(
        description="RMS of how far the target moves between a left frame and the right frame nearest in time, m."
    )


class ZoomAt(Output):
    """The camera of a zoom lens at the setting that was measured with."""

    zoom: float = Field(description="The setting.")
    interpolated: bool = Field(description="Whether it lies between calibrated settings.")
    fx_px: float = Field(description="Focal length along x, px.")
    fx_std_px: float = Field(description="Its standard deviation, calibration and interpolation, px.")
    fx_interpolation_px: float = Field(description="The part of it that the interpolation brings, px.")
    pupil_m: float = Field(description="Where the centre of projection stands; 0 where the settings do not say it, m.")


class MadeWith(Output):
    """Which rig and target a run was measured with, as fingerprints: equal only where their numbers are."""

    rig: str = Field(description="SHA-256 of the cameras' intrinsics and poses.")
    target: str = Field(description="SHA-256 of the target's names and points.")


class MeasureOutput(Output):
    """armsight measure; also OUT/measure.json."""

    n_frames: int = Field(description="Pairs of frames.")
    n_ok: int = Field(description="Pairs that gave a pose.")
    n_doubtful: int = Field(description="Pairs that gave a pose that does not fit the claims, or whose run does not.")
    n_position_only: int = Field(description="Pairs that gave a position without an orientation.")
    n_lost: int = Field(description="Pairs that gave nothing.")
    reprojection_rms_px: float | None = Field(description="RMS of the 2-D residual per light and view, px.")
    ms_per_frame: FrameTime = Field(description="How long a pair takes.", json_schema_extra={"unit": "ms"})
    reasons: dict[str, int] = Field(
        description="How often each kind of cause (listed above) took a pose or its rotation away, or made it doubtful."
    )
    candidates: Candidates | None = Field(None, exclude_if=absent, description="Bright things in all images.")
    std: PoseDeviations | None = Field(
        None, exclude_if=absent, description="Median standard deviations of the full poses."
    )
    consistency: ConsistencyOutput | None = Field(
        None, exclude_if=absent, description="Whether residuals, rig and target agree."
    )
    skew: SkewOutput | None = Field(None, exclude_if=absent, description="Time between the frames of live pairs.")
    timing: FreeRunning | None = Field(
        None, exclude_if=absent, description="Where each view was taken at its own time."
    )
    error: str | None = Field(None, exclude_if=absent, description="Why the run ended early.")
    assumed_fps: float | None = Field(
        None, exclude_if=absent, description="Frames a second that were assumed, where nothing tells the frames' times."
    )
    zoom: dict[str, ZoomAt] | None = Field(
        None, exclude_if=absent, description="The cameras that zoom, by left and right."
    )
    made_with: MadeWith | None = Field(None, exclude_if=absent, description="Which rig and target it was.")


class TruthError(Output):
    """Error of one coordinate of the poses against the truth, in the unit of its key."""

    rms: float = Field(description="Root mean square error.")
    max: float = Field(description="Largest absolute error.")
    claimed: float = Field(description="Root mean square of the claimed standard deviations.")


class PoseErrors(Output):
    """Errors of the poses by coordinate."""

    x_m: TruthError = Field(description="Of x, m.")
    y_m: TruthError = Field(description="Of y, m.")
    z_m: TruthError = Field(description="Of z, m.")
    rx_rad: TruthError = Field(description="Of the rotation about x, rad.")
    ry_rad: TruthError = Field(description="Of the rotation about y, rad.")
    rz_rad: TruthError = Field(description="Of the rotation about z, rad.")


class PicturesOutput(Output):
    """The demo's real pictures of a checkerboard, calibrated and measured."""

    n_pairs: int = Field(description="Pairs of pictures.")
    rms_px: float = Field(description="Reprojection residual of the calibration, RMS, px.")
    baseline_m: float = Field(description="Distance of the two cameras, m.")
    square_error_m: float | None = Field(
        description="Error of the board's squares in pairs that the calibration did not see, RMS, m."
    )
    n_ok: int = Field(description="Pairs in which the board's pose was measured.")
    out: str = Field(description="Where its results are.")


class DemoOutput(MeasureOutput):
    """armsight demo; also OUT/demo.json."""

    truth: PoseErrors = Field(description="Errors against the simulated truth, in rig axes.")
    inside_95: float | None = Field(description="Share of the poses, 0 to 1, inside their own 95 % ellipsoid.")
    seconds_s: float = Field(description="How long the whole command took, s.")
    assumptions: list[str] = Field(description="What the simulated cell takes for granted.")
    pictures: PicturesOutput | None = Field(description="The real pictures; null where they were left out.")
