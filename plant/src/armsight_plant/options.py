"""What is published and where: addresses, certificates and secrets, checked before anything is opened."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import unquote, urlsplit

from armsight.errors import BadFile, UsageError
from armsight.ops.requests.plant import STALE_S
from armsight.store.tokens import read_tokens

MQTT_PASSWORD = "ARMSIGHT_MQTT_PASSWORD"
"""The environment variable with the password for the broker."""
MQTT_PORTS = {"mqtts": 8883, "mqtt": 1883}
OPCUA_PORT, FOXGLOVE_PORT = 4840, 8767
LOOPBACK = "127.0.0.1"
LONGEST_SECRET = 4096
LONGEST_PREFIX = 200
NOTHING = "Nothing is published, and nothing was started"
ENDS = "Nothing is published, and what was begun ends"


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaOptions:
    """Where the OPC UA server listens and who may come in. users: tokens.yaml; trusted: the only clients' certificates
    that are let in, None: any. anonymous: whoever reaches the port may read, also without a certificate."""

    host: str
    port: int
    certificate: Path | None = None
    key: Path | None = None
    trusted: Path | None = None
    users: Path | None = None
    anonymous: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MqttOptions:
    """The broker, what every topic begins with, and how we say who we are."""

    host: str
    port: int
    prefix: str
    tls: bool
    ca: Path | None = None
    user: str = ""
    password: str = ""

    def __repr__(self) -> str:
        return f"MqttOptions({self.host}:{self.port}/{self.prefix})"  # without the password


@dataclass(frozen=True, slots=True, kw_only=True)
class FoxgloveOptions:
    """Where Foxglove's WebSocket listens."""

    host: str
    port: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantOptions:
    """What is published; at least one of the three. stale_s: the age from which a value is no longer good."""

    opcua: OpcUaOptions | None = None
    mqtt: MqttOptions | None = None
    foxglove: FoxgloveOptions | None = None
    stale_s: float = STALE_S


def opcua_options(
    url: str,
    *,
    certificate: Path | None,
    key: Path | None,
    trusted: Path | None,
    users: Path | None,
    anonymous: bool,
) -> OpcUaOptions:
    """Return checked options of an address opc.tcp://HOST[:PORT]. Raises UsageError, BadFile."""
    host, port, path = _address(url, {"opc.tcp": OPCUA_PORT}, "--opcua", "opc.tcp://0.0.0.0:4840")
    if path.strip("/"):
        raise UsageError(
            f"--opcua {url} has a path", consequence=NOTHING, cure="Give opc.tcp://HOST:PORT, and nothing behind it"
        )
    if certificate is None:
        users = None  # tokens would cross the network in plain text
    _check_who_comes_in(certificate, key, users, anonymous=anonymous)
    if users is not None:
        read_tokens(users)
    if key is not None:
        check_private(key, "the key")
    if trusted is not None and not trusted.is_dir():
        raise UsageError(
            f"{trusted} is no folder", consequence=NOTHING, cure="Give the folder of clients' certificates"
        )
    return OpcUaOptions(
        host=host, port=port, certificate=certificate, key=key, trusted=trusted, users=users, anonymous=anonymous
    )


def _check_who_comes_in(certificate: Path | None, key: Path | None, users: Path | None, *, anonymous: bool) -> None:
    """Raise UsageError where nobody could come in, or nobody could tell who does."""
    if (certificate is None) != (key is None):
        raise UsageError(
            "a certificate needs its key, and a key its certificate",
            consequence=NOTHING,
            cure="Give both --opcua-certificate and --opcua-key",
        )
    if certificate is None and not anonymous:
        raise UsageError(
            "--opcua has no certificate",
            consequence=NOTHING,
            cure="Give --opcua-certificate and --opcua-key; `armsight serve --make-certificate FOLDER` makes a pair",
        )
    if users is None and not anonymous:
        raise UsageError(
            "--opcua names nobody who may read",
            consequence=NOTHING,
            cure="Give --opcua-users with tokens.yaml, or --opcua-anonymous to let everyone read who reaches the port",
        )


def mqtt_options(url: str, *, ca: Path | None, user: str, password_file: Path | None) -> MqttOptions:
    """Return checked options of an address mqtts://HOST[:PORT]/PREFIX. Raises UsageError, BadFile."""
    shown = "mqtts://broker.example:8883/plant/cell1"
    host, port, path = _address(url, MQTT_PORTS, "--mqtt", shown)
    tls = url.lower().startswith("mqtts:")
    prefix = path.strip("/")
    if not prefix or len(prefix) > LONGEST_PREFIX:
        raise UsageError(
            f"--mqtt {url[:LONGEST_PREFIX]} says no topic to begin with, or too long a one",
            consequence=NOTHING,
            cure=f"Give for instance {shown}",
        )
    if prefix.startswith("$") or not prefix.isprintable() or any(letter in prefix for letter in "+#\ufffd"):
        raise UsageError(
            f"--mqtt {url}: no topic may begin with $, nor hold +, # or what cannot be printed",
            consequence=f"A broker takes nothing there. {NOTHING}",
            cure=f"Give for instance {shown}",
        )
    if port == 0:
        raise UsageError(f"--mqtt {url}: no broker listens at port 0", consequence=NOTHING, cure=f"As {shown}")
    if not tls and not _loopback(host):
        raise UsageError(
            f"--mqtt {url} goes to another machine in plain text",
            consequence="Everyone on the way could read and forge it; nothing is published",
            cure="Give mqtts://",
        )
    if ca is not None and not tls:
        raise UsageError("--mqtt-ca is of TLS, and mqtt:// has none", consequence=NOTHING, cure="Give mqtts://")
    if ca is not None:
        _readable(ca)
    password = _password(password_file)
    if password and not user:
        raise UsageError("a password for the broker, and no user", consequence=NOTHING, cure="Give --mqtt-user")
    return MqttOptions(host=host, port=port, prefix=prefix, tls=tls, ca=ca, user=user, password=password)


def foxglove_options(where: str) -> FoxgloveOptions:
    """Return the options of [HOST:]PORT. Raises UsageError."""
    host, _, port = where.rpartition(":")
    if not (port.isascii() and port.isdigit()) or not 0 <= int(port) <= 65535 or "/" in host:
        raise UsageError(
            f"--foxglove {where} is not [HOST:]PORT", consequence=NOTHING, cure=f"Give for instance {FOXGLOVE_PORT}"
        )
    return FoxgloveOptions(host=host.strip("[]") or LOOPBACK, port=int(port))


def check_private(path: Path, what: str) -> None:
    """Raise BadFile for a secret that others than its owner and its group may read, or than its owner may write."""
    _readable(path)
    if path.stat().st_mode & (stat.S_IWGRP | stat.S_IRWXO):
        raise BadFile(f"{path}: {what} is open to others than its owner", consequence=NOTHING, cure=f"chmod 600 {path}")


def _readable(path: Path) -> None:
    try:
        with path.open("rb") as file:
            file.read(1)
    except OSError as error:
        raise BadFile(f"{path}: {error.strerror or error}", consequence=NOTHING, cure="Check the name") from error


def _password(file: Path | None) -> str:
    if file is None:
        return os.environ.get(MQTT_PASSWORD, "")
    check_private(file, "the password")
    cure = "Keep the password in it, and nothing else"
    with file.open("rb") as opened:
        data = opened.read(LONGEST_SECRET + 1)
    try:
        password = data.decode("utf-8").strip("\r\n")
    except UnicodeDecodeError as error:
        raise BadFile(f"{file}: no text", consequence=NOTHING, cure=cure) from error
    if not password or len(data) > LONGEST_SECRET:
        raise BadFile(f"{file}: {'no' if not password else 'too long for a'} password", consequence=NOTHING, cure=cure)
    return password


def _address(url: str, ports: dict[str, int], flag: str, shown: str) -> tuple[str, int, str]:
    """Return host, port and path of a URL whose scheme is one of ports. Raises UsageError; the URL is not repeated
    where it holds a password."""
    cure = f"Give for instance {shown}"
    try:
        found = urlsplit(url)
        port = found.port
    except ValueError as error:
        raise UsageError(f"{flag}: {error}", consequence=NOTHING, cure=cure) from None
    if found.username is not None or found.password is not None:
        raise UsageError(
            f"{flag} has a name or a password in its address",
            consequence="Everyone on this machine could read it; nothing is published",
            cure=f"Give --mqtt-user, and the password in a file or in ${MQTT_PASSWORD}",
        )
    if found.scheme not in ports:
        raise UsageError(
            f"{flag} {url}: there is no {found.scheme + '://' if found.scheme else 'scheme'}",
            consequence=NOTHING,
            cure=f"{' or '.join(f'{name}://' for name in ports)} is known. {cure}",
        )
    if not found.hostname or found.query or "#" in url:
        raise UsageError(f"{flag} {url} is no address", consequence=NOTHING, cure=cure)
    return found.hostname, ports[found.scheme] if port is None else port, unquote(found.path)


def _loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
