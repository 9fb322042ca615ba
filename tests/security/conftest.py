"""What these tests share with the server's: a loop and a log in memory, tokens, a certificate; and raw sockets."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armsight.server.auth import Authenticator
from armsight.store.tokens import add_token, read_tokens
from loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 20.0

_server = module_of(ROOT / "tests/unit/server/conftest.py")
certificate, host, log, service = _server.certificate, _server.host, _server.log, _server.service


class Tokens:
    """A file with one token for each role: `drive` of ann, `watch` of eve."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.drive, self.watch = add_token(file, "ann", "drive"), add_token(file, "eve", "watch")
        self.auth = Authenticator(read_tokens(file))


@pytest.fixture
def tokens(tmp_path: Path) -> Tokens:
    return Tokens(tmp_path / "tokens.yaml")


@pytest.fixture
def said() -> Callable[[str, bytes], bytes]:
    """Return what a server at ws://HOST:PORT answers to bytes that are sent to it, up to its end or the answer's."""

    def say(url: str, request: bytes) -> bytes:
        where, _, port = url.rpartition("//")[2].rpartition(":")
        with socket.create_connection((where, int(port)), timeout=WAIT_S) as line:
            line.sendall(request)
            answer = b""
            while b"\r\n\r\n" not in answer:
                more = line.recv(65536)
                if not more:
                    break
                answer += more
            return answer

    return say


@contextmanager
def _running(server: Any, listener: socket.socket) -> Iterator[None]:
    """Run a web server in a thread while the block runs."""
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="session")
def fakes() -> Any:
    """The loop and log in memory, for those who make a server of their own; and what runs one."""
    return SimpleNamespace(FakeHost=_server.FakeHost, KeptLog=_server.KeptLog, running=_running)
