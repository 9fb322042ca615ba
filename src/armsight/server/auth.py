"""The log-ins of browsers: a random id each, which stands for a token as long as that counts, and for a day at most."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections import Counter, OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any, Literal

from starlette.requests import HTTPConnection

from armsight.clock import Clock, SystemClock
from armsight.control.session.channels import SESSION_BYTES, Newest
from armsight.drivers.remote.wire import is_loopback
from armsight.errors import BadFile
from armsight.store.tokens import TokenEntry, read_tokens

DAY_S = 86_400
"""So long a log-in lasts."""

MOST = 400
"""Log-ins at a time; one more, and the oldest of the token that has most of them ends. Each takes 160 bytes."""

ID_BYTES = 32
"""An id is 256 random bits, as a token is: it needs no salt."""


class BrowserSessions:
    """Which token the log-in of a browser stands for. Hashes alone are kept, and no file.

    memory: where they are, which the line for stops reads from its own process; one process writes it. Times are of
    the machine's monotonic clock, which both have.
    """

    def __init__(self, memory: Newest | None = None, *, clock: Clock | None = None) -> None:
        self._memory = memory or Newest(SESSION_BYTES)
        self._clock = clock or SystemClock()
        self._read: bytes | None = None
        self._kept: dict[str, tuple[str, float]] = {}

    @staticmethod
    def digest(session: str) -> str:
        """Return the SHA-256 of an id, in hexadecimal digits."""
        return hashlib.sha256(session.encode("utf-8", "surrogatepass")).hexdigest()

    def begin(self, token: str) -> str:
        """Return the id of a new log-in; token: the SHA-256 of the one that was given."""
        kept = {login: its for login, its in self._now().items() if its[1] > self._clock.now_s()}
        if len(kept) >= MOST:
            most = Counter(its[0] for its in kept.values()).most_common(1)[0][0]
            del kept[next(login for login, its in kept.items() if its[0] == most)]
        made = secrets.token_urlsafe(ID_BYTES)
        self._write({**kept, self.digest(made): (token, self._clock.now_s() + DAY_S)})
        return made

    def token(self, login: str) -> str:
        """Return the SHA-256 of the token that a log-in, by its id's digest, stands for; empty where it has ended."""
        token, until_s = self._now().get(login, ("", 0.0))
        return token if self._clock.now_s() < until_s else ""

    def end(self, session: str) -> None:
        """End the log-in with this id; nothing where there is none."""
        kept, login = self._now(), self.digest(session)
        if login in kept:
            self._write({other: its for other, its in kept.items() if other != login})

    def _now(self) -> dict[str, tuple[str, float]]:
        data = self._memory.read()
        if data != self._read:
            self._read = data
            self._kept = {login: (str(its[0]), float(its[1])) for login, its in json.loads(data or b"{}").items()}
        return self._kept

    def _write(self, kept: dict[str, tuple[str, float]]) -> None:
        self._memory.write(json.dumps(kept).encode())


Role = Literal["watch", "drive"]

FAILURES = 5
"""So many wrong tokens of one address within WINDOW_S, and further wrong ones are answered 429. A right one is let in
all the same: a stop must pass, and guessing is hopeless at 256 random bits, limited or not."""

WINDOW_S = 60.0

ADDRESSES = 1024
"""Addresses with failures that are remembered; the oldest is forgotten first."""

LONGEST_TOKEN = 200

COOKIE, SECURE_COOKIE = "armsight_session", "__Host-armsight_session"
"""In which a browser keeps the id of its log-in: the latter over TLS, which no other host or plain text can set."""

LONGEST_COOKIE = 4096

LOCAL_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
"""What a browser sends as Host for this machine, and nothing that only looks like it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Who it is and what they may do; token: its SHA-256; login: that of a browser's log-in id, else empty."""

    who: str
    role: Role
    token: str = field(default="", compare=False, repr=False)
    login: str = field(default="", compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Denied:
    """Why somebody stays out, with the HTTP status: 401 no valid token, 403 not from there, 429 too many failures."""

    status: int
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """What a request says of itself: its address, its headers Authorization, Host and Origin, its log-in's cookie."""

    address: str
    authorization: str = ""
    session: str = field(default="", repr=False)
    host: str = ""
    origin: str = ""


class Authenticator:
    """Lets callers in by their tokens; without tokens, everyone on this machine may drive.

    A web page of another origin is kept out though its browser runs on this machine: no token is needed there, and a
    WebSocket is not held back by the browser's rule of the same origin.
    """

    def __init__(
        self,
        tokens: Sequence[TokenEntry] | Path = (),
        *,
        clock: Clock | None = None,
        page_port: int | None = None,
        sessions: BrowserSessions | None = None,
    ) -> None:
        """tokens: or their file, which is read anew when it has changed. page_port: of this machine's own pages, where
        they come from another port than they ask. sessions: where browsers' log-ins are kept. Raises BadFile."""
        self._file = tokens if isinstance(tokens, Path) else None
        self._entries = read_tokens(tokens) if isinstance(tokens, Path) else tuple(tokens)
        self._open = self._file is None and not self._entries
        self._read_at = self._stamp()
        self._page_port = page_port
        self._clock = clock or SystemClock()
        self.sessions = sessions or BrowserSessions(clock=self._clock)
        self._failed: OrderedDict[str, deque[float]] = OrderedDict()

    def check(self, caller: Caller) -> Identity | Denied:
        """Return who the caller is, or why they stay out."""
        if caller.origin and not self._own_page(caller):
            return Denied(status=403, why=f"a page of {caller.origin[:80]!r} may not use this server")
        if self._open:
            return self._local(caller)
        found = self._of_token(caller.authorization) if caller.authorization else self._of_session(caller.session)
        if found is not None:
            return found
        if not caller.authorization:  # nothing was tried: a browser that opens a page, or whose log-in has ended
            return Denied(status=401, why="no token")
        if self._waits(caller.address):
            return Denied(status=429, why=f"{FAILURES} wrong tokens within {WINDOW_S:g} s; wait")
        self._note_failure(caller.address)
        return Denied(status=401, why="no valid token")

    def knows(self, who: Identity) -> bool:
        """Tell whether somebody who came in may still do what they may: to be asked for everything that they say."""
        if self._open:
            return True
        if who.login and self.sessions.token(who.login) != who.token:
            return False
        return any(
            (entry.name, _role(entry), entry.sha256) == (who.who, who.role, who.token) for entry in self._tokens()
        )

    def log_in(self, who: Identity) -> str:
        """Return the id of a new log-in of somebody whose token is good, for their browser to keep."""
        return self.sessions.begin(who.token)

    def _of_token(self, authorization: str) -> Identity | None:
        kind, _, token = authorization.partition(" ")
        if kind.lower() != "bearer" or len(token) > LONGEST_TOKEN:
            return None
        # every entry is compared, so that the time does not tell which came near
        matching = [entry for entry in self._tokens() if entry.matches(token.strip())]
        return _identity(matching[0]) if matching else None

    def _of_session(self, session: str) -> Identity | None:
        login = BrowserSessions.digest(session)
        token = self.sessions.token(login) if session else ""
        return next((_identity(entry, login) for entry in self._tokens() if entry.sha256 == token), None)

    def _tokens(self) -> tuple[TokenEntry, ...]:
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


def _identity(entry: TokenEntry, login: str = "") -> Identity:
    return Identity(who=entry.name, role=_role(entry), token=entry.sha256, login=login)


class Visitor:
    """Somebody who came in, as they are at the moment that this is asked: a role may end while a connection lasts."""

    def __init__(self, auth: Authenticator, found: Identity) -> None:
        self._auth, self._found = auth, found

    @property
    def who(self) -> str:
        """Their name."""
        return self._found.who

    @property
    def role(self) -> Role | Literal["none"]:
        """What they may do now; none: their token was taken out or made anew, or their log-in has ended."""
        return self._found.role if self._auth.knows(self._found) else "none"

    @property
    def logged_in(self) -> bool:
        """Whether they came by a log-in, which they can end."""
        return bool(self._found.login)


def is_secure(scope: Any) -> bool:
    """Return whether a request came over TLS."""
    return scope.get("scheme") in ("https", "wss")


def cookie_name(scope: Any) -> str:
    """Return the name of the cookie that holds the log-in of a request's browser."""
    return SECURE_COOKIE if is_secure(scope) else COOKIE


def caller_of(connection: HTTPConnection, token: str = "") -> Caller:
    """Return what a request says of itself; token: one that it brings elsewhere than in its header."""
    headers = connection.headers
    return Caller(
        address=address_of(connection),
        authorization=f"Bearer {token}" if token else headers.get("authorization", ""),
        session=_session_of(connection),
        host=headers.get("host", ""),
        origin=headers.get("origin", ""),
    )


def _session_of(connection: HTTPConnection) -> str:
    cookies: SimpleCookie = SimpleCookie()
    try:
        cookies.load(connection.headers.get("cookie", "")[:LONGEST_COOKIE])
    except CookieError:
        return ""
    found = cookies.get(cookie_name(connection.scope))
    return "" if found is None else found.value[:LONGEST_TOKEN]


def address_of(connection: HTTPConnection) -> str:
    """Return the address that a request comes from."""
    return connection.client.host if connection.client else "unknown"
