"""Certificates of OPC UA: ours and its key, those of clients that are trusted, and a pair for a first try."""

from __future__ import annotations

import os
import socket
import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from armsight.errors import BadFile, DeviceNotFound, UsageError
from armsight.store.atomic import disk_errors
from armsight_plant.options import NOTHING, PlantOptions

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
    from cryptography.x509 import Certificate

DAYS = 825
LEAST_BITS = 2048
PRIVATE_MODE = 0o600
SUFFIXES = (".pem", ".der", ".crt", ".cer")


def missing(extra: str, package: str) -> DeviceNotFound:
    """Return the error for a package that is not installed."""
    return DeviceNotFound(
        f"the package {package} is not installed", consequence=NOTHING, cure=f"pip install 'armsight[{extra}]'"
    )


def read_certificate(path: Path) -> Certificate:
    """Return a certificate, PEM or DER. Raises BadFile, DeviceNotFound where the package is missing."""
    try:
        from cryptography import x509
    except ImportError as error:
        raise missing("plant", "cryptography") from error
    try:
        data = path.read_bytes()
        if data.lstrip().startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(data)
        return x509.load_der_x509_certificate(data)
    except OSError as error:
        raise BadFile(f"{path}: {error.strerror or error}", consequence=NOTHING, cure="Check the name") from error
    except ValueError as error:
        raise BadFile(f"{path} is no certificate", consequence=NOTHING, cure="Give one as PEM or DER") from error


def read_pair(certificate: Path, key: Path) -> tuple[Certificate, RSAPrivateKey, str]:
    """Return our certificate, its key, and the application URI in it.

    Raises BadFile for what Basic256Sha256 or a client would refuse: expired, of another key, not RSA of 2048 bits or
    more, without a URI.
    """
    from cryptography.x509 import SubjectAlternativeName, UniformResourceIdentifier

    own, secret = read_certificate(certificate), _read_key(key)
    if own.public_key() != secret.public_key():
        raise BadFile(f"{key} is not the key of {certificate}", consequence=NOTHING, cure="Give both of one pair")
    now = datetime.now(UTC)
    if not own.not_valid_before_utc <= now <= own.not_valid_after_utc:
        raise BadFile(
            f"{certificate} is valid from {own.not_valid_before_utc:%Y-%m-%d} to {own.not_valid_after_utc:%Y-%m-%d}, "
            f"and today is {now:%Y-%m-%d}",
            consequence=f"Clients would refuse it. {NOTHING}",
            cure="Have a new one made",
        )
    found = [one.value for one in own.extensions if isinstance(one.value, SubjectAlternativeName)]
    uris = [uri for names in found for uri in names.get_values_for_type(UniformResourceIdentifier)]
    if not uris:
        raise BadFile(
            f"{certificate} names no application: its subject's alternative names hold no URI",
            consequence=f"Clients would refuse it. {NOTHING}",
            cure="Have one made with URI:urn:..., or make a pair with `armsight serve --make-certificate FOLDER`",
        )
    return own, secret, uris[0]


def _read_key(path: Path) -> RSAPrivateKey:
    from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
    from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key

    try:
        data = path.read_bytes()
        load = load_pem_private_key if data.lstrip().startswith(b"-----BEGIN") else load_der_private_key
        found = load(data, None)
    except OSError as error:
        raise BadFile(f"{path}: {error.strerror or error}", consequence=NOTHING, cure="Check the name") from error
    except (ValueError, TypeError) as error:
        raise BadFile(
            f"{path} is no private key that can be read", consequence=NOTHING, cure="Give it as PEM, without a password"
        ) from error
    if not isinstance(found, RSAPrivateKey) or found.key_size < LEAST_BITS:
        raise BadFile(
            f"{path} is no RSA key of {LEAST_BITS} bits or more",
            consequence=NOTHING,
            cure="Basic256Sha256 asks for one",
        )
    return found


def read_trusted(folder: Path) -> frozenset[bytes]:
    """Return the certificates of a folder, DER. Raises BadFile where one cannot be read or none is there."""
    from cryptography.hazmat.primitives.serialization import Encoding

    files = sorted(one for one in folder.iterdir() if one.suffix.lower() in SUFFIXES)
    if not files:
        raise BadFile(
            f"{folder} holds no certificate ({', '.join(SUFFIXES)})",
            consequence=f"No client could come in. {NOTHING}",
            cure="Copy the certificate of each client into it",
        )
    return frozenset(read_certificate(one).public_bytes(Encoding.DER) for one in files)


def tls_context(ca: Path | None) -> ssl.SSLContext:
    """Return what trusts the certificates of an authority, None: the system's. Raises BadFile."""
    try:
        context = ssl.create_default_context(cafile=ca)
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        raise BadFile(
            f"{ca} is no certificate: {getattr(error, 'strerror', None) or error}",
            consequence=NOTHING,
            cure="Give the broker's certificate authority as PEM",
        ) from error
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    return context


def check(options: PlantOptions) -> None:
    """Raise BadFile for certificates that cannot be used, before a robot or a recording is opened."""
    opcua, mqtt = options.opcua, options.mqtt
    if opcua is not None and opcua.certificate is not None and opcua.key is not None:
        read_pair(opcua.certificate, opcua.key)
    if opcua is not None and opcua.trusted is not None:
        read_trusted(opcua.trusted)
    if mqtt is not None and mqtt.tls:
        tls_context(mqtt.ca)


def make_pair(folder: Path, host: str = "") -> tuple[Path, Path]:
    """Make a self-signed certificate and its key for OPC UA in a folder; return both files.

    host: by which clients know this machine. Raises UsageError where they are there, DeviceFailed for the disk.
    """
    try:
        from cryptography.hazmat.primitives.asymmetric import rsa
        from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
    except ImportError as error:
        raise missing("plant", "cryptography") from error
    files = folder / "opcua-cert.pem", folder / "opcua-key.pem"
    if any(one.exists() for one in files):
        raise UsageError(
            f"{files[0]} or its key is there", consequence="Clients trust it; it is kept", cure="Give another folder"
        )
    host = host or socket.gethostname()
    secret = rsa.generate_private_key(public_exponent=65537, key_size=LEAST_BITS)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(files[1], os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE)
        with os.fdopen(handle, "wb") as file:
            file.write(secret.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        files[0].write_bytes(_signed(secret, host).public_bytes(Encoding.PEM))
    return files


def _signed(secret: RSAPrivateKey, host: str) -> Certificate:
    """Return a certificate as OPC UA asks for it (Part 6, 6.2.2), signed with its own key."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"armsight {host}"[:64])])
    now = datetime.now(UTC)
    uses = x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        key_cert_sign=False,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    roles = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    names = [x509.UniformResourceIdentifier(f"urn:{host}:armsight"), x509.DNSName(host)]
    return (
        x509.CertificateBuilder(name, name, secret.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))  # clocks of a plant differ
        .not_valid_after(now + timedelta(days=DAYS))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(uses, critical=True)
        .add_extension(x509.ExtendedKeyUsage(roles), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(secret.public_key()), critical=False)
        .sign(secret, hashes.SHA256())
    )
