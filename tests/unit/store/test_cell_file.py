"""cell.yaml: what belongs to a cell."""

from pathlib import Path

import pytest

from armsight.errors import BadFile
from armsight.store.cell_file import CellFile, cell_path, read_cell, write_cell
from refusals import refuses


def test_a_cell_is_read_as_it_was_written(tmp_path: Path) -> None:
    cell = CellFile(left="camera:0", right="camera:2", rig="rig.yaml", fps=25.0, play_again=True)
    write_cell(tmp_path / "new", cell)
    again = read_cell(tmp_path / "new")
    assert again.model_dump(exclude={"created", "software"}) == cell.model_dump(exclude={"created", "software"})


def test_a_folder_without_one_is_an_empty_cell(tmp_path: Path) -> None:
    assert read_cell(tmp_path) == CellFile()


@pytest.mark.parametrize(
    "text", ["format: armsight/cell\nlefft: x\n", "format: armsight/cell\nfps: 0\n", "format: x\n"]
)
def test_what_is_no_cell_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "cell.yaml").write_text(text)
    with refuses(BadFile, "cell.yaml"):
        read_cell(tmp_path)


def test_a_named_file_must_be_there(tmp_path: Path) -> None:
    assert cell_path(tmp_path, "", "rig") is None
    with pytest.raises(BadFile, match="rig"):
        cell_path(tmp_path, "rig.yaml", "rig")
