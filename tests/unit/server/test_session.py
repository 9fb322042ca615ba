"""Which messages of a connection are taken."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent
from armsight.server.messages import VIOLATIONS, Session
from refusals import refuses


def text(session, seq, kind="joint_step", **fields):
    if kind == "joint_step" and not fields:
        fields = {"step": [0.1, 0.2]}
    return json.dumps({"type": kind, "session": session.nonce, "seq": seq, **fields})


def test_messages_in_order_are_taken():
    session = Session("drive")
    assert session.admit(text(session, 1)).step == [0.1, 0.2]
    assert session.admit(text(session, 7)).seq == 7
    assert session.violations == 0


def test_replayed_messages_are_refused():
    session, other = Session("drive"), Session("drive")
    first = text(session, 5)
    session.admit(first)
    for again in (first, text(session, 4)):
        with pytest.raises(Inconsistent, match="replay"):
            session.admit(again)
    with refuses(Inconsistent, "another connection"):
        other.admit(first)
    assert session.violations == 2


def test_a_refused_message_does_not_use_up_its_number():
    session = Session("drive")
    with pytest.raises(Inconsistent):
        session.admit(text(session, 3, step=[]))
    assert session.admit(text(session, 3)).seq == 3


@pytest.mark.parametrize(
    "fields",
    [{"step": [float("nan")]}, {"step": [float("inf")]}, {"step": [1e9]}, {"step": ["0.1"]}, {"step": [True]},
     {"step": [0.1] * 17}, {"step": 0.1}, {"step": None}, {"step": [0.1], "more": 1}, {"q": [0.1]}],
    ids=str,
)  # fmt: skip
def test_wrong_values_are_refused(fields):
    session = Session("drive")
    with pytest.raises(Inconsistent):
        session.admit(text(session, 1, **fields))


@pytest.mark.parametrize("seq", [0, -1, 1.5, "1", None, True, 2**53])
def test_wrong_numbers_are_refused(seq):
    session = Session("drive")
    with pytest.raises(Inconsistent):
        session.admit(text(session, seq))


def test_oversized_messages_are_refused():
    session = Session("drive")
    fits = text(session, 1).ljust(say.MAX_BYTES)
    with pytest.raises(Inconsistent, match="longer"):
        session.admit(fits + " ")
    assert session.admit(fits).seq == 1


def test_a_connection_that_breaks_the_rules_is_spent():
    session = Session("drive")
    for _ in range(VIOLATIONS):
        assert not session.spent
        with pytest.raises(Inconsistent):
            session.admit("{")
    assert session.spent


KINDS = ["heartbeat", "joint_step", "joint_goal", "stop", "flange_pose", "tool_twist", "read", "fly"]
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
NEARLY = st.fixed_dictionaries(
    {"type": st.sampled_from(KINDS), "session": st.just("?") | st.text(max_size=4), "seq": st.integers() | JSON},
    optional={"step": JSON, "q": JSON, "enable": JSON, "T_base_flange": JSON, "velocity_m_s": JSON},
)


@settings(max_examples=60, deadline=None)
@given(st.one_of(NEARLY.map(json.dumps), JSON.map(json.dumps), st.binary(max_size=64), st.text(max_size=64)))
def test_whatever_comes_is_a_command_or_a_refusal(message):
    session = Session("drive")
    if isinstance(message, str):
        message = message.replace('"?"', f'"{session.nonce}"')
    try:
        command = session.admit(message)
    except Inconsistent:
        assert session.violations == 1
    else:
        if command.type != "stop":  # that is anybody's
            assert command.session == session.nonce
        assert 1 <= command.seq < 2**53
