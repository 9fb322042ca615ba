"""What callers hand over, as the jobs of `app` take it: records and arrays become files in a folder of their own.

A command of the command line is one job and one function of `app`; here the same job is filled from objects. So every
option, check and result is the same, and `armsight.verify(...)` gives what `armsight verify --json` prints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import chain, islice
from os import PathLike, fspath, sep
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight.columns import POSE7
from armsight.errors import ArmsightError, Inconsistent, UsageError
from armsight.fields import bare, known_hints
from armsight.kinematics import Arm
from armsight.ops.arrays import ImageLike, as_image, as_path, as_poses
from armsight.optics import Rig
from armsight.records import Frame, Target, real_array, require_kind
from armsight.store import World, write_text, write_world
from armsight.store.tables import cells
from armsight.store.targets import board_text

PathText = str | PathLike[str]
RigLike = Rig | PathText
TargetLike = Target | PathText
ArmLike = Arm | PathText
Source = PathText | Sequence[ImageLike] | NDArray[np.uint8] | Iterable[Frame]
"""Frames: as the command line names them (folder, pattern, video, recording, camera:NAME), or images in order.

A camera of one's own is an iterable of Frame, opened where it is a context manager; its frames keep their times."""
Columns = Mapping[str, ArrayLike | Sequence[str]]


class _Saveable(Protocol):
    def save(self, path: PathText) -> object:
        """Write the record's file."""


TableLike = PathText | _Saveable | Columns | tuple[ArrayLike, ArrayLike] | ArrayLike
"""A table: a file, a track, columns by name (a DataFrame), (t_s, q) or (t_s, T), or q or T alone."""
PoseLike = ArrayLike | RigidTransform | _Saveable | PathText
"""Where something is: a pose (4, 4), a result that holds it, or a file."""

J = TypeVar("J")

SOURCES = ("left", "right", "image", "images", "source", "frames", "left_only", "right_only")
RECORDS = (
    *("a", "b", "arm", "camera", "compare", "handeye", "left", "limits", "path", "record", "rig", "right"),
    *("rsi_config", "source", "target", "tip"),
)
"""Parameters that an array or a dictionary is none of."""
ENDING = {"poses": ".csv", "path": ".csv"}


class Given:
    """A folder for what a job reads and writes; out: where results stay, else they go with the block."""

    def __init__(self, out: PathText | None = None, *, name: str = "", limit: int | None = None) -> None:
        given = None if out is None else as_path(out, "out")
        self._temporary = TemporaryDirectory(prefix="armsight-")
        self.folder = Path(self._temporary.name)
        self.out = given or self.folder / "out" / name
        self._limit = limit

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, ArmsightError):  # what was given as an object is named as the parameter
            for part in ("cause", "consequence", "cure"):
                setattr(error, part, getattr(error, part).replace(f"{self.folder}{sep}", ""))
        self._temporary.cleanup()

    def job(self, kind: type[J], values: Mapping[str, Any], /, **more: Any) -> J:
        """Return a job filled from a function's arguments by name; what is None keeps the job's own default."""
        taken = {**values, **more}
        if taken.get("out") is None:
            taken["out"] = self.out
        self._limit = taken.get("limit")
        filled = {}
        for name, hint in known_hints(kind).items():
            if taken.get(name) is not None:
                filled[name] = self._converted(name, bare(hint), taken[name])
        return kind(**filled)

    def _converted(self, name: str, kinds: tuple[Any, ...], value: Any) -> Any:
        if name == "arm" or name == "model" or name == "nominal":
            path = self.arm(name, value)
            return Path(path) if Path in kinds else path
        if Path in kinds:
            return self.file(name, value)
        if name in SOURCES and str in kinds:
            return self.source(name, value)
        if name == "board":
            return board_text(value) if isinstance(value, Target) else as_text(name, value)
        return value

    def arm(self, name: str, value: object) -> str:
        """Return an arm's file, or its preset's name."""
        return str(self.file(name, value)) if isinstance(value, Arm) else as_text(name, value, Arm)

    def file(self, name: str, value: object) -> Path:
        """Return the path of a file with the value: its own where it is one. Raises UsageError for what has none."""
        if isinstance(value, str | PathLike):
            return Path(fspath(value))
        save = getattr(value, "save", None)
        if callable(save) and not isinstance(value, type):
            ending = ".csv" if hasattr(value, "poses") else ENDING.get(name, ".yaml")  # a track's is a table
            path = self.folder / f"{name}{ending}"
            save(path)
            return path
        if name == "world":
            return self._world(name, value)
        if name == "mask":
            return self._image(name, 0, value)
        if name in RECORDS:
            raise UsageError(
                f"{name} is of type {type(value).__name__}",
                consequence="It cannot be used",
                cure="Give a record or a file",
            )
        path = self.folder / f"{name}.csv"
        write_text(path, as_table(name, value))
        return path

    def picture(self, name: str, value: Any) -> Path:
        """Return the file of one image."""
        return Path(fspath(value)) if isinstance(value, str | PathLike) else self._image(name, 0, value)

    def source(self, name: str, value: object) -> str:
        """Return frames as the command line names them; images are written without loss, Frames with their times."""
        if isinstance(value, str | PathLike):
            return fspath(value)
        if not isinstance(value, Iterable) or isinstance(value, Mapping):
            raise UsageError(
                f"{name} is of type {type(value).__name__}",
                consequence="There are no frames",
                cure="Give a folder, a video, a recording, camera:NAME, or a list of images",
            )
        with value if isinstance(value, AbstractContextManager) else nullcontext(value) as frames:
            each = iter(frames)
            first = next(each, None)
            if isinstance(first, Frame):
                return self._recorded(name, first, each)
            folder = self.folder / name
            folder.mkdir()
            for number, image in enumerate([] if first is None else chain([first], each)):
                self._image(f"{name}/{number:06d}", number, image)
            return str(folder)

    def _recorded(self, name: str, first: Frame, rest: Iterator[Any]) -> str:
        """Return a recording of frames with times of their own, the first so many where there is a limit."""
        from armsight.store.recording import RecordingWriter

        path = self.folder / f"{name}.mcap"
        with RecordingWriter(path) as writer:
            before_s = -np.inf
            for frame in islice(chain([first], rest), self._limit):
                require_kind(f"a frame of {name}", frame, Frame)
                if frame.t_s <= before_s:
                    raise Inconsistent(
                        f"frame {frame.sequence} of {name} is of {frame.t_s:g} s, that before it of {before_s:g} s",
                        consequence="Frames without an order in time cannot be followed",
                        cure="Give each its own t_s, in s, growing",
                    )
                before_s = frame.t_s
                writer.frame(name, frame)
        return f"{path}:{name}"

    def _image(self, name: str, number: int, value: Any) -> Path:
        array = value if getattr(value, "dtype", None) == np.uint16 else as_image(_as_bytes(value), f"image {number}")
        path = self.folder / f"{name}.png"
        cv2.imwrite(str(path), array, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return path

    def _world(self, name: str, value: Any) -> Path:
        path = self.folder / "world.yaml"
        write_world(path, World(parent="base", T_parent_rig=as_poses(value, name)[0]))
        return path


def _as_bytes(value: Any) -> Any:
    return value.astype(np.uint8) * 255 if getattr(value, "dtype", None) == np.bool_ else value


def as_arm(name: str, value: ArmLike) -> Arm:
    """Return an arm, the arm of a file, or the one known by that name. Raises UsageError, BadFile."""
    if isinstance(value, Arm):
        return value
    from armsight.ops.arm_files import load_arm  # with all kinds of files

    return load_arm(as_text(name, value, Arm))


def as_text(name: str, value: object, *more: type) -> str:
    """Return a text; a path is taken as one. Raises UsageError for all else."""
    require_kind(name, value, str, PathLike, *more)
    return str(value)


def as_table(name: str, value: Any) -> str:
    """Return columns by name, (t_s, rows) or rows as CSV: rows (n, m) are joints q1..qm, (n, 4, 4) poses.

    Raises UsageError or Inconsistent for what is none of these.
    """
    if hasattr(value, "keys"):
        columns = {str(key): np.asarray(value[key]) for key in value.keys()}  # noqa: SIM118  a DataFrame too
    else:
        t_s, rows = value if isinstance(value, tuple) and len(value) == 2 else (None, value)
        columns = {} if t_s is None else {"t_s": real_array(f"the times of {name}", t_s)}
        columns |= _columns(name, rows)
    if not columns or {column.shape for column in columns.values()} != {next(iter(columns.values())).shape[:1]}:
        raise UsageError(
            f"the columns of {name} are of different lengths, or none",
            consequence="Nobody knows which belong together",
            cure="Give columns by name, (t_s, q) or (t_s, T), each with one entry a row",
        )
    lines = [",".join(columns)]
    lines += [",".join(map(_cell, row)) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return cells([value]) if isinstance(value, float) else str(value)


def _columns(name: str, rows: Any) -> dict[str, NDArray[Any]]:
    if isinstance(rows, RigidTransform) or _is_list_of_poses(rows) or real_array(name, rows).ndim == 3:
        T = as_poses(rows, name)
        values = np.hstack([T.translation, T.rotation.as_quat(canonical=True)])
        return dict(zip(POSE7, values.T, strict=True))
    q = np.atleast_2d(real_array(name, rows))
    return {f"q{i + 1}": column for i, column in enumerate(q.T)}


def _is_list_of_poses(rows: Any) -> bool:
    return isinstance(rows, list | tuple) and bool(rows) and isinstance(rows[0], RigidTransform)


def path_of(value: Any) -> Path | None:
    """Return the path that a value is; None for an object."""
    return Path(fspath(value)) if isinstance(value, str | PathLike) else None


def record_of(name: str, value: Any, kind: type[J], read: Callable[[Path], J]) -> J:
    """Return a record, or that of a file. Raises UsageError, BadFile."""
    path = path_of(value)
    if path is not None:
        return read(path)
    require_kind(name, value, kind, cure="Give a record or a file")
    return value  # type: ignore[no-any-return]  # of that kind
