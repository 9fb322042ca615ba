"""The web server: which addresses are safe to listen at, the listening socket, and uvicorn with our limits."""

from __future__ import annotations

import functools
import logging
import math
import os
import socket
import ssl
import stat
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import uvicorn
from starlette.types import ASGIApp

from armsight.drivers.remote import protocol as say
from armsight.drivers.remote.wire import is_loopback
from armsight.errors import BadFile, UsageError
from armsight.server.connections import HEAD_BYTES, Connections, ListeningSocket
from armsight.server.limited import LimitedHttp, LimitedWebSocket
from armsight.store.tokens import TokenEntry, read_tokens

if TYPE_CHECKING:
    from armsight.ops.requests.plant import Publishing

LOOPBACK = "127.0.0.1"
PORT = 8765

PING_S = 5.0
"""A client whose machine is gone without a word is noticed within twice this; the robot is held long before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """Where a server listens, who may come in, and its certificate.

    stop_port: of the line for stops; None: the one after port, or any that is free. plant: what the plant's systems are
    told besides.
    """

    bind: str = LOOPBACK
    port: int = PORT
    stop_port: int | None = None
    tokens: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    plant: Publishing | None = None

    @property
    def scheme(self) -> str:
        """The scheme of its WebSockets."""
        return "ws" if self.tls_cert is None else "wss"


def check_options(options: ServeOptions) -> tuple[TokenEntry, ...]:
    """Return the tokens of safe options. Raises UsageError for far addresses without TLS and tokens, BadFile."""
    if (options.tls_cert is None) != (options.tls_key is None):
        raise UsageError(
            "a certificate needs its key, and a key its certificate", cure="Give both --tls-cert and --tls-key"
        )
    missing = [
        flag
        for flag, given in (("--tls-cert and --tls-key", options.tls_cert), ("--tokens", options.tokens))
        if not given
    ]
    if missing and not is_loopback(options.bind):
        raise UsageError(
            f"the address {options.bind} can be reached from other machines, without {' and '.join(missing)}",
            consequence="Anyone there could move the robot; nothing is served",
            cure=f"Give {' and '.join(missing)}, or leave --bind away to serve this machine only",
        )
    if options.tls_cert is not None and options.tls_key is not None:
        _check_certificate(options.tls_cert, options.tls_key)
    return () if options.tokens is None else read_tokens(options.tokens)


def web_server(
    app: ASGIApp, options: ServeOptions, connections: Connections, *, lifespan: bool = True
) -> uvicorn.Server:
    """Return the server of an application, with the limits of connections."""
    logging.getLogger("uvicorn.error").addFilter(_QUIET)
    for name, its in _BOUNDED.items():
        logging.getLogger(name).addFilter(its)
    config = uvicorn.Config(
        app,
        http=functools.partial(LimitedHttp, connections=connections),  # type: ignore[arg-type]
        ws=functools.partial(LimitedWebSocket, connections=connections),  # type: ignore[arg-type]
        loop="asyncio",  # whose listening socket is ours: it counts and ends those that hang in a handshake
        h11_max_incomplete_event_size=HEAD_BYTES,
        ws_max_size=say.MAX_BYTES,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_per_message_deflate=False,  # a small message must not unpack to a large one
        proxy_headers=False,  # a client must not choose the address that its failures are counted by
        server_header=False,
        headers=[("x-frame-options", "DENY"), ("x-content-type-options", "nosniff")],
        access_log=False,
        log_config=None,
        lifespan="on" if lifespan else "off",
        timeout_graceful_shutdown=2,
        ssl_certfile=options.tls_cert,
        ssl_keyfile=options.tls_key,
    )
    return _Server(config, connections)


class _Server(uvicorn.Server):
    """A server whose connections are counted from their first moment."""

    def __init__(self, config: uvicorn.Config, connections: Connections) -> None:
        super().__init__(config)
        self._connections = connections

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        doors: list[socket.socket] = [ListeningSocket(one, self._connections) for one in sockets or ()]
        await super().startup(doors)


class _ComingsAndGoingsAreNoError(logging.Filter):
    """Leaves out what uvicorn says of clients that were kept out as they should be, or went before an answer came."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether the record is kept."""
        if record.msg == "ASGI callable returned without completing handshake.":
            return False  # the log of ours has it
        error = record.exc_info[1] if record.exc_info else None
        return not (isinstance(error, RuntimeError) and str(error) == "No response returned.")


_QUIET = _ComingsAndGoingsAreNoError()

RECORDS_PER_MIN = 20
"""Of one package's log: a traceback has 5 kB, so that whoever provokes one fills 100 kB a minute and package."""


class BoundedLog(logging.Filter):
    """Lets RECORDS_PER_MIN through; of what comes beyond them the number is told with the next one."""

    def __init__(self) -> None:
        super().__init__()
        self._begun_s, self._count = -math.inf, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether the record is kept."""
        now_s = time.monotonic()
        if now_s - self._begun_s > 60.0:
            left_out, self._begun_s, self._count = self._count - RECORDS_PER_MIN, now_s, 0
            if left_out > 0:
                record.msg, record.args = f"{record.getMessage()} ({left_out} before it were left out)", ()
        self._count += 1
        return self._count <= RECORDS_PER_MIN


_PROVOKED = ("uvicorn.error", "asyncio", "nicegui", "engineio.server", "socketio.server", "armsight.console")
"""The logs of what callers can provoke."""

_BOUNDED = {name: BoundedLog() for name in _PROVOKED}


def _check_certificate(cert: Path, key: Path) -> None:
    """Raise BadFile for files that are no pair, and for a key that others may read or write."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(cert, key)
        mode = key.stat().st_mode
    except OSError as error:  # ssl.SSLError is one
        raise BadFile(
            f"{cert} and {key} are no certificate with its key: {error.strerror or error}",
            consequence="Nothing is served",
            cure="Give both as PEM files that belong together",
        ) from error
    if os.name == "posix" and mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
        raise BadFile(
            f"{key}: others than its owner may {'read' if mode & stat.S_IROTH else 'write'} it",
            consequence="Anyone of them could pose as this server; nothing is served",
            cure=f"chmod 600 {key}",
        )
