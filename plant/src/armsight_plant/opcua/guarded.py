"""asyncua's server with a guard before every request: what may be asked on which channel, by whom, and how much.

asyncua by itself lets a session that was never activated read, knows sessions by numbers that can be guessed, looks at
the certificate that a client names and not at that of its channel, and bounds no message that is not whole yet.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.uaprocessor import UaProcessor
from cryptography import x509

from armsight.errors import BadFile
from armsight.store.tokens import TokenEntry, read_tokens
from armsight_plant.state import Note, Tell

Ids = ua.ObjectIds

CONNECTIONS = 64
"""Clients at once; further ones are turned away."""
SUBSCRIPTIONS = 128
ACTIVATE_S = 10.0
"""A connection that has not said who it is by then is closed."""
MESSAGE_BYTES = 1 << 20
WAITING_BYTES = 4 << 20
"""Answers that a client does not take; with more it is closed."""
PENDING = 200
"""Requests of a connection that wait; with more it is closed."""


def _ids(*names: str) -> frozenset[int]:
    return frozenset(getattr(Ids, f"{name}Request_Encoding_DefaultBinary") for name in names)


FIRST = _ids("GetEndpoints", "FindServers", "CloseSecureChannel")
"""What anybody may ask, on any channel: how to speak to this server."""
SESSION = _ids("CreateSession", "ActivateSession", "CloseSession")
READS = _ids(
    *("Read", "Browse", "TranslateBrowsePathsToNodeIds", "RegisterNodes", "UnregisterNodes"),
    *("CreateSubscription", "ModifySubscription", "DeleteSubscriptions", "TransferSubscriptions", "SetPublishingMode"),
    *("CreateMonitoredItems", "ModifyMonitoredItems", "DeleteMonitoredItems", "SetMonitoringMode"),
    *("Publish", "Republish"),
)
CALLS = _ids("Call")
ACTIVATE = _ids("ActivateSession")
ANONYMOUS = ua.UserTokenType.Anonymous


@dataclass
class PlantUser(User):
    """Who a session is of. may: the role of their token; empty for those without a name."""

    may: str = ""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks, from where, and whether on a channel that is at least signed."""

    who: str
    may: str
    address: str
    secured: bool


CALLER: ContextVar[Caller | None] = ContextVar("caller", default=None)
"""Of the request that is being answered."""


class ListeningSocket:
    """Who may come in: clients by their certificates, people and programs by their tokens."""

    def __init__(self, users: Path | None, trusted: frozenset[bytes] | None, *, anonymous: bool, tell: Tell) -> None:
        self._users, self._trusted, self.anonymous, self._tell = users, trusted, anonymous, tell

    def note(self, address: str, why: str) -> None:
        """Tell that somebody was kept out."""
        self._tell(Note(level="warning", message=f"OPC UA: {address} was kept out: {why}"))

    def refused(self, data: bytes | None, *, secured: bool) -> str:
        """Return why a channel is not good, by its client's certificate (DER); empty where it is.

        On a channel that is not secured a certificate is only claimed, and counts for nothing.
        """
        if not secured:
            return "" if self.anonymous else "without a certificate"
        try:
            data = data or b""
            found = x509.load_der_x509_certificate(data)
        except ValueError:
            return "a certificate that is none"
        if not found.not_valid_before_utc <= datetime.now(UTC) <= found.not_valid_after_utc:
            return "a certificate that is not valid today"
        if self._trusted is not None and not any(hmac.compare_digest(data, one) for one in self._trusted):
            return f"its certificate is not trusted ({found.subject.rfc4514_string()[:80]})"
        return ""

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: bytes | None = None
    ) -> PlantUser | None:
        """Return who it is, None for whom nobody knows; asyncua's name for it."""
        caller = CALLER.get()
        if username is None and password is None:
            return PlantUser(role=UserRole.User) if self.anonymous else None
        if caller is None or not caller.secured:  # a token that crossed the network in plain text is none any more
            return None
        entry = self._entry(username or "", password or "")
        return None if entry is None else PlantUser(role=UserRole.User, name=entry.name, may=entry.role)

    def _entry(self, name: str, token: str) -> TokenEntry | None:
        # read anew each time: a token that was taken out of the file lets nobody in any more
        if self._users is None or not token:
            return None
        try:
            entries = read_tokens(self._users)
        except (BadFile, OSError):
            return None
        matching = [entry for entry in entries if entry.matches(token)]
        return next((entry for entry in matching if entry.name == name), None)


class GuardedInternalServer(InternalServer):
    """Sessions are known by random bytes, and nobody can enter another server here."""

    def __init__(self, door: ListeningSocket) -> None:
        super().__init__(user_manager=door)
        self.max_connections, self.max_subscriptions = CONNECTIONS, SUBSCRIPTIONS
        self.max_pending_activation_seconds = ACTIVATE_S
        self.max_pending_messages_per_connection = PENDING
        self.max_session_timeout_ms = 120_000.0
        self.max_monitored_item_queue_size = 100
        self.max_unacked_messages_per_subscription = 100
        self.max_lifetime_count, self.max_keep_alive_count = 1000, 300

    def register_external_session(self, session: InternalSession) -> None:
        """Keep a session by a name that nobody guesses."""
        session.auth_token = ua.NodeId(secrets.token_bytes(32), 0, ua.NodeIdType.ByteString)
        super().register_external_session(session)


class GuardedProcessor(UaProcessor):
    """Answers one connection, after each request was looked at."""

    door: ListeningSocket
    refresh: Callable[[], Awaitable[None]]
    session: Any

    @property
    def address(self) -> str:
        """Where it comes from."""
        return f"{self.name[0]}" if isinstance(self.name, tuple) else "somewhere"

    @property
    def _secured(self) -> bool:
        policy: Any = self._connection.security_policy
        return self._connection.is_open() and policy.Mode in (
            ua.MessageSecurityMode.Sign,
            ua.MessageSecurityMode.SignAndEncrypt,
        )

    async def process(self, header: Any, body: Any) -> bool:
        """Take a message; one that breaks the channel's rules closes it."""
        try:
            return bool(await super().process(header, body))
        except Exception as error:  # whatever a client sends: asyncua logs it, and would leave the connection open
            self.door.note(self.address, f"a message against the protocol ({type(error).__name__})")
            return False

    async def _process_message(self, typeid: ua.NodeId, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        number = typeid.Identifier
        if number not in FIRST:
            self._check(number)
        if number in READS:
            await self.refresh()
        user = self.session.user if self.session is not None else None
        may = user if isinstance(user, PlantUser) else PlantUser()
        CALLER.set(Caller(who=may.name or "", may=may.may, address=self.address, secured=self._secured))
        before = self.session
        try:
            return await super()._process_message(typeid, requesthdr, seqhdr, body)
        except Exception as error:
            if number in ACTIVATE:
                self.session = before  # asyncua would leave it with the session that it failed to prove
            if number in SESSION:
                why = "wrong name or token" if number in ACTIVATE else type(error).__name__
                self.door.note(self.address, why)
            raise

    def _check(self, number: int) -> None:
        """Raise UaStatusCodeError for what may not be asked here."""
        policy: Any = self._connection.security_policy
        if not self._connection.is_open():
            raise ua.UaStatusCodeError(ua.StatusCodes.BadSecureChannelClosed)
        why = self.door.refused(policy.peer_certificate, secured=self._secured)
        if why:
            if number in SESSION:
                self.door.note(self.address, why)
            raise ua.UaStatusCodeError(ua.StatusCodes.BadSecurityChecksFailed)
        if number in SESSION:
            return
        if self.session is None or not self.session.is_activated():
            raise ua.UaStatusCodeError(ua.StatusCodes.BadSessionNotActivated)
        if number not in READS | CALLS:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadUserAccessDenied)


class GuardedProtocol(OPCUAProtocol):
    """A connection, with what it may pile up on this side."""

    make: Callable[..., UaProcessor]
    processor: UaProcessor | None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Answer with the guarded processor."""
        super().connection_made(transport)
        if self.processor is not None:
            self.processor = self.make(self.iserver, self.transport, self.limits)
            self.processor.set_policies(self.policies)

    def data_received(self, data: bytes) -> None:
        """Take bytes, unless too many wait here already."""
        transport = self.transport
        if transport is None:
            return
        piled = len(self._buffer) + len(data) > MESSAGE_BYTES
        if piled or transport.get_write_buffer_size() > WAITING_BYTES:
            transport.abort()
            return
        super().data_received(data)


class GuardedBinaryServer(BinaryServer):
    """The listening socket."""

    make: Callable[..., UaProcessor]

    def _make_protocol(self) -> OPCUAProtocol:
        made = GuardedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )
        made.make = self.make
        return made


async def start_guarded(
    server: Server, door: ListeningSocket, host: str, port: int, refresh: Callable[[], Awaitable[None]]
) -> int:
    """Start a server whose address space is there, behind the door; return its port. refresh: called before anything
    is read. Raises OSError."""
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what matters of it is in our log
    server.limits = TransportLimits(
        max_recv_buffer=65535, max_send_buffer=65535, max_chunk_count=16, max_message_size=MESSAGE_BYTES
    )
    await server._setup_server_nodes()
    if not door.anonymous:  # it is not offered, and refused where a client asks for it all the same
        server.iserver.endpoints[:] = [
            one for one in server.iserver.endpoints if one.SecurityMode is not ua.MessageSecurityMode.None_
        ]
    for one in server.iserver.endpoints:
        if one.SecurityMode is ua.MessageSecurityMode.None_:  # nobody is asked for a token that is refused there
            one.UserIdentityTokens = [kind for kind in one.UserIdentityTokens if kind.TokenType is ANONYMOUS]
    await server.iserver.start()

    def make(*given: Any) -> UaProcessor:
        made = GuardedProcessor(*given)
        made.door, made.refresh = door, refresh
        return made

    bound = GuardedBinaryServer(server.iserver, host, port, server.limits)
    bound.make = make
    bound.set_policies(server._policies)
    server.bserver = bound
    await bound.start()
    return int(bound.port)
