"""OPC UA with asyncua's own client over loopback: what is read, who is kept out, who may acknowledge."""

import asyncio
import contextlib
import threading
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.uaerrors import UaError

from armsight.control.guard import GuardState
from armsight.errors import DeviceFailed
from armsight.store.tokens import read_tokens
from armsight_plant.opcua.publisher import NAMESPACE, OpcUaPublisher
from armsight_plant.options import OpcUaOptions
from armsight_plant.publishing import Feed
from armsight_plant.state import Acknowledge, Note
from loading import module_of

states = module_of(Path(__file__).with_name("plant_states.py"))
state, robot, seen = states.state, states.robot, states.seen

SIGN, BOTH = ua.MessageSecurityMode.Sign, ua.MessageSecurityMode.SignAndEncrypt
TOO_MUCH = 64 << 20
TOLERANCE = "verdict.in_tolerance"


class Served:
    """A server, what it sent back, and clients for it."""

    def __init__(self, publisher, keys, sent, server):
        self.publisher, self.keys, self.sent, self.server = publisher, keys, sent, server
        self.url = f"opc.tcp://127.0.0.1:{publisher.port}"

    def notes(self):
        return [one.message for one in self.sent if isinstance(one, Note)]

    @asynccontextmanager
    async def client(self, role="acknowledge", *, token=None, pair="client", mode=BOTH):
        client = Client(self.url, timeout=20)
        client.application_uri = f"urn:{pair}.example:armsight"
        client.session_timeout = 60_000
        if pair is not None:
            files = getattr(self.keys, pair)
            await client.set_security(SecurityPolicyBasic256Sha256, *map(str, files), mode=mode)
        if role is not None:
            client.set_user(role)
            client.set_password(self.keys.of.get(role, "") if token is None else token)
        async with client:
            client.index = await client.get_namespace_index(NAMESPACE)
            yield client


async def data(client, name):
    node = client.get_node(ua.NodeId(name, client.index))
    return await node.read_data_value(raise_on_bad_status=False)


async def acknowledge(client, number):
    return await client.get_node(ua.NodeId("alarms", client.index)).call_method(
        ua.NodeId("alarms.acknowledge", client.index), number
    )


class Background:
    """An event loop in a thread, with one server: its address space takes a second to build."""

    def __init__(self, keys, options):
        self.keys, self.sent, self.room, self.now_s = keys, [], True, 0.0
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()
        self.publisher = OpcUaPublisher(options, 1.0, self.tell, clock=lambda: self.now_s)
        self.wait(self.publisher.start())

    def tell(self, request):
        self.sent.append(request)
        return self.room

    def wait(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(60)

    def run(self, body, *, room=True):
        """Let a body do its work with the state of every test's beginning."""
        self.room = room
        self.sent.clear()
        self.wait(self.publisher.show(state(), 100.0))
        self.wait(body(Served(self.publisher, self.keys, self.sent, self)))

    def close(self):
        self.wait(self.publisher.stop())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


@pytest.fixture(scope="module")
def tokens(keys, tmp_path_factory):
    """The server's own copy, which a test may change."""
    copy = tmp_path_factory.mktemp("tokens") / "tokens.yaml"
    copy.write_bytes(keys.tokens.read_bytes())
    copy.chmod(0o600)
    return copy


@pytest.fixture(scope="module")
def guarded(keys, tokens):
    own = {"certificate": keys.server[0], "key": keys.server[1], "trusted": keys.trusted, "users": tokens}
    made = Background(keys, OpcUaOptions(host="127.0.0.1", port=0, **own))
    yield made.run
    made.close()


@pytest.fixture(scope="module")
def open_to_all(keys, tokens):
    own = {"certificate": keys.server[0], "key": keys.server[1], "users": tokens, "anonymous": True}
    made = Background(keys, OpcUaOptions(host="127.0.0.1", port=0, **own))
    yield made.run
    made.close()


@pytest.mark.parametrize("mode", [SIGN, BOTH])
def test_a_plc_reads_values_with_their_time_and_unit(guarded, mode):
    async def body(served):
        async with served.client("watch", mode=mode) as client:
            one = await data(client, TOLERANCE)
            assert (one.Value.Value, one.Value.VariantType) == (True, ua.VariantType.Boolean)
            assert one.StatusCode.is_good()
            assert one.SourceTimestamp == datetime.fromtimestamp(states.UNIX_S + 100.0, UTC)
            assert (await data(client, "robot.joints")).Value.Value == [0.1, 0.2]
            unit = await client.get_node(ua.NodeId("verdict.error_m.unit", client.index)).read_value()
            assert (unit.DisplayName.Text, unit.UnitId) == ("m", 5067858)
            path = ["0:Objects", *(f"{client.index}:{name}" for name in ("armsight", "verdict", "in_tolerance"))]
            assert (await client.nodes.root.get_child(path)).nodeid.Identifier == TOLERANCE

    guarded(body)


def test_what_is_stale_is_told_as_such_and_good_again(guarded):
    async def body(served):
        async with served.client("watch") as client:
            shown = served.publisher.show
            await shown(state(at_s=101.5, seen=seen(at_s=100.0)), 101.6)
            old = await data(client, TOLERANCE)
            assert (old.Value.Value, old.StatusCode.value) == (False, ua.StatusCodes.UncertainLastUsableValue)
            assert (await data(client, "robot.state")).StatusCode.is_good()
            await shown(state(at_s=101.5), 110.0)  # the source says nothing any more
            silent = await data(client, TOLERANCE)
            assert (silent.Value.Value, silent.StatusCode.value) == (None, ua.StatusCodes.BadNoCommunication)
            assert (await data(client, "alarms.robot.active")).StatusCode.value == ua.StatusCodes.BadNoCommunication
            await shown(state(at_s=110.0), 110.0)
            again = await data(client, TOLERANCE)
            assert again.Value.Value is True and again.StatusCode.is_good()

    guarded(body)


def test_a_process_that_was_held_up_does_not_answer_with_what_was_good_before(guarded):
    async def body(served):
        async with served.client("watch") as client:
            assert (await data(client, TOLERANCE)).Value.Value is True
            served.server.now_s += 5.0  # and nothing was shown meanwhile
            late = await data(client, TOLERANCE)
            assert (late.Value.Value, late.StatusCode.value) == (None, ua.StatusCodes.BadNoCommunication)
            assert (await data(client, "robot.joints")).StatusCode.value == ua.StatusCodes.BadNoCommunication

    guarded(body)


@pytest.mark.parametrize(
    ("who", "why"),
    [
        ({"role": None}, "kept out"),
        ({"token": "wrong"}, "wrong name or token"),
        ({"role": "acknowledge", "token": ""}, "wrong name or token"),
        ({"role": "watch", "token": "that of drive"}, "wrong name or token"),
        ({"pair": "stranger"}, "not trusted"),
    ],
)
def test_who_is_not_known_is_refused_and_logged(guarded, keys, who, why):
    token = {"token": keys.of["drive"]} if who.get("token") == "that of drive" else {}

    async def body(served):
        with pytest.raises(UaError):
            async with served.client(**{**who, **token}):
                pass
        assert any(why in note and "127.0.0.1" in note for note in served.notes())
        assert not any("wrong" in note and note.endswith("wrong") for note in served.notes())

    guarded(body)


def test_without_security_only_how_to_speak_is_told(guarded):
    async def body(served):
        offered = await Client(served.url).connect_and_get_server_endpoints()
        assert {one.SecurityMode for one in offered} == {SIGN, BOTH}
        client = Client(served.url, timeout=20)
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            with pytest.raises(UaError):
                await client.create_session()
        finally:
            client.disconnect_socket()
        assert any("without a certificate" in note for note in served.notes())

    guarded(body)


def test_a_session_that_was_not_activated_reads_nothing(guarded, keys):
    async def body(served):
        client = Client(served.url, timeout=20)
        client.application_uri = "urn:client.example:armsight"
        await client.set_security(SecurityPolicyBasic256Sha256, *map(str, keys.client), mode=BOTH)
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            await client.create_session()
            with pytest.raises(UaError):
                await client.get_node(ua.NodeId(TOLERANCE, 2)).read_value()
            with pytest.raises(UaError):
                await client.activate_session(username="watch", password="wrong")
            with pytest.raises(UaError):
                await client.get_node(ua.NodeId(TOLERANCE, 2)).read_value()
        finally:
            client.disconnect_socket()

    guarded(body)


def test_a_session_of_others_is_not_taken_over(guarded, keys):
    async def body(served):
        async with served.client("acknowledge") as victim:
            theirs = victim.uaclient.protocol.authentication_token
            assert theirs.NodeIdType is ua.NodeIdType.ByteString and len(theirs.Identifier) == 32
            thief = Client(served.url, timeout=20)
            thief.application_uri = "urn:client.example:armsight"
            await thief.set_security(SecurityPolicyBasic256Sha256, *map(str, keys.client), mode=BOTH)
            await thief.connect_socket()
            try:
                await thief.send_hello()
                await thief.open_secure_channel()
                thief.uaclient.protocol.authentication_token = theirs
                thief._server_nonce = b"x" * 32
                with pytest.raises(UaError):
                    await thief.activate_session(username="watch", password="wrong")
                with pytest.raises(UaError):
                    await thief.get_node(ua.NodeId(TOLERANCE, 2)).read_value()
            finally:
                thief.disconnect_socket()

    guarded(body)


def test_everyone_reads_where_that_is_allowed_and_nothing_else(open_to_all):
    async def body(served):
        async with served.client(None, pair=None) as client:
            assert (await data(client, TOLERANCE)).Value.Value is True
            await served.publisher.show(stopped(), 101.0)
            with pytest.raises(UaError):
                await acknowledge(client, (await data(client, "alarms.stopped.id")).Value.Value)
            with pytest.raises(UaError):
                await client.get_node(ua.NodeId(TOLERANCE, client.index)).write_value(True)
        assert not [one for one in served.sent if isinstance(one, Acknowledge)]

    open_to_all(body)


def test_a_token_counts_on_a_secured_channel_alone(open_to_all):
    async def body(served):
        with pytest.raises(UaError):
            async with served.client("acknowledge", pair=None):
                pass
        async with served.client("acknowledge", pair="stranger") as client:  # no list of trusted clients was given
            assert (await data(client, TOLERANCE)).Value.Value is True

    open_to_all(body)


def stopped(at_s=101.0):
    return Feed(lambda *_: None, 1.0).with_alarms(state(at_s, robot=robot(at_s, GuardState.STOPPED, why="by anna")))


def test_who_may_acknowledges_the_occurrence_that_they_saw(guarded):
    async def body(served):
        await served.publisher.show(stopped(), 101.0)
        async with served.client("acknowledge") as client:
            assert (await data(client, "alarms.stopped.active")).Value.Value is True
            number = (await data(client, "alarms.stopped.id")).Value.Value
            await acknowledge(client, number)
            with pytest.raises(ua.uaerrors.BadEventIdUnknown):
                await acknowledge(client, f"{number}1")
            with pytest.raises(ua.uaerrors.BadEventIdUnknown):
                await acknowledge(client, "")
        found = [one for one in served.sent if isinstance(one, Acknowledge)]
        assert [(one.id, one.who, one.address) for one in found] == [(number, "acknowledge", "127.0.0.1")]

    guarded(body)


def test_who_may_only_watch_acknowledges_and_writes_nothing(guarded):
    async def body(served):
        await served.publisher.show(stopped(), 101.0)
        async with served.client("watch") as client:
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await acknowledge(client, (await data(client, "alarms.stopped.id")).Value.Value)
            with pytest.raises(UaError):
                await client.get_node(ua.NodeId(TOLERANCE, client.index)).write_value(True)
        assert not [one for one in served.sent if isinstance(one, Acknowledge)]
        assert any("watch at 127.0.0.1 may not acknowledge" in note for note in served.notes())

    guarded(body)


def test_an_acknowledgement_that_finds_no_room_fails(guarded):
    async def body(served):
        await served.publisher.show(stopped(), 101.0)
        async with served.client("drive") as client:
            with pytest.raises(ua.uaerrors.BadResourceUnavailable):
                await acknowledge(client, (await data(client, "alarms.stopped.id")).Value.Value)

    guarded(body, room=False)


def test_a_token_that_was_taken_out_lets_nobody_in_any_more(guarded, tokens):
    before = tokens.read_text()

    async def body(served):
        async with served.client("watch"):
            pass
        tokens.write_text(before.replace("name: watch", "name: other"))
        assert "other" in [one.name for one in read_tokens(tokens)]
        with pytest.raises(UaError):
            async with served.client("watch"):
                pass

    try:
        guarded(body)
    finally:
        tokens.write_text(before)


def test_a_message_that_never_ends_is_cut_off(guarded):
    async def body(served):
        _, writer = await asyncio.open_connection("127.0.0.1", served.publisher.port)
        writer.write(b"HELF\xff\xff\xff\x7f")
        sent = 0
        with contextlib.suppress(ConnectionError):
            while sent < TOO_MUCH:
                writer.write(b"x" * 65536)
                sent += 65536
                await asyncio.wait_for(writer.drain(), 20)
        assert sent < TOO_MUCH
        writer.transport.abort()
        async with served.client("watch") as client:
            assert (await data(client, TOLERANCE)).Value.Value is True

    guarded(body)


def test_a_port_in_use_is_told(guarded):
    async def body(served):
        options = OpcUaOptions(host="127.0.0.1", port=served.publisher.port, anonymous=True)
        other = OpcUaPublisher(options, 1.0, lambda _: True)
        with pytest.raises(DeviceFailed, match=f"port {served.publisher.port}"):
            await other.start()
        await other.stop()

    guarded(body)
