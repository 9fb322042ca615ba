"""Which file each record is written to."""

from __future__ import annotations

from functools import singledispatch
from os import PathLike
from pathlib import Path

from armsight.kinematics import Arm
from armsight.optics import Camera, Rig
from armsight.records import Target, TaughtPath, require_kind
from armsight.store.arm_file import write_arm
from armsight.store.path_file import write_path
from armsight.store.rigs import write_camera, write_rig
from armsight.store.targets import write_target


@singledispatch
def save(record: object, path: str | PathLike[str]) -> None:
    """Write a record's file. Raises TypeError for a record that has none, DeviceFailed where the disk refuses."""
    raise TypeError(f"{type(record).__name__} has no file of its own; {path} is not written")


@save.register
def _(record: Camera, path: str | PathLike[str]) -> None:
    write_camera(_file(path), record)


@save.register
def _(record: Rig, path: str | PathLike[str]) -> None:
    write_rig(_file(path), record)


@save.register
def _(record: Target, path: str | PathLike[str]) -> None:
    write_target(_file(path), record)


@save.register
def _(record: Arm, path: str | PathLike[str]) -> None:
    write_arm(_file(path), record)


@save.register
def _(record: TaughtPath, path: str | PathLike[str]) -> None:
    write_path(_file(path), record)


def _file(path: str | PathLike[str]) -> Path:
    require_kind("path", path, str, PathLike, cure="Give a file's path as text or pathlib.Path")
    return Path(path)
