"""The line for stops: who may say what on it, a page too, and whose enable counts."""

import hashlib
import json
import pickle
from types import SimpleNamespace

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from armsight.control.session.channels import LineChannels, granted
from armsight.control.session.operator_session import FRESH_S, OperatorSession, Person
from armsight.control.session.service import Service
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceFailed
from armsight.server.auth import COOKIE, Authenticator, BrowserSessions, Caller, Denied, Identity
from armsight.server.limited import CONNECTION
from armsight.server.messages import Session
from armsight.server.stop_line import StopLine, stop_line
from armsight.server.web_server import ServeOptions
from armsight.store.tokens import add_token

WAIT_S = 20.0
PAGE_PORT = 8080
PAGE = f"http://127.0.0.1:{PAGE_PORT}"
ANN = Person(who="ann")
ROLES = {"ann": "drive", "ben": "drive", "eve": "watch"}


class Page:
    """What a page does on the line."""

    def __init__(self, served, name="eve", **headers):
        known = {"Cookie": served.cookie(name), "Origin": PAGE}
        self.socket = connect(
            f"ws://127.0.0.1:{served.service.stop_port}{say.STOP_PATH}",
            additional_headers={**known, **headers}, proxy=None, compression=None,
        ).__enter__()  # fmt: skip
        self.session, self.seq = json.loads(self.socket.recv(timeout=WAIT_S))["session"], 0

    def say(self, **fields):
        self.seq += 1
        self.socket.send(json.dumps({**fields, "session": self.session, "seq": self.seq}))
        return json.loads(self.socket.recv(timeout=WAIT_S))["type"]


class Served:
    """A line of a loop in memory, and the log-ins of browsers."""

    def __init__(self, service, tokens):
        self.service, self.tokens = service, tokens
        self.sessions = BrowserSessions(service.host.line.sessions)

    def cookie(self, name):
        return f"{COOKIE}={self.sessions.begin(hashlib.sha256(self.tokens[name].encode()).hexdigest())}"

    @property
    def orders(self):
        """What the loop was told since this was last asked."""
        taken = iter(self.service.host.line.orders.get, None)
        return [pickle.loads(data) for data in taken]


@pytest.fixture(scope="module")
def served(fakes, tmp_path_factory):
    file = tmp_path_factory.mktemp("line") / "tokens.yaml"
    tokens = {name: add_token(file, name, role) for name, role in ROLES.items()}
    service = Service(fakes.FakeHost(), fakes.KeptLog())
    with stop_line(service, ServeOptions(port=0, tokens=file), page_port=PAGE_PORT):
        yield Served(service, tokens)


@pytest.fixture
def page(served):
    made = Page(served)
    yield made
    made.socket.close()


def test_a_page_stops_by_its_cookie(served, page):
    assert page.say(type="stop") == "done"
    assert served.orders == [("stop", "stopped by eve")]


@pytest.mark.parametrize("headers", [{"Origin": "http://evil.example"}, {"Cookie": f"{COOKIE}=x"}])
def test_no_foreign_page_and_nobody_without_a_token(served, headers):
    with pytest.raises(InvalidStatus):
        Page(served, **headers)
    assert served.orders == []


@pytest.mark.parametrize("name", ["ben", "eve"])
def test_anothers_key_is_no_right(served, name):
    served.service.host.grant(7, "key", "ann")
    other = Page(served, name)
    assert other.say(type="heartbeat", enable=True, number=1, key="key") == "refused"
    assert other.say(type="heartbeat", enable=False, number=2, key="key") == "refused"
    assert served.orders == []
    other.socket.close()


def test_a_log_out_ends_what_the_line_hears(served):
    page = Page(served, "ann")
    assert page.say(type="stop") == "done" and len(served.orders) == 1
    served.service.host.line.sessions.write(b"{}")
    with pytest.raises(ConnectionClosed):
        page.say(type="stop")
    assert served.orders == []


def test_an_enable_counts_by_the_key_that_is_granted(served):
    page = Page(served, "ann")
    beat = {"type": "heartbeat", "enable": True, "number": 1}
    served.service.host.grant(7, "key", "ann")
    assert page.say(**beat, key="other") == "refused" and page.say(**beat) == "refused"
    assert served.orders == []
    assert page.say(**beat, key="key") == "done"
    assert [(order[0], order[1], *order[3:]) for order in served.orders] == [("beat", (True, 1), 7, "key")]
    served.service.host.grant(7, "")
    assert page.say(**beat, key="key") == "refused" and page.say(**beat, key="") == "refused"


@pytest.mark.parametrize(
    ("origin", "port", "own"),
    [
        ("https://robot.example", 443, True),
        ("http://robot.example", 80, True),
        ("http://robot.example", 443, False),
        ("https://robot.example", 8080, False),
        ("https://robot.example:8080", 8080, True),
        ("https://evil.example", 443, False),
    ],
)
def test_pages_of_a_port_that_browsers_leave_away(tmp_path, origin, port, own):
    token = add_token(tmp_path / "tokens.yaml", "ann", "drive")
    door = Authenticator(tmp_path / "tokens.yaml", page_port=port)
    found = door.check(
        Caller(address="192.0.2.1", authorization=f"Bearer {token}", host="robot.example:444", origin=origin)
    )
    assert isinstance(found, Denied) is not own


def test_a_pages_enable_counts_on_the_line_only_while_it_does_on_the_page(service, host):
    session, line = OperatorSession(service), host.line.grant

    def beat(enable, age_s=0.0):
        session.beat("a", ANN, enable=enable, seen_s=host.t_s - age_s, number=1, key="key")

    beat(True)
    assert granted(line) == (1, "key", "ann")
    beat(False)
    assert granted(line)[:2] == (1, ""), "let go of"
    beat(True)
    session.stop(Person(who="eve"))
    assert granted(line)[:2] == (1, ""), "stopped"
    beat(True)
    session.reset("a", ANN)
    assert granted(line)[:2] == (1, ""), "reset while it is held on"
    with pytest.raises(DeviceFailed):
        beat(True)
    assert granted(line)[:2] == (1, "")
    beat(False)
    beat(True)
    with pytest.raises(DeviceFailed):
        beat(True, age_s=2.0 * FRESH_S)
    assert granted(line)[:2] == (1, ""), "out of a buffer"
    beat(False)
    beat(True)
    session.leave("a")
    assert granted(line)[:2] == (1, ""), "gone"


def test_nobody_is_granted_before_anybody_was():
    assert granted(LineChannels().grant) == (0, "", "")


def test_who_drives_does_not_make_room_on_the_line():
    kept = []
    connection = SimpleNamespace(transport=None, guarded=SimpleNamespace(known=lambda *_, keep: kept.append(keep)))
    channels, session = LineChannels(), Session("stop")
    channels.grant.write(json.dumps([1, "key", "ann"]).encode())
    line, socket = StopLine(channels, Authenticator()), SimpleNamespace(scope={"state": {CONNECTION: connection}})
    for seq, said in enumerate(({"type": "stop"}, {"type": "heartbeat", "enable": True, "key": "key"}), start=1):
        text = json.dumps({**said, "session": session.nonce, "seq": seq})
        told = line._answer(socket, session, Identity(who="ann", role="drive"), {"text": text})
        assert told.type == "done"
    assert kept == [True], "by its enable alone"
