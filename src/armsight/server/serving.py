"""Serving a robot: which addresses are safe, the listening socket, and the web server on it."""

from __future__ import annotations

import contextlib
import logging
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp

from armsight.app.robot.service import Service
from armsight.drivers.remote import protocol as say
from armsight.errors import BadFile, DeviceFailed, UsageError
from armsight.server.application import create_app
from armsight.server.auth import Authenticator, is_loopback
from armsight.server.gate import Gate
from armsight.store.tokens import TokenEntry, read_tokens

LOOPBACK = "127.0.0.1"
PORT = 8765

PING_S = 5.0
"""A client whose machine is gone without a word is noticed within twice this; the robot is held long before."""

REQUESTS = 64
"""Requests and connections that the web server handles at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """Where a server listens, who may come in, and its certificate."""

    bind: str = LOOPBACK
    port: int = PORT
    tokens: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    @property
    def scheme(self) -> str:
        """The scheme of its WebSockets."""
        return "ws" if self.tls_cert is None else "wss"


def check_options(options: ServeOptions) -> tuple[TokenEntry, ...]:
    """Return the tokens of options that are safe.

    Raises UsageError for an address beyond this machine without TLS and tokens, BadFile for wrong files.
    """
    if (options.tls_cert is None) != (options.tls_key is None):
        raise UsageError(
            "a certificate needs its key, and a key its certificate",
            consequence="Nothing is served",
            cure="Give both --tls-cert and --tls-key",
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


def serve(service: Service, options: ServeOptions, *, ready: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM; ready is called with the address, ws://HOST:PORT, once it listens.

    Raises as check_options; DeviceFailed where the address cannot be had.
    """
    tokens = check_options(options)
    with listening(options) as listener:
        server = _server(service, Authenticator(tokens), options)
        ready(_url(options, listener))
        server.run(sockets=[listener])


def serve_pages(app: FastAPI, options: ServeOptions, listener: socket.socket, *, ready: Callable[[str], None]) -> None:
    """Serve an application with pages, behind the gate, until SIGINT or SIGTERM; ready is called with http://HOST:PORT.

    listener: of listening, opened before anything that takes long, so that a port in use is told at once. Raises as
    check_options.
    """
    tokens = check_options(options)
    gate = Gate(app, Authenticator(tokens), secure=options.tls_cert is not None)
    server = _web_server(gate, options)
    ready(_url(options, listener).replace("ws", "http", 1))
    server.run(sockets=[listener])


@contextlib.contextmanager
def background(service: Service, options: ServeOptions | None = None) -> Iterator[str]:
    """Serve from a thread while the block runs; gives the address. Raises as serve."""
    options = options or ServeOptions(port=0)
    tokens = check_options(options)
    with listening(options) as listener:
        server = _server(service, Authenticator(tokens), options)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="armsight-serve")
        thread.start()
        try:
            yield _url(options, listener)
        finally:
            server.should_exit = True
            thread.join()


class _ComingsAndGoingsAreNoError(logging.Filter):
    """Leaves out what uvicorn says of clients that were kept out as they should be, or went before an answer came."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether the record is kept."""
        if record.msg == "ASGI callable returned without completing handshake.":
            return False  # the log of ours has it
        error = record.exc_info[1] if record.exc_info else None
        return not (isinstance(error, RuntimeError) and str(error) == "No response returned.")


_QUIET = _ComingsAndGoingsAreNoError()


def _server(service: Service, auth: Authenticator, options: ServeOptions) -> uvicorn.Server:
    return _web_server(create_app(service, auth), options)


def _web_server(app: ASGIApp, options: ServeOptions) -> uvicorn.Server:
    logging.getLogger("uvicorn.error").addFilter(_QUIET)
    config = uvicorn.Config(
        app,
        http="h11",
        ws="websockets-sansio",
        ws_max_size=say.MAX_BYTES,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_per_message_deflate=False,  # a small message must not unpack to a large one
        proxy_headers=False,  # a client must not choose the address that its failures are counted by
        server_header=False,
        access_log=False,
        log_config=None,
        lifespan="on",
        limit_concurrency=REQUESTS,
        timeout_graceful_shutdown=2,
        ssl_certfile=options.tls_cert,
        ssl_keyfile=options.tls_key,
    )
    return uvicorn.Server(config)


@contextlib.contextmanager
def listening(options: ServeOptions) -> Iterator[socket.socket]:
    """Hold the listening socket while the block runs. Raises DeviceFailed where the address cannot be had."""
    try:
        family, *_, where = socket.getaddrinfo(options.bind, options.port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server((str(where[0]), int(where[1])), family=family, backlog=REQUESTS)
    except (OSError, OverflowError) as error:
        raise DeviceFailed(
            f"cannot listen at {options.bind}, port {options.port}: {error}",
            consequence="Nothing is served",
            cure="Choose another port with --port, or an address of this machine with --bind",
        ) from error
    with listener:
        yield listener


def _url(options: ServeOptions, listener: socket.socket) -> str:
    host = f"[{options.bind}]" if ":" in options.bind else options.bind
    return f"{options.scheme}://{host}:{listener.getsockname()[1]}"


def _check_certificate(cert: Path, key: Path) -> None:
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(cert, key)
    except OSError as error:  # ssl.SSLError is one
        raise BadFile(
            f"{cert} and {key} are no certificate with its key: {error.strerror or error}",
            consequence="Nothing is served",
            cure="Give both as PEM files that belong together",
        ) from error
