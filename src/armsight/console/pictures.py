"""Pictures to the browser: one message holds a JPEG and what was found in it; the browser asks for each."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from contextlib import suppress

from fastapi import FastAPI, WebSocket, WebSocketDisconnect

from armsight.app.live.measurement import COMPLEX
from armsight.app.live.station import Shown
from armsight.app.live.views import complex_view
from armsight.console.state import Console

LOOK_S = 0.005
"""Time between two looks for a newer picture."""
SIDES = ("left", "right", COMPLEX)
WIDEST_PX = 8192
"""What a page that does not say its width gets at most: every camera's picture as it is."""
WIDTH = re.compile(r"[1-9][0-9]{0,5}")


def add_pictures(server: FastAPI, console: Console) -> None:
    """Serve the newest picture of a side at /console/pictures/left and /right, as often as the browser asks.

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
        if side not in SIDES:
            await socket.close(code=1008)
            return
        await socket.accept()
        last: Shown | None = None
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


def picture_message(console: Console, shown: Shown, side: str) -> bytes:
    """Return the length of the findings (uint32, little endian), the findings as JSON, and the JPEG."""
    if side == COMPLEX:
        view, data = complex_view(shown.view), shown.left_jpeg
    else:
        view, data = (shown.view.left, shown.left_jpeg) if side == "left" else (shown.view.right, shown.right_jpeg)
    masks = [list(box) for box in console.look.masked.get(side, ())]
    head = json.dumps({**view.to_dict(), "masks": masks}).encode()
    return struct.pack("<I", len(head)) + head + data


async def _said(socket: WebSocket) -> str:
    """Return what a page says, nothing where it is no text. Raises WebSocketDisconnect."""
    said = await socket.receive()
    if said["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(said.get("code", 1005))
    return said.get("text") or ""


async def _newer(console: Console, last: Shown | None, asked: asyncio.Future[str]) -> Shown:
    """Return the next newer picture. Raises WebSocketDisconnect where the page goes while none comes."""
    while True:
        if asked.done() and asked.exception() is not None:
            asked.result()
        shown = console.station.shown if console.station is not None else None
        if shown is not None and shown is not last:
            return shown
        await asyncio.sleep(LOOK_S)
