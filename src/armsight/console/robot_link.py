"""The robot in a browser: its deadman, stop, jog keys and override, over a connection whose end holds the robot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
from typing import Annotated, Any, Literal, TypeVar

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from armsight.clock import monotonic_s
from armsight.console import texts
from armsight.console.layout import SIGNS
from armsight.console.routes import opener_of, person_of, require_login
from armsight.console.state import Console
from armsight.control.guard import GuardState
from armsight.control.session.operator_session import OperatorSession, Push
from armsight.control.status import RobotStatus
from armsight.drivers import RobotState
from armsight.drivers.remote.protocol import MAX_JOINTS
from armsight.errors import ArmsightError, UsageError

LONGEST = 2000
"""Characters of a message; ours have a tenth."""
LARGEST_PX = 1e5
"""Farthest corner of a rectangle drawn on a picture: ten times the widest camera."""
Seconds = Annotated[float, Field(ge=-1e12, le=1e12, allow_inf_nan=False)]
"""A time on the loop's clock; a machine that was on for 30 years has 1e9."""
Pixel = Annotated[float, Field(ge=-LARGEST_PX, le=LARGEST_PX, allow_inf_nan=False)]


class _Said(BaseModel):
    """No key more, no type but the one that is written: "1" is no number and 1 is no truth."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class JogKey(_Said):
    """A jog key that is held; axis from 0: the joint, or x y z rx ry rz."""

    frame: Literal["joints", "base", "tool"]
    axis: int = Field(ge=0, lt=MAX_JOINTS)
    sense: Literal["-1", "1"]  # as text, since true is the number 1 to a literal

    def held(self) -> Push:
        """Return the key as the session takes it."""
        return Push(frame=self.frame, axis=self.axis, sense=float(self.sense))


class Heartbeat(_Said):
    """The page is alive. enable: whether its button is held; seen: t of the newest state that it had, None of none.

    number: of the beat, which the page says on the line for stops as well; one that was overtaken does not count.
    """

    do: Literal["beat"]
    enable: bool
    push: JogKey | None = None
    seen: Seconds | None = None
    number: int | None = Field(None, ge=1, lt=2**53)


class Page(_Said):
    """The page is this one, by the name that the server gave it: work that was begun there moves with its enable."""

    do: Literal["page"]
    page: str = Field(max_length=64)


class Stop(_Said):
    """Stop the robot."""

    do: Literal["stop"]


class Reset(_Said):
    """Release the stop."""

    do: Literal["reset"]


class Override(_Said):
    """Another share of every speed."""

    do: Literal["override"]
    share: float = Field(ge=0.0, le=1.0)


class Drawn(_Said):
    """A rectangle drawn on a picture: corners u0, v0, u1, v1 in px, in which nothing is looked for."""

    side: str = Field(max_length=16)
    mask: tuple[Pixel, Pixel, Pixel, Pixel] = Field(strict=False)


RobotMessage = Page | Heartbeat | Stop | Reset | Override
"""What a page may say of the robot."""

_ROBOT: TypeAdapter[RobotMessage] = TypeAdapter(Annotated[RobotMessage, Field(discriminator="do")])
_DRAWN: TypeAdapter[Drawn] = TypeAdapter(Drawn)
Model = TypeVar("Model")


def robot_message(text: str | None) -> RobotMessage:
    """Return what a page says of the robot; None stands for bytes, which it never sends. Raises UsageError."""
    if text is None:
        raise _refused("it is no text")
    if len(text) > LONGEST:
        raise _refused(f"it is longer than {LONGEST} characters")
    try:
        said = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise _refused(str(error)) from None
    return _validated(_ROBOT, said)


def drawn(said: Any) -> Drawn:
    """Return the rectangle that a page tells of. Raises UsageError."""
    return _validated(_DRAWN, said)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object's content. Raises ValueError for a key that stands twice: which is meant is not known."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _validated(adapter: TypeAdapter[Model], said: Any) -> Model:
    try:
        return adapter.validate_python(said)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise _refused(f"{where}: {first['msg']}" if where else first["msg"]) from None


def _refused(why: str) -> UsageError:
    return UsageError(
        f"the page said what is no message: {why}"[:300], consequence="Nothing was done", cure="Load the page anew"
    )


STATE_S = 0.1
"""Time between two states sent to a browser."""

SENT_AFTER = "armsight.sent_after_s"
"""Where the server says after what time (monotonic_s()) a message was sent, by the round trip that it measures."""


def add_robot_link(server: FastAPI, console: Console) -> None:
    """Serve the WebSocket /console/robot, and /console/stop, which works without it."""
    links: dict[str, RobotLink] = {}

    @server.post("/console/stop", include_in_schema=False)
    async def stop(request: Request) -> Response:
        if console.robot is not None:
            console.robot.session.stop(person_of(request))
        return Response(status_code=204)

    @server.websocket("/console/robot")
    async def robot(socket: WebSocket) -> None:
        if console.robot is None:
            await socket.close(code=1008)
            return
        await socket.accept()
        await RobotLink(console.robot.session, socket, links).serve()


class RobotLink:
    """One browser's connection to the operator's session: of a page once it says which, and that page is its own.

    links: the connection of each page, by the page's name.
    """

    def __init__(self, session: OperatorSession, socket: WebSocket, links: dict[str, RobotLink]) -> None:
        self._session, self._socket, self._links = session, socket, links
        self._browser = secrets.token_urlsafe(16)
        self._key = secrets.token_hex(16)  # names its enable on the line for stops, while the session lets it
        self._refused = ""
        self._sent_s = -math.inf

    async def serve(self) -> None:
        """Take what the browser says until its connection ends; then the robot is let go of first of all."""
        sender = asyncio.create_task(self._send_states())
        try:
            while (said := await self._socket.receive())["type"] == "websocket.receive":
                sent_after_s = said.get(SENT_AFTER)
                self.take(said.get("text"), 0.0 if sent_after_s is None else monotonic_s() - sent_after_s)
        finally:
            # before anything is awaited: the robot is let go of even where the page's other task hangs
            self._give_up()
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    def take(self, text: str | None, age_s: float = 0.0) -> None:
        """Do what a message asked age_s ago; what is refused, or is no message, is told with the next state."""
        try:
            require_login(person_of(self._socket))
            match robot_message(text):
                case Page(page=name):
                    self._join(name)
                case Heartbeat() as beat:
                    self._beat(beat, age_s)
                case Stop():
                    self._session.stop(person_of(self._socket))
                case Reset():
                    self._session.reset(self._browser, person_of(self._socket))
                    self._refused = ""
                case Override(share=share):
                    self._session.choose_override(self._browser, person_of(self._socket), share)
        except ArmsightError as error:
            self._refused = str(error)

    def _beat(self, beat: Heartbeat, age_s: float) -> None:
        seen_s = -math.inf if beat.seen is None else beat.seen
        if beat.enable and seen_s > self._sent_s:  # it would stay fresh however long it lay in a buffer
            raise UsageError("the page saw a state that it was not told", consequence="Nothing was done")
        push = None if beat.push is None else beat.push.held()
        said = {"enable": beat.enable, "seen_s": seen_s, "age_s": age_s, "push": push, "number": beat.number}
        self._session.beat(self._browser, person_of(self._socket), key=self._key, **said)  # type: ignore[arg-type]
        if beat.enable:
            self._refused = ""

    def _join(self, page: str) -> None:
        """Speak for a page from now on. Raises UsageError for another's, or none."""
        if opener_of(page) != person_of(self._socket):
            raise UsageError(
                "this page is not yours, or is gone", consequence="Nothing was done", cure="Load the page anew"
            )
        if (before := self._links.get(page)) is not self:
            self._give_up()
            if before is not None:  # the page's connection broke, and the server has not seen it yet
                before._give_up()
            self._browser = page
            self._links[page] = self

    def _give_up(self) -> None:
        """Let the robot go, and the page."""
        self._session.leave(self._browser)
        if self._links.get(self._browser) is self:
            del self._links[self._browser]
        self._browser = secrets.token_urlsafe(16)

    async def _send_states(self) -> None:
        while person_of(self._socket).role != "none":
            self._session.look()
            await self._socket.send_text(json.dumps(self.state()))
            await asyncio.sleep(STATE_S)
        self._give_up()
        await self._socket.close(1008, "logged out")

    def state(self) -> dict[str, Any]:
        """Return what the page is told."""
        session = self._session
        try:
            with session.lock:  # who drives and what the robot does belong to one moment
                now, mine, enabled = session.status(), session.drives(self._browser), session.enabled(self._browser)
        except ArmsightError as error:
            return {"level": "bad", "words": str(error), "refused": self._refused, "mine": False, "enabled": False}
        self._sent_s = now.t_s
        level, words = robot_words(now, mine=mine)
        return {
            "t": now.t_s,
            "instance": session.service.authority.instance,
            "level": level,
            "words": f"{SIGNS[level]} {words}",
            "refused": self._refused or not_recorded(session.service.recording_failed),
            "stopped": now.robot is RobotState.STOPPED,
            "mine": mine,
            "enabled": enabled,
            "override": session.override,
            "drives": person_of(self._socket).role == "drive",
            "line": session.service.stop_port,
            "key": self._key,
        }


def not_recorded(failed: str) -> str:
    """Return what an operator has to know of a disk that takes no more; empty while it does."""
    return texts.NOT_RECORDED.format(why=failed) if failed else ""


LEVELS = {RobotState.READY: "good", RobotState.MOVING: "warn"}


def robot_words(status: RobotStatus, *, mine: bool) -> tuple[str, str]:
    """Return the level (good, warn, bad, idle) and the words of a robot's status; mine: whether who reads it drives."""
    level, words = LEVELS.get(status.robot, "bad"), texts.ROBOT[status.robot]
    if status.robot is RobotState.STOPPED and status.why:
        words = texts.STOPPED_WHY.format(why=status.why)
    elif status.guard is GuardState.HOLDING and status.why:
        level, words = "warn", texts.HOLDING.format(why=status.why)
    if status.driver and not mine:
        words = f"{words}. {texts.DRIVES.format(who=status.driver)}"
    return level, words
