"""What a hand-eye calibration returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.correlation import Correlation
from armsight.calibrate.handeye.image_comparison import ImageComparison
from armsight.calibrate.handeye.noise import Noise
from armsight.calibrate.handeye.pairs import Array, PosePairs, Setup
from armsight.calibrate.handeye.rotation_excitation import RotationExcitation
from armsight.fitting.quantiles import t_ppf
from armsight.records import NamedCovariance, frozen_array

POSE_NAMES = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
NAMES = tuple(f"{who}.{name}" for who in ("camera", "target") for name in POSE_NAMES)
"""Names of the covariance: the camera's pose in its mount, then the target's in its seat."""


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
    T_base_camera and T_flange_target. covariance (12, 12): of both, translation then rotation vector, in mount's
    and seat's axes, widened for the noise being estimated: +- 1.96 std holds 95 %. pairs: as given. used (n,): which
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
        whole = self.covariance.std()
        return {name: whole[f"{who}.{name}"] for name in POSE_NAMES}


def _rms(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
