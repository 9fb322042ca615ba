"""The listening socket, and what a browser sees that comes before the pages are there: what is waited for.

Imports nothing that takes long, so that it is there first.
"""

from __future__ import annotations

import contextlib
import html
import select
import socket
import threading
from collections.abc import Iterator

from armsight.errors import DeviceFailed

BACKLOG = 128
"""Connections that wait to be taken."""
PATIENCE_S = 0.5
"""For a request to come: those behind it wait."""
MOST_BYTES = 8192
PAGE = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="1">'
    '<meta name="viewport" content="width=device-width,initial-scale=1"><title>{title}</title>'
    "<style>body{{font:18px/1.5 system-ui,sans-serif;margin:18vh auto;max-width:34em;padding:0 1em;"
    "color-scheme:light dark}}"
    '</style></head><body><h1>{title}</h1><p role="status" data-testid="waiting">{step}</p></body></html>'
)
HEAD = (
    "HTTP/1.1 503 Service Unavailable\r\ncontent-type: text/html; charset=utf-8\r\ncontent-length: {length}\r\n"
    "retry-after: 1\r\ncache-control: no-store\r\nx-frame-options: DENY\r\nx-content-type-options: nosniff\r\n"
    "content-security-policy: default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'\r\n"
    "connection: close\r\n\r\n"
)


@contextlib.contextmanager
def listening(bind: str, port: int) -> Iterator[socket.socket]:
    """Hold the listening socket while the block runs. Raises DeviceFailed where the address cannot be had."""
    try:
        family, *_, where = socket.getaddrinfo(bind, port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server((str(where[0]), int(where[1])), family=family, backlog=BACKLOG)
    except (OSError, OverflowError) as error:
        raise DeviceFailed(
            f"cannot listen at {bind}, port {port}: {error}",
            consequence="Nothing is served",
            cure="Choose another port with --port, or an address of this machine with --bind",
        ) from error
    with listener:
        yield listener


class WaitingPage:
    """Answers at a listening socket with the step that is being done, until it is closed; then a server takes over.

    503, so that programs do not take it for the page; callers are answered one after the other.
    """

    def __init__(self, listener: socket.socket, title: str) -> None:
        self.listener, self._title, self._step = listener, title, ""
        self._end, self._ended = socket.socketpair()
        self._thread = threading.Thread(target=self._answer, name="armsight-waiting", daemon=True)
        self._thread.start()

    def step(self, words: str) -> None:
        """Say what is being done now."""
        self._step = words

    def close(self) -> None:
        """End, once or again; who has not been answered is left in the queue for the server."""
        if self._thread.is_alive():
            self._end.send(b"x")
            self._thread.join()
            self._end.close()
            self._ended.close()

    def _answer(self) -> None:
        while True:
            ready, _, _ = select.select([self.listener, self._ended], [], [])
            if self._ended in ready:
                return
            with contextlib.suppress(OSError):  # a caller that went
                caller, _ = self.listener.accept()
                with caller:
                    caller.settimeout(PATIENCE_S)
                    caller.recv(MOST_BYTES)
                    caller.sendall(self._page())

    def _page(self) -> bytes:
        text = PAGE.format(title=html.escape(self._title), step=html.escape(self._step)).encode()
        return HEAD.format(length=len(text)).encode() + text


@contextlib.contextmanager
def waiting_page(bind: str, port: int, title: str, *, secure: bool) -> Iterator[WaitingPage]:
    """Listen, and give the page that answers until closed; secure: callers speak TLS. Raises DeviceFailed."""
    with listening(bind, port) as listener:
        page = WaitingPage(listener, title)
        try:
            if secure:
                page.close()
            yield page
        finally:
            page.close()
