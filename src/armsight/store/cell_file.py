"""cell.yaml: which cameras, robot and files belong to one cell, relative to the folder it is in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from armsight.defaults import GLASS, MIRROR_GAP_M, PLATE_NEAR_M
from armsight.errors import BadFile
from armsight.store.codec import Finite, Strict, validated
from armsight.store.schema import Origin, read_document, write_document

CELL_FORMAT: Literal["armsight/cell"] = "armsight/cell"
CELL_NAME = "cell.yaml"
COMPLEX = "complex"
"""The one picture of a mirror rig, which holds both views."""


class CellMirrors(Strict):
    """How the mirrors before the one camera were built, and what is shown to it for their calibration.

    shown: the board, or the target's lights. baseline_m, near_m, gap_m: as designed; null: not given. plate_m:
    thickness of the half-silvered plate, null to find it from the views, 0 for none; index: its refractive index.
    """

    shown: Literal["board", "target"] = "board"
    baseline_m: Finite | None = Field(None, gt=0.0)
    near_m: Finite = Field(PLATE_NEAR_M, gt=0.0)
    gap_m: Finite = Field(MIRROR_GAP_M, gt=0.0)
    plate_m: Finite | None = Field(None, ge=0.0)
    index: Finite = Field(GLASS, ge=1.0, le=3.0)


class CellFile(Origin):
    """What a cell is made of; an empty text is not there yet.

    left, right: sources of frames, or DRIVER:DEVICE cameras, as commands take them; left alone is the one camera of a
    mirror rig, whose mirrors are as `mirrors` says and whose lens as the file `camera`. robot: DRIVER:DEVICE. All
    others are names of files in the cell's folder. fps: of files. play_again: files begin anew at their end.
    cameras: further sources, or all, by their cameras' names, `carried` then says that the robot carries the cameras;
    else whether left and right stand beside the robot or are carried by it.
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
    camera: str = ""
    mirrors: CellMirrors = CellMirrors()
    board: str = "checkerboard:9x6:0.025"
    fps: Finite = Field(30.0, gt=0.0)
    play_again: bool = False
    cameras: Literal["standing", "carried"] | dict[str, str] = "standing"
    carried: bool = False

    @property
    def named(self) -> dict[str, str]:
        """The sources that stand by their cameras' names."""
        return {} if isinstance(self.cameras, str) else self.cameras

    @property
    def sources(self) -> dict[str, str]:
        """All sources, by the names of the pictures: of the cameras, or of a mirror rig's one."""
        if self.left and not self.right and not self.named:
            return {COMPLEX: self.left}
        return {side: text for side, text in (("left", self.left), ("right", self.right)) if text} | self.named

    def changed(self, entries: Mapping[str, Any]) -> CellFile:
        """Return the cell with other entries; who carries the cameras stays, by whichever key it is said."""
        named = entries.get("cameras", self.cameras)
        said: Any = (
            {"carried": self.on_robot}
            if isinstance(named, dict) and named
            else {"cameras": "carried" if self.on_robot else "standing", "carried": False}
        )
        return self.model_copy(update={**entries, **said})

    @property
    def on_robot(self) -> bool:
        """Whether the robot carries the cameras."""
        return self.carried or self.cameras == "carried"


def read_cell(folder: Path) -> CellFile:
    """Return the cell of a folder; an empty one where the folder holds none. Raises BadFile, naming the key."""
    path = folder / CELL_NAME
    if not path.exists():
        return CellFile()
    return validated(CellFile, read_document(path, CELL_FORMAT), str(path))


def write_cell(folder: Path, cell: CellFile) -> Path:
    """Write cell.yaml into the folder, which is made where it is missing; return the file. Raises DeviceFailed."""
    said = set() if cell.named or cell.carried else {"carried"}
    content: dict[str, Any] = cell.model_dump(exclude={"format", "version", "created", "software", "inputs"} | said)
    path = folder / CELL_NAME
    write_document(path, CELL_FORMAT, content, [])
    return path


def cell_path(folder: Path, name: str, what: str) -> Path | None:
    """Return a file of the cell, None where it has none. Raises BadFile where it is named and not there, as within."""
    if not name:
        return None
    path = within(folder, name)
    if not path.is_file():
        raise BadFile(
            f"{path} is not there",
            consequence=f"The cell has no {what}",
            cure=f"Put the file into {folder}, or choose another",
        )
    return path


def within(folder: Path, name: str) -> Path:
    """Return a path in the cell's folder. Raises BadFile for one that leads out of it.

    Whoever may open the cell's pages chooses its files, and is not to read all others of the computer thereby.
    """
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise BadFile(
            f"{name[:80]} is not in {folder}", cure="Copy it into the cell's folder, or put a link to it there"
        )
    return folder / name
