"""What a hand-eye calibration returns."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.correlation import Correlation
from armsight.calibrate.handeye.image_comparison import ImageComparison
from armsight.calibrate.handeye.noise import Noise
from armsight.calibrate.handeye.pairs import PosePairs, RotationExcitation, Setup
from armsight.calibrate.handeye.stream_pairing import TimeOffset
from armsight.columns import POSE6, POSITION, ROTATION_VECTOR
from armsight.errors import Inconsistent
from armsight.fields import Doc
from armsight.fitting.quantiles import t_ppf
from armsight.geometry import euler_rad, xyz_quat
from armsight.optics import Camera
from armsight.records import NamedCovariance, require_count
from armsight.records.checks import freeze
from armsight.records.output import Output, Row, TitledOutput, figure, output, with_std
from armsight.records.result_parts import MEANING, PoseStd, Verdict
from armsight.shown import REJECTED_SHOWN, Bars, Shown, Table, digits, pose_rows
from armsight.units import DEG, MM, displayed_name

Vector3 = tuple[float, float, float]

SCALE_SURE = 1e-5
"""Chance below which a wrong scale is believed: one good set in a hundred thousand is accused."""

SCALE_MATTERS = 2e-3
"""A target whose size is right within 0.2 % is not worth a word."""

NAMES = tuple(f"{who}.{name}" for who in ("camera", "target") for name in POSE6)
"""Names of the covariance: the camera's pose in the frame that carries it, then the target's."""


@output
class Scale(Output):
    """True over assumed size of the target, as the robot's motion says."""

    factor: Annotated[float, Doc("True size over assumed size.")]
    std: Annotated[float, Doc("Standard deviation of the factor.")]
    p: Annotated[float, Doc("Chance of so large a difference from 1 if there is none.")]

    @property
    def wrong(self) -> bool:
        """Whether the robot's motion contradicts the target's size."""
        return self.p < SCALE_SURE and abs(self.factor - 1.0) > SCALE_MATTERS


@output
class Proposal(Output):
    """A further pose that would make the result surer; T_camera_target: what the camera is expected to see there."""

    T_base_flange: Annotated[RigidTransform, Doc("Where to move the flange, in base axes.")]
    T_camera_target: RigidTransform
    expected_std_m: Annotated[float, Doc("Standard deviation of the camera's place to expect with it, m.")]


FEW_PAIRS = 10
"""Below it the answer and its uncertainty lean on each single pair."""


@output
class RejectedPair(Output):
    """A pair, image or robot pose that was left out."""

    row: Annotated[int | None, Doc("Its row, from 1; null for what made no pair.")]
    name: Annotated[str, Doc("Its name: of the row or of the image.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class HandEyeResult(TitledOutput):
    """armsight calibrate handeye: where the camera and the target are, and how far to believe it.

    EYE_IN_HAND: T_parent_camera is T_flange_camera and T_parent_target is T_base_target. EYE_TO_HAND: they are
    T_base_camera and T_flange_target. covariance (12, 12): of both, translation then rotation vector, in the axes of
    the frames that carry them, widened for the noise being estimated: +- 1.96 std holds 95 %. pairs: as given. used
    (n,): which pairs the answer rests on; rejected_pairs: the others. residuals (n, 6), left_out (n, 6): measured
    T_camera_target against the fit to all used pairs, and against the fit to the others; camera axes, m and rad.
    correlation: of the errors in time, where the poses are of one recording; left_out is then against what is further
    away in time. comparison: of images, what the result rests on and by which errors. unseen: images and robot poses
    that made no pair. offset: between the clocks of two streams. camera: the one that was freed and kept, None where
    none was. boards: what the report shows of images (report.run.BoardViews).
    """

    setup: Annotated[Setup, Doc("eye-in-hand or eye-to-hand.")]
    T_parent_camera: RigidTransform
    T_parent_target: RigidTransform
    covariance: NamedCovariance
    dof: float
    noise: Annotated[Noise, Doc("Noise of robot and camera.")]
    rotation_excitation: RotationExcitation
    pairs: PosePairs
    used: NDArray[np.bool_]
    rejected_pairs: tuple[RejectedPair, ...]
    residuals: Array
    left_out: Array
    concerns: Annotated[
        tuple[str, ...], Doc("The advice to follow before the result can be trusted; empty: it can be.")
    ]
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]
    scale: Annotated[Scale | None, Doc("Whether the target's size is true.", key="target_scale")] = None
    reprojection_rms_px: Annotated[
        float | None, Doc("Reprojection residual of the images, RMS, px; with images only.")
    ] = None
    correlation: Correlation | None = None
    comparison: Annotated[
        ImageComparison | None, Doc("Result from poses against that from corners; with images only.", key="crossval")
    ] = None
    covariance_factor: Annotated[
        float | None,
        Doc("On the covariances of the camera's poses, by which pairs are weighed; where they are known."),
    ] = None
    unseen: tuple[RejectedPair, ...] = ()
    offset: TimeOffset | None = None
    camera: Camera | None = None
    boards: Any = None
    camera_file: Annotated[str | None, Doc("The freed camera that the result belongs to, where it was kept.")] = None
    proposals: Annotated[tuple[Proposal, ...] | None, Doc("Further poses, with --propose.")] = None

    def __post_init__(self) -> None:
        n = len(self.pairs)
        freeze(self, residuals=(n, 6), left_out=(n, 6))

    @property
    def camera_parent(self) -> str:
        """The frame that carries the camera."""
        return "flange" if self.setup is Setup.EYE_IN_HAND else "base"

    @property
    def target_parent(self) -> str:
        """The frame that carries the target."""
        return "base" if self.setup is Setup.EYE_IN_HAND else "flange"

    @figure("The camera; eye-in-hand only.", key="T_flange_camera", optional=True)
    def camera_on_flange(self) -> RigidTransform | None:
        return self.T_parent_camera if self.setup is Setup.EYE_IN_HAND else None

    @figure("The target; eye-in-hand only.", key="T_base_target", optional=True)
    def target_in_base(self) -> RigidTransform | None:
        return self.T_parent_target if self.setup is Setup.EYE_IN_HAND else None

    @figure("The camera; eye-to-hand only.", key="T_base_camera", optional=True)
    def camera_in_base(self) -> RigidTransform | None:
        return self.T_parent_camera if self.setup is Setup.EYE_TO_HAND else None

    @figure("The target; eye-to-hand only.", key="T_flange_target", optional=True)
    def target_on_flange(self) -> RigidTransform | None:
        return self.T_parent_target if self.setup is Setup.EYE_TO_HAND else None

    @property
    def T_flange_camera(self) -> Array:
        """Pose of the camera on the flange (4, 4). Raises Inconsistent for a camera that is not on the arm."""
        return self._of_setup(Setup.EYE_IN_HAND, "T_flange_camera")

    @property
    def T_base_target(self) -> Array:
        """Pose of the target in the base (4, 4). Raises Inconsistent for a target that is on the arm."""
        return self._of_setup(Setup.EYE_IN_HAND, "T_base_target")

    @property
    def T_base_camera(self) -> Array:
        """Pose of the camera in the base (4, 4). Raises Inconsistent for a camera that is on the arm."""
        return self._of_setup(Setup.EYE_TO_HAND, "T_base_camera")

    @property
    def T_flange_target(self) -> Array:
        """Pose of the target on the flange (4, 4). Raises Inconsistent for a target that is not on the arm."""
        return self._of_setup(Setup.EYE_TO_HAND, "T_flange_target")

    def _of_setup(self, setup: Setup, name: str) -> Array:
        if self.setup is not setup:
            raise Inconsistent(
                f"{name} belongs to {setup}, and this calibration is {self.setup}",
                cure="Give setup='eye-to-hand' for a camera beside the arm, 'eye-in-hand' for one on it",
            )
        camera = name.endswith("camera")
        return np.asarray((self.T_parent_camera if camera else self.T_parent_target).as_matrix())

    @figure("Standard deviations of the camera's pose, in axes of flange or base.", key="std")
    def std_camera(self) -> PoseStd:
        return PoseStd(**self.std)

    @figure("Standard deviations of the target's pose, in axes of base or flange.")
    def std_target(self) -> PoseStd:
        return PoseStd(**self.target_std)

    @figure("Pairs, images and robot poses given.")
    def n_pairs(self) -> int:
        return len(self.pairs) + len(self.unseen)

    @figure("Pairs that the result rests on.")
    def n_used(self) -> int:
        return int(self.used.sum())

    @figure("Independent pairs that they are worth; of streams only.", optional=True)
    def n_effective(self) -> float | None:
        return None if self.correlation is None else self.correlation.n_effective

    @figure("After which a drift of the errors is forgotten, s; of streams only.", optional=True)
    def correlation_time_s(self) -> float | None:
        return None if self.correlation is None else self.correlation.time_s

    @figure("What was left out.", key="rejected")
    def every_rejected(self) -> tuple[RejectedPair, ...]:
        return (*self.rejected_pairs, *self.unseen)

    @figure("Residual of T_camera_target's position, RMS, m.")
    def residual_rms_m(self) -> float:
        return _rms(self.residuals[self.used, :3])

    @figure("Residual of T_camera_target's orientation, RMS, rad.")
    def residual_rms_rad(self) -> float:
        return _rms(self.residuals[self.used, 3:])

    @figure("Position error of each pair predicted from the others, RMS, m.")
    def loo_rms_m(self) -> float:
        return _rms(self.left_out[self.used, :3])

    @figure("Orientation error of each pair predicted from the others, RMS, rad.")
    def loo_rms_rad(self) -> float:
        return _rms(self.left_out[self.used, 3:])

    @figure("Turns of the hand about its principal axes, falling, RMS, rad.", key="turning_rms_rad")
    def rotation_excitation_rms_rad(self) -> Vector3:
        x, y, z = self.rotation_excitation.rms_rad.tolist()
        return x, y, z

    @figure("Add it to the camera's times to get the robot's, s; with streams only.", optional=True)
    def time_offset_s(self) -> float | None:
        return None if self.offset is None else self.offset.offset_s

    @figure("Standard deviation of the time offset, s; with streams only.", optional=True)
    def time_offset_std_s(self) -> float | None:
        return None if self.offset is None else self.offset.std_s

    @figure("Whether the result can be trusted, in words.")
    def verdict(self) -> str:
        std = self.std
        position = 1.96 * max(std[name] for name in POSITION) / MM
        turn = 1.96 * max(std[name] for name in ROTATION_VECTOR) / DEG
        worth = "" if self.n_effective is None else f", worth {self.n_effective:.0f} independent ones"
        text = (
            f"The camera's place in the {self.camera_parent} is known to {position:.2g} mm and {turn:.2g} degrees "
            f"(95 %) from {self.n_used} of {len(self.pairs)} poses{worth}; a pose left out is predicted to "
            f"{self.loo_rms_m / MM:.2g} mm "
            f"and {self.loo_rms_rad / DEG:.2g} degrees"
        )
        if self.scale is not None and self.scale.wrong:
            return text + ", but the target is not of the size that was given: measure it and run again."
        return text + "."

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        level, headline = "good", "Good"
        if self.scale is not None and self.scale.wrong:
            level, headline = "bad", "Measure the target"
        elif self.rejected_pairs:
            level, headline = "care", "Usable, with poses left out"
        elif self.n_used < FEW_PAIRS:
            level, headline = "care", "Usable, few poses"
        elif self.concerns:
            level, headline = "care", "Usable with care"
        todo = self.concerns or ("Use it; calibrate again when camera or target has moved.",)
        return Verdict(level=level, headline=headline, reasons=[self.verdict], next=[todo[0]])

    @property
    def coverage_factor(self) -> float:
        """Student's factor on the standard deviations for the noise being estimated."""
        return float(t_ppf(0.975, self.dof) / t_ppf(0.975, np.inf))

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the camera's pose: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."""
        return self._std_of("camera")

    @property
    def target_std(self) -> dict[str, float]:
        """The same of the target's pose."""
        return self._std_of("target")

    def _std_of(self, who: str) -> dict[str, float]:
        std = self.covariance.std()
        return {name: std[f"{who}.{name}"] for name in POSE6}

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """(row, why) of the pairs that were left out."""
        return tuple((one.name, one.why) for one in self.rejected_pairs)

    @property
    def left_out_rms_m(self) -> float:
        """Error of the target's place in pairs that were left out of the fit, RMS, m."""
        return self.loo_rms_m

    @property
    def left_out_rms_rad(self) -> float:
        """Error of its rotation in pairs left out, RMS, rad."""
        return self.loo_rms_rad

    @property
    def solved(self) -> SimpleNamespace:
        """Of earlier versions: boards and freed, the camera."""
        warnings.warn(
            "solved.boards and solved.freed are boards and camera; use those", DeprecationWarning, stacklevel=2
        )
        return SimpleNamespace(result=self, boards=self.boards, freed=self.camera)

    def propose(self, n: int, reachable: Callable[[RigidTransform], bool] | None = None) -> tuple[Proposal, ...]:
        """Return the n next poses to drive to: T_base_flange, and the standard deviation to expect after it.

        reachable: tells whether the robot can go to a T_base_flange. Raises Inconsistent where no pose is left.
        """
        from armsight.calibrate.handeye.advice import propose

        require_count("n", n, least=1)
        return propose(self, n, reachable)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        where = f"T_{self.camera_parent}_camera"
        return f"Hand-eye ({self.setup}): {where} from {self.n_used} of {len(self.pairs)} pairs"

    def rows(self) -> list[Row]:
        """Return the camera's pose with standard deviations, residuals and the verdict."""
        T = self.T_parent_camera
        values = [*T.translation.tolist(), *euler_rad(T.rotation).tolist()]
        rows = []
        for (name, std), value in zip(self.std.items(), values, strict=True):
            stem, unit, size = displayed_name(name)
            rows.append((stem, with_std(value, std, unit, scale=1.0 / size)))
        return [
            *rows,
            ("left-out error", f"{1e3 * self.loo_rms_m:.3g} mm, {np.rad2deg(self.loo_rms_rad):.3g} deg RMS"),
            *((f"rejected {name}", why) for name, why in self.rejected[:5]),
            ("verdict", self.verdict),
            *(("advice", text) for text in self.advice),
        ]

    def summary(self) -> Iterator[Shown]:
        """Yield both poses, how far to believe them, what to do, what was left out and what is proposed."""
        for name, pose, std in (
            (f"T_{self.camera_parent}_camera", self.T_parent_camera, self.std_camera),
            (f"T_{self.target_parent}_target", self.T_parent_target, self.std_target),
        ):
            rows = pose_rows(pose.translation, pose.rotation.as_rotvec(), std.translation_m, std.rotation_rad)
            yield Table(name, ["", "value", "+-"], rows)
        yield self.verdict
        if self.comparison is not None:
            yield self.comparison.why
        if self.camera_file is not None:
            yield f"The result belongs to the freed camera: {self.camera_file}"
        yield from (f"- {text}" for text in self.advice)
        yield from (f"  left out: {item.name}: {item.why}" for item in self.every_rejected[:REJECTED_SHOWN])
        for proposed in self.proposals or ():
            xyz, quat = (", ".join(f"{v:.4f}" for v in values) for values in xyz_quat(proposed.T_base_flange))
            yield f"  propose T_base_flange ({xyz}) m, ({quat}): then {digits(proposed.expected_std_m / MM, 2)} mm"

    def bars(self) -> Bars:
        """Return each pair's error of place, mm."""
        values = np.linalg.norm(self.residuals[:, :3], axis=1) / MM
        return Bars(self.title, list(self.pairs.names), values.tolist(), "row", "error, mm")


def _rms(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
