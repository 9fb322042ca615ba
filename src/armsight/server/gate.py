"""The door of pages: whoever asks is known, or is asked for their token, which the browser then keeps."""

from __future__ import annotations

from html import escape
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from armsight.server.auth import COOKIE, Authenticator, Denied, caller_of
from armsight.server.limited import known_as

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
