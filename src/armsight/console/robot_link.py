"""The robot in a browser: its deadman, stop, jog keys and override, over a connection whose end holds the robot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import time
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response, WebSocket, WebSocketDisconnect
from starlette.requests import HTTPConnection

from armsight.console import texts
from armsight.console.layout import SIGNS
from armsight.console.messages import BROWSER, Beat, Override, Reset, Stop, robot_message
from armsight.console.state import Console
from armsight.control.session.operator_session import OperatorSession, Person
from armsight.drivers import RobotState
from armsight.errors import ArmsightError, UsageError

STATE_S = 0.1
"""Time between two states sent to a browser."""

IDENTITY = "armsight.identity"
"""Where the server that lets callers in puts who they are into a request's scope."""

SENT_AFTER = "armsight.sent_after_s"
"""Where the server says after what time (time.monotonic()) a message was sent, by the round trip that it measures."""


def person_of(connection: HTTPConnection | None) -> Person:
    """Return who asks; where nobody is checked, because only this machine is served, its operator."""
    found: Any = None if connection is None else connection.scope.get(IDENTITY)
    return Person() if found is None else Person(who=found.who, role=found.role)


def add_robot_link(server: FastAPI, console: Console) -> None:
    """Serve the WebSocket /console/robot?browser=NAME, and /console/stop, which works without it."""

    @server.post("/console/stop", include_in_schema=False)
    async def stop(request: Request) -> Response:
        if console.robot is not None:
            console.robot.session.stop(person_of(request))
        return Response(status_code=204)

    @server.websocket("/console/robot")
    async def robot(socket: WebSocket, browser: Annotated[str, Query(pattern=BROWSER)]) -> None:
        if console.robot is None:
            await socket.close(code=1008)
            return
        await socket.accept()
        await RobotLink(console.robot.session, socket, browser).serve()


class RobotLink:
    """One browser's connection to the operator's session."""

    def __init__(self, session: OperatorSession, socket: WebSocket, browser: str) -> None:
        self._session, self._socket, self._browser = session, socket, browser
        self._person = person_of(socket)
        self._key = secrets.token_hex(16)  # names its enable on the line for stops, while the session lets it
        self._refused = ""
        self._sent_s = -math.inf

    async def serve(self) -> None:
        """Take what the browser says until its connection ends; then the robot is let go of first of all."""
        sender = asyncio.create_task(self._send_states())
        try:
            while (said := await self._socket.receive())["type"] == "websocket.receive":
                sent_after_s = said.get(SENT_AFTER)
                self.take(said.get("text"), 0.0 if sent_after_s is None else time.monotonic() - sent_after_s)
        finally:
            self._session.leave(self._browser)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    def take(self, text: str | None, age_s: float = 0.0) -> None:
        """Do what a message asked age_s ago; what is refused, or is no message, is told with the next state."""
        try:
            match robot_message(text):
                case Beat() as beat:
                    self._beat(beat, age_s)
                case Stop():
                    self._session.stop(self._person)
                case Reset():
                    self._session.reset(self._browser, self._person)
                    self._refused = ""
                case Override(share=share):
                    self._override(share)
        except ArmsightError as error:
            self._refused = str(error)

    def _beat(self, beat: Beat, age_s: float) -> None:
        seen_s = -math.inf if beat.seen is None else beat.seen
        if beat.enable and seen_s > self._sent_s:  # it would stay fresh however long it lay in a buffer
            raise UsageError("the page saw a state that it was not told", consequence="Nothing was done")
        push = None if beat.push is None else beat.push.held()
        said = {"enable": beat.enable, "seen_s": seen_s, "age_s": age_s, "push": push, "number": beat.number}
        self._session.beat(self._browser, self._person, key=self._key, **said)  # type: ignore[arg-type]
        if beat.enable:
            self._refused = ""

    def _override(self, share: float) -> None:
        """Take another speed, from who drives or may do so while nobody does."""
        if self._person.role == "drive" and self._session.browser in ("", self._browser):
            self._session.override = share

    async def _send_states(self) -> None:
        while True:
            self._session.look()
            await self._socket.send_text(json.dumps(self.state()))
            await asyncio.sleep(STATE_S)

    def state(self) -> dict[str, Any]:
        """Return what the page is told."""
        session = self._session
        try:
            with session.lock:  # who drives and what the robot does belong to one moment
                now, mine, enabled = session.status(), session.drives(self._browser), session.enabled(self._browser)
        except ArmsightError as error:
            return {"level": "bad", "words": str(error), "refused": self._refused, "mine": False, "enabled": False}
        self._sent_s = now.t_s
        level, words = texts.robot_words(now, mine=mine)
        return {
            "t": now.t_s,
            "instance": session.service.authority.instance,
            "level": level,
            "words": f"{SIGNS[level]} {words}",
            "refused": self._refused,
            "stopped": now.robot is RobotState.STOPPED,
            "mine": mine,
            "enabled": enabled,
            "override": session.override,
            "drives": self._person.role == "drive",
            "line": session.service.stop_port,
            "key": self._key,
        }
