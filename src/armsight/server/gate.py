"""The door of pages: it asks for a token, keeps the browser's log-in in a cookie, and ends it."""

from __future__ import annotations

from html import escape
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from armsight.server.auth import DAY_S, Authenticator, Denied, Visitor, caller_of, cookie_name, is_secure
from armsight.server.limited import known_as

IDENTITY = "armsight.identity"
LOGIN, LOGOUT = "/login", "/logout"
LONGEST_BODY = 4096

PAGE = (
    "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>armsight</title>"
    "<meta name='viewport' content='width=device-width'></head><body style='font-family:system-ui;margin:2rem'>"
    "<h1>armsight</h1><p>{why}</p><form method='post' action='/login'><label>Token "
    "<input name='token' type='password' autocomplete='current-password' autofocus></label> "
    "<button>Enter</button></form></body></html>"
)


SAID = {
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; "
    "base-uri 'none'; frame-ancestors 'none'",
}


class Gate:
    """Lets requests through whose token or log-in is good, as a Visitor in scope[IDENTITY]; `/api/` checks its own."""

    def __init__(self, app: ASGIApp, auth: Authenticator) -> None:
        self.app, self._auth = app, auth

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it here."""
        if scope["type"] not in ("http", "websocket") or scope["path"].startswith("/api/"):
            await self.app(scope, receive, send)
            return
        acts = {LOGIN: self._login, LOGOUT: self._logout}
        if scope["type"] == "http" and scope["path"] in acts and scope["method"] == "POST":
            await (await acts[scope["path"]](Request(scope, receive)))(scope, receive, send)
            return
        found = self._auth.check(caller_of(HTTPConnection(scope)))
        if not isinstance(found, Denied):
            known_as(scope, found.who)
            await self.app({**scope, IDENTITY: Visitor(self._auth, found)}, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=found.why[:120])(scope, receive, send)
        else:
            await _denied(found, str(scope["path"]))(scope, receive, send)

    async def _login(self, request: Request) -> Response:
        """Log a browser in whose person has a good token, and lead on; ask again where it is none."""
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > LONGEST_BODY:
                return PlainTextResponse("too long", 413)
        token = parse_qs(body.decode("utf-8", "replace")).get("token", [""])[0].strip()
        found = self._auth.check(caller_of(request, token or "none"))
        if isinstance(found, Denied):
            return _asking(found)
        answer = RedirectResponse("/", status_code=303)
        if found.token:  # else everybody on this machine may come in
            self._auth.sessions.end(caller_of(request).session)
            secure = is_secure(request.scope)
            answer.set_cookie(
                cookie_name(request.scope),
                self._auth.log_in(found),
                max_age=DAY_S,
                httponly=True,
                samesite="strict",
                secure=secure,
            )
        return answer

    async def _logout(self, request: Request) -> Response:
        """End a browser's log-in, and ask who is there."""
        caller = caller_of(request)
        found = self._auth.check(caller)
        if isinstance(found, Denied) and found.status != 401:
            return _asking(found)
        self._auth.sessions.end(caller.session)
        answer = RedirectResponse("/", status_code=303)
        answer.delete_cookie(
            cookie_name(request.scope), httponly=True, samesite="strict", secure=is_secure(request.scope)
        )
        return answer


def _denied(denied: Denied, path: str) -> Response:
    """Ask for the token where a page was wanted; refuse all else."""
    asks = denied.status == 401 and "." not in path.rpartition("/")[2]
    return _asking(denied) if asks else PlainTextResponse(denied.why, denied.status)


def _asking(denied: Denied) -> Response:
    why = "Who are you? Enter your token." if denied.why == "no token" else denied.why
    return HTMLResponse(PAGE.format(why=escape(why)), denied.status, headers=SAID)
