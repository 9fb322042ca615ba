"""What the plant's systems are told, and where: the flags of serve and verify --live."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

from armsight.fields import Bounds, Doc, Flag

if TYPE_CHECKING:
    from armsight.control.session.service import Service
    from armsight.ops.verification.supervising import Supervision
    from armsight.verify.supervision import Seen

PLANT = "The plant's systems (OPC UA, MQTT, Foxglove)"
STALE_S = 1.0
_FOLDER = Flag(metavar="FOLDER", panel=PLANT)
_FILE = Flag(metavar="FILE", panel=PLANT)


class Publishing(Protocol):
    """What armsight-plant makes of the flags: what is published, and where."""

    def served(
        self, service: Service, tell: Callable[[str], None], seen: Callable[[], Seen | None] = ...
    ) -> AbstractContextManager[None]:
        """Publish a served robot while the block runs. tell: the addresses, and failures. seen: what a supervision
        measured last. Raises DeviceFailed for a port in use, DeviceNotFound for a package that is missing."""
        ...

    def supervised(self, run: Supervision) -> AbstractContextManager[None]:
        """Publish an open supervision while the block runs. Raises as served."""
        ...


@dataclass(frozen=True, kw_only=True)
class PlantFlags:
    """Where state, pose, errors and alarms are published; nothing by default."""

    opcua: Annotated[str | None, Doc("Serve OPC UA at opc.tcp://HOST:PORT."), Flag(metavar="URL", panel=PLANT)] = None
    opcua_certificate: Annotated[Path | None, Doc("Its certificate, PEM or DER."), _FILE] = None
    opcua_key: Annotated[Path | None, Doc("The certificate's key."), _FILE] = None
    opcua_trusted: Annotated[
        Path | None, Doc("Let in clients with these certificates alone. [default: any certificate]"), _FOLDER
    ] = None
    opcua_users: Annotated[
        Path | None, Doc("tokens.yaml: who may read and acknowledge. [default of serve: --tokens]"), _FILE
    ] = None
    opcua_anonymous: Annotated[
        bool, Doc("Everyone who reaches the port may read, also without a certificate."), Flag(panel=PLANT)
    ] = False
    mqtt: Annotated[
        str | None, Doc("Publish at a broker, mqtts://HOST:PORT/PREFIX."), Flag(metavar="URL", panel=PLANT)
    ] = None
    mqtt_ca: Annotated[
        Path | None, Doc("Whose certificates the broker may have, PEM. [default: the system's]"), _FILE
    ] = None
    mqtt_user: Annotated[str, Doc("Who we are to the broker."), Flag(metavar="NAME", panel=PLANT)] = ""
    mqtt_password_file: Annotated[
        Path | None, Doc("With the password alone. [default: $ARMSIGHT_MQTT_PASSWORD]"), _FILE
    ] = None
    foxglove: Annotated[
        str | None,
        Doc("Serve Foxglove's WebSocket; on this machine alone where no HOST is given."),
        Flag(metavar="[HOST:]PORT", panel=PLANT),
    ] = None
    stale_after_s: Annotated[
        float,
        Doc("Values older than so many seconds are told as stale."),
        Bounds(least=0.1, most=3600.0),
        Flag(metavar="S", panel=PLANT),
    ] = STALE_S

    def made(self, notify: Callable[[str], None], users: Path | None = None) -> Publishing | None:
        """Return what is published, checked; None where nothing is. users: in place of --opcua-users.

        Raises UsageError, BadFile, DeviceNotFound where armsight-plant is missing.
        """
        if self == PlantFlags():
            return None
        from armsight.registry import PLANT, extension

        made: Callable[..., Publishing] = extension(PLANT, "publishing", "plant")
        return made(self, notify, users)
