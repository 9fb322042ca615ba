"""The address space of docs/guide/plant.md, and what is written into it."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import Server, ua
from asyncua.common.node import Node

from armsight._version import __version__
from armsight.errors import DeviceFailed
from armsight_plant.certificates import read_pair, read_trusted
from armsight_plant.opcua.guarded import CALLER, GuardedInternalServer, ListeningSocket, start_guarded
from armsight_plant.options import ENDS, OpcUaOptions
from armsight_plant.state import NAMES, Acknowledge, Note, PlantState, Quality, Tell
from armsight_plant.values import VALUES, Given, alarm_values, told

NAMESPACE = "urn:armsight:plant"
ROOT = "armsight"
MAY_ACKNOWLEDGE = ("acknowledge", "drive")
CODES = {
    Quality.GOOD: ua.StatusCodes.Good,
    Quality.UNDECIDED: ua.StatusCodes.UncertainSubNormal,
    Quality.STALE: ua.StatusCodes.UncertainLastUsableValue,
    Quality.WAITING: ua.StatusCodes.BadWaitingForInitialData,
    Quality.SILENT: ua.StatusCodes.BadNoCommunication,
}
TYPES = {
    bool: ua.VariantType.Boolean,
    int: ua.VariantType.UInt32,
    float: ua.VariantType.Double,
    str: ua.VariantType.String,
    list: ua.VariantType.Double,
}
UNITS = {"m": ("m", "metre", 5067858), "rad": ("rad", "radian", 4405297), "s": ("s", "second", 5457219)}
"""Unit: its display name, description, and number by UNECE's common codes (OPC UA Part 8)."""
ALARM_TYPES: dict[str, type] = {
    "id": str,
    "active": bool,
    "acknowledged": bool,
    "acknowledged_by": str,
    "why": str,
    "since_s": float,
    "severity": int,
    "latched": bool,
}
ANONYMOUS_POLICY = ua.SecurityPolicyType.NoSecurity
POLICIES = [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt, ua.SecurityPolicyType.Basic256Sha256_Sign]
BEHIND_S = 0.1
"""A state that was looked at longer ago is looked at again before a request is answered."""
KINDS = {one.name: one.kind for one in VALUES}
STILL = {one.name for one in VALUES if one.part == "source"}
"""As old as the last word of the source: written when they change, or a clock would tick in each of them."""


class OpcUaPublisher:
    """An OPC UA server that holds the newest state; for one event loop."""

    def __init__(
        self, options: OpcUaOptions, stale_s: float, tell: Tell, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Nothing is opened. clock: in s, of how long ago a state was shown. Raises BadFile for certificates that
        cannot be used."""
        self._options, self._stale_s, self._tell, self._clock = options, stale_s, tell, clock
        self._shown: tuple[PlantState | None, float, float] = None, 0.0, clock()
        self._showing = asyncio.Lock()
        self._pair = None
        if options.certificate is not None and options.key is not None:
            self._pair = read_pair(options.certificate, options.key)
        trusted = None if options.trusted is None else read_trusted(options.trusted)
        self._door = ListeningSocket(options.users, trusted, anonymous=options.anonymous, tell=tell)
        self._server = Server(iserver=GuardedInternalServer(self._door))
        self._written: dict[str, tuple[Given, Quality, float]] = {}
        self._index = 0
        self._alarms: dict[str, str] = {}
        self.port = 0

    async def start(self) -> None:
        """Build the address space and listen. Raises DeviceFailed where the port cannot be had."""
        server, options = self._server, self._options
        try:  # before the address space is built, which takes a second
            socket.create_server((options.host, options.port), family=_family(options.host)).close()
        except (OSError, OverflowError) as error:
            raise self._cannot_listen(error) from error
        await server.init()
        server.set_server_name("armsight")
        server.application_type = ua.ApplicationType.Server
        server.product_uri = "urn:armsight"
        server.set_endpoint(f"opc.tcp://{f'[{options.host}]' if ':' in options.host else options.host}:{options.port}")
        tokens: list[type] = [] if options.users is None else [ua.UserNameIdentityToken]
        server.set_identity_tokens([*tokens, ua.AnonymousIdentityToken] if options.anonymous else tokens)
        policies = [] if self._pair is None else [*POLICIES]
        server.set_security_policy([*policies, ANONYMOUS_POLICY] if options.anonymous else policies)
        if self._pair is not None:
            server.iserver.certificate, server.iserver.private_key, uri = self._pair
            await server.set_application_uri(uri)
        else:
            await server.set_application_uri("urn:armsight:server")
        await server.set_build_info("urn:armsight", "armsight", "armsight", __version__, "", datetime.now(UTC))
        await self._build()
        try:
            self.port = await start_guarded(server, self._door, options.host, options.port, self.refresh)
        except (OSError, OverflowError) as error:
            raise self._cannot_listen(error) from error

    def _cannot_listen(self, error: Exception) -> DeviceFailed:
        return DeviceFailed(
            f"OPC UA cannot listen at {self._options.host}, port {self._options.port}: {error}",
            consequence=ENDS,
            cure="Choose another port or address with --opcua",
        )

    async def show(self, state: PlantState | None, now_s: float) -> None:
        """Write what has changed."""
        async with self._showing:
            await self._show(state, now_s)

    async def refresh(self) -> None:
        """Write what has become of the state shown last where that was a while ago: this process may have been held
        up, and a request that waits must not be answered with what was good before."""
        async with self._showing:
            state, now_s, at_s = self._shown
            passed_s = self._clock() - at_s
            if passed_s > BEHIND_S:
                await self._show(state, now_s + passed_s)

    async def _show(self, state: PlantState | None, now_s: float) -> None:
        self._shown = state, now_s, self._clock()
        for name, one in told(state, now_s, self._stale_s).items():
            key = (one.value, one.quality, 0.0 if name in STILL or one.value is None else one.at_s)
            if self._written.get(name) != key:
                self._written[name] = key
                await self._write(name, KINDS[name], one.value, one.quality, one.at_s)
        at_s = math.nan if state is None else state.made_unix_s
        quality = Quality.GOOD if state is not None and self._written["source"][1] is Quality.GOOD else Quality.SILENT
        for alarm, values in alarm_values(state).items():
            for part, value in values.items():
                name = f"alarms.{alarm}.{part}"
                if self._written.get(name) != (value, quality, 0.0):
                    self._written[name] = (value, quality, 0.0)
                    await self._write(name, ALARM_TYPES[part], value, quality, at_s)
            if quality is Quality.GOOD:
                self._alarms[alarm] = str(values["id"])

    async def stop(self) -> None:
        """Close all connections."""
        await self._server.stop()

    async def _build(self) -> None:
        self._index = await self._server.register_namespace(NAMESPACE)
        objects = self._server.get_objects_node()
        root = await objects.add_object(self._id(ROOT), self._name(ROOT))
        folders: dict[str, Node] = {}
        for one in VALUES:
            group, _, last = one.name.rpartition(".")
            parent = root
            if group:
                if group not in folders:
                    folders[group] = await root.add_object(self._id(group), self._name(group))
                parent = folders[group]
            await self._variable(parent, one.name, last or one.name, one.kind, one.text, one.unit)
        alarms = await root.add_object(self._id("alarms"), self._name("alarms"))
        for name, (_, _, text) in NAMES.items():
            node = await alarms.add_object(self._id(f"alarms.{name}"), self._name(name))
            for part, kind in ALARM_TYPES.items():
                await self._variable(node, f"alarms.{name}.{part}", part, kind, text if part == "active" else "", "")
        argument = ua.Argument(
            Name="id",
            DataType=ua.NodeId(ua.ObjectIds.String),
            ValueRank=-1,
            ArrayDimensions=[],
            Description=ua.LocalizedText("Of the occurrence that was seen: alarms.NAME.id"),
        )
        await alarms.add_method(
            self._id("alarms.acknowledge"), self._name("acknowledge"), self._acknowledge, [argument], []
        )

    async def _variable(self, parent: Node, name: str, shown: str, kind: type, text: str, unit: str) -> None:
        empty = ua.Variant([] if kind is list else kind(), TYPES[kind], is_array=kind is list)
        node = await parent.add_variable(self._id(name), self._name(shown), empty)
        if text:
            await node.write_attribute(
                ua.AttributeIds.Description,
                ua.DataValue(ua.Variant(ua.LocalizedText(text), ua.VariantType.LocalizedText)),
            )
        if kind is list:
            await node.write_value_rank(ua.ValueRank.OneDimension)
        if unit:
            shown_unit, described, number = UNITS[unit]
            info = ua.EUInformation(
                NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
                UnitId=number,
                DisplayName=ua.LocalizedText(shown_unit),
                Description=ua.LocalizedText(described),
            )
            await node.add_property(self._id(f"{name}.unit"), ua.QualifiedName("EngineeringUnits", 0), info)
        await self._write(name, kind, None, Quality.WAITING, math.nan)

    async def _write(self, name: str, kind: type, value: Given, quality: Quality, at_s: float) -> None:
        stands = value if value is not None else ([] if kind is list else kind())
        stamp = None if math.isnan(at_s) else datetime.fromtimestamp(at_s, UTC)
        data = ua.DataValue(
            ua.Variant(stands, TYPES[kind], is_array=kind is list),
            StatusCode=ua.StatusCode(CODES[quality]),
            SourceTimestamp=stamp,
            ServerTimestamp=datetime.now(UTC),
        )
        await self._server.write_attribute_value(self._id(name), data)

    async def _acknowledge(self, parent: ua.NodeId, number: Any) -> Any:
        """Answer the method: whoever may acknowledges the occurrence that they saw."""
        caller, wanted = CALLER.get(), number.Value
        if caller is None or caller.may not in MAY_ACKNOWLEDGE:
            who = "nobody" if caller is None else caller.who or "somebody without a name"
            where = "" if caller is None else f" at {caller.address}"
            self._tell(Note(level="warning", message=f"OPC UA: {who}{where} may not acknowledge alarms"))
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        if not isinstance(wanted, str) or not wanted or wanted not in self._alarms.values():
            return ua.StatusCode(ua.StatusCodes.BadEventIdUnknown)
        if not self._tell(Acknowledge(id=wanted, who=caller.who, address=caller.address)):
            return ua.StatusCode(ua.StatusCodes.BadResourceUnavailable)
        return []

    def _id(self, name: str) -> ua.NodeId:
        return ua.NodeId(name, self._index, ua.NodeIdType.String)

    def _name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._index)


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET
