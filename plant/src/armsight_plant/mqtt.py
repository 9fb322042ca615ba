"""MQTT: the newest state as one retained JSON object, which the broker itself replaces where we are gone."""

from __future__ import annotations

import contextlib
import json
import math
import ssl
import threading
from datetime import UTC, datetime
from typing import Any

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from armsight._version import __version__
from armsight_plant.certificates import tls_context
from armsight_plant.options import MqttOptions
from armsight_plant.state import Note, PlantState, Quality, Tell
from armsight_plant.values import IN_TOLERANCE, Given, PublishedValue, alarm_values, told

FORMAT = "armsight/plant"
EVERY_S = 0.1
"""The state is published so often at the most."""
STILL_S = 1.0
"""... and so often at the least, though nothing changes."""
EXPIRES_S = 5
"""A broker throws a state away that is older: one that was off, and we with it, must not tell what was before."""
KEEPALIVE_S = 5
"""A broker that has heard nothing for one and a half of this tells our last will."""
RETRY_S = 1, 10
"""Pause before a broker is tried again, from the first to the longest, in s."""
QUEUED = 4
"""Messages on the way to a broker at the most; where it is slower newer states are left out, and none piles up."""


def state_json(state: PlantState | None, now_s: float, stale_s: float) -> dict[str, Any]:
    """Return the JSON object of a state as it may be used at now_s of time.monotonic."""
    values = told(state, now_s, stale_s)
    found: dict[str, Any] = {"format": FORMAT, "version": 1, "online": True}
    source = values["source"]
    verdict = values[IN_TOLERANCE]
    found["time"] = None if state is None else _time(state.made_unix_s)
    found["stale"] = source.quality is not Quality.GOOD or verdict.quality in (Quality.STALE, Quality.SILENT)
    found["in_tolerance"] = verdict.value
    for name, one in values.items():
        group, _, last = name.rpartition(".")
        if not group:
            found[last] = one.value
            continue
        if group not in found:
            found[group] = {"time": _stamp(one), "quality": one.quality.value}
        found[group][last] = _number(one.value)
    found["verdict"]["quality"] = verdict.quality.value
    alarms = alarm_values(state)
    there = {name: values for name, values in alarms.items() if values["id"]}
    found["alarms"] = [
        {"name": name, **{key: value for key, value in values.items() if key != "since_s"}, "since": _since(values)}
        for name, values in there.items()
    ]
    return found


def offline_json() -> dict[str, Any]:
    """Return what the topic says while nothing is published: the last will."""
    return {
        "format": FORMAT,
        "version": 1,
        "online": False,
        "stale": True,
        "in_tolerance": None,
        "software": f"armsight {__version__}",
    }


def _expiring() -> Properties:
    found = Properties(PacketTypes.PUBLISH)
    found.MessageExpiryInterval = EXPIRES_S
    return found


def _time(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _stamp(one: PublishedValue) -> str | None:
    return None if math.isnan(one.at_s) else _time(one.at_s)


def _since(values: dict[str, Given]) -> str:
    return _time(float(values["since_s"]))  # type: ignore[arg-type]  # a float, as alarm_values has it


def _number(value: Given) -> Given:
    """JSON knows no NaN."""
    if isinstance(value, list):
        return value if all(math.isfinite(one) for one in value) else None
    return None if isinstance(value, float) and not math.isfinite(value) else value


class MqttPublisher:
    """A client of a broker that is tried for ever; show() never waits for it."""

    def __init__(self, options: MqttOptions, stale_s: float, tell: Tell) -> None:
        """Nothing is opened. Raises BadFile for what is no certificate."""
        self._options, self._stale_s, self._tell = options, stale_s, tell
        self._topic = f"{options.prefix}/state"
        self._next_s, self._last = 0.0, ""
        self._said = ""
        self._up = threading.Event()
        client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        client.will_set(self._topic, json.dumps(offline_json()), qos=1, retain=True)
        client.reconnect_delay_set(*RETRY_S)
        client.max_queued_messages_set(QUEUED)
        client.max_inflight_messages_set(QUEUED)
        client.on_connect, client.on_disconnect = self._connected, self._gone
        client.on_connect_fail = self._failed
        if options.user:
            client.username_pw_set(options.user, options.password or None)
        if options.tls:
            client.tls_set_context(tls_context(options.ca))
        self._client = client

    @property
    def _broker(self) -> str:
        return f"{self._options.host}:{self._options.port}"

    async def start(self) -> None:
        """Begin to look for the broker; one that is not there is looked for again and again."""
        self._client.connect_async(self._options.host, self._options.port, keepalive=KEEPALIVE_S)
        self._client.loop_start()

    async def show(self, state: PlantState | None, now_s: float) -> None:
        """Publish the state, unless the last one is on its way still."""
        if not self._up.is_set() or now_s < self._next_s or self._client.want_write():
            return
        content = state_json(state, now_s, self._stale_s)
        text = json.dumps(content)
        if text == self._last and now_s < self._next_s + STILL_S - EVERY_S:
            return
        self._next_s, self._last = now_s + EVERY_S, text
        self._client.publish(self._topic, text, qos=0, retain=True, properties=_expiring())

    async def stop(self) -> None:
        """Say that nothing comes any more, and go."""
        if self._up.is_set():
            said = self._client.publish(self._topic, json.dumps(offline_json()), qos=1, retain=True)
            with contextlib.suppress(RuntimeError, ValueError):  # the broker went first, and tells our last will
                said.wait_for_publish(timeout=1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _connected(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            cure = "; it must speak MQTT 5" if "protocol version" in str(reason) else ""
            self._say("error", f"MQTT: the broker {self._broker} refused: {reason}{cure}")
            return
        self._last = ""
        self._up.set()
        self._say("info", f"MQTT: published at {self._broker}, topic {self._topic}")

    def _gone(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if self._up.is_set():
            self._say("error", f"MQTT: the broker {self._broker} is gone ({reason}); it is looked for")
        self._up.clear()

    def _failed(self, client: Any, data: Any) -> None:
        self._say("error", f"MQTT: the broker {self._broker} cannot be reached{self._why()}; it is looked for")

    def _why(self) -> str:
        """Return why a connection fails, found by one try of our own: paho keeps it to itself."""
        import socket

        try:
            with socket.create_connection((self._options.host, self._options.port), timeout=2.0) as line:
                if self._options.tls:
                    with tls_context(self._options.ca).wrap_socket(line, server_hostname=self._options.host):
                        pass
        except ssl.SSLCertVerificationError as error:
            return f": its certificate is not trusted ({error.verify_message})"
        except OSError as error:
            return f": {error.strerror or error}"
        return ""

    def _say(self, level: str, message: str) -> None:
        """Tell it once, until something else is so."""
        if message != self._said:
            self._said = message
            self._tell(Note(level=level, message=message))
