"""The web application of a robot server: state over HTTP, watching and driving over WebSockets."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from html import escape
from typing import Annotated, Any

from fastapi import Depends, FastAPI, HTTPException, Request, WebSocket
from fastapi.responses import HTMLResponse

from armsight.control.session.service import Service
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError
from armsight.server.auth import Authenticator, Identity, address_of, caller_of
from armsight.server.limited import known_as
from armsight.server.messages import state_message
from armsight.server.sockets import Connection

PUMP_S = 0.02
"""How often the loop's events are fetched."""


async def known(request: Request) -> Identity:
    """Return who asks. Raises HTTPException for whom the server does not know; each refusal is kept in the log."""
    found = request.app.state.auth.check(caller_of(request))
    if isinstance(found, Identity):
        known_as(request.scope, found.who)
        return found
    request.app.state.service.authority.note("warning", f"{address_of(request)} was kept out: {found.why}")
    raise HTTPException(found.status, found.why, headers={"WWW-Authenticate": "Bearer"})


Known = Annotated[Identity, Depends(known)]


def create_app(service: Service, auth: Authenticator) -> FastAPI:
    """Return the application; other pages, such as the console's, may be mounted on it (app.mount, nicegui.run_with).

    service: the robot's control authority, host and log; it is opened and closed by the caller, and its events are
    pumped while the application runs. A page mounted here drives through service.authority, as the connections do.
    """
    app = FastAPI(
        title="armsight robot server",
        version=f"{say.VERSION}.0",
        description="The state of a robot. Watching and driving go over WebSockets; see /api/v1/protocol.",
        docs_url=None,
        redoc_url=None,
        lifespan=_pumping(service),
    )
    app.state.service, app.state.auth = service, auth

    @app.get(say.STATE_PATH, summary="The state of robot and loop")
    async def state(_: Known) -> say.StateMessage:
        try:
            return state_message(service.authority.status(), service.authority.instance)
        except ArmsightError as error:
            raise HTTPException(503, str(error)) from error

    @app.get(f"/api/v{say.VERSION}/protocol", summary="JSON schema of the messages on the WebSockets")
    async def protocol(_: Known) -> dict[str, Any]:
        return say.protocol_schema()

    @app.get("/docs", response_class=HTMLResponse, include_in_schema=False)
    async def docs() -> str:
        return openapi_page(app.openapi())

    @app.websocket(say.STREAM_PATH)
    async def stream(socket: WebSocket) -> None:
        await Connection(service, auth, socket, caller_of(socket), role="watch").serve()

    @app.websocket(say.DRIVE_PATH)
    async def drive(socket: WebSocket) -> None:
        await Connection(service, auth, socket, caller_of(socket), role="drive").serve()

    return app


def openapi_page(schema: dict[str, Any]) -> str:
    """Return the OpenAPI description as a page that needs nothing from elsewhere: a robot's cell is often offline."""
    rows = "".join(
        f"<tr><td>{escape(method.upper())}</td><td><code>{escape(path)}</code></td>"
        f"<td>{escape(operation.get('summary', ''))}</td></tr>"
        for path, methods in schema["paths"].items()
        for method, operation in methods.items()
    )
    sockets = "".join(
        f"<tr><td>WebSocket</td><td><code>{path}</code></td><td>{what}</td></tr>"
        for path, what in ((say.STREAM_PATH, "Watch, and stop"), (say.DRIVE_PATH, "Drive: one client at a time"))
    )
    title = escape(schema["info"]["title"])
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{title}</title></head><body>"
        f"<h1>{title}</h1><p>{escape(schema['info']['description'])}</p>"
        f"<table><tr><th>Method</th><th>Path</th><th>What</th></tr>{rows}{sockets}</table>"
        "<p>Machines read <a href='/openapi.json'>/openapi.json</a>.</p></body></html>"
    )


def _pumping(service: Service) -> Any:
    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        task = asyncio.create_task(_pump(service))
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    return lifespan


async def _pump(service: Service) -> None:
    while True:
        service.pump()
        await asyncio.sleep(PUMP_S)
