"""Eclipse Mosquitto as a broker for tests and benchmarks: in a folder of its own, with TLS and passwords."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

USER, PASSWORD = "plant", "a password of this test"
PLACES = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"))
BEGIN_S, END_S = 20.0, 5.0


def missing() -> str:
    """Return what is not installed of what the broker needs; empty where all is there."""
    lacking = [name for name in ("mosquitto", "mosquitto_passwd") if shutil.which(name, path=PLACES) is None]
    return f"{' and '.join(lacking)} not installed" if lacking else ""


class Broker:
    """Runs Mosquitto at a free port of this machine. `with Broker(folder) as broker`: broker.url, broker.ca.

    ca: whose certificate it has; other_ca: another, which does not vouch for it.
    """

    def __init__(self, folder: Path) -> None:
        """Write configuration, certificates and passwords into the folder; nothing runs yet."""
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self.port = _free_port()
        self.ca, self.other_ca = folder / "ca.pem", folder / "other-ca.pem"
        _write_certificates(folder, self.ca, self.other_ca)
        passwords = folder / "passwords"
        passwords.touch(mode=0o600)
        tool = str(shutil.which("mosquitto_passwd", path=PLACES))
        subprocess.run([tool, "-b", str(passwords), USER, PASSWORD], check=True, capture_output=True)
        (folder / "mosquitto.conf").write_text(
            f"listener {self.port} 127.0.0.1\ncafile {self.ca}\ncertfile {folder / 'broker.pem'}\n"
            f"keyfile {folder / 'broker-key.pem'}\nallow_anonymous false\npassword_file {passwords}\n"
            f"persistence false\nlog_dest file {folder / 'mosquitto.log'}\n"
            "user root\n"
        )

    @property
    def url(self) -> str:
        """Its address, without a topic."""
        return f"mqtts://127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Start it, and wait until it takes connections. Raises RuntimeError where it does not."""
        broker = str(shutil.which("mosquitto", path=PLACES))
        self._process = subprocess.Popen([broker, "-c", str(self._folder / "mosquitto.conf")])
        until = datetime.now(UTC) + timedelta(seconds=BEGIN_S)
        while self._process.poll() is None and datetime.now(UTC) < until:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=0.05).close()
                return
            except OSError:
                pass
        raise RuntimeError(f"mosquitto did not begin: see {self._folder / 'mosquitto.log'}")

    def stop(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(END_S)
            self._process = None


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


def _write_certificates(folder: Path, ca_file: Path, other_file: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric import rsa
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    ca_key, other_key, own_key = (rsa.generate_private_key(public_exponent=65537, key_size=2048) for _ in range(3))
    ca = _certificate("test authority", ca_key, None, ca_key)
    ca_file.write_bytes(ca.public_bytes(Encoding.PEM))
    other_file.write_bytes(_certificate("another authority", other_key, None, other_key).public_bytes(Encoding.PEM))
    own = _certificate("localhost", own_key, ca, ca_key)
    (folder / "broker.pem").write_bytes(own.public_bytes(Encoding.PEM))
    secret = own_key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "broker-key.pem").write_bytes(secret)


def _certificate(name: str, key: Any, issuer: Certificate | None, issuer_key: Any) -> Certificate:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=30))
        .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()), critical=False)
    )
    if issuer is None:
        uses = dict.fromkeys(
            ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement", "encipher_only"), False
        )
        signs = x509.KeyUsage(**uses, decipher_only=False, digital_signature=True, key_cert_sign=True, crl_sign=True)
        made = made.add_extension(signs, critical=True)
    else:
        names = [x509.DNSName("localhost"), x509.IPAddress(ip_address("127.0.0.1"))]
        made = made.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return made.sign(issuer_key, hashes.SHA256())
