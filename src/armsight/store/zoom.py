"""The keys of cameras in camera.yaml and rig.yaml: intrinsics, noise, timing, and the settings of zoom lenses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from armsight.errors import BadFile, Inconsistent
from armsight.optics import Camera, LensKind, ZoomLens, ZoomSetting
from armsight.optics.camera import coefficients_of
from armsight.records import CameraTiming, NamedCovariance, NoiseModel
from armsight.records.camera import TIMING
from armsight.store import codec
from armsight.store.schema import Kind, Origin, read_document, write_document


class TimingKey(codec.structure(CameraTiming)):  # type: ignore[misc]  # made of the record's fields
    """A camera's timing; times in s. std: standard deviations, each by itself; covariance counts before it."""

    record = CameraTiming
    std: dict[str, codec.Finite | None] | None = None

    def made(self) -> CameraTiming:
        """Return the record; Inconsistent where no camera can be like this."""
        timing: CameraTiming = super().made()
        given = {name: value for name, value in (self.std or {}).items() if value is not None}
        unknown = [name for name in self.std or () if name not in TIMING]
        if unknown or any(value < 0.0 for value in given.values()):
            raise Inconsistent(f"timing.std: of {', '.join(TIMING)}, none negative, not {self.std}")
        if timing.covariance is not None or not given:
            return timing
        covariance = NamedCovariance(names=tuple(given), matrix=np.diag(np.square([*given.values()])))
        return replace(timing, covariance=covariance)


def timing_mapping(timing: CameraTiming) -> dict[str, Any]:
    """Return a camera's timing as files hold it."""
    content = codec.mapping(timing)
    return content if timing.covariance is None else content | {"std": timing.std}


if TYPE_CHECKING:
    NoiseKey: TypeAlias = Any
else:
    NoiseKey = codec.structure(NoiseModel)


NotNegative = Annotated[codec.Finite, Field(ge=0.0)]


class LensModel(codec.Strict):
    """Intrinsics in px; distortion k1, k2, p1, p2, k3, of a fisheye lens k1, k2, k3, k4, of a rational one with k4, k5,
    k6 behind a pinhole's."""

    lens: Literal["pinhole", "fisheye", "rational"] = "pinhole"

    fx: codec.Finite
    fy: codec.Finite
    cx: codec.Finite
    cy: codec.Finite
    skew: codec.Finite = 0.0
    distortion: Annotated[list[codec.Finite], Field(min_length=4, max_length=8)]

    @model_validator(mode="after")
    def _coefficients(self) -> Self:
        names = coefficients_of(LensKind(self.lens))
        if len(self.distortion) != len(names):
            raise ValueError(
                f"distortion of a {self.lens} lens is {', '.join(names)}, and {len(self.distortion)} numbers are given"
            )
        return self

    def of_size(self, width: int, height: int) -> Camera:
        """Return the record; Inconsistent where no camera can be like this."""
        make = {"fisheye": Camera.fisheye, "rational": Camera.rational}.get(self.lens, Camera.pinhole)
        return make(width, height, self.fx, self.fy, self.cx, self.cy, skew=self.skew, distortion=self.distortion)


class SizeModel(codec.Strict):
    """The size of a camera's images in px."""

    width: codec.Count
    height: codec.Count


class IntrinsicsModel(LensModel, SizeModel):
    """A camera's image size and intrinsics; in errors the size comes first, as in files."""

    def camera(self) -> Camera:
        """Return the record; Inconsistent where no camera can be like this."""
        return self.of_size(self.width, self.height)


class ZoomSettingModel(LensModel):
    """A camera calibrated at one value of its zoom."""

    zoom: codec.Finite
    pupil_m: codec.Finite | None = None
    pupil_std_m: NotNegative = 0.0
    rms_px: codec.Finite | None = None
    covariance: codec.CovarianceModel | None = None


Settings = Annotated[list[ZoomSettingModel], Field(min_length=1, max_length=100)]


class MountedZoomModel(codec.Strict):
    """The settings of a rig's camera; at: the zoom at which the rig was calibrated."""

    at: codec.Finite
    settings: Settings

    def lens(self, width: int, height: int) -> ZoomLens:
        """Return the record; Inconsistent where these are not settings of one camera."""
        return _lens(self.settings, width, height)


class ZoomCameraModel(Origin):
    """camera.yaml of a zoom lens: the settings in place of one camera's intrinsics."""

    format: Literal["armsight/camera"] = "armsight/camera"
    width: codec.Count
    height: codec.Count
    zoom: Settings
    noise: NoiseKey | None = None
    timing: TimingKey | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoomCameraFile:
    """What the camera.yaml of a zoom lens holds; noise and timing are of the sensor, at all settings."""

    lens: ZoomLens
    noise: NoiseModel | None = None
    timing: CameraTiming | None = None
    inputs: Sequence[Mapping[str, str]] = ()


def is_zoom_camera(content: Mapping[str, Any]) -> bool:
    """Tell whether a camera.yaml's structure is that of a zoom lens."""
    return "zoom" in content


def read_zoom_camera(path: Path) -> ZoomCameraFile:
    """Return the settings of a zoom lens; BadFile where the file holds none."""
    content = read_document(path, ZOOM_YAML.format)
    if not is_zoom_camera(content):
        raise BadFile(
            f"{path}: holds a camera without zoom settings",
            consequence="Nobody knows at which zoom it was calibrated",
            cure="Calibrate its settings into a file of their own: armsight calibrate camera --zoom VALUE -o FILE",
        )
    return zoom_camera_from_mapping(content, str(path))


def _zoom_camera(model: ZoomCameraModel) -> ZoomCameraFile:
    return ZoomCameraFile(
        lens=_lens(model.zoom, model.width, model.height),
        **codec.values(model, "noise", "timing"),
        inputs=[item.model_dump() for item in model.inputs],
    )


def _content(file: ZoomCameraFile) -> dict[str, Any]:
    width, height = file.lens.size
    return {
        "width": width,
        "height": height,
        "zoom": settings_mapping(file.lens),
        "noise": codec.mapping(file.noise) if file.noise else None,
        "timing": timing_mapping(file.timing) if file.timing else None,
    }


ZOOM_YAML: Kind[ZoomCameraFile] = Kind(name="camera", model=ZoomCameraModel, record=_zoom_camera, content=_content)
zoom_camera_from_mapping = ZOOM_YAML.parse


def write_zoom_camera(path: Path, file: ZoomCameraFile, *, inputs: Sequence[Path] = ()) -> None:
    """Write the camera.yaml of a zoom lens; inputs come behind those that the file held before."""
    write_document(path, ZOOM_YAML.format, _content(file), inputs, earlier=file.inputs)


def with_setting(path: Path | None, setting: ZoomSetting, noise: NoiseModel | None = None) -> ZoomCameraFile:
    """Return what a zoom lens's file holds with a calibrated setting, in place of the one at its zoom.

    Where there is no file it is the only setting. The noise that the file holds stays where no new one is given. Raises
    Inconsistent where the setting is not of the same camera, BadFile.
    """
    if path is None or not path.exists():
        return ZoomCameraFile(lens=ZoomLens(settings=(setting,)), noise=noise)
    old = read_zoom_camera(path)
    return replace(old, lens=old.lens.with_setting(setting), noise=noise or old.noise)


def settings_mapping(lens: ZoomLens) -> list[dict[str, Any]]:
    """Return a lens's settings as files hold them."""
    return [_setting_mapping(one) for one in lens.settings]


def intrinsics_mapping(camera: Camera) -> dict[str, Any]:
    """Return a camera's intrinsics, without its size, as files hold them."""
    fx, fy, cx, cy, skew = camera.intrinsics[:5].tolist()
    lens = {} if camera.lens is LensKind.PINHOLE else {"lens": camera.lens.value}
    return {**lens, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew, "distortion": camera.distortion.tolist()}


def _setting_mapping(one: ZoomSetting) -> dict[str, Any]:
    out: dict[str, Any] = {"zoom": one.zoom, **intrinsics_mapping(one.camera)}
    if one.pupil_m is not None:
        out |= {"pupil_m": one.pupil_m, "pupil_std_m": one.pupil_std_m}
    if one.rms_px is not None:
        out["rms_px"] = one.rms_px
    if one.covariance is not None:
        out["covariance"] = codec.covariance_mapping(one.covariance)
    return out


def _lens(settings: Sequence[ZoomSettingModel], width: int, height: int) -> ZoomLens:
    return ZoomLens(
        settings=tuple(
            ZoomSetting(
                camera=one.of_size(width, height),
                **codec.values(one, "zoom", "covariance", "rms_px", "pupil_m", "pupil_std_m"),
            )
            for one in settings
        )
    )
