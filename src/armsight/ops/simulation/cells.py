"""Simulated cells, reached by name."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, cast

import cv2

from armsight.drivers import CELLS, Skew, load
from armsight.errors import DeviceFailed, UsageError
from armsight.ops.arm_files import refuse_file_called
from armsight.records import Frame
from armsight.store import rig_from_mapping, target_from_mapping, write_rig, write_target, write_text
from armsight.store.covariances import POSE_COLUMNS
from armsight.store.tables import cells, number
from armsight.store.yamls import dump_yaml

SIDES = ("left", "right")

PNG = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP)
"""Of OpenCV's filters the smallest and quickest for noisy frames: half the time of its adaptive choice both ways."""


PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Endings that tell a picture's path from a room's name."""


class Cell(Protocol):
    """What a simulated cell offers (entry points armsight.cells: (seed, frames) -> Cell)."""

    name: str
    rig: Mapping[str, Any]
    target: Mapping[str, Any]
    fps: float
    truth: Sequence[Any]
    assumptions: Sequence[str]

    def frames(self) -> Iterator[tuple[Frame, Frame]]:
        """Yield the pairs."""
        ...


def load_cell(name: str, *, seed: int, frames: int, room: str | None = None, zoom: float | None = None) -> Cell:
    """Return the cell registered under a name; DeviceNotFound, with the known names, where there is none.

    room: instead of the cell's own, see room_choice; UsageError for one that is unknown.
    zoom: zoom lenses before the cameras, at this setting; UsageError for a cell that knows none.
    """
    make = load(CELLS, name)
    refuse_file_called(name, "a simulated cell")
    chosen: dict[str, Any] = {} if room is None else {"room": room_choice(room)}
    if zoom is not None:
        if "zoom" not in inspect.signature(make).parameters:
            raise UsageError(
                f"the cell {name} has no zoom lenses", cure="hand-cell and board-cell have; or leave it away"
            )
        chosen["zoom"] = zoom
    return cast(Cell, make(seed=seed, frames=frames, **chosen))


def room_choice(room: str) -> Any:
    """Return a room as a scenario's key takes it: the name of one, or a picture by its path."""
    return {"picture": room} if Path(room).suffix.lower() in PICTURES else room


class CellPairs:
    """A cell as a source of pairs; with a folder, each frame is also written there as PNG."""

    skew: Skew | None = None

    def __init__(self, cell: Cell, total: int, *, folder: Path | None = None) -> None:
        self._cell = cell
        self._folder = folder
        self.name = cell.name
        self.total: int | None = total

    def __enter__(self) -> Self:
        if self._folder is not None:
            for side in SIDES:
                (self._folder / side).mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        for index, pair in enumerate(self._cell.frames()):
            if self._folder is not None:
                for side, frame in zip(SIDES, pair, strict=True):
                    write_png(self._folder / side / f"{index:06d}.png", frame)
            yield pair


def write_cell_files(cell: Cell, folder: Path, *, seed: int, frames: int, kept: int | None = None) -> None:
    """Write rig.yaml, target.yaml, times.csv, truth.csv and scenario.yaml of a cell; kept: of its first frames only."""
    truth = list(cell.truth)[:kept]
    write_rig(folder / "rig.yaml", rig_from_mapping(cell.rig, f"{cell.name}'s rig"))
    write_target(folder / "target.yaml", target_from_mapping(cell.target, f"{cell.name}'s target"))
    rows = [f"{number(t_s)},{cells(xyz_m)},{cells(quat_xyzw)},,,,,,,ok," for t_s, xyz_m, quat_xyzw in truth]
    write_text(folder / "truth.csv", "\n".join([",".join(POSE_COLUMNS), *rows]) + "\n")
    write_text(folder / "times.csv", "\n".join(["t_s", *(number(t_s) for t_s, _, _ in truth)]) + "\n")
    scenario = {
        "format": "armsight/scenario",
        "version": 1,
        "name": cell.name,
        "seed": seed,
        "frames": frames,
        "fps": cell.fps,
        "assumptions": list(cell.assumptions),
    }
    write_text(folder / "scenario.yaml", dump_yaml(scenario))


def write_png(path: Path, frame: Frame) -> None:
    """Write a frame, of any name; DeviceFailed where the disk refuses, and no half of it is left."""
    _, content = cv2.imencode(".png", frame.image, PNG)
    try:
        path.write_bytes(content.tobytes())
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        raise DeviceFailed(
            f"{path}: cannot be written ({error.strerror or error})",
            consequence="Frames end before this one",
            cure="Check the folder, its permissions and the free space, or choose another place",
        ) from error
