"""cell.yaml: what belongs to a cell."""

from pathlib import Path

import pytest

from armsight.errors import BadFile
from armsight.store.cell_file import CellFile, read_cell, write_cell
from refusals import refuses


def test_a_cell_is_read_as_it_was_written(tmp_path: Path) -> None:
    cell = CellFile(left="camera:0", right="camera:2", rig="rig.yaml", fps=25.0, play_again=True)
    write_cell(tmp_path / "new", cell)
    again = read_cell(tmp_path / "new")
    assert again.model_dump(exclude={"created", "software"}) == cell.model_dump(exclude={"created", "software"})


def test_cameras_by_name_are_read_as_written_and_files_of_two_stay_as_they_were(tmp_path: Path) -> None:
    four = CellFile(left="camera:0", cameras={"top": "camera:2", "back": "b.mp4"}, carried=True)
    assert read_cell(write_cell(tmp_path, four).parent).cameras == four.cameras
    assert read_cell(tmp_path).on_robot and list(four.sources) == ["left", "top", "back"]
    pair = CellFile(left="camera:0", right="camera:2", cameras="carried")
    text = write_cell(tmp_path, pair).read_text()
    assert "\ncameras: carried\ncreated: " in text and "\ncarried: " not in text
    assert list(pair.sources) == ["left", "right"] and list(CellFile(left="camera:0").sources) == ["complex"]
    named = pair.changed({"cameras": {"top": "camera:4"}})
    assert named.on_robot and named.carried and named.changed({"cameras": {}}).cameras == "carried"
    (tmp_path / "cell.yaml").write_text("format: armsight/cell\nversion: 1\ncameras: {top: 3}\n")
    with refuses(BadFile, "cameras"):
        read_cell(tmp_path)


@pytest.mark.parametrize(
    "text", ["format: armsight/cell\nlefft: x\n", "format: armsight/cell\nfps: 0\n", "format: x\n"]
)
def test_what_is_no_cell_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "cell.yaml").write_text(text)
    with refuses(BadFile, "cell.yaml"):
        read_cell(tmp_path)
