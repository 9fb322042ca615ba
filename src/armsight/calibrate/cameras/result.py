"""What calibrations of a camera and of a pair return."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from os import PathLike
from typing import Annotated, Any, Literal

from armsight._files import Files
from armsight.arrays import Array
from armsight.calibrate.camera_noise.photon_transfer import NoiseCalibration
from armsight.calibrate.cameras.observations import Observations
from armsight.calibrate.cameras.outlier_rejection import MetricKey, epipolar_rms
from armsight.calibrate.cameras.preconditions import images_doubted, images_verdict
from armsight.calibrate.cameras.zoom import ZoomOutput
from armsight.fields import Doc
from armsight.optics import SIDES, Camera, LensKind, Rig, ZoomSetting
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import NamedCovariance, NoiseModel
from armsight.records.output import Row, TitledOutput, extended, figure, output, with_std
from armsight.records.result_parts import MEANING, RejectedFile, Verdict
from armsight.shown import WRITTEN, Shown, Table, digits, rejected_lines
from armsight.units import MM

UNITS = {
    **dict.fromkeys(("fx", "fy", "cx", "cy", "skew"), "px"),
    **dict.fromkeys(("tx", "ty", "tz"), "m"),
    **dict.fromkeys(("rx", "ry", "rz"), "rad"),
    "delay": "s",
    "readout": "s",
}
"""Of the parameters by name; those of distortion have none."""


class FromBoards(TitledOutput):
    """What calibrations from boards show of themselves."""

    __slots__ = ()
    rms_px: float
    holdout_rms_px: float | None
    rejected: tuple[RejectedFile, ...]
    advice: tuple[str, ...]

    @property
    def left_out_rms_px(self) -> float | None:
        """`holdout_rms_px`; of earlier versions."""
        warnings.warn("left_out_rms_px is holdout_rms_px; use that", DeprecationWarning, stacklevel=2)
        return self.holdout_rms_px

    @property
    def noun(self) -> str:
        """What is left out to see how well the rest foretells it."""
        return "images"

    def _fit_rows(self) -> list[Row]:
        left_out = "" if self.holdout_rms_px is None else f"; {self.holdout_rms_px:.3g} px on images left out"
        rows = [("reprojection", f"{self.rms_px:.3g} px RMS{left_out}"), ("rejected", str(len(self.rejected)))]
        return rows + [("advice", text) for text in self.advice]


@output
class CameraCalibration(FromBoards):
    """armsight calibrate camera: a camera, how sure it is, and what it rests on.

    covariance: of the free intrinsics, by name (px; none for distortion). holdout_rms_px: None where there were too few
    views. sources, view_rms_px: of the views used. uv_px, residual_px (n, 2): every point used and its residual (model
    minus detected). used: the observations in the fit; T_camera_board (G, 4, 4): where its views show the board.
    doubts: where pixels would not be square. setting: of a zoom lens, the one at which the images were taken.
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
    noise: Annotated[
        NoiseCalibration | NoiseModel | None,
        Doc("The camera's noise, with --noise; the keys from n_given on of still frames, not of a file."),
    ] = None
    zoom: Annotated[ZoomOutput | None, Doc("The zoom lens, with --zoom.")] = None
    setting: ZoomSetting | None = None

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

    @figure("k1, k2, p1, p2, k3 (Brown), of a rational lens k4, k5, k6 behind them; of a fisheye k1, k2, k3, k4.")
    def distortion(self) -> tuple[float, ...]:
        return tuple(self.camera.distortion.tolist())

    @figure("The kind of lens, where it is a fisheye or rational; a pinhole is not named.", optional=True)
    def lens(self) -> Literal["fisheye", "rational"] | None:
        of_kind: dict[LensKind, Literal["fisheye", "rational"]] = {
            LensKind.FISHEYE: "fisheye",
            LensKind.RATIONAL: "rational",
        }
        return of_kind.get(self.camera.lens)

    @figure("Standard deviations by name: fx_px, fy_px, cx_px, cy_px, k1 ... k3, of a rational lens to k6.")
    def std(self) -> dict[str, float]:
        return std_by_key(self.covariance)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        seen = {"camera": (self.camera, self.uv_px)}
        doubts = images_doubted(self.n_used, self.n_images, self.rms_px, self.holdout_rms_px, seen)
        found = f"{self.n_used} of {self.n_images} images fit to {self.rms_px:.3g} px RMS{left_out_words(self)}"
        squares = [f"{text}, as where squares are printed longer than wide" for text in self.doubts]
        return images_verdict(found, squares + doubts, self.advice, squares=bool(squares))

    def save(
        self,
        path: str | PathLike[str],
        *,
        zoom: float | None = None,
        pupil_m: float | None = None,
        pupil_std_m: float = 0.0,
        noise: NoiseModel | None = None,
    ) -> Any:  # a Path, as of Saveable: the maths names no files
        """Write camera.yaml with the covariance, and return its path.

        zoom: of a zoom lens, the setting at which the images were taken; the file keeps its other settings. pupil_m,
        pupil_std_m: where the centre of projection stands along the axis, forward. noise: of calibrate_noise.
        """
        setting = self.setting if zoom is None else as_setting(self, zoom, pupil_m, pupil_std_m)
        return Files.save(extended(self, type(self), setting=setting, noise=noise or self.noise), path)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Camera from {self.n_used} images of a board"

    def rows(self) -> list[Row]:
        """Return the intrinsics with standard deviations, and how well they fit."""
        std = self.covariance.std()
        values = self.camera.named.items()
        rows = [(name, with_std(v, std.get(name), "px" if i < 5 else "")) for i, (name, v) in enumerate(values)]
        return rows + self._fit_rows()

    def summary(self) -> Iterator[Shown]:
        """Yield the camera, how well it fits, the images left out, its zoom lens and its noise."""
        values = {"fx": self.fx_px, "fy": self.fy_px, "cx": self.cx_px, "cy": self.cy_px}
        rows = [[name, digits(value, 6), digits(self.std.get(f"{name}_px"), 2)] for name, value in values.items()]
        distortion = list(self.camera.named.items())[5:]
        rows += [[name, digits(value, 4), digits(self.std.get(name), 2)] for name, value in distortion]
        yield Table(f"Camera, {self.n_used} of {self.n_images} images", ["", "value", "+-"], rows)
        yield f"Reprojection {digits(self.rms_px)} px RMS; {digits(self.holdout_rms_px)} px on left-out images"
        yield from rejected_lines(self.rejected)
        yield WRITTEN
        yield from (f"- {text}" for text in self.advice)
        yield from () if self.zoom is None else self.zoom.summary()
        yield from () if self.noise is None else (*self.noise.summary(), WRITTEN)

    def clouds(self) -> dict[str, tuple[Array, Array]]:
        """Return every point used and its residual (n, 2), px, by camera."""
        return {"camera": (self.uv_px, self.residual_px)}


@output
class StereoCalibration(FromBoards):
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
        return epipolar_rms([(self.used, self.pair_rig())])

    @figure("Distance of the two centres of projection, m.")
    def baseline_m(self) -> float:
        return self.pair_rig().baseline_m

    @figure("Standard deviations by name: left.fx_px ... right.k3, right.tx_m ... right.rz_rad, baseline_m.")
    def std(self) -> dict[str, float]:
        return {**std_by_key(self.pair_rig().covariance), "baseline_m": self.baseline_std_m}

    @figure("How parallel the two views stand.")
    def alignment(self) -> Parallelism:
        return parallelism(self.pair_rig())

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
    def noun(self) -> str:
        """What is left out to see how well the rest foretells it."""
        return "pairs"

    @property
    def thing(self) -> str:
        """What the images show."""
        return "board"

    def pair_rig(self) -> Rig:
        """Return the rig as the fit has it, in axes of the left camera: two lenses, of mirrors their virtual ones."""
        return self.rig

    def doubted(self) -> list[str]:
        """Return what speaks against relying on the pairs."""
        seen = {side: (self.pair_rig().camera(side), uv) for side, uv in self.uv_px.items()}
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

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Rig ({self.rig.kind}) from {self.n_used} pairs of views of a board"

    def rows(self) -> list[Row]:
        """Return baseline and focal lengths with standard deviations, and how well they fit."""
        std = self.std
        rows = [("baseline", with_std(self.rig.baseline_m, std.get("baseline_m"), "mm", scale=1e3))]
        for side in SIDES:
            values = zip(("fx", "fy", "cx", "cy"), self.rig.camera(side).intrinsics[:4].tolist(), strict=True)
            rows += [(f"{side} {name}", with_std(v, std.get(f"{side}.{name}_px"), "px")) for name, v in values]
        return [*rows, ("epipolar", f"{self.epipolar_rms_px:.3g} px RMS"), *self._fit_rows()]

    def summary(self) -> Iterator[Shown]:
        """Yield the rig, how well it fits, the images left out, and what would make it surer."""
        yield from self.shown_fit()
        yield from (f"- {text}" for text in self.advice)

    def shown_fit(self) -> Iterator[Shown]:
        """Yield the rig, how well it fits, and the images left out."""
        expected, mean, rms = (
            None if value is None else value / MM
            for value in (self.metric.get(name) for name in ("expected_m", "mean_m", "rms_m"))
        )
        rows = [
            ["baseline, mm", digits(self.baseline_m / MM, 5)],
            ["baseline +-, mm", digits(self.baseline_std_m / MM, 2)],
            ["reprojection, px RMS", digits(self.rms_px)],
            ["... on left-out pairs", digits(self.holdout_rms_px)],
            ["epipolar, px RMS", digits(self.epipolar_rms_px)],
            ["neighbouring corners, mm expected", digits(expected, 5)],
            ["... mean on left-out pairs", digits(mean, 5)],
            ["... RMS error", digits(rms)],
        ]
        yield Table(f"Rig, {self.n_used} of {self.n_pairs} pairs", ["", ""], rows)
        yield from rejected_lines(self.rejected)
        yield WRITTEN

    def clouds(self) -> dict[str, tuple[Array, Array]]:
        """Return every point used and its residual (n, 2), px, by side."""
        return {side: (self.uv_px[side], self.residual_px[side]) for side in SIDES}


def as_setting(
    done: CameraCalibration, zoom: float, pupil_m: float | None = None, pupil_std_m: float = 0.0
) -> ZoomSetting:
    """Return a calibration as a setting of a zoom lens. pupil_m, pupil_std_m: as of ZoomSetting."""
    return ZoomSetting(
        zoom=zoom,
        camera=done.camera,
        covariance=done.covariance,
        rms_px=done.rms_px,
        pupil_m=pupil_m,
        pupil_std_m=pupil_std_m,
    )


def left_out_words(done: FromBoards) -> str:
    """Return how well images left out of the fit are met, in words; empty where none was left out."""
    return "" if done.holdout_rms_px is None else f", {done.noun} left out of the fit to {done.holdout_rms_px:.3g} px"


def std_by_key(covariance: NamedCovariance | None) -> dict[str, float]:
    """Return standard deviations by name with the unit in the key: left.fx_px."""
    known = {} if covariance is None else covariance.std()
    units = {name: UNITS.get(name.rpartition(".")[2]) for name in known}
    return {f"{name}_{units[name]}" if units[name] else name: value for name, value in known.items()}
