"""What tests of the console share: one browser, starting the console as a person does, and a page of it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

CHROMIUM = "/usr/bin/chromium"
PATIENCE_MS = 60_000


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def begin(folder: Path, *more: str) -> tuple[str, subprocess.Popen[bytes]]:
    """Start the console as a person does; return its address."""
    port = free_port()
    command = [sys.executable, "-c", "from armsight.cli import main; main()", "console", "--folder", str(folder)]
    process = subprocess.Popen([*command, "--port", str(port), *more], stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = b""
    while b"Open http://" not in said:
        line = process.stderr.readline()
        assert line, said.decode()
        said += line
    listening(port)
    return f"http://127.0.0.1:{port}", process


def listening(port: int) -> None:
    """Return when somebody answers on a port; fails where nobody comes."""
    pause = threading.Event()
    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        pause.wait(0.05)
    raise AssertionError(f"nobody listens on port {port}")


def end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGINT)
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    finally:
        if process.stderr is not None:
            process.stderr.close()


def opened(browser: Any, address: str, *, width: int = 1400, dark: bool = False) -> Any:
    """Return a page, loaded, that fails the test where its scripts do."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address, wait_until="domcontentloaded")
    page.wait_for_selector("[data-testid=state]")
    return page


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as player:
        made = player.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture(scope="session")
def console() -> SimpleNamespace:
    """How a console is begun (folder, flags -> address, process) and ended, and how a page of it is opened."""
    return SimpleNamespace(begin=begin, end=end, opened=opened)
