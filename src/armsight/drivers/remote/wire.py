"""One WebSocket to a robot server, for several threads: messages out, each with its number, and answers to them."""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pydantic import ValidationError
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as open_socket

from armsight import errors
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError, DeviceFailed, DeviceLost, DeviceNotFound, UsageError

TOKEN_VARIABLE = "ARMSIGHT_TOKEN"
"""The environment variable that gives the token where nothing else does: a command line shows to everyone."""

OPEN_S = 5.0
ANSWER_S = 5.0
"""Longest waits, in s, for a connection and for an answer: the web server gives way to all else of its machine."""

Answer = say.Accepted | say.StateMessage | say.Done


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerAddress:
    """Where a robot server is, and what opens it.

    url: ws://HOST:PORT, or wss://HOST:PORT with TLS. ca_file: certificates to trust besides the system's, such as the
    server's own. token: None takes the environment variable ARMSIGHT_TOKEN. Raises UsageError for another url, and for
    a token that would cross the network in plain text.
    """

    url: str
    token: str | None = None
    ca_file: Path | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "token", self.token or os.environ.get(TOKEN_VARIABLE) or None)
        try:
            parts = urlsplit(self.url)
            port, host = parts.port, parts.hostname
        except ValueError:
            port = host = None
        if "@" in self.url:
            raise UsageError(
                "an address with a name or a password in it",
                consequence="There is no connection: addresses stand in messages and logs",
                cure=f"Give ws://HOST:PORT, and the token as token or in {TOKEN_VARIABLE}",
            )
        if host is None or port is None or parts.scheme not in ("ws", "wss") or parts.path not in ("", "/"):
            raise UsageError(
                f"{self.url!r} is not the address of a robot server",
                cure="Give ws://HOST:PORT, or wss://HOST:PORT where the server has a certificate",
            )
        if self.token and parts.scheme == "ws" and not is_loopback(host):
            raise UsageError(
                f"the token would go to {host} in plain text",
                cure="Use wss://, and a server with --tls-cert and --tls-key",
            )

    def tls(self) -> ssl.SSLContext | None:
        """Return how the server's certificate is checked; None without TLS. Raises UsageError for a wrong ca_file."""
        if not self.url.startswith("wss:"):
            return None
        try:
            return ssl.create_default_context(cafile=None if self.ca_file is None else str(self.ca_file))
        except OSError as error:
            raise UsageError(f"{self.ca_file} holds no certificates: {error}") from error


class Wire:
    """A connection to one path of a server. heard: is given what comes without being asked for, in its thread."""

    def __init__(self, address: ServerAddress, path: str, heard: Callable[[say.ServerMessage], None]) -> None:
        self.address = address
        self.ended = ""
        """Why the connection ended, in words; empty while it lives."""
        self._path = path
        self._heard = heard
        self._socket: ClientConnection | None = None
        self._reader: threading.Thread | None = None
        self._session = ""
        self._answers: dict[int | None, say.ServerMessage] = {}
        self._waiting: set[int | None] = set()
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._seq = 0

    def open(self) -> say.Welcome | say.LineWelcome:
        """Connect; return what the server says first. Raises DeviceNotFound, DeviceFailed where refused, UsageError."""
        connection = self._connect()
        try:
            first = say.parse_answer(connection.recv(timeout=OPEN_S))
            if isinstance(first, say.Refused):
                raise as_error(first)
            if not isinstance(first, say.Welcome | say.LineWelcome) or first.version != say.VERSION:
                raise DeviceFailed(f"{self.address.url} does not speak version {say.VERSION} of the protocol")
        except (TimeoutError, ConnectionClosed) as error:
            connection.close()
            raise DeviceFailed(f"{self.address.url} says nothing", consequence="There is no connection") from error
        except ArmsightError:
            connection.close()
            raise
        self._socket, self._session, self.ended, self._seq = connection, first.session, "", 0
        self._answers.clear()
        self._reader = threading.Thread(target=self._read, args=(connection,), name="armsight-link", daemon=True)
        self._reader.start()
        return first

    def ask(self, make: Callable[..., say.Command], **fields: Any) -> Answer:
        """Send a message and return its answer. Raises the refusal's error, DeviceLost without a connection."""
        connection, seq = self._send(make, fields, waits=True)
        with self._news:
            found = self._news.wait_for(lambda: seq in self._answers or bool(self.ended), timeout=ANSWER_S)
            self._waiting.discard(seq)
            answer = self._answers.pop(seq, None)
        if answer is None:
            if not found:
                self.end(f"{self.address.url} did not answer for {ANSWER_S:g} s")
                connection.close()
            raise self._lost()
        if isinstance(answer, say.Refused):
            raise as_error(answer)
        if isinstance(answer, Answer):
            return answer
        raise DeviceFailed(f"{self.address.url} answered with {answer.type}", consequence="It is not known what it did")

    @property
    def awaited(self) -> bool:
        """Whether somebody waits for an answer."""
        return bool(self._waiting)

    def send(self, make: Callable[..., say.Command], **fields: Any) -> None:
        """Send a message and do not wait for its answer. Raises DeviceLost without a connection."""
        self._send(make, fields, waits=False)

    def cut(self) -> None:
        """End the connection as a pulled cable does: without a word to the server."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                self._socket.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End the connection; legal always."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join()
        self._reader = None
        self.end("closed")

    def end(self, why: str) -> None:
        """Take note that it ended; the first reason counts."""
        with self._news:
            self.ended = self.ended or why
            self._news.notify_all()

    def _connect(self) -> ClientConnection:
        where = self.address.url
        try:
            return open_socket(
                where.rstrip("/") + self._path,
                ssl=self.address.tls(),
                additional_headers={"Authorization": f"Bearer {self.address.token}"} if self.address.token else {},
                proxy=None,  # a robot's link goes straight
                open_timeout=OPEN_S,
                close_timeout=1.0,
                max_size=64 * say.MAX_BYTES,
                compression=None,
                ping_interval=None,  # the server pings; a thread for it here may race close() in joining the reader
            ).__enter__()
        except InvalidStatus as error:
            raise refused_entry(where, error) from error
        except ssl.SSLError as error:
            raise DeviceFailed(
                f"{where}: its certificate is not trusted ({error.reason or error})",
                consequence="There is no connection",
                cure="Give the certificate's file as ca_file, or check that it is this server",
            ) from error
        except (OSError, InvalidHandshake, EOFError) as error:
            raise DeviceNotFound(
                f"no robot server answers at {where}: {error}"[:300],
                consequence="There is no connection",
                cure="Check that `armsight serve` runs there, its port, and ws against wss",
            ) from error

    def _send(
        self, make: Callable[..., say.Command], fields: dict[str, Any], *, waits: bool
    ) -> tuple[ClientConnection, int]:
        with self._sending:
            connection = self._socket
            if connection is None or self.ended:
                raise self._lost()
            # number and sending belong together: a message that overtakes another is a replay to the server
            seq = self._seq + 1
            command = _made(make, session=self._session, seq=seq, **fields)
            self._seq = seq
            # before it is sent: the answer may be there before this thread goes on
            if waits:
                with self._news:
                    self._waiting.add(seq)
            try:
                connection.send(command.model_dump_json())
            except (ConnectionClosed, OSError) as error:
                self.end(_why(error))
                raise self._lost() from error
            return connection, seq

    def _read(self, connection: ClientConnection) -> None:
        try:
            for text in connection:
                self._take(say.parse_answer(text))
            self.end("the server closed the connection")
        except (ConnectionClosed, OSError, ArmsightError) as error:
            self.end(_why(error))

    def _take(self, message: say.ServerMessage) -> None:
        number = getattr(message, "reply_to", None)
        if number is None:
            self._heard(message)
            return
        with self._news:
            if number in self._waiting:
                self._answers[number] = message
                self._news.notify_all()

    def _lost(self) -> DeviceLost:
        return DeviceLost(
            f"the connection to {self.address.url} is lost ({self.ended or 'not open'})",
            consequence="The server holds the robot",
            cure="Open it again",
        )


def as_error(refused: say.Refused) -> ArmsightError:
    """Return a refusal as the error that it was at the server; DeviceFailed where this program does not know it."""
    kind = getattr(errors, refused.kind, None)
    plain = isinstance(kind, type) and issubclass(kind, ArmsightError) and kind.__init__ is ArmsightError.__init__
    made: type[ArmsightError] = kind if plain and kind is not None else DeviceFailed
    return made(refused.cause, consequence=refused.consequence, cure=refused.cure)


def refused_entry(url: str, error: InvalidStatus) -> DeviceFailed:
    """Return why a server let nobody in."""
    response = error.response
    said = (response.body or b"").decode("utf-8", "replace")[:200] or response.reason_phrase
    return DeviceFailed(
        f"{url} refuses ({response.status_code}): {said}",
        consequence="There is no connection",
        cure=f"Give a token of the server's token file, for instance in {TOKEN_VARIABLE}",
    )


def _made(make: Callable[..., say.Command], **fields: Any) -> say.Command:
    try:
        return make(**fields)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise UsageError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error


def is_loopback(host: str) -> bool:
    """Return whether an address or localhost is this machine itself; any other name may lead elsewhere."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _why(error: Exception) -> str:
    if isinstance(error, ConnectionClosed) and error.rcvd is not None:
        return error.rcvd.reason or f"closed with code {error.rcvd.code}"
    return str(error)[:200] or type(error).__name__
