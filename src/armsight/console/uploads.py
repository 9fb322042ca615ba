"""Files of a cell: reports to look at, and tables and models that a person brings."""

from __future__ import annotations

import os
import re
from pathlib import Path

from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse, PlainTextResponse

from armsight.console import texts
from armsight.console.headers import REPORT_POLICY
from armsight.console.robot_link import person_of
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.store.atomic import write_bytes

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
        if not data.strip():
            return PlainTextResponse(texts.EMPTY_FILE.format(name=name), 400)
        try:
            write_bytes(console.folder / name, bytes(data))
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
