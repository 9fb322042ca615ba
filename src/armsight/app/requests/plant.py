"""What the plant's systems are told, and where: the flags of serve and verify --live."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag

if TYPE_CHECKING:
    from armsight.publish.options import PlantOptions

PLANT = "The plant's systems (OPC UA, MQTT, Foxglove)"
STALE_S = 1.0
_FOLDER = Flag(metavar="FOLDER", panel=PLANT)
_FILE = Flag(metavar="FILE", panel=PLANT)


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

    def made(self, notify: Callable[[str], None], users: Path | None = None) -> PlantOptions | None:
        """Return what is published, checked; None where nothing is. users: in place of --opcua-users.

        Raises UsageError, BadFile.
        """
        self._check_alone()
        if self.opcua is None and self.mqtt is None and self.foxglove is None:
            return None
        from armsight.publish import certificates, options

        opcua = mqtt = foxglove = None
        if self.opcua is not None:
            opcua = options.opcua_options(
                self.opcua,
                certificate=self.opcua_certificate,
                key=self.opcua_key,
                trusted=self.opcua_trusted,
                users=self.opcua_users or users,
                anonymous=self.opcua_anonymous,
            )
            if self.opcua_anonymous:
                notify("Note: --opcua-anonymous lets everyone who reaches its port read, unencrypted if they like.")
        if self.mqtt is not None:
            mqtt = options.mqtt_options(
                self.mqtt, ca=self.mqtt_ca, user=self.mqtt_user, password_file=self.mqtt_password_file
            )
        if self.foxglove is not None:
            foxglove = options.foxglove_options(self.foxglove)
            notify("Note: Foxglove's protocol knows no passwords: whoever reaches its port may watch.")
        made = options.PlantOptions(opcua=opcua, mqtt=mqtt, foxglove=foxglove, stale_s=self.stale_after_s)
        certificates.check(made)
        return made

    def _check_alone(self) -> None:
        """Raise UsageError for a flag of something that is not published."""
        for main, names in (
            ("opcua", ("opcua_certificate", "opcua_key", "opcua_trusted", "opcua_users", "opcua_anonymous")),
            ("mqtt", ("mqtt_ca", "mqtt_user", "mqtt_password_file")),
        ):
            given = [f"--{name.replace('_', '-')}" for name in names if getattr(self, name)]
            if given and getattr(self, main) is None:
                raise UsageError(
                    f"{', '.join(given)} without --{main}",
                    consequence="Nothing is published",
                    cure=f"Give --{main} URL",
                )
        if self.stale_after_s != STALE_S and self.opcua is None and self.mqtt is None and self.foxglove is None:
            raise UsageError(
                "--stale-after is of what is published, and nothing is",
                consequence="It would change nothing",
                cure="Give --opcua, --mqtt or --foxglove, or leave it away",
            )
        if self.opcua_certificate is None and (self.opcua_users or self.opcua_trusted):
            raise UsageError(
                "--opcua-users and --opcua-trusted need a certificate of the server",
                consequence="Tokens would cross the network in plain text; nothing is published",
                cure="Give --opcua-certificate and --opcua-key",
            )
