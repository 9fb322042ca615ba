"""The console as a web application: NiceGUI pages on a FastAPI server, which a browser needs nothing else for."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.resources import files

from fastapi import FastAPI, Request
from fastapi.responses import RedirectResponse
from fastapi.staticfiles import StaticFiles
from nicegui import app, ui
from starlette.applications import Starlette

from armsight.console import texts
from armsight.console.layout import STATIC, notice, page, text_of
from armsight.console.page_socket import PageSocket
from armsight.console.pages.calibrate import calibrate_page
from armsight.console.pages.cell import cell_page
from armsight.console.pages.identify import identify_page
from armsight.console.pages.live import live_page
from armsight.console.pages.settings import settings_page
from armsight.console.pages.teach import teach_page
from armsight.console.pages.verify import verify_page
from armsight.console.robot_link import add_robot_link
from armsight.console.routes import SafeHeaders, add_files, add_pictures, person_of
from armsight.console.state import Console

PAGES: dict[str, Callable[[Console], None]] = {
    "live": live_page,
    "calibrate": calibrate_page,
    "cell": cell_page,
    "identify": identify_page,
    "teach": teach_page,
    "verify": verify_page,
    "settings": settings_page,
}

WATCHED: dict[str, Callable[[Console], None]] = {"live": partial(live_page, watching=True)}
"""What who may watch gets: pages without anything that changes the cell."""


def add_console(server: FastAPI, console: Console) -> None:
    """Add the console's pages to a server: /live and its sisters; / leads to /live."""
    server.add_middleware(PageSocket, note=console.note)
    server.add_middleware(SafeHeaders)
    server.mount(STATIC, StaticFiles(directory=str(files("armsight") / "console" / "static")))
    add_pictures(server, console)
    add_files(server, console)
    add_robot_link(server, console)

    @server.get("/", include_in_schema=False)
    def root() -> RedirectResponse:
        return RedirectResponse("/live")

    for name, build in PAGES.items():
        _add_page(name, build, console)
    app.on_page_exception(lambda: text_of("p", texts.PAGE_FAILED))  # what went wrong is for the log, not for callers
    server.mount("/api", Starlette())  # what is no path there is told so here: a page of NiceGUI would be kept for it
    ui.run_with(server, title=texts.TITLE, dark=None, show_welcome_message=False, tailwind=False)
    app.config.socket_io_js_transports = ["websocket"]


def _add_page(name: str, build: Callable[[Console], None], console: Console) -> None:
    @ui.page(f"/{name}", title=f"{texts.PAGES[name]} · {texts.TITLE}")
    def show(request: Request) -> None:
        person = person_of(request)
        with page(name, console):
            (build if person.role == "drive" else WATCHED.get(name, _not_for_watchers))(console)


def _not_for_watchers(_: Console) -> None:
    notice(texts.WATCHING)
