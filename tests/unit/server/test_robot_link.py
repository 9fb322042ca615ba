"""The robot's connection of a page: whatever a browser says, nothing is raised and nothing moves without the enable."""

import asyncio
import json
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armsight.console import robot_link
from armsight.console.robot_link import RobotLink
from armsight.console.routes import IDENTITY
from armsight.control.session.operator_session import OperatorSession, Person

NOW = 100.0
KEY = {"frame": "joints", "axis": 0, "sense": "1"}
BEAT = {"do": "beat", "enable": True, "push": KEY, "seen": NOW}
OVERRIDE = {"do": "override", "share": 0.5}


class Visit:
    """Somebody who came in; their role may change."""

    def __init__(self, who, role):
        self.who, self.role = who, role


@pytest.fixture
def link(service):
    made = RobotLink(OperatorSession(service), SimpleNamespace(scope={}), {})
    made.state()
    return made


def moved(host):
    """Return whether the robot was asked to move, or told that it may."""
    return any(what[0] in ("post", "reset") or what == ("beat", True) for what in host.told)


def test_messages_do_what_they_say(link, host):
    for said in (BEAT, OVERRIDE, {"do": "stop"}, {"do": "reset"}, {"do": "beat", "enable": False}):
        link.take(json.dumps(said))
        assert link.state()["refused"] == ""
    assert [what[0] for what in host.told] == ["beat", "post", "stop", "reset", "beat"]
    for share, kept in ((0, 0.01), (1, 1.0)):
        link.take(json.dumps({**OVERRIDE, "share": share}))
        assert link.state()["override"] == kept


def test_letting_go_counts_whatever_was_seen(link, host):
    link.take(json.dumps(BEAT))
    link.take(json.dumps({"do": "beat", "enable": False, "seen": NOW + 1.0}))
    assert ("beat", False) in host.told
    assert not link.state()["enabled"]


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(), max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
LIKELY = VALUES | st.sampled_from([True, False, "joints", "base", "tool", 0, 1, -1, "²", NOW, 0.5, KEY])
NEARLY = st.fixed_dictionaries(
    {"do": st.sampled_from(["beat", "stop", "reset", "override"]) | VALUES},
    optional=dict.fromkeys(("enable", "push", "seen", "share", "axis"), LIKELY),
)
SAID = st.text(max_size=60) | (VALUES | NEARLY).map(json.dumps)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(said=SAID)
def test_whatever_is_said_nothing_is_raised_and_nothing_moves_without_the_enable(service, host, said):
    host.told.clear()
    host.t_s += 20.0  # whoever drove before is silent for long
    link = RobotLink(OperatorSession(service), SimpleNamespace(scope={}), {})
    link.state()
    link.take(said)
    assert 0.01 <= link.state()["override"] <= 1.0
    if moved(host):
        asked = json.loads(said)
        assert asked["do"] == "reset" or (asked["do"] == "beat" and asked["enable"] is True and asked["seen"] >= NOW)
    link.take('{"do": "stop"}')
    link._give_up()


def test_bytes_and_a_page_that_goes_end_nothing_but_the_connection(service, host):
    frames = [{"bytes": b"\xff", "text": None}, {"bytes": b""}, {"text": json.dumps({"do": "stop"})}]
    said = [{"type": "websocket.receive", **frame} for frame in frames] + [{"type": "websocket.disconnect"}]
    sent = []

    async def receive():
        await asyncio.sleep(0)
        return said.pop(0)

    async def send_text(text):
        sent.append(json.loads(text))

    socket = SimpleNamespace(scope={}, receive=receive, send_text=send_text)
    asyncio.run(RobotLink(OperatorSession(service), socket, {}).serve())
    assert ("stop", "stopped by operator") in host.told and sent


EVE, ANN, BEN = Visit("eve", "watch"), Visit("ann", "drive"), Visit("ben", "drive")


@pytest.fixture
def pages(monkeypatch):
    """The pages that are open, by name, with who opened them."""
    opened = {"anns": ANN, "bens": BEN, "eves": EVE}
    found = {name: Person(who=visit.who, role=visit.role) for name, visit in opened.items()}
    monkeypatch.setattr(robot_link, "opener_of", found.get)
    return found


def joined(session, links, visit, page):
    made = RobotLink(session, SimpleNamespace(scope={IDENTITY: visit}), links)
    made.state()
    made.take(json.dumps({"do": "page", "page": page}))
    return made


def test_a_connection_that_broke_gives_way_to_the_pages_next_one(service, host, pages):
    session, links = OperatorSession(service), {}
    first = joined(session, links, ANN, "anns")
    first.take(json.dumps({**BEAT, "enable": False}))
    second = joined(session, links, ANN, "anns")
    second.take(json.dumps(BEAT))
    first._give_up()  # its end is seen late
    assert session.enabled("anns") and links == {"anns": second}
    second._give_up()
    assert not session.enabled("anns") and links == {}


@pytest.mark.parametrize("said", [BEAT, {**BEAT, "push": None}, {"do": "reset"}, OVERRIDE, {"do": "stop"}])
def test_who_was_logged_out_says_nothing_more(service, host, pages, said):
    visit = Visit("ann", "drive")
    link = joined(OperatorSession(service), {}, visit, "anns")
    link.take(json.dumps(BEAT))
    host.told.clear()
    visit.role = "none"
    link.take(json.dumps(said))
    assert host.told == [] and "has ended" in link.state()["refused"] and not link.state()["drives"]


def test_a_connection_ends_with_what_it_was_opened_by(service, host, pages):
    visit, sent, closed = Visit("ann", "drive"), [], []

    async def send_text(text):
        sent.append(json.loads(text))
        visit.role = "none"

    async def close(code, reason):
        closed.append(code)

    socket = SimpleNamespace(scope={IDENTITY: visit}, send_text=send_text, close=close)
    link = RobotLink(OperatorSession(service), socket, {})
    link.state()
    link.take(json.dumps(BEAT))
    asyncio.run(link._send_states())
    assert len(sent) == 1 and closed == [1008]
    assert [what[0] for what in host.told] == ["beat", "post", "stop", "release"], "it was held"
