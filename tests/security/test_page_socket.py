"""NiceGUI's own socket as a page, or somebody in its place, speaks on it: wrong types, other pages, other roles."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from nicegui import Client, core
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from armsight.console import application
from armsight.console.page_socket import MESSAGES, VIOLATIONS

WAIT_S = 20.0
QUERY = {"EIO": "4", "transport": "websocket", "implicit_handshake": "true", "tab_id": "t", "document_id": "d"}


def page_of(served: Any, path: str, token: str) -> Client:
    """Open a page and return it as the server has it."""
    known = set(Client.instances)
    httpx.get(served.at + path, headers={"authorization": f"Bearer {token}"}, timeout=WAIT_S)
    (made,) = set(Client.instances) - known
    return Client.instances[made]


@contextmanager
def opened(served: Any, token: str, **query: str) -> Iterator[ClientConnection]:
    """Open NiceGUI's socket, as its script does; query: more of its address, or other."""
    words = "&".join(f"{key}={value}" for key, value in {**QUERY, "next_message_id": "0", **query}.items())
    address = f"{served.socket}/_nicegui_ws/socket.io/?{words}"
    with connect(address, additional_headers={"authorization": f"Bearer {token}"}, proxy=None) as line:
        yield line


@contextmanager
def spoken(served: Any, page: Client, token: str) -> Iterator[ClientConnection]:
    """Open the socket of a page, up to where it speaks."""
    with opened(served, token, client_id=page.id) as line:
        assert str(line.recv(timeout=WAIT_S)).startswith("0{")
        line.send("40")
        assert str(line.recv(timeout=WAIT_S)).startswith("40{")
        yield line


def done(line: ClientConnection, page: Client) -> None:
    """Wait until all that was said is done: what is asked last is answered then."""
    line.send(said("handshake", page, **GOOD["handshake"]).replace("42", "427", 1))
    while not str(line.recv(timeout=WAIT_S)).startswith("437"):
        pass


def until_closed(line: ClientConnection) -> None:
    with pytest.raises(ConnectionClosed):
        while True:
            line.recv(timeout=WAIT_S)


def said(kind: str, page: Client, **fields: Any) -> str:
    return "42" + json.dumps([kind, {"client_id": page.id, **fields}])


def test_these_are_all_events_that_nicegui_hears() -> None:
    assert set(core.sio.handlers["/"]) == {*MESSAGES, "connect", "disconnect"}


GOOD: dict[str, dict[str, Any]] = {
    "event": {"id": 0, "listener_id": "x", "args": ["1"]},
    "javascript_response": {"request_id": "x", "result": {"a": 1}},
    "ack": {"next_message_id": 0},
    "log": {"level": "info", "message": "hello"},
    "handshake": {"tab_id": "t", "document_id": "d", "next_message_id": 0},
}
OPTIONAL = ("handshake", "next_message_id")
ODD_VALUES: list[Any] = [None, True, -7, 1.5, 10**400, "x" * 300, "²", [], {}, [[]]]


def odd_packets(page: Client) -> Iterator[str]:
    """Every message with each of its fields of every wrong type, or without it; and packets that are none."""
    yield from (
        "",
        "x",
        "0",
        "2probe",
        "5",
        "6",
        "9",
        "4",
        "4x",
        "43",
        "44",
        "45-[]",
        "46",
        "42",
        "42x",
        "42{}",
        "42[]",
    )
    yield from (
        "42[1]",
        '42[["event"]]',
        "42" + "[" * 900,
        "42/other,[]",
        "42²[]",
        '42["disconnect",{}]',
        '42["connect",{}]',
    )
    yield from (f'42{"9" * 99}["ack",{{}}]', '42["event"]', '42["event",null]', '42["event",{},{}]', '421-["event",{}]')
    for kind, fields in GOOD.items():
        yield from (said(kind, page, client_id=value) for value in ODD_VALUES)
        for key in fields:
            if key not in ("args", "result") and (kind, key) != OPTIONAL:
                yield "42" + json.dumps([kind, {"client_id": page.id, **{k: v for k, v in fields.items() if k != key}}])
            if key != "result":
                yield from (
                    said(kind, page, **{**fields, key: value})
                    for value in ODD_VALUES
                    if fits(key, value) and (value is not None or (kind, key) != OPTIONAL)
                )
    yield from (
        said("event", page, **{**GOOD["event"], "args": args}) for args in (["{"], [1], [{}], ["NaN"], ["1"] * 50)
    )


def fits(key: str, value: Any) -> bool:
    """Whether a value is wrong for a key: short texts, whatever is in them, are names."""
    return not (key == "message" or (key == "args" and value == []) or (key.endswith("_id") and value == "\u00b2"))


@pytest.fixture
def packets(served: Any, caplog: pytest.LogCaptureFixture) -> Iterator[Any]:
    """Return what is said by odd packets: how many were noted, and what the packages logged."""

    def speak(*texts: str) -> tuple[int, list[str]]:
        served.host.t_s += 60.0  # of a flood of warnings only some are kept
        served.log.events.clear()
        page = page_of(served, "/settings", served.drive)
        with spoken(served, page, served.drive) as line:
            for text in texts:
                line.send(text.replace("PAGE", page.id))
            if len(texts) >= VIOLATIONS:
                until_closed(line)
        errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
        return sum("refused" in message for _, message in served.log.events), errors

    yield speak


def test_what_is_no_message_is_told_does_nothing_and_ends_the_connection(served: Any, packets: Any) -> None:
    page = page_of(served, "/settings", served.drive)
    odd = [text.replace(page.id, "PAGE") for text in odd_packets(page)]
    before = list(served.host.told)
    for first in range(0, len(odd), VIOLATIONS):
        some = (odd[first:] + odd)[:VIOLATIONS]
        assert packets(*some) == (VIOLATIONS, []), some
    assert served.host.told == before


@pytest.mark.parametrize("kind", GOOD)
def test_what_is_a_message_is_heard(served: Any, packets: Any, kind: str) -> None:
    assert packets("42" + json.dumps([kind, {"client_id": "PAGE", **GOOD[kind]}])) == (0, [])


@pytest.mark.parametrize(
    "query",
    [{"client_id": "none"}, {"tab_id": "x" * 200}, {"client_id": "OTHERS"}, {"sid": "x"}, {"transport": "polling"},
     {"EIO": "3"}, {"document_id": ""}],
)  # fmt: skip
def test_a_socket_is_opened_for_a_page_of_ones_own_alone(served: Any, query: dict[str, str]) -> None:
    mine, others = page_of(served, "/live", served.watch), page_of(served, "/settings", served.drive)
    query = {"client_id": mine.id, **{key: value.replace("OTHERS", others.id) for key, value in query.items()}}
    if query.get("document_id") == "":
        query["document_id"] = "a&document_id=b"
    with pytest.raises(InvalidStatus), opened(served, served.watch, **query):
        pass


def test_no_connection_is_named_by_an_address(served: Any) -> None:
    for method, query in (("GET", "EIO=4&transport=polling"), ("POST", "EIO=4&transport=polling&sid=x")):
        answer = httpx.request(
            method, f"{served.at}/_nicegui_ws/socket.io/?{query}", headers={"authorization": f"Bearer {served.drive}"}
        )
        assert answer.status_code == 404


@pytest.mark.parametrize("name", sorted(application.PAGES))
def test_odd_values_for_elements_write_no_tracebacks(served: Any, caplog: pytest.LogCaptureFixture, name: str) -> None:
    """Fields hold whatever comes and are checked where they are used; nothing else takes a value."""
    page = page_of(served, f"/{name}", served.drive)
    pairs = [(element, one) for element in page.elements.values() for one in element._event_listeners.values()]
    odd = ["null", "true", "1e3", '"x"', "[]", '[{"a": []}]', "{}", '{"value": {"value": []}}', "-1", "1e308"]
    with spoken(served, page, served.drive) as line:
        for value in odd:
            for element, listener in pairs:
                if element.tag not in ("button", "a"):
                    line.send(said("event", page, id=element.id, listener_id=listener.id, args=[value]))
        done(line, page)
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_a_page_ends_with_what_it_was_opened_by(served: Any) -> None:
    cookie = httpx.post(f"{served.at}/login", data={"token": served.drive}, timeout=WAIT_S).headers["set-cookie"]
    known, cookie = set(Client.instances), cookie.split(";")[0]
    httpx.get(f"{served.at}/live", headers={"cookie": cookie}, timeout=WAIT_S)
    (page,) = set(Client.instances) - known
    words = "&".join(f"{key}={value}" for key, value in {**QUERY, "client_id": page, "next_message_id": "0"}.items())
    address = f"{served.socket}/_nicegui_ws/socket.io/?{words}"
    with connect(address, additional_headers={"cookie": cookie}, proxy=None) as line:
        line.send("40")
        httpx.post(f"{served.at}/logout", headers={"cookie": cookie}, timeout=WAIT_S)
        line.send(f'42["ack",{{"client_id":"{page}","next_message_id":0}}]')
        until_closed(line)
