"""`armsight serve --console`: programs and the operator's pages of one robot, with one right to drive."""

import signal
import subprocess
from collections.abc import Iterator

import httpx
import pytest

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


def test_pages_and_interface_are_there(address: str) -> None:
    page = httpx.get(f"http://{address}/live", timeout=30.0)
    assert page.status_code == 200 and "data-testid" in page.text
    state = httpx.get(f"http://{address}/api/v1/state", timeout=30.0)
    assert state.status_code == 200 and state.json()["type"] == "state"
