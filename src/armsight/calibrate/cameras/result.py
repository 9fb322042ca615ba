"""What calibrations of a camera and of a pair return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from armsight.arrays import Array
from armsight.calibrate.cameras.cross_validation import MetricKey, epipolar_rms
from armsight.calibrate.cameras.observations import Observations
from armsight.calibrate.cameras.verdict import images_doubted, images_verdict
from armsight.fields import Doc
from armsight.optics import SIDES, Camera, LensKind, Rig
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import NamedCovariance
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, RejectedFile, Verdict
from armsight.units import MM

UNITS = {
    **dict.fromkeys(("fx", "fy", "cx", "cy", "skew"), "px"),
    **dict.fromkeys(("tx", "ty", "tz"), "m"),
    **dict.fromkeys(("rx", "ry", "rz"), "rad"),
}
"""Of the parameters by name; those of distortion have none."""


@output
class CameraCalibration(Output):
    """armsight calibrate camera: a camera, how sure it is, and what it rests on.

    covariance: of the free intrinsics, by name (px; none for distortion). holdout_rms_px: None where there were too few
    views. sources, view_rms_px: of the views used. uv_px, residual_px (n, 2): every point used and its residual (model
    minus detected). used: the observations in the fit; T_camera_board (G, 4, 4): where its views show the board.
    doubts: where pixels would not be square.
    """

    rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    n_used: Annotated[int, Doc("Images that the result rests on.")]
    rejected: Annotated[tuple[RejectedFile, ...], Doc("Images left out.")]
    holdout_rms_px: Annotated[float | None, Doc("Reprojection residual on images left out of the fit, RMS, px.")]
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]
    camera: Camera
    covariance: NamedCovariance
    view_rms_px: tuple[float, ...]
    sources: tuple[str, ...]
    uv_px: Array
    residual_px: Array
    used: Observations
    T_camera_board: Array
    doubts: tuple[str, ...] = ()

    @figure("Images read.")
    def n_images(self) -> int:
        return self.n_used + len(self.rejected)

    @figure("Focal length along x, px.")
    def fx_px(self) -> float:
        return float(self.camera.intrinsics[0])

    @figure("Focal length along y, px.")
    def fy_px(self) -> float:
        return float(self.camera.intrinsics[1])

    @figure("Column of the principal point, px from the centre of the top left pixel.")
    def cx_px(self) -> float:
        return float(self.camera.intrinsics[2])

    @figure("Row of the principal point, px from the centre of the top left pixel.")
    def cy_px(self) -> float:
        return float(self.camera.intrinsics[3])

    @figure("k1, k2, p1, p2, k3 (Brown); of a fisheye lens k1, k2, k3, k4.")
    def distortion(self) -> tuple[float, float, float, float, float] | tuple[float, float, float, float]:
        return tuple(self.camera.distortion.tolist())

    @figure("Where the lens is a fisheye; a pinhole is not named.", optional=True)
    def lens(self) -> Literal["fisheye"] | None:
        return None if self.camera.lens is LensKind.PINHOLE else "fisheye"

    @figure("Standard deviations by name: fx_px, fy_px, cx_px, cy_px, k1 ... k3.")
    def std(self) -> dict[str, float]:
        return std_by_key(self.covariance)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        seen = {"camera": (self.camera, self.uv_px)}
        doubts = images_doubted(self.n_used, self.n_images, self.rms_px, self.holdout_rms_px, seen)
        found = f"{self.n_used} of {self.n_images} images fit to {self.rms_px:.3g} px RMS{left_out_words(self)}"
        squares = [f"{text}, as where squares are printed longer than wide" for text in self.doubts]
        return images_verdict(found, squares + doubts, self.advice, squares=bool(squares))


@output
class StereoCalibration(Output):
    """armsight calibrate stereo: a rig (its covariance inside, its reference the left camera), and what it rests on.

    holdout_*: None where there were too few pairs. metric: on left-out pairs; where there were too few,
    metric_is_left_out is False and it is of the fit's own pairs; empty where no folds were asked for. used: the
    observations in the fit; T_left_board (G, 4, 4): where they show the board. residual_px: of every point used (n, 2),
    model minus detected, by side. doubts: where pixels would not be square.
    """

    rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    n_pairs: Annotated[int, Doc("Pairs of images read.")]
    n_used: Annotated[int, Doc("Pairs that the result rests on.")]
    rejected: Annotated[tuple[RejectedFile, ...], Doc("Images left out.")]
    holdout_rms_px: Annotated[float | None, Doc("Reprojection residual on pairs left out of the fit, RMS, px.")]
    holdout_epipolar_rms_px: Annotated[float | None, Doc("Epipolar distance on pairs left out, RMS, px.")]
    metric: Annotated[
        dict[MetricKey, float | None],
        Doc(
            "Distance of neighbouring corners after triangulation, m: as built, mean, RMS of the error; "
            "board_rms_m: RMS distance from the printed board laid onto them."
        ),
    ]
    metric_is_left_out: Annotated[bool, Doc("Whether `metric` is of pairs left out of the fit.")]
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]
    rig: Rig
    baseline_std_m: float
    view_rms_px: tuple[float, ...]
    used: Observations
    residual_px: Mapping[str, Array]
    T_left_board: Array
    doubts: tuple[str, ...] = ()

    @figure("Distance of the corners from their epipolar lines, RMS, px.")
    def epipolar_rms_px(self) -> float:
        return epipolar_rms([(self.used, self.rig)])

    @figure("Distance of the two centres of projection, m.")
    def baseline_m(self) -> float:
        return self.rig.baseline_m

    @figure("Standard deviations by name: left.fx_px ... right.k3, right.tx_m ... right.rz_rad, baseline_m.")
    def std(self) -> dict[str, float]:
        return {**std_by_key(self.rig.covariance), "baseline_m": self.baseline_std_m}

    @figure("How parallel the two views stand.")
    def alignment(self) -> Parallelism:
        return parallelism(self.rig)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        found = (
            f"{self.n_used} of {self.n_pairs} pairs fit to {self.rms_px:.3g} px RMS{left_out_words(self)}; the cameras "
            f"stand {self.baseline_m / MM:.5g} mm apart"
        )
        squares = [f"{text}, as where squares are printed longer than wide" for text in self.doubts]
        doubts = squares + self.doubted()
        return images_verdict(found, doubts, self.advice, squares=bool(squares), noun="pairs", thing=self.thing)

    @property
    def thing(self) -> str:
        """What the images show."""
        return "board"

    def doubted(self) -> list[str]:
        """Return what speaks against relying on the pairs."""
        seen = {side: (self.rig.camera(side), uv) for side, uv in self.uv_px.items()}
        return images_doubted(
            self.n_used, self.n_pairs, self.rms_px, self.holdout_rms_px, seen, noun="pairs", thing=self.thing
        )

    @property
    def sources(self) -> tuple[tuple[str, ...], ...]:
        """Names of the two images of each pair used."""
        return self.used.sources

    @property
    def uv_px(self) -> dict[str, Array]:
        """Every point used (n, 2), by side."""
        return {side: self.used.uv[:, c][self.used.weight[:, c] > 0.0] for c, side in enumerate(SIDES)}


def left_out_words(done: CameraCalibration | StereoCalibration) -> str:
    """Return how well images left out of the fit are met, in words; empty where none was left out."""
    noun = "images" if isinstance(done, CameraCalibration) else "pairs"
    return "" if done.holdout_rms_px is None else f", {noun} left out of the fit to {done.holdout_rms_px:.3g} px"


def std_by_key(covariance: NamedCovariance | None) -> dict[str, float]:
    """Return standard deviations by name with the unit in the key: left.fx_px."""
    known = {} if covariance is None else covariance.std()
    units = {name: UNITS.get(name.rpartition(".")[2]) for name in known}
    return {f"{name}_{units[name]}" if units[name] else name: value for name, value in known.items()}
