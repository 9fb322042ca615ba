"""The robot in a browser: its deadman, stop, jog keys and override, over a connection whose end holds the robot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from typing import Any

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from starlette.requests import HTTPConnection

from armsight.app.operator.seat import Person, Push, Seat
from armsight.console import texts
from armsight.console.layout import SIGNS
from armsight.console.state import Console
from armsight.errors import ArmsightError

TELL_S = 0.1
"""Time between two states told to a browser."""

IDENTITY = "armsight.identity"
"""Where the server that lets callers in puts who they are into a request's scope."""

LONGEST = 2000
"""Characters of a message; ours have a tenth."""


def person_of(connection: HTTPConnection | None) -> Person:
    """Return who asks; where nobody is checked, because only this machine is served, its operator."""
    found: Any = None if connection is None else connection.scope.get(IDENTITY)
    return Person() if found is None else Person(who=found.who, role=found.role)


def add_robot_link(server: FastAPI, console: Console) -> None:
    """Serve the WebSocket /console/robot?browser=NAME, and /console/stop, which works without it."""

    @server.post("/console/stop", include_in_schema=False)
    async def stop(request: Request) -> Response:
        if console.robot is not None:
            console.robot.seat.stop(person_of(request))
        return Response(status_code=204)

    @server.websocket("/console/robot")
    async def robot(socket: WebSocket, browser: str = "") -> None:
        if console.robot is None or not browser or len(browser) > 64:
            await socket.close(code=1008)
            return
        await socket.accept()
        await RobotLink(console.robot.seat, socket, browser).serve()


class RobotLink:
    """One browser's connection to the seat."""

    def __init__(self, seat: Seat, socket: WebSocket, browser: str) -> None:
        self._seat, self._socket, self._browser = seat, socket, browser
        self._person = person_of(socket)
        self._refused = ""

    async def serve(self) -> None:
        """Take what the browser says until its connection ends; then the robot is let go of first of all."""
        teller = asyncio.create_task(self._tell())
        try:
            while True:
                self._take(await self._socket.receive_text())
        except WebSocketDisconnect:
            pass
        finally:
            self._seat.leave(self._browser)
            teller.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await teller

    def _take(self, text: str) -> None:
        """Do what a message asks; what is refused is told with the next state."""
        message = _read(text)
        try:
            match message.get("do"):
                case "beat":
                    self._beat(message)
                case "stop":
                    self._seat.stop(self._person)
                case "reset":
                    self._seat.reset(self._browser, self._person)
                    self._refused = ""
                case "override":
                    self._override(message)
        except ArmsightError as error:
            self._refused = str(error)

    def _beat(self, message: dict[str, Any]) -> None:
        enable = message.get("enable") is True
        seen_s = message.get("seen")
        seen_s = float(seen_s) if isinstance(seen_s, int | float) else -math.inf
        self._seat.beat(self._browser, self._person, enable=enable, seen_s=seen_s, push=_push(message.get("push")))
        if enable:
            self._refused = ""

    def _override(self, message: dict[str, Any]) -> None:
        """Take another speed, from who drives or may do so while nobody does."""
        share = message.get("share")
        if (
            self._person.role == "drive"
            and self._seat.browser in ("", self._browser)
            and isinstance(share, int | float)
        ):
            self._seat.override = float(share)

    async def _tell(self) -> None:
        while True:
            self._seat.look()
            await self._socket.send_text(json.dumps(self._state()))
            await asyncio.sleep(TELL_S)

    def _state(self) -> dict[str, Any]:
        try:
            now = self._seat.state(self._browser)
        except ArmsightError as error:
            return {"level": "bad", "words": str(error), "refused": self._refused, "mine": False, "enabled": False}
        level, words = texts.robot_words(now.robot, now.guard, now.why, now.driver, mine=now.mine)
        return {
            "t": now.t_s,
            "instance": now.instance,
            "level": level,
            "words": f"{SIGNS[level]} {words}",
            "refused": self._refused,
            "stopped": now.robot == "stopped",
            "mine": now.mine,
            "enabled": now.enabled,
            "override": now.override,
            "drives": self._person.role == "drive",
        }


def _read(text: str) -> dict[str, Any]:
    try:
        message = json.loads(text) if len(text) <= LONGEST else {}
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _push(said: Any) -> Push | None:
    """Return the jog key that a message names, None for none, or for what is none."""
    if not isinstance(said, str):
        return None
    frame, _, rest = said.partition(":")
    axis, _, sense = rest.partition(":")
    if frame not in ("joints", "base", "tool") or not axis.isdigit() or sense not in ("1", "-1"):
        return None
    return Push(frame=frame, axis=int(axis), sense=float(sense))
