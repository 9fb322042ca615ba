"""What a hand-eye calibration returns: the poses, whose noise the residuals are, the verdict and what to do next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.correlation import Correlation
from armsight.calibrate.handeye.image_comparison import ImageComparison
from armsight.calibrate.handeye.pairs import Array, PosePairs, RotationExcitation, Setup
from armsight.calibrate.handeye.solution import Solution
from armsight.fitting.quantiles import t_ppf
from armsight.records import NamedCovariance, frozen_array
from armsight.units import DEG, MM

POSE_NAMES = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
NAMES = tuple(f"{who}.{name}" for who in ("camera", "target") for name in POSE_NAMES)
"""Names of the covariance: of T_parent_camera, then of T_parent_target."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """True over assumed size of the target, as the robot's motion says, with its standard deviation; p: chance of
    seeing so large a difference from 1 if there is none."""

    factor: float
    std: float
    p: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandEye:
    """Where the camera and the target are, and how far to believe it.

    setup: EYE_IN_HAND: T_parent_camera is T_flange_camera and T_parent_target is T_base_target. EYE_TO_HAND: they are
    T_base_camera and T_flange_target. covariance (12, 12): of both, translation then rotation vector, in the
    parents' axes, widened for the noise being estimated: +- 1.96 std holds 95 %. pairs: as given. used (n,): which
    pairs the answer rests on. rejected: (name, why) of the others. residuals (n, 6), left_out (n, 6): measured
    T_camera_target against the fit to all used pairs, and against the fit to the others; camera axes, m and rad.
    correlation: of the errors in time, where the poses are of one recording; left_out is then against what is further
    away in time. covariance_factor: on the covariances of the camera's poses, by which the pairs are weighed with what
    these leave unexplained; None where none were given. comparison: of images, what the result rests on and by which
    errors. advice: what would make it surer; concerns: those that keep it from being trusted.
    """

    setup: Setup
    T_parent_camera: RigidTransform
    T_parent_target: RigidTransform
    covariance: NamedCovariance
    dof: float
    noise: Noise
    scale: Scale | None
    rotation_excitation: RotationExcitation
    pairs: PosePairs
    used: NDArray[np.bool_]
    rejected: tuple[tuple[str, str], ...]
    residuals: Array
    left_out: Array
    concerns: tuple[str, ...]
    advice: tuple[str, ...]
    reprojection_rms_px: float | None = None
    correlation: Correlation | None = None
    comparison: ImageComparison | None = None
    covariance_factor: float | None = None

    def __post_init__(self) -> None:
        n = len(self.pairs)
        object.__setattr__(self, "residuals", frozen_array("residuals", self.residuals, (n, 6)))
        object.__setattr__(self, "left_out", frozen_array("left_out", self.left_out, (n, 6)))

    @property
    def camera_parent(self) -> str:
        """The frame that carries the camera."""
        return "flange" if self.setup is Setup.EYE_IN_HAND else "base"

    @property
    def target_parent(self) -> str:
        """The frame that carries the target."""
        return "base" if self.setup is Setup.EYE_IN_HAND else "flange"

    @property
    def n_used(self) -> int:
        """Pairs that the answer rests on."""
        return int(self.used.sum())

    @property
    def residual_rms_m(self) -> float:
        """Root mean square of the position residuals' length over the used pairs."""
        return _rms(self.residuals[self.used, :3])

    @property
    def residual_rms_rad(self) -> float:
        """Root mean square of the orientation residuals' angle over the used pairs."""
        return _rms(self.residuals[self.used, 3:])

    @property
    def loo_rms_m(self) -> float:
        """Root mean square of the left-out position errors over the used pairs."""
        return _rms(self.left_out[self.used, :3])

    @property
    def loo_rms_rad(self) -> float:
        """Root mean square of the left-out angles over the used pairs."""
        return _rms(self.left_out[self.used, 3:])

    @property
    def coverage_factor(self) -> float:
        """Student's factor on the standard deviations for the noise being estimated."""
        return float(t_ppf(0.975, self.dof) / t_ppf(0.975, np.inf))

    def std(self, who: str = "camera") -> dict[str, float]:
        """Return the standard deviations of the 'camera' or the 'target' pose by name."""
        std = self.covariance.std()
        return {name: std[f"{who}.{name}"] for name in POSE_NAMES}


def _rms(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


# Whose noise the residuals are: the robot's or the camera's.


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One noise: its standard deviation per component and how well that is known, in m or rad.

    std is infinite where the data cannot tell this noise from another; then value is its upper bound.
    """

    value: float
    std: float

    @property
    def known(self) -> bool:
        """Whether the data can tell this noise from the others."""
        return bool(np.isfinite(self.std))


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of one component of a pose of the robot and of the camera.

    translation_m: of both together as seen at the target, without what the robot's orientation adds through the
    lever. Pose pairs cannot split it: a shift of the flange and a shift of the target look alike; with images, or
    covariances of the camera's poses, the camera's share is known.
    """

    translation_m: Part
    robot_m: Part
    camera_m: Part
    robot_rad: Part
    camera_rad: Part
    lever_m: float

    def explanation(self) -> str:
        """Return one sentence on whether robot or camera explains the residuals."""
        total = self.robot_rad.value**2 + self.camera_rad.value**2
        share = self.robot_rad.value**2 / total if total > 0.0 else 0.0
        uncertainty = 2.0 * np.hypot(
            self.robot_rad.value * self.robot_rad.std, self.camera_rad.value * self.camera_rad.std
        )
        size = f"{np.sqrt(total) / DEG:.2g} degrees"
        if total > 0.0 and uncertainty > 0.3 * total:
            turn = f"The data cannot yet tell whether robot or camera causes the {size} in orientation"
        elif share > 0.7:
            turn = f"The robot explains most of the {size} in orientation"
        elif share < 0.3:
            turn = f"The camera explains most of the {size} in orientation"
        else:
            turn = f"Robot and camera share the {size} in orientation"
        if not self.robot_m.known:
            return f"{turn}; the {self.translation_m.value / MM:.2g} mm in position may be either's"
        robot, corners = self.robot_m.value / MM, self.camera_m.value / MM
        rest = "the robot, or what bends an image as a whole (lens, sheet)"
        return f"{turn}; in position the noise of the image makes {corners:.2g} mm, {rest} {robot:.2g} mm"


def noise_of_pairs(solution: Solution, covariance: Array) -> Noise:
    """Return the noises of a fit to pose pairs, from the covariance (k, k) of its variances."""
    variances, lever_m = solution.variances, float(solution.lever[solution.keep].mean())
    if solution.weighed is not None:
        claimed = np.einsum("nii->i", solution.weighed.known[solution.keep]) / solution.n_used
        return noise_beside(variances[:3], covariance, lever_m, variances[3] * claimed)
    together = part(variances[0], covariance[0, 0])
    open_ = Part(value=together.value, std=float("inf"))
    return Noise(
        translation_m=together,
        robot_m=open_,
        camera_m=open_,
        robot_rad=part(variances[2], covariance[2, 2]),
        camera_rad=part(variances[1], covariance[1, 1]),
        lever_m=lever_m,
    )


def noise_beside(variances: Array, covariance: Array, lever_m: float, known: Array) -> Noise:
    """Return the noises where the mean variances (6,) of the camera's poses are known, from those found beside them."""
    camera_m, camera_rad = float(known[:3].mean()), float(known[3:].mean())
    return Noise(
        translation_m=part(variances[0] + camera_m, covariance[0, 0]),
        robot_m=part(variances[0], covariance[0, 0]),
        camera_m=part(camera_m, 0.0),
        robot_rad=part(variances[2], covariance[2, 2]),
        camera_rad=part(variances[1] + camera_rad, covariance[1, 1]),
        lever_m=lever_m,
    )


def part(variance: float, spread: float) -> Part:
    """Return the standard deviation of a variance; near zero its uncertainty is that of the variance itself, not of its
    slope."""
    value = float(np.sqrt(max(variance, 0.0)))
    uncertainty = float(np.sqrt(max(spread, 0.0)))
    return Part(
        value=value, std=float(min(uncertainty / (2.0 * value) if value > 0.0 else np.inf, np.sqrt(uncertainty)))
    )


# What to tell the person: verdict, warnings, what to do next.

SCALE_SURE = 1e-5
"""Chance below which a wrong scale is believed: one good set in a hundred thousand is accused."""

SCALE_MATTERS = 2e-3
"""A target whose size is right within 0.2 % is not worth a word."""

CLAIM_OFF = 1.5
"""Standard deviations of the camera's poses that are right within this factor need no word: 20 pairs tell it to 0.2."""

FEW_PAIRS = 10
WEAK_TURN_RAD = 8.0 * DEG
"""Below this second turn (root mean square) more tilt is the cheapest gain: errors shrink in proportion to it."""


def advise(result: HandEye, pitch_m: float | None) -> HandEye:
    """Return the result with its advice, most urgent first."""
    drift = () if result.correlation is None else result.correlation.warnings(result.n_used)
    concerns = (*_scale(result, pitch_m), *_outliers(result), *_poses(result), *drift)
    advice = (*concerns, *_copies(result), *_weights(result), result.noise.explanation() + ".")
    return replace(result, concerns=concerns, advice=advice)


def verdict(result: HandEye) -> str:
    """Return the verdict in one sentence."""
    std = result.std()
    place = 1.96 * max(std[name] for name in ("x_m", "y_m", "z_m")) / MM
    turn = 1.96 * max(std[name] for name in ("rx_rad", "ry_rad", "rz_rad")) / DEG
    text = (
        f"The camera's place in the {result.camera_parent} is known to {place:.2g} mm and {turn:.2g} degrees (95 %) "
        f"from {result.n_used} of {len(result.pairs)} poses{_worth(result)}; a pose left out is predicted to "
        f"{result.loo_rms_m / MM:.2g} mm "
        f"and {result.loo_rms_rad / DEG:.2g} degrees"
    )
    if scale_is_wrong(result):
        return text + ", but the target is not of the size that was given: measure it and run again."
    return text + "."


def _worth(result: HandEye) -> str:
    """Return how many independent poses a recording's are worth, in words."""
    correlation = result.correlation
    return "" if correlation is None else f", worth {correlation.n_effective:.0f} independent ones"


def scale_is_wrong(result: HandEye) -> bool:
    """Tell whether the robot's motion contradicts the target's size."""
    scale = result.scale
    return scale is not None and scale.p < SCALE_SURE and abs(scale.factor - 1.0) > SCALE_MATTERS


def _scale(result: HandEye, pitch_m: float | None) -> list[str]:
    scale = result.scale
    if scale is None or not scale_is_wrong(result):
        return []
    percent = 100.0 * (scale.factor - 1.0)
    uncertainty = 100.0 * scale.std
    text = f"The robot's motion says that the target is {abs(percent):.2f} +- {uncertainty:.2f} % "
    text += "smaller than given" if percent < 0.0 else "larger than given"
    if pitch_m is not None:
        given, true = pitch_m / MM, pitch_m * scale.factor / MM
        text += f": a pitch of {true:.2f} +- {pitch_m * scale.std / MM:.2f} mm, not {given:.4g} mm"
    return [text + ". Measure the target with a calliper over many squares, correct the pitch, and run again."]


def _outliers(result: HandEye) -> list[str]:
    wrong = [name for name, why in result.rejected if why.startswith("off by")]
    if not wrong:
        return []
    named = ", ".join(wrong[:8]) + (", ..." if len(wrong) > 8 else "")
    return [
        f"{len(wrong)} of {len(result.pairs)} poses contradict the others and were left out ({named}): look at these "
        "images and robot poses."
    ]


def _copies(result: HandEye) -> list[str]:
    copies = sum(not why.startswith("off by") for _, why in result.rejected)
    return [f"{copies} rows repeat others and were left out: copies add no knowledge."] if copies else []


def _weights(result: HandEye) -> list[str]:
    told = [f"{result.pairs.unweighed}."] if result.pairs.unweighed else []
    if result.covariance_factor is not None:
        factor = float(np.sqrt(result.covariance_factor))
        text = "The pairs are weighed by the covariances of the camera's poses"
        if not 1.0 / CLAIM_OFF < factor < CLAIM_OFF:
            text += f", whose standard deviations the residuals say are {factor:.2g} times as large as given"
        told.append(f"{text}.")
    return told


def _poses(result: HandEye) -> list[str]:
    out = []
    behind = result.pairs.T_camera_target.translation[result.used, 2] < 0.0
    if np.mean(behind) > 0.5:
        out.append(
            "The target lies behind the camera (z < 0): if the camera looks along z, both tables are inverted "
            "(T_flange_base and T_target_camera), and the two results have changed places."
        )
    if result.n_used < FEW_PAIRS:
        out.append(f"{result.n_used} poses are few: {FEW_PAIRS} to 30 make the answer and its uncertainty trustworthy.")
    second = float(result.rotation_excitation.rms_rad[1])
    if second < WEAK_TURN_RAD:
        x, y, z = result.rotation_excitation.axes[1]
        out.append(
            f"The hand turns by only {second / DEG:.2g} degrees (root mean square) about its second axis ({x:.2f}, "
            f"{y:.2f}, {z:.2f}): poses tilted by 20 degrees about it help most."
        )
    return out
