"""Foxglove's WebSocket, by its protocol: the channels and schemas of a recording, and the newest values on them."""

import asyncio
import json
import struct
from contextlib import contextmanager
from pathlib import Path

import pytest
from websockets.sync.client import connect

from armsight.store.recording import RecordingWriter
from armsight_plant.foxglove import FoxglovePublisher
from armsight_plant.options import FoxgloveOptions
from loading import module_of

states = module_of(Path(__file__).with_name("plant_states.py"))
state = states.state

WAIT_S = 20.0
MESSAGE_DATA = 1
PROTOCOL = "foxglove.sdk.v1"


@contextmanager
def serving():
    publisher = FoxglovePublisher(FoxgloveOptions(host="127.0.0.1", port=0), 1.0, lambda _: True)
    asyncio.run(publisher.start())
    try:
        yield publisher
    finally:
        asyncio.run(publisher.stop())


class Viewer:
    """What Foxglove's app does."""

    def __init__(self, publisher):
        self._socket = connect(f"ws://127.0.0.1:{publisher.port}", subprotocols=[PROTOCOL], proxy=None).__enter__()
        assert self._socket.subprotocol == PROTOCOL
        self.channels = {}

    def advertised(self, n):
        while len(self.channels) < n:
            said = json.loads(self._socket.recv(WAIT_S))
            for one in said.get("channels", ()):
                self.channels[one["topic"]] = one
        return self.channels

    def subscribe(self, publisher, *topics):
        self._ids = {self.channels[topic]["id"]: topic for topic in topics}
        wanted = [{"id": number, "channelId": number} for number in self._ids]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        for topic in topics:  # until the server has heard it
            while not publisher._channels[topic].has_sinks():
                self._socket.ping().wait(WAIT_S)

    def next(self):
        """Return topic, time in ns, and what is said."""
        data = self._socket.recv(WAIT_S)
        kind, number, t_ns = struct.unpack_from("<BIQ", data)
        assert kind == MESSAGE_DATA
        return self._ids[number], t_ns, json.loads(data[13:])

    def close(self):
        self._socket.close()


def test_channels_and_schemas_are_those_of_a_recording(tmp_path):
    now = state()
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.pose(now.seen.pose)
        writer.joints(now.robot.reading)
        writer.event(100.0, "something")
    with serving() as publisher:
        viewer = Viewer(publisher)
        found = {
            topic: (one["encoding"], one["schemaName"], one["schemaEncoding"], one["schema"])
            for topic, one in viewer.advertised(4).items()
        }
        viewer.close()
    assert found == recorded(tmp_path / "a.mcap")


def recorded(file):
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    return {
        one.topic: (
            one.message_encoding,
            summary.schemas[one.schema_id].name,
            summary.schemas[one.schema_id].encoding,
            summary.schemas[one.schema_id].data.decode(),
        )
        for one in summary.channels.values()
    }


def test_a_viewer_sees_what_is_new_once():
    with serving() as publisher:
        viewer = Viewer(publisher)
        viewer.advertised(4)
        viewer.subscribe(publisher, "/target/pose", "/robot/joints")
        for at_s, now_s in ((100.0, 100.0), (100.0, 100.01), (100.2, 100.2)):
            asyncio.run(publisher.show(state(at_s), now_s))
        heard = [viewer.next() for _ in range(4)]
        viewer.close()
    assert sorted((topic, t_ns) for topic, t_ns, _ in heard) == [
        (topic, round(1e9 * (states.UNIX_S + at_s)))
        for topic in ("/robot/joints", "/target/pose")
        for at_s in (100.0, 100.2)
    ]
    pose = next(said for topic, _, said in heard if topic == "/target/pose")
    assert pose["frame_id"] == "rig" and pose["pose"]["position"] == pytest.approx({"x": 0.1, "y": 0.2, "z": 0.9})
