"""cell.yaml: which cameras, robot and files belong to one cell, relative to the folder it is in."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from armsight.errors import BadFile
from armsight.store.schema import Finite, Origin, read_document, validated, write_document

CELL_FORMAT: Literal["armsight/cell"] = "armsight/cell"
CELL_NAME = "cell.yaml"


class CellFile(Origin):
    """What a cell is made of; an empty text is not there yet.

    left, right: sources of frames, or DRIVER:DEVICE cameras, as commands take them. robot: DRIVER:DEVICE. All others
    are names of files in the cell's folder. fps: of files. play_again: files begin anew at their end.
    cameras: whether they stand beside the robot, or are carried by it.
    """

    format: Literal["armsight/cell"] = CELL_FORMAT
    left: str = ""
    right: str = ""
    robot: str = ""
    rig: str = ""
    target: str = ""
    world: str = ""
    arm: str = ""
    handeye: str = ""
    tip: str = ""
    limits: str = ""
    board: str = "checkerboard:9x6:0.025"
    fps: Finite = Field(30.0, gt=0.0)
    play_again: bool = False
    cameras: Literal["standing", "carried"] = "standing"


def read_cell(folder: Path) -> CellFile:
    """Return the cell of a folder; an empty one where the folder holds none. Raises BadFile, naming the key."""
    path = folder / CELL_NAME
    if not path.exists():
        return CellFile()
    return validated(CellFile, read_document(path, CELL_FORMAT), str(path))


def write_cell(folder: Path, cell: CellFile) -> Path:
    """Write cell.yaml into the folder, which is made where it is missing; return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = cell.model_dump(exclude={"format", "version", "created", "software", "inputs"})
    path = folder / CELL_NAME
    write_document(path, CELL_FORMAT, content, [])
    return path


def cell_path(folder: Path, name: str, what: str) -> Path | None:
    """Return a file of the cell, None where it has none. Raises BadFile where it is named and not there."""
    if not name:
        return None
    path = folder / name
    if not path.is_file():
        raise BadFile(
            f"{path} is not there",
            consequence=f"The cell has no {what}",
            cure=f"Put the file into {folder}, or choose another",
        )
    return path
