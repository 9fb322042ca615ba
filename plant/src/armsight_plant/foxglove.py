"""Foxglove's WebSocket: the newest pose, joints and alarms on the channels and by the schemas of a recording."""

from __future__ import annotations

import logging

import foxglove

from armsight._version import __version__
from armsight.errors import DeviceFailed
from armsight.store.atomic import json_text
from armsight.store.recording.schemas import (
    EVENTS,
    JOINTS,
    MEASURED,
    NS,
    SCHEMA_OF,
    SHOWN,
    event_content,
    joints_content,
    pose_contents,
    schema_of,
)
from armsight_plant.options import ENDS, FoxgloveOptions
from armsight_plant.state import PlantState, Tell
from armsight_plant.values import IN_TOLERANCE, told

BACKLOG = 64
"""Messages that wait for a client; of one that is slower the oldest are left out."""
NAME = "armsight"


class FoxglovePublisher:
    """A WebSocket server that whoever reaches it may watch."""

    def __init__(self, options: FoxgloveOptions, stale_s: float, tell: Tell) -> None:
        """Nothing is opened."""
        self._options, self._stale_s = options, stale_s
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._server: foxglove.websocket.WebSocketServer | None = None
        self._sent: dict[str, float] = {}
        self._said: set[tuple[str, bool, str]] = set()
        self._verdict = ""
        self.port = 0

    async def start(self) -> None:
        """Listen, with every channel there is. Raises DeviceFailed where the port cannot be had."""
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        for topic in (MEASURED, SHOWN, JOINTS, EVENTS):
            encoding, kind, data = schema_of(SCHEMA_OF[topic])
            schema = foxglove.Schema(name=SCHEMA_OF[topic], encoding=kind, data=data)
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema, message_encoding=encoding, context=self._context
            )
        try:
            self._server = foxglove.start_server(
                name=f"armsight {__version__}",
                host=self._options.host,
                port=self._options.port,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except Exception as error:  # the SDK has errors of its own kinds for what the system refuses
            raise DeviceFailed(
                f"Foxglove's WebSocket cannot listen at {self._options.host}, port {self._options.port}: {error}",
                consequence=ENDS,
                cure="Choose another port or address with --foxglove",
            ) from error
        self.port = self._server.port

    async def show(self, state: PlantState | None, now_s: float) -> None:
        """Send what is new; alarms and verdicts as events, once each."""
        if state is not None:
            if state.robot is not None and state.robot.reading is not None:
                t_ns = round(NS * state.unix_s(state.robot.at_s))
                self._send(JOINTS, joints_content(state.robot.reading), t_ns, state.robot.at_s)
            if state.seen is not None:
                t_ns = round(NS * state.unix_s(state.seen.at_s))
                for topic, content in pose_contents(state.seen.pose, t_ns).items():
                    self._send(topic, content, t_ns, state.seen.at_s)
            self._tell_alarms(state)
        self._tell_verdict(state, now_s)

    async def stop(self) -> None:
        """Close all connections."""
        if self._server is not None:
            self._server.stop()

    def _send(self, topic: str, content: object, t_ns: int, at_s: float) -> None:
        if self._sent.get(topic) != at_s:
            self._sent[topic] = at_s
            self._channels[topic].log(json_text(content, indent=None).encode(), log_time=t_ns)

    def _tell_alarms(self, state: PlantState) -> None:
        said = {(one.id, one.active, one.acknowledged_by) for one in state.alarms}
        for one in state.alarms:
            if (one.id, one.active, one.acknowledged_by) in self._said:
                continue
            how = "is active" if one.active else "has gone"
            by = f", acknowledged by {one.acknowledged_by}" if one.acknowledged else ""
            level = "error" if one.latched else "warning"
            self._event(state.made_unix_s, f"alarm {one.id} {how}{by}: {one.why}", level)
        self._said = said

    def _tell_verdict(self, state: PlantState | None, now_s: float) -> None:
        verdict = told(state, now_s, self._stale_s)[IN_TOLERANCE]
        words = {True: "in tolerance", False: "beyond tolerance", None: f"tolerance not known ({verdict.quality})"}
        text = words[verdict.value]  # type: ignore[index]  # a bool, or None
        if text != self._verdict and state is not None:
            self._verdict = text
            self._event(state.made_unix_s, text, "info" if verdict.value else "warning")

    def _event(self, unix_s: float, message: str, level: str) -> None:
        t_ns = round(NS * unix_s)
        content = event_content(t_ns, message, level, NAME)
        self._channels[EVENTS].log(json_text(content, indent=None).encode(), log_time=t_ns)
