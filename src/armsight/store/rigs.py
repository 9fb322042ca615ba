"""rig.yaml, camera.yaml, and world.yaml: cameras, and where a rig stands in the world or at the base of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.columns import POSE6
from armsight.errors import BadFile
from armsight.optics import Camera, LensKind, MountedCamera, MountedZoom, Plate, Rig, RigKind, Zooms, at_zoom
from armsight.records import CameraTiming, NamedCovariance, NoiseModel, Saveable
from armsight.store import codec
from armsight.store.schema import Kind, Origin, read_document, write_document
from armsight.store.yamls import read_yaml
from armsight.store.zoom import (
    IntrinsicsModel,
    MountedZoomModel,
    NoiseKey,
    TimingKey,
    intrinsics_mapping,
    is_zoom_camera,
    settings_mapping,
    timing_mapping,
)


def add_noise(path: Path, noise: Mapping[str, NoiseModel], *, inputs: Sequence[Path] = ()) -> None:
    """Write the noise into a camera.yaml (side "") or rig.yaml (by camera) that was read before; all else stays."""
    content = read_yaml(path)
    for side, one in noise.items():
        camera = content["cameras"][side] if side else content
        camera["noise"] = codec.mapping(one)
    origin = {name: content.pop(name, None) for name in ("format", *Origin.model_fields) if name != "version"}
    write_document(path, str(origin["format"]), content, inputs, earlier=origin["inputs"] or ())


SMALLEST_BASELINE_M = 1e-4
"""Two cameras nearer than this see no depth at any distance a rig is used at: a wrong file, not a rig."""


PlateModel = codec.structure(Plate)


class RigCameraModel(IntrinsicsModel):
    """A camera with its place in the rig, its noise where known, and the glass plate it looks through, if any."""

    T_rig_camera: codec.PoseModel
    noise: NoiseKey | None = None
    plate: PlateModel | None = None  # type: ignore[valid-type]  # of the record
    timing: TimingKey | None = None
    zoom: MountedZoomModel | None = None

    def camera(self) -> Camera:
        """Return the record; Inconsistent where no camera can be like this."""
        plain = IntrinsicsModel.camera(self)
        return plain if self.plate is None else replace(plain, plate=codec.record_of(self.plate))


class SidesModel(codec.Strict):
    """The rig's two cameras."""

    left: RigCameraModel
    right: RigCameraModel


class RigModel(Origin):
    """rig.yaml of a pair."""

    format: Literal["armsight/rig"] = "armsight/rig"
    kind: Literal["stereo", "mirror"]
    cameras: SidesModel
    rms_px: codec.Finite | None = None
    covariance: codec.CovarianceModel | None = None


class CamerasModel(Origin):
    """rig.yaml of any other cameras, in the rig's order."""

    format: Literal["armsight/rig"] = "armsight/rig"
    version: Literal[2]  # type: ignore[assignment]  # of the same key
    kind: Literal["cameras"]
    cameras: dict[str, RigCameraModel]
    rms_px: codec.Finite | None = None
    covariance: codec.CovarianceModel | None = None


class WideRigModel(CamerasModel):
    """rig.yaml of any cameras of which one has a rational lens, which earlier versions do not know."""

    version: Literal[3]  # type: ignore[assignment]  # of the same key
    kind: Literal["stereo", "mirror", "cameras"]  # type: ignore[assignment]  # of the same key


class CameraModel(Origin, IntrinsicsModel):
    """camera.yaml."""

    format: Literal["armsight/camera"] = "armsight/camera"
    rms_px: codec.Finite | None = None
    covariance: codec.CovarianceModel | None = None
    noise: NoiseKey | None = None
    timing: TimingKey | None = None


class RationalCameraModel(CameraModel):
    """camera.yaml of a rational lens."""

    version: Literal[2]  # type: ignore[assignment]  # of the same key


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFile:
    """What a camera.yaml holds: the camera; where it says so, how well it is known (by its names), its noise."""

    camera: Camera
    covariance: NamedCovariance | None = None
    rms_px: float | None = None
    noise: NoiseModel | None = None
    timing: CameraTiming | None = None


def _rig(model: RigModel | CamerasModel) -> Rig:
    cameras = dict(model.cameras)  # left and right first, as the model has them
    rig = Rig(
        kind=RigKind(model.kind),
        cameras=tuple(
            MountedCamera(
                name=name,
                camera=one.camera(),
                zoom=_zoom(one),
                **codec.values(one, "T_rig_camera", "noise", "timing"),
            )
            for name, one in cameras.items()
        ),
        **codec.values(model, "covariance", "rms_px"),
    )
    for first, second in combinations(rig.cameras, 2):
        apart = second.T_rig_camera.translation - first.T_rig_camera.translation
        if not float(np.linalg.norm(apart)) >= SMALLEST_BASELINE_M:
            which = "both cameras" if rig.is_pair else f"the cameras {first.name} and {second.name}"
            raise BadFile(
                f"{which} stand at the same place",
                consequence="Such a rig sees no depth",
                cure="Check T_rig_camera of both cameras: xyz_m is in metres",
            )
    return rig


def rig_mapping(rig: Rig) -> dict[str, Any]:
    """Return the rig as rig.yaml's structure, without format and origin, and without the version of a pair."""
    return {
        **_version(rig),
        "kind": rig.kind.value,
        "cameras": {one.name: _mounted_mapping(one) for one in rig.cameras},
        "rms_px": rig.rms_px,
        "covariance": codec.covariance_mapping(rig.covariance) if rig.covariance else None,
    }


def _version(rig: Rig) -> dict[str, int]:
    if any(one.camera.lens is LensKind.RATIONAL for one in rig.cameras):
        return {"version": 3}
    return {} if rig.is_pair else {"version": 2}


def _mounted_mapping(one: MountedCamera) -> dict[str, Any]:
    zoom = None if one.zoom is None else {"at": one.zoom.at, "settings": settings_mapping(one.zoom.lens)}
    return {
        **camera_mapping(one.camera),
        "T_rig_camera": codec.pose_mapping(one.T_rig_camera),
        **({} if one.noise is None else {"noise": codec.mapping(one.noise)}),
        **({} if one.timing is None else {"timing": timing_mapping(one.timing)}),
        **({} if zoom is None else {"zoom": zoom}),
    }


def camera_mapping(camera: Camera) -> dict[str, Any]:
    """Return a camera's size and intrinsics as files hold them."""
    plate = {} if camera.plate is None else {"plate": codec.mapping(camera.plate)}
    return {"width": camera.width, "height": camera.height, **intrinsics_mapping(camera), **plate}


RIG_YAML: Kind[Rig] = Kind(
    name="rig", model=RigModel, record=_rig, content=rig_mapping, later=(CamerasModel, WideRigModel)
)
rig_from_mapping, write_rig = RIG_YAML.parse, RIG_YAML.write

ALONE = "camera"
"""Name of the camera of a rig that is a camera.yaml."""


def read_zoom_rig(path: Path) -> Rig:
    """Return the rig of a rig.yaml with its zoom settings, or of a camera.yaml that camera alone. Raises BadFile."""
    content = read_yaml(path)
    if content.get("format") != CAMERA_YAML.format:
        return RIG_YAML.read(path)
    file = read_camera_file(path)
    mounted = MountedCamera(
        name=ALONE, camera=file.camera, T_rig_camera=RigidTransform.identity(), noise=file.noise, timing=file.timing
    )
    known = file.covariance
    named = known and NamedCovariance(names=tuple(f"{ALONE}.{name}" for name in known.names), matrix=known.matrix)
    return Rig(cameras=(mounted,), covariance=named, rms_px=file.rms_px)


def read_rig(path: Path, zoom: Zooms = (), *, any_cameras: bool = False) -> Rig:
    """Return the rig in a rig.yaml, at these zooms of its cameras where they have zoom lenses.

    Raises BadFile where it is none; UsageError where it is no pair, unless any_cameras; UsageError, NotEnoughData where
    the zooms do not fit, see optics.at_zoom.
    """
    rig = read_zoom_rig(path)
    return at_zoom(rig if any_cameras else rig.require_pair(str(path)), zoom).rig


def _camera(model: CameraModel) -> CameraFile:
    return CameraFile(camera=model.camera(), **codec.values(model, "covariance", "rms_px", "noise", "timing"))


def _camera_content(file: CameraFile) -> dict[str, Any]:
    return {
        **({"version": 2} if file.camera.lens is LensKind.RATIONAL else {}),
        **camera_mapping(file.camera),
        "rms_px": file.rms_px,
        "covariance": codec.covariance_mapping(file.covariance) if file.covariance else None,
        "noise": codec.mapping(file.noise) if file.noise else None,
        "timing": timing_mapping(file.timing) if file.timing else None,
    }


CAMERA_YAML: Kind[CameraFile] = Kind(
    name="camera", model=CameraModel, record=_camera, content=_camera_content, later=(RationalCameraModel,)
)


def read_camera_file(path: Path) -> CameraFile:
    """Return all that a camera.yaml says; BadFile where it is none, or holds the settings of a zoom lens."""
    content = read_document(path, CAMERA_YAML.format)
    if is_zoom_camera(content):
        raise BadFile(
            f"{path}: holds the settings of a zoom lens, and one camera is wanted",
            consequence="It is open which of them is meant",
            cure="Make the file of one setting: armsight convert camera FILE --zoom VALUE -o fixed.yaml",
        )
    return CAMERA_YAML.parse(content, str(path))


def _zoom(model: RigCameraModel) -> MountedZoom | None:
    if model.zoom is None:
        return None
    return MountedZoom(lens=model.zoom.lens(model.width, model.height), at=model.zoom.at)


def read_camera(path: Path) -> Camera:
    """Return the camera in a camera.yaml; BadFile where it is none."""
    return read_camera_file(path).camera


def write_camera(
    path: Path,
    camera: Camera,
    *,
    covariance: NamedCovariance | None = None,
    rms_px: float | None = None,
    noise: NoiseModel | None = None,
    timing: CameraTiming | None = None,
    inputs: Sequence[Path] = (),
) -> None:
    """Write camera.yaml with the hashes of the files it was made from."""
    file = CameraFile(camera=camera, covariance=covariance, rms_px=rms_px, noise=noise, timing=timing)
    CAMERA_YAML.write(path, file, inputs=inputs)


class WorldModel(Origin):
    """world.yaml: exactly one of T_world_rig and T_base_rig."""

    format: Literal["armsight/world"] = "armsight/world"
    T_world_rig: codec.PoseModel | None = None
    T_base_rig: codec.PoseModel | None = None
    covariance: codec.CovarianceModel | None = None
    residual_rms_m: codec.Finite | None = None
    n_used: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World(Saveable):
    """The rig's pose in its parent frame, 'world' or 'base'; covariance (6, 6) named POSE6, where known."""

    parent: str
    T_parent_rig: RigidTransform
    covariance: NamedCovariance | None = None
    residual_rms_m: float | None = None
    n_used: int | None = None


def _world(model: WorldModel) -> World:
    if (model.T_world_rig is None) == (model.T_base_rig is None):
        raise BadFile(
            "exactly one of T_world_rig and T_base_rig is wanted",
            consequence="The rig's place is not known",
            cure="Give the rig's pose in the frame that the results shall be in",
        )
    if model.covariance is not None and tuple(model.covariance.names) != POSE6:
        raise BadFile(f"the covariance's names are {model.covariance.names}, not {POSE6}")
    parent, pose = ("base", model.T_base_rig) if model.T_world_rig is None else ("world", model.T_world_rig)
    return World(
        parent=parent,
        T_parent_rig=pose.pose(),  # type: ignore[union-attr]  # one of them is there
        **codec.values(model, "covariance", "residual_rms_m", "n_used"),
    )


def _content(world: World) -> dict[str, Any]:
    return {
        f"T_{world.parent}_rig": codec.pose_mapping(world.T_parent_rig),
        "covariance": codec.covariance_mapping(world.covariance) if world.covariance else None,
        "residual_rms_m": world.residual_rms_m,
        "n_used": world.n_used,
    }


WORLD_YAML = Kind(name="world", model=WorldModel, record=_world, content=_content)
read_world, write_world = WORLD_YAML.read, WORLD_YAML.write
