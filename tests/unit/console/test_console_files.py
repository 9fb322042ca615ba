"""Files brought to the console, its folder, and one console for each folder."""

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from armsight.app.operator.robot_cell import one_console
from armsight.console.routes import LARGEST_BYTES, add_files
from armsight.console.state import Console
from armsight.errors import DeviceFailed
from armsight.store.cell_file import CellFile, write_cell
from refusals import refuses


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "cell"


def put(folder: Path, name: str, content: bytes) -> int:
    """Return the answer's status to a file that is brought."""
    server = FastAPI()
    add_files(server, Console(folder=folder))

    async def ask() -> int:
        where: Any = httpx.ASGITransport(server)
        async with httpx.AsyncClient(transport=where, base_url="http://here") as client:
            return (await client.put(f"/console/files/{name}", content=content)).status_code

    return asyncio.run(ask())


@pytest.mark.parametrize(
    ("name", "content", "status"),
    [
        ("rig.yaml", b"", 400),
        ("rig.yaml", b" \n\n", 400),
        ("rig.yaml", b"x" * (LARGEST_BYTES + 1), 413),
        ("..%2Frig.yaml", b"x", 405),
        (".hidden.yaml", b"x", 400),
        ("rig.yaml.exe", b"x", 400),
        ("r%00.yaml", b"x", 400),
        ("%E6%BC%A2" * 79 + ".yaml", b"x", 400),
        ("a" * 300 + ".yaml", b"x", 400),
    ],
)
def test_what_is_no_file_of_a_cell_is_refused_and_not_kept(
    folder: Path, name: str, content: bytes, status: int
) -> None:
    assert put(folder, name, content) == status
    assert not folder.exists() or not list(folder.iterdir())


def test_a_file_that_is_there_stays_as_it_is(folder: Path) -> None:
    assert put(folder, "größe.yaml", b"one") == 200
    assert put(folder, "größe.yaml", b"two") == 409
    assert (folder / "größe.yaml").read_bytes() == b"one"


def test_a_folder_that_cannot_be_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with refuses(DeviceFailed, "written"):
        write_cell(tmp_path / "file" / "cell", CellFile())
    with refuses(DeviceFailed, "written"):
        one_console(tmp_path / "file" / "cell")


def test_a_second_console_of_a_folder_is_refused(folder: Path) -> None:
    with one_console(folder), refuses(DeviceFailed, "write over"), one_console(folder):
        raise AssertionError("both serve it")
    with one_console(folder):
        pass
