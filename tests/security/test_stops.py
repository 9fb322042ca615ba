"""A stop with a right token passes, by every way and in every state of every limiter."""

from __future__ import annotations

import json
import pickle
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceLost
from armsight.server import stop_line
from armsight.server.application import WATCHERS_PER_ADDRESS
from armsight.server.auth import FAILURES
from armsight.server.connections import PER_ADDRESS, UNKNOWN_PER_ADDRESS
from armsight.server.messages import VIOLATIONS

WAIT_S = 30.0


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


def opened(stack: ExitStack, url: str, headers: dict[str, str]) -> tuple[ClientConnection, dict[str, Any]]:
    """Open a WebSocket; return it with the first that it is told."""
    line = stack.enter_context(connect(url, additional_headers=headers, proxy=None, compression=None, max_queue=None))
    return line, json.loads(line.recv(timeout=WAIT_S))


def said_on(url: str, page: bool = False) -> Callable[[Any, ExitStack, dict[str, str]], None]:
    def stop(served: Any, stack: ExitStack, headers: dict[str, str]) -> None:
        line, hello = opened(stack, url.format(**vars(served)), headers)
        said = {"do": "stop"} if page else {"type": "stop", "session": hello["session"], "seq": 1}
        line.send(json.dumps(said))
        while not stopped(served):
            line.recv(timeout=WAIT_S)

    return stop


def posted(url: str) -> Callable[[Any, ExitStack, dict[str, str]], None]:
    def stop(served: Any, _: ExitStack, headers: dict[str, str]) -> None:
        where = url.format(at=served.at, line=served.line.replace("ws", "http", 1))
        assert httpx.post(where, headers=headers, timeout=WAIT_S).status_code == 204
        assert stopped(served)

    return stop


WAYS = {
    "stream": said_on("{socket}" + say.STREAM_PATH),
    "drive": said_on("{socket}" + say.DRIVE_PATH),
    "line": said_on("{line}" + say.STOP_PATH),
    "page": said_on("{socket}/console/robot", page=True),
    "line, posted": posted("{line}" + say.STOP_PATH),
    "page, posted": posted("{at}/console/stop"),
}


def stopped(served: Any) -> bool:
    """Whether the loop was told to stop since this was last asked."""
    orders = [pickle.loads(data)[0] for data in iter(served.host.line.orders.get, None)]
    told = [what[0] for what in served.host.told]
    served.host.told.clear()
    return "stop" in (*orders, *told)


def with_wrong_tokens(served: Any, *_: object) -> None:
    for k in range(FAILURES + 1):
        codes = [
            httpx.get(f"{served.at}{say.STATE_PATH}", headers=bearer(f"guess{k}")).status_code,
            httpx.post(served.line.replace("ws", "http") + say.STOP_PATH, headers=bearer(f"guess{k}")).status_code,
        ]
    assert codes == [429, 429], "wrong ones stay limited"


def with_all_connections(served: Any, stack: ExitStack, way: str) -> None:
    ask = f"GET /nothing HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {served.watch}\r\n\r\n".encode()
    for _ in range(PER_ADDRESS):
        line = stack.enter_context(silent(served, way))
        line.sendall(ask)
        assert line.recv(12)


def with_silent_connections(served: Any, stack: ExitStack, way: str) -> None:
    for _ in range(2 * UNKNOWN_PER_ADDRESS):
        stack.enter_context(silent(served, way))


def silent(served: Any, way: str) -> socket.socket:
    """Return a connection to the server that a way of stopping goes to."""
    host, _, port = (served.line if way.startswith("line") else served.socket).rpartition("//")[2].partition(":")
    return socket.create_connection((host, int(port)), timeout=WAIT_S)


def with_watchers(served: Any, stack: ExitStack, _: str) -> None:
    for _ in range(WATCHERS_PER_ADDRESS):
        opened(stack, served.socket + say.STREAM_PATH, bearer(served.watch))


def with_warnings(served: Any, *_: object) -> None:
    for k in range(1000):
        served.service.authority.note("warning", f"{k}")


def with_orders(served: Any, *_: object) -> None:
    line = stop_line.StopLine(served.host.line, served.line_auth)
    with pytest.raises(DeviceLost):
        for _ in range(10_000):
            line._order("beat", (True, None), 0.0, 1, "key")


STATES = {
    "nothing else": lambda *_: None,
    "wrong tokens": with_wrong_tokens,
    "all connections of the address": with_all_connections,
    "silent connections": with_silent_connections,
    "watchers": with_watchers,
    "a flood of warnings": with_warnings,
    "orders that the loop has not taken": with_orders,
}


@pytest.fixture
def at_rest(served: Any) -> Iterator[Any]:
    served.auth._failed.clear()
    served.line_auth._failed.clear()
    stopped(served)
    yield served
    served.auth._failed.clear()
    served.line_auth._failed.clear()


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("way", WAYS)
def test_a_stop_with_a_right_token_passes(at_rest: Any, way: str, state: str) -> None:
    served = at_rest
    token = served.drive if way == "drive" else served.watch
    with ExitStack() as stack:
        STATES[state](served, stack, way)
        WAYS[way](served, stack, bearer(token))


@pytest.mark.parametrize("way", ["page", "page, posted"])
def test_a_stop_of_a_browser_that_logged_in_passes_beside_wrong_tokens(at_rest: Any, way: str) -> None:
    answer = httpx.post(f"{at_rest.at}/login", data={"token": at_rest.watch}, timeout=WAIT_S)
    with ExitStack() as stack:
        with_wrong_tokens(at_rest, stack)
        WAYS[way](at_rest, stack, {"cookie": answer.headers["set-cookie"].split(";")[0]})


@pytest.mark.parametrize(("where", "path"), [("socket", say.STREAM_PATH), ("line", say.STOP_PATH)])
def test_a_stop_passes_before_the_last_message_against_the_rules(at_rest: Any, where: str, path: str) -> None:
    with ExitStack() as stack:
        line, hello = opened(stack, getattr(at_rest, where) + path, bearer(at_rest.watch))
        for text in ["{}"] * (VIOLATIONS - 1):
            line.send(text)
        line.send(json.dumps({"type": "stop", "session": hello["session"], "seq": 1}))
        while not stopped(at_rest):
            line.recv(timeout=WAIT_S)
