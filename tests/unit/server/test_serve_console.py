"""`armsight serve --console`: programs and the operator's pages of one robot, with one right to drive."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

import warm_python

START = ["serve", "--robot", "sim:webcam-cell"]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("served") / "cell"
    command = [warm_python.commands() / "armsight", *START, "--port", "0", "--console", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    said = ""
    while "Open http://" not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    yield said.split("Open http://")[1].split()[0]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)


def told(page: ClientConnection) -> dict[str, Any]:
    """Return the robot's next state as the page gets it."""
    message = json.loads(page.recv(timeout=30.0))
    assert isinstance(message, dict)
    return message


def beat(page: ClientConnection, *, enable: bool) -> dict[str, Any]:
    """Give the page's sign of life, and return what it is told then."""
    page.send(json.dumps({"do": "beat", "enable": enable, "seen": told(page)["t"]}))
    return told(page)


def test_pages_and_interface_are_there(address: str) -> None:
    page = httpx.get(f"http://{address}/live", timeout=30.0)
    assert page.status_code == 200 and "data-testid" in page.text
    state = httpx.get(f"http://{address}/api/v1/state", timeout=30.0)
    assert state.status_code == 200 and state.json()["type"] == "state"


def test_a_page_and_a_program_do_not_drive_at_once(address: str) -> None:
    with connect(f"ws://{address}/console/robot", max_queue=None) as page:
        with connect(f"ws://{address}/api/v1/drive", max_queue=None) as program:
            assert "welcome" in str(program.recv(timeout=30.0))
            assert any("drives" in beat(page, enable=True)["refused"] for _ in range(20))
            assert not beat(page, enable=False)["enabled"]
        assert any(beat(page, enable=turn % 2 == 1)["mine"] for turn in range(100)), "the program is gone"
        with connect(f"ws://{address}/api/v1/drive", max_queue=None) as program:
            assert "drives" in str(program.recv(timeout=30.0))
