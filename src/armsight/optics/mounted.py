"""A camera where it stands in a rig, and by which name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any

from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent, UsageError
from armsight.optics.camera import SIDES, Camera
from armsight.optics.zoom import ZoomLens
from armsight.records import CameraTiming, NoiseModel, require_kind

MOST_CAMERAS = 8
"""Beyond these no USB controller and no computer keeps up with the pictures."""

LONGEST_NAME = 16
RESERVED_NAMES = ("rig", "image", "complex", "all")
"""What flags, files and messages call other things than a camera."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountedZoom:
    """The zoom lens of a rig's camera; at: the zoom that the rig was calibrated at and its camera is of."""

    lens: ZoomLens
    at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountedCamera:
    """A camera of a rig: its name there, its pose in the rig's axes, and what is known beside.

    noise: of its grey levels; timing: when its lines are exposed; zoom: its lens's settings, where it zooms. Raises
    Inconsistent for what is no name.
    """

    name: str
    camera: Camera
    T_rig_camera: RigidTransform
    noise: NoiseModel | None = None
    timing: CameraTiming | None = None
    zoom: MountedZoom | None = None

    def __post_init__(self) -> None:
        require_camera_name(self.name)
        pair = self.name in SIDES  # whose values users give by these keywords
        require_kind(self.name if pair else f"camera of {self.name}", self.camera, Camera)
        require_kind(f"T_rig_{self.name}", self.T_rig_camera, RigidTransform)
        require_kind(f"noise of the {self.name} camera", self.noise, NoiseModel, NoneType)
        require_kind(f"timing of the {self.name} camera", self.timing, CameraTiming, NoneType)
        require_kind(f"zoom of the {self.name} camera", self.zoom, MountedZoom, NoneType)


def require_camera_name(name: object) -> None:
    """Raise Inconsistent for what is no name of a camera."""
    plain = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name) is not None
    if plain and len(str(name)) <= LONGEST_NAME and name not in RESERVED_NAMES:
        return
    raise Inconsistent(
        f"{str(name)[:40]!r} is no name of a camera",
        consequence="Flags, files and results could not tell it",
        cure=f"Take a letter, then letters, digits, - or _, at most {LONGEST_NAME} in all, and none of "
        f"{', '.join(RESERVED_NAMES)}",
    )


def place_of(cameras: Sequence[MountedCamera], name: str) -> int:
    """Return which of the cameras has a name; UsageError, with the names there are, where none has."""
    names = [one.name for one in cameras]
    if name not in names:
        raise UsageError(f"there is no camera {name!r}", cure=f"Use one of: {', '.join(names)}")
    return names.index(name)


def with_each(cameras: Sequence[MountedCamera], given: Mapping[str, Sequence[Any] | None]) -> tuple[MountedCamera, ...]:
    """Return the cameras with other values of the fields that are given, one each; UsageError for another number."""
    values = {name: each for name, each in given.items() if each is not None}
    for name, each in values.items():
        require_kind(name, each, tuple, list, cure="Give a tuple, one of each camera in order, None where not known")
        if len(each) != len(cameras):
            raise UsageError(
                f"{name} has {len(each)} entries",
                consequence=f"The rig's cameras are {', '.join(one.name for one in cameras)}",
                cure=f"Give {len(cameras)}",
            )
    return tuple(
        replace(one, **{name: each[k] for name, each in values.items()}) if values else one
        for k, one in enumerate(cameras)
    )


def require_names(names: tuple[str, ...]) -> None:
    """Raise Inconsistent for a number of cameras that no rig has, and for a name that is there twice."""
    if not 1 <= len(names) <= MOST_CAMERAS:
        raise Inconsistent(
            f"a rig of {len(names)} cameras", consequence="It cannot be used", cure=f"Take one to {MOST_CAMERAS}"
        )
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise Inconsistent(
            f"two cameras of the rig are called {twice}",
            consequence="Files and results could not tell which is meant",
            cure="Give each a name of its own",
        )
