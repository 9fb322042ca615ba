"""Who looks at a page, and what browsers fetch and send besides pages: pictures, files, reports."""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

from fastapi import FastAPI, HTTPException, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, PlainTextResponse
from nicegui import Client, ui
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from armsight.app.live.station import Snapshot, picture_view
from armsight.console import texts
from armsight.console.state import Console
from armsight.control.session.operator_session import Person
from armsight.defaults import LOOK_S
from armsight.errors import ArmsightError, UsageError
from armsight.store.atomic import write_bytes

IDENTITY = "armsight.identity"
"""Where the server that lets callers in puts who they are into a request's scope."""

PAGE_NAME = "armsight.page"
"""Where a page's name is kept: not NiceGUI's own, which stands in the address of its socket."""


def person_of(connection: HTTPConnection | None) -> Person:
    """Return who asks, as it is now; where nobody is checked, because only this machine is served, its operator."""
    return person_in({} if connection is None else connection.scope)


def person_in(scope: Any) -> Person:
    """Return who asked in a request with this scope, and what they may do now."""
    found: Any = scope.get(IDENTITY)
    return Person() if found is None else Person(who=found.who, role=found.role)


def require_login(person: Person) -> None:
    """Raise UsageError where what somebody came in by has ended."""
    if person.role == "none":
        raise UsageError(
            f"the token or the log-in of {person.who} has ended", consequence="Nothing was done", cure="Log in again"
        )


def logged_in(connection: HTTPConnection) -> bool:
    """Return whether somebody came by a log-in, which they can end."""
    return bool(getattr(connection.scope.get(IDENTITY), "logged_in", False))


def page_name() -> str:
    """Return the name of the page that is being built, made where it has none: its robot's connection speaks in it."""
    name: str = ui.context.client.storage.setdefault(PAGE_NAME, secrets.token_urlsafe(16))
    return name


def opener_of(name: str) -> Person | None:
    """Return who opened the page of this name, and what they may do now; None where no such page is open."""
    found = next((client for client in Client.instances.values() if client.storage.get(PAGE_NAME) == name), None)
    return None if found is None else opened_by(found)


def opened_by(page: Client) -> Person | None:
    """Return who opened a page, and what they may do now; None where nobody did."""
    return None if page._request is None else person_in(page._request.scope)


PAGE_POLICY = "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
"""Says nothing of scripts: NiceGUI writes them into its pages, and Vue compiles templates, so that all kinds would have
to be let. What keeps foreign text from being script is that every text is set as text."""

REPORT_POLICY = "sandbox allow-scripts allow-downloads; frame-ancestors 'none'"
"""A report is a page of an origin of its own: whatever stands in it, it reaches neither robot nor console."""

SAID = {
    "content-security-policy": PAGE_POLICY,
    "x-frame-options": "DENY",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}


class SafeHeaders:
    """Adds SAID to every answer over HTTP; what an answer says itself stays."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, and add to its answer."""

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SAID.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, send_safely)


LARGEST_BYTES = 2_000_000
"""Of a file brought: a rig with its covariance has 20 kB, a long table of readings some 100 kB."""
LONGEST_NAME_BYTES = 200
"""Of a file's name: file systems end at 255, and the writer's temporary name is longer."""
NAME = re.compile(r"\w[\w.-]{0,80}\.(ya?ml|csv|urdf)")
REPORT = re.compile(r"(?:\w[\w.-]{0,80}/)?\w[\w.-]{0,80}\.html")
"""A report in the cell's folder, or in a folder inside it."""


def add_files(server: FastAPI, console: Console) -> None:
    """Serve reports at /console/files/NAME.html, and take files there; what is there is never replaced."""

    @server.get("/console/files/{name:path}", include_in_schema=False)
    async def report(name: str) -> FileResponse:
        if not REPORT.fullmatch(name):
            raise HTTPException(404)
        path = (console.folder / name).resolve()
        if not path.is_relative_to(console.folder.resolve()) or not path.is_file():
            raise HTTPException(404)
        return FileResponse(path, media_type="text/html", headers={"content-security-policy": REPORT_POLICY})

    @server.put("/console/files/{name}", include_in_schema=False)
    async def take(name: str, request: Request) -> PlainTextResponse:
        refused = _refused(console.folder, name, person_of(request).role)
        if refused is not None:
            return refused
        data = bytearray()
        async for part in request.stream():
            data += part
            if len(data) > LARGEST_BYTES:
                return PlainTextResponse(texts.TOO_BIG.format(mb=LARGEST_BYTES // 1_000_000), 413)
        refused = _refused(console.folder, name, person_of(request).role)  # it may have taken long
        return refused or _written(console.folder, name, bytes(data))


def _written(folder: Path, name: str, data: bytes) -> PlainTextResponse:
    """Write a file that was brought into the folder; return what is told of it."""
    if not data.strip():
        return PlainTextResponse(texts.EMPTY_FILE.format(name=name), 400)
    try:
        write_bytes(folder / name, data)
    except ArmsightError as error:
        return PlainTextResponse(str(error), 507)
    return PlainTextResponse(texts.UPLOADED.format(name=name))


def _refused(folder: Path, name: str, role: str) -> PlainTextResponse | None:
    """Return why a file of this name is not taken from somebody, None where it may come."""
    if role != "drive":
        return PlainTextResponse(texts.WATCHING, 403)
    if not NAME.fullmatch(name) or len(name.encode()) > LONGEST_NAME_BYTES:
        return PlainTextResponse(texts.NOT_A_NAME.format(name=name[:80]), 400)
    if os.path.lexists(folder / name):  # a link too, wherever it leads
        return PlainTextResponse(texts.EXISTS.format(name=name), 409)
    return None


def reports(folder: Path) -> list[Path]:
    """Return the reports of a cell, relative to its folder, the newest first."""
    found = [path for pattern in ("*.html", "*/*.html") for path in folder.glob(pattern)]
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    names = (path.relative_to(folder) for path in found)
    return [name for name in names if REPORT.fullmatch(name.as_posix())]


WIDEST_PX = 8192
"""What a page that does not say its width gets at most: every camera's picture as it is."""
WIDTH = re.compile(r"[1-9][0-9]{0,5}")


def add_pictures(server: FastAPI, console: Console) -> None:
    """Serve the newest picture of a camera at /console/pictures/NAME, as often as the browser asks.

    Each time it says how wide the picture is on its screen, in px; all get what the widest of them needs. A mirror
    rig's one picture, with what was found of both views in it, is at /console/pictures/complex.
    """
    widths_px: dict[WebSocket, int] = {}

    def ask(socket: WebSocket, text: str) -> None:
        widths_px[socket] = min(int(text), WIDEST_PX) if WIDTH.fullmatch(text) else WIDEST_PX
        if console.station is not None:
            console.station.show_width(max(widths_px.values()))

    @server.websocket("/console/pictures/{side}")
    async def pictures(socket: WebSocket, side: str) -> None:
        if side not in console.pictures:
            await socket.close(code=1008)
            return
        await socket.accept()
        last: Snapshot | None = None
        try:
            with suppress(WebSocketDisconnect):
                ask(socket, await _said(socket))
                while True:
                    asked = asyncio.ensure_future(_said(socket))  # for the next one, or the page is gone
                    try:
                        last = await _newer(console, last, asked)
                        await socket.send_bytes(picture_message(console, last, side))
                        ask(socket, await asked)
                    finally:
                        asked.cancel()
        finally:
            widths_px.pop(socket, None)


def picture_message(console: Console, shown: Snapshot, side: str) -> bytes:
    """Return the length of the findings (uint32, little endian), the findings as JSON, and the JPEG."""
    view = picture_view(shown, side)
    masks = [list(box) for box in console.look.masked.get(side, ())]
    head = json.dumps({**view.to_dict(), "masks": masks}).encode()
    return struct.pack("<I", len(head)) + head + shown.jpegs.get(side, b"")


async def _said(socket: WebSocket) -> str:
    """Return what a page says, nothing where it is no text. Raises WebSocketDisconnect."""
    said = await socket.receive()
    if said["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(said.get("code", 1005))
    if person_of(socket).role == "none":  # what they came in by has ended
        await socket.close(1008, "logged out")
        raise WebSocketDisconnect(1008)
    return said.get("text") or ""


async def _newer(console: Console, last: Snapshot | None, asked: asyncio.Future[str]) -> Snapshot:
    """Return the next newer picture. Raises WebSocketDisconnect where the page goes while none comes."""
    while True:
        if asked.done() and asked.exception() is not None:
            asked.result()
        shown = console.station.shown if console.station is not None else None
        if shown is not None and shown is not last:
            return shown
        await asyncio.sleep(LOOK_S)
