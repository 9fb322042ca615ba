"""A server on loopback: who is let in, what is refused and logged, and that a driver who leaves holds the robot."""

import contextlib
import json
import socket
import urllib.error
import urllib.request

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from armsight.drivers.remote import Link, ServerAddress
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound
from armsight.server.application import CROWDED, WATCHERS_PER_ADDRESS
from armsight.server.connections import UNKNOWN_PER_ADDRESS
from armsight.server.limited import QUIET
from armsight.server.serving import background
from armsight.server.web_server import ServeOptions
from armsight.store.tokens import add_token
from refusals import refuses

WAIT_S = 20.0


@pytest.fixture
def url(service):
    with background(service) as url:
        yield url


class Raw:
    """A client that says what it likes; it keeps whatever comes, or it would stop reading, and take long to close."""

    def __init__(self, url, path=say.DRIVE_PATH, **headers):
        given = {"proxy": None, "compression": None, "max_queue": None}
        self.socket = connect(url + path, additional_headers=headers, **given).__enter__()
        self.hello = json.loads(self.socket.recv(timeout=WAIT_S))
        self.seq = 0

    def say(self, kind, **fields):
        self.seq += 1
        text = json.dumps({"type": kind, "session": self.hello["session"], "seq": self.seq, **fields})
        return self.send(text), text

    def send(self, text):
        self.socket.send(text)
        while True:
            answer = json.loads(self.socket.recv(timeout=WAIT_S))
            if "reply_to" in answer and (answer["type"] != "state" or answer["reply_to"] is not None):
                return answer

    def closed(self):
        """Read until the server closes; return the code."""
        with pytest.raises(ConnectionClosed) as caught:
            while True:
                self.socket.recv(timeout=WAIT_S)
        return caught.value.rcvd.code if caught.value.rcvd else None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


def get(url, path, **headers):
    request = urllib.request.Request(url.replace("ws:", "http:") + path, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_state_schema_and_pages(url, host):
    status, text = get(url, say.STATE_PATH)
    assert status == 200
    assert json.loads(text)["q_sent"] == [0.0, 0.0]
    assert say.STATE_PATH in json.loads(get(url, "/openapi.json")[1])["paths"]
    assert json.loads(get(url, "/api/v1/protocol")[1]) == say.protocol_schema()
    page = get(url, "/docs")[1]
    assert "/api/v1/drive" in page
    assert "http" not in page, "the page needs nothing from elsewhere"
    host.ended = True
    assert get(url, say.STATE_PATH)[0] == 503


@pytest.mark.parametrize("how", ["close", "reset"])
def test_a_driver_who_leaves_or_is_cut_holds_the_robot(url, host, how):
    link = Link(ServerAddress(url=url), say.DRIVE_PATH)
    link.open()
    link.ask(say.Heartbeat, enable=True)
    if how == "reset":
        link.cut()
    link.close()
    assert host.heard.wait(WAIT_S), "the loop is told to hold"
    with Raw(url) as next_one:
        assert next_one.hello["role"] == "drive", "another may drive without a restart"


def test_tls(service, certificate, tmp_path):
    cert, key = certificate
    path = tmp_path / "tokens.yaml"
    token = add_token(path, "anna", "drive")
    options = ServeOptions(port=0, tokens=path, tls_cert=cert, tls_key=key)
    with background(service, options) as url:
        assert url.startswith("wss://")
        link = Link(ServerAddress(url=url, token=token, ca_file=cert), say.STREAM_PATH)
        assert link.open().who == "anna@127.0.0.1"
        link.close()
        with refuses(DeviceFailed, "trusted"):
            Link(ServerAddress(url=url, token=token), say.STREAM_PATH).open()


def test_connections_that_say_nothing_are_ended_before_tls_too(service, certificate):
    cert, key = certificate
    with background(service, ServeOptions(port=0, tls_cert=cert, tls_key=key)) as url, contextlib.ExitStack() as stack:
        where = ("127.0.0.1", int(url.rpartition(":")[2]))
        slow = [
            stack.enter_context(socket.create_connection(where, timeout=WAIT_S)) for _ in range(UNKNOWN_PER_ADDRESS + 2)
        ]
        assert [one.recv(1) for one in slow[:2]] == [b"", b""], "the oldest make room, without a word of TLS"


def test_a_watcher_more_finds_room_and_the_busiest_makes_it(url):
    with contextlib.ExitStack() as stack:
        quiet, busy, *others = (stack.enter_context(Raw(url, say.STREAM_PATH)) for _ in range(WATCHERS_PER_ADDRESS))
        for _ in range(int(2 * QUIET)):
            busy.say("read")
        assert stack.enter_context(Raw(url, say.STREAM_PATH)).say("stop")[0]["type"] == "accepted"
        assert busy.closed() == CROWDED
        assert quiet.say("stop")[0]["type"] == "accepted" and others[-1].say("stop")[0]["type"] == "accepted"
        stack.enter_context(Raw(url, say.STREAM_PATH))
        assert [one.say("read")[0]["type"] for one in others].count("state") == len(others), "the oldest quiet one went"


def test_a_server_started_anew_is_told_apart(service, host, log):
    with background(service) as url:
        link = Link(ServerAddress(url=url), say.STREAM_PATH)
        first = link.open().instance
    with pytest.raises(DeviceLost, match="lost"):
        link.ask(say.ReadMessage)
    link.close()
    again = type(service)(host, log)
    with background(again) as url:
        link = Link(ServerAddress(url=url), say.STREAM_PATH)
        assert link.open().instance != first
        link.close()


def test_nobody_answers(url):
    with refuses(DeviceNotFound, "robot server"):
        Link(ServerAddress(url="ws://127.0.0.1:1"), say.STREAM_PATH).open()
    link = Link(ServerAddress(url=url), say.STREAM_PATH)
    link.open()
    link.close()
