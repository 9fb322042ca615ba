"""Who may come in: tokens, addresses, where pages come from; and the door of pages, which asks for a token."""

from __future__ import annotations

import re
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from http.cookies import SimpleCookie
from ipaddress import ip_address
from pathlib import Path
from typing import Literal
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from armsight.clock import Clock, SystemClock
from armsight.errors import BadFile
from armsight.server.limited import known_as
from armsight.store.tokens import TokenEntry, read_tokens

Role = Literal["watch", "drive"]

FAILURES = 5
"""So many wrong tokens of one address within WINDOW_S, and it has to wait."""

WINDOW_S = 60.0

ADDRESSES = 1024
"""Addresses with failures that are remembered; the oldest is forgotten first."""

LONGEST_TOKEN = 200

COOKIE = "armsight_token"
"""In which a browser keeps its token."""

LONGEST_COOKIE = 4096

LOCAL_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
"""What a browser sends as Host for this machine, and nothing that only looks like it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Who it is and what they may do."""

    who: str
    role: Role


@dataclass(frozen=True, slots=True, kw_only=True)
class Denied:
    """Why somebody stays out, with the HTTP status: 401 no valid token, 403 not from there, 429 too many failures."""

    status: int
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """What a request says of itself: its address and its headers Authorization, Host and Origin."""

    address: str
    authorization: str = ""
    host: str = ""
    origin: str = ""


class Authenticator:
    """Lets callers in by their tokens; without tokens, everyone on this machine may drive.

    A web page of another origin is kept out though its browser runs on this machine: no token is needed there, and a
    WebSocket is not held back by the browser's rule of the same origin.
    """

    def __init__(
        self, tokens: Sequence[TokenEntry] | Path = (), *, clock: Clock | None = None, page_port: int | None = None
    ) -> None:
        """tokens: or their file, which is read anew when it has changed. page_port: of this machine's own pages, where
        they come from another port than they ask. Raises BadFile."""
        self._file = tokens if isinstance(tokens, Path) else None
        self._entries = read_tokens(tokens) if isinstance(tokens, Path) else tuple(tokens)
        self._open = self._file is None and not self._entries
        self._read_at = self._stamp()
        self._page_port = page_port
        self._clock = clock or SystemClock()
        self._failed: OrderedDict[str, deque[float]] = OrderedDict()

    def check(self, caller: Caller) -> Identity | Denied:
        """Return who the caller is, or why they stay out."""
        if caller.origin and not self._own_page(caller):
            return Denied(status=403, why=f"a page of {caller.origin[:80]!r} may not use this server")
        if self._open:
            return self._local(caller)
        if self._waits(caller.address):
            return Denied(status=429, why=f"{FAILURES} wrong tokens within {WINDOW_S:g} s; wait")
        kind, _, token = caller.authorization.partition(" ")
        found = self._entry(token.strip()) if kind.lower() == "bearer" and len(token) <= LONGEST_TOKEN else None
        if found is None:
            if not caller.authorization:  # nothing was tried: a browser that opens a page for the first time
                return Denied(status=401, why="no token")
            self._note_failure(caller.address)
            return Denied(status=401, why="no valid token")
        return Identity(who=found.name, role=_role(found))

    def knows(self, who: Identity) -> bool:
        """Tell whether somebody who came in may still do what they may."""
        return self._open or any((entry.name, _role(entry)) == (who.who, who.role) for entry in self._tokens())

    def _tokens(self) -> tuple[TokenEntry, ...]:
        """Return the tokens as they are now; none while their file cannot be read, and nobody comes in."""
        stamp = self._stamp()
        if stamp != self._read_at and self._file is not None:
            try:
                self._entries = read_tokens(self._file)
            except (BadFile, OSError):
                self._entries = ()
            self._read_at = stamp
        return self._entries

    def _stamp(self) -> tuple[int, int] | None:
        try:
            found = None if self._file is None else self._file.stat()
        except OSError:
            return (0, 0)
        return None if found is None else (found.st_mtime_ns, found.st_ino)

    def _own_page(self, caller: Caller) -> bool:
        """Tell whether the page that asks is one of this server."""
        scheme, _, origin = caller.origin.lower().partition("://")
        host = caller.host.lower()
        if self._page_port is not None:
            host = re.sub(r":[0-9]+$", "", host)
            if self._page_port != {"http": 80, "https": 443}.get(scheme):  # which browsers leave away
                host = f"{host}:{self._page_port}"
        return origin == host

    def _local(self, caller: Caller) -> Identity | Denied:
        """Let in who is on this machine and asked for this machine: a foreign name that leads here is a trick."""
        if LOCAL_HOST.fullmatch(caller.host) is None or not is_loopback(caller.address):
            return Denied(status=403, why="without tokens only this machine may use the server, by the name localhost")
        return Identity(who="local", role="drive")

    def _entry(self, token: str) -> TokenEntry | None:
        """Return the token's entry; every entry is compared, so that the time does not tell which came near."""
        matching = [entry for entry in self._tokens() if entry.matches(token)]
        return matching[0] if matching else None

    def _waits(self, address: str) -> bool:
        failed = self._failed.get(address)
        if failed is None:
            return False
        while failed and self._clock.now_s() - failed[0] > WINDOW_S:
            failed.popleft()
        return len(failed) >= FAILURES

    def _note_failure(self, address: str) -> None:
        self._failed.setdefault(address, deque(maxlen=FAILURES)).append(self._clock.now_s())
        self._failed.move_to_end(address)
        while len(self._failed) > ADDRESSES:
            self._failed.popitem(last=False)


def _role(entry: TokenEntry) -> Role:
    """Return what a token allows here, where there is nothing to acknowledge."""
    return "drive" if entry.role == "drive" else "watch"


def caller_of(connection: HTTPConnection, token: str = "") -> Caller:
    """Return what a request says of itself; token: one that it brings elsewhere than in its header or its cookie."""
    headers = connection.headers
    said = headers.get("authorization", "")
    if not said and not token:
        cookies: SimpleCookie = SimpleCookie()
        cookies.load(headers.get("cookie", "")[:LONGEST_COOKIE])
        token = cookies[COOKIE].value if COOKIE in cookies else ""
    if token and len(token) <= LONGEST_TOKEN:
        said = f"Bearer {token}"
    return Caller(
        address=address_of(connection),
        authorization=said,
        host=headers.get("host", ""),
        origin=headers.get("origin", ""),
    )


def address_of(connection: HTTPConnection) -> str:
    """Return the address that a request comes from."""
    return connection.client.host if connection.client else "unknown"


def is_loopback(address: str) -> bool:
    """Return whether an address or localhost is this machine itself; any other name may lead elsewhere."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False


IDENTITY = "armsight.identity"
LOGIN = "/login"
LONGEST_BODY = 4096
DAY_S = 86_400

PAGE = (
    "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>armsight</title>"
    "<meta name='viewport' content='width=device-width'></head><body style='font-family:system-ui;margin:2rem'>"
    "<h1>armsight</h1><p>{why}</p><form method='post' action='/login'><label>Token "
    "<input name='token' type='password' autocomplete='current-password' autofocus></label> "
    "<button>Enter</button></form></body></html>"
)


class Gate:
    """Lets requests through whose token is good, in the header or in the cookie; the paths `/api/` check their own.

    Who it is stands in scope[IDENTITY].
    """

    def __init__(self, app: ASGIApp, auth: Authenticator, *, secure: bool) -> None:
        """secure: whether pages are served over TLS, and the cookie is for it alone."""
        self.app, self._auth, self._secure = app, auth, secure

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it here."""
        if scope["type"] not in ("http", "websocket") or scope["path"].startswith("/api/"):
            await self.app(scope, receive, send)
            return
        if scope["type"] == "http" and scope["path"] == LOGIN and scope["method"] == "POST":
            await (await self._login(Request(scope, receive)))(scope, receive, send)
            return
        found = self._auth.check(caller_of(HTTPConnection(scope)))
        if not isinstance(found, Denied):
            known_as(scope, found.who)
            await self.app({**scope, IDENTITY: found}, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=found.why[:120])(scope, receive, send)
        else:
            await _denied(found, str(scope["path"]))(scope, receive, send)

    async def _login(self, request: Request) -> Response:
        """Keep a good token in the browser, and lead on; ask again where it is none."""
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > LONGEST_BODY:
                return PlainTextResponse("too long", 413)
        token = parse_qs(body.decode("utf-8", "replace")).get("token", [""])[0].strip()
        found = self._auth.check(caller_of(request, token))
        if isinstance(found, Denied):
            return _asking(found)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(COOKIE, token, max_age=DAY_S, httponly=True, samesite="strict", secure=self._secure)
        return answer


def _denied(denied: Denied, path: str) -> Response:
    """Ask for the token where a page was wanted; refuse all else."""
    asks = denied.status == 401 and "." not in path.rpartition("/")[2]
    return _asking(denied) if asks else PlainTextResponse(denied.why, denied.status)


def _asking(denied: Denied) -> Response:
    why = "Who are you? Enter your token." if denied.why == "no token" else denied.why
    return HTMLResponse(PAGE.format(why=escape(why)), denied.status)
