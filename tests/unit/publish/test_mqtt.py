"""MQTT through Mosquitto: what is retained, the last will, TLS and passwords, a broker that comes later."""

import asyncio
import gc
import json
import queue
import time
from dataclasses import replace
from pathlib import Path

import pytest
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from armsight_plant.mqtt import EXPIRES_S, MqttPublisher
from armsight_plant.options import PlantOptions, mqtt_options
from armsight_plant.process import PlantProcess
from armsight_plant.state import Note
from loading import module_of
from mosquitto import PASSWORD, USER, Broker, missing

states = module_of(Path(__file__).with_name("plant_states.py"))
state = states.state

WAIT_S = 30.0
TOPIC = "plant/cell1/state"

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    with Broker(tmp_path_factory.mktemp("broker")) as running:
        yield running


@pytest.fixture(autouse=True)
def nothing_retained(request):
    yield
    if "broker" in request.fixturenames:
        Listener(request.getfixturevalue("broker"), clear=True).close()


class Listener:
    """A client of the stock library that keeps what it hears."""

    def __init__(self, broker, *, clear=False):
        self.heard = queue.Queue()
        self._client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.username_pw_set(USER, PASSWORD)
        self._client.tls_set(str(broker.ca))
        self._client.on_message = lambda client, data, message: self._hear(message)
        self._client.connect("127.0.0.1", broker.port)
        self._client.loop_start()
        if clear:
            self._client.publish(TOPIC, b"", qos=1, retain=True).wait_for_publish(WAIT_S)
        else:
            self._client.subscribe(TOPIC, qos=1)

    def _hear(self, message):
        self.expires_s = getattr(message.properties, "MessageExpiryInterval", None)
        self.heard.put((message.retain, message.payload))

    def next(self):
        """Return whether it was retained, and what it says."""
        retained, data = self.heard.get(timeout=WAIT_S)
        return retained, json.loads(data)

    def until(self, true):
        """Return the first one for which it is true."""
        while not true(said := self.next()[1]):
            pass
        return said

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()


def options(broker, monkeypatch, **more):
    monkeypatch.setenv("ARMSIGHT_MQTT_PASSWORD", PASSWORD)
    given = {"ca": broker.ca, "user": USER, "password_file": None}
    return replace(mqtt_options(f"{broker.url}/plant/cell1", **given), **more)


class Published:
    """A publisher, and what it noted."""

    def __init__(self, given):
        self.notes = queue.Queue()
        self.publisher = MqttPublisher(given, 1.0, lambda note: self.notes.put(note) is None)
        asyncio.run(self.publisher.start())

    def note(self, part):
        while part not in (note := self.notes.get(timeout=WAIT_S)).message:
            pass
        assert isinstance(note, Note)
        return note

    def show(self, of, now_s):
        self.note_up()
        asyncio.run(self.publisher.show(of, now_s))

    def note_up(self):
        assert self.publisher._up.wait(WAIT_S)

    def close(self):
        asyncio.run(self.publisher.stop())


@pytest.fixture
def published(request):
    made = []

    def make(given):
        made.append(Published(given))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_who_comes_later_hears_the_newest_state(broker, monkeypatch, published):
    ours = published(options(broker, monkeypatch))
    ours.show(state(), 100.0)
    first = Listener(broker)
    assert first.next()[1]["in_tolerance"] is True
    ours.show(state(101.0, seen=states.seen(101.0, level=states.Level.WARN)), 101.0)
    assert first.next()[1]["in_tolerance"] is False
    later = Listener(broker)
    retained, said = later.next()
    assert retained and (said["in_tolerance"], said["online"], said["format"]) == (False, True, "armsight/plant")
    for one in (first, later):
        one.close()


def test_a_broker_keeps_no_old_state_and_for_ever_that_there_is_none(broker, monkeypatch, published):
    ours = published(options(broker, monkeypatch))
    listener = Listener(broker)
    ours.show(state(), 100.0)
    assert listener.next()[1]["online"] is True
    assert 0 < listener.expires_s <= EXPIRES_S
    ours.close()
    assert listener.next()[1]["online"] is False
    assert listener.expires_s is None
    listener.close()


def test_the_broker_tells_the_last_will_of_a_process_that_was_killed(broker, monkeypatch):
    listener = Listener(broker)
    with PlantProcess(PlantOptions(mqtt=options(broker, monkeypatch), stale_s=3600.0)) as process:
        now_s = time.monotonic()
        process.show(replace(state(now_s), made_unix_s=time.time()))
        assert listener.until(lambda said: said["in_tolerance"] is True)["online"] is True
        process._process.kill()
        said = listener.until(lambda said: not said["online"])
        assert (said["stale"], said["in_tolerance"]) == (True, None)
        process._process.join()
        assert not process.alive
        process.restart()
        process.show(replace(state(time.monotonic()), made_unix_s=time.time()))
        assert listener.until(lambda said: said["in_tolerance"] is True)["stale"] is False
    assert listener.until(lambda said: not said["online"])["in_tolerance"] is None
    listener.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho leaves a refused socket open
@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"password": "wrong"}, "Not authorized"),
        ({"ca": "other_ca"}, "its certificate is not trusted"),
        ({"tls": False, "ca": None}, ""),
    ],
)
def test_what_the_broker_refuses_is_told_and_tried_again(broker, monkeypatch, published, wrong, why):
    given = {name: getattr(broker, value) if value == "other_ca" else value for name, value in wrong.items()}
    ours = published(options(broker, monkeypatch, **given))
    if why:
        assert ours.note(why).level == "error"  # which a person at the terminal is told
    asyncio.run(ours.publisher.show(state(), 100.0))  # which must not wait, nor fail
    assert not ours.publisher._up.is_set()
    ours.close()
    gc.collect()


def test_a_broker_that_comes_later_is_found(tmp_path, monkeypatch, published):
    late = Broker(tmp_path)
    ours = published(options(late, monkeypatch))
    ours.note("cannot be reached")
    asyncio.run(ours.publisher.show(state(), 100.0))
    with late:
        ours.note("published at")
        ours.show(state(101.0), 101.0)
        listener = Listener(late)
        assert listener.next()[1]["in_tolerance"] is True
        listener.close()
    ours.note("is gone")


def test_no_secret_is_shown(broker, monkeypatch):
    assert PASSWORD not in repr(options(broker, monkeypatch))
