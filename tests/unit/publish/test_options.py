"""Addresses, certificates and secrets: what is refused before anything is opened, and in which words."""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from armsight.errors import BadFile, DeviceNotFound, UsageError
from armsight.ops.requests.plant import PlantFlags
from armsight_plant.certificates import make_pair, read_pair, read_trusted
from armsight_plant.options import (
    FoxgloveOptions,
    MqttOptions,
    OpcUaOptions,
    PlantOptions,
    foxglove_options,
    mqtt_options,
    opcua_options,
)
from armsight_plant.process import publishers

URL = "opc.tcp://127.0.0.1:4840"
NONE = {"certificate": None, "key": None, "trusted": None, "users": None, "anonymous": False}
BROKER = {"ca": None, "user": "", "password_file": None}


def quiet(_):
    return True


def test_nothing_is_published_by_default():
    assert PlantFlags().made(print) is None


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("http://here:4840", "there is no http://"),
        ("here:4840", "there is no here://"),
        ("4840", "there is no scheme"),
        ("opc.tcp://", "no address"),
        ("opc.tcp://here:99999", "Port out of range"),
        ("opc.tcp://here:4840/path", "has a path"),
        ("opc.tcp://anna:secret@here:4840", "a name or a password"),
    ],
)
def test_an_address_that_is_none_is_refused(url, why):
    with pytest.raises(UsageError, match=why) as refused:
        opcua_options(url, **NONE | {"anonymous": True})
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("mqtts://broker", "says no topic"),
        ("mqtts://broker/a/#", "is no address|says no topic"),
        ("mqtts://broker/a+b", "no topic may"),
        ("mqtts://broker/a/%23", "no topic may"),
        ("mqtts://broker/$SYS/a", "no topic may"),
        ("mqtts://broker/a%0ab", "no topic may"),
        ("mqtts://broker/a%ffb", "no topic may"),
        ("mqtts://broker:0/a", "port 0"),
        ("mqtt://broker.example/a", "in plain text"),
        ("ws://broker/a", "there is no ws://"),
        ("mqtts://anna:secret@broker/a", "a name or a password"),
    ],
)
def test_a_broker_that_is_none_is_refused(url, why):
    with pytest.raises(UsageError, match=why) as refused:
        mqtt_options(url, **BROKER)
    assert "secret" not in str(refused.value)


def test_a_broker_has_its_usual_port():
    assert mqtt_options("mqtts://broker.example/plant/cell1/", **BROKER).port == 8883
    plain = mqtt_options("mqtt://localhost/a", **BROKER)
    assert (plain.port, plain.tls, plain.prefix) == (1883, False, "a")


@pytest.mark.parametrize("where", ["", "here", "here:", "here:99999", "ws://here:8767", "²"])
def test_a_port_of_foxglove_that_is_none_is_refused(where):
    with pytest.raises(UsageError, match="--foxglove"):
        foxglove_options(where)


def test_foxglove_is_served_to_this_machine_where_nothing_else_is_said():
    assert foxglove_options("8767") == FoxgloveOptions(host="127.0.0.1", port=8767)
    assert foxglove_options("[::1]:8767").host == "::1"


@pytest.mark.parametrize(
    ("given", "why"),
    [({}, "has no certificate"), ({"certificate": 0}, "needs its key"), ({"certificate": 0, "key": 1}, "names nobody")],
)
def test_opc_ua_without_what_keeps_others_out_is_refused(keys, given, why):
    files = {name: keys.server[number] for name, number in given.items()}
    with pytest.raises(UsageError, match=why):
        opcua_options(URL, **NONE | files)


def test_tokens_are_not_taken_where_they_would_cross_in_plain_text(keys):
    assert opcua_options(URL, **NONE | {"users": keys.tokens, "anonymous": True}).users is None


def test_flags_of_what_is_not_published_are_refused(keys):
    with pytest.raises(UsageError, match="--opcua-users without --opcua"):
        PlantFlags(opcua_users=keys.tokens).made(print)
    with pytest.raises(UsageError, match="--mqtt-user without --mqtt"):
        PlantFlags(mqtt_user="anna", foxglove="8767").made(print)
    with pytest.raises(UsageError, match="--stale-after"):
        PlantFlags(stale_after_s=5.0).made(print)
    with pytest.raises(UsageError, match="need a certificate"):
        PlantFlags(opcua=URL, opcua_users=keys.tokens, opcua_anonymous=True).made(print)


@pytest.mark.parametrize("mode", [0o644, 0o620])
def test_a_secret_that_others_may_read_or_write_is_refused(keys, tmp_path, mode):
    key = tmp_path / "key.pem"
    key.write_bytes(keys.server[1].read_bytes())
    key.chmod(mode)
    with pytest.raises(BadFile, match="chmod 600"):
        opcua_options(URL, **NONE | {"certificate": keys.server[0], "key": key, "users": keys.tokens})
    password = tmp_path / "password"
    password.write_text("secret\n")
    password.chmod(mode)
    with pytest.raises(BadFile, match="chmod 600"):
        mqtt_options("mqtts://broker/a", ca=None, user="anna", password_file=password)
    password.chmod(0o600)
    assert mqtt_options("mqtts://broker/a", ca=None, user="anna", password_file=password).password == "secret"


def test_a_password_without_a_user_is_refused(monkeypatch):
    monkeypatch.setenv("ARMSIGHT_MQTT_PASSWORD", "secret")
    with pytest.raises(UsageError, match="no user"):
        mqtt_options("mqtts://broker/a", **BROKER)


@pytest.mark.parametrize(("content", "why"), [("\n", "no password"), ("a" * 4097, "too long"), ("\udc80", "no text")])
def test_a_file_that_holds_no_password_is_refused(tmp_path, content, why):
    file = tmp_path / "password"
    file.write_bytes(content.encode("utf-8", "surrogateescape"))
    file.chmod(0o600)
    with pytest.raises(BadFile, match=why):
        mqtt_options("mqtts://broker/a", ca=None, user="anna", password_file=file)


def test_files_that_are_not_there_are_told(tmp_path, keys):
    missing = tmp_path / "missing"
    with pytest.raises(BadFile, match="missing"):
        mqtt_options("mqtts://broker/a", ca=missing, user="", password_file=None)
    with pytest.raises(BadFile, match="missing"):
        opcua_options(URL, **NONE | {"certificate": missing, "key": missing, "anonymous": True})
    with pytest.raises(UsageError, match="is no folder"):
        pair = {"certificate": keys.server[0], "key": keys.server[1]}
        opcua_options(URL, **NONE | pair | {"trusted": missing, "anonymous": True})


def test_a_pair_is_made_once_with_a_key_for_its_owner(tmp_path):
    certificate, key = make_pair(tmp_path, "robot.example")
    assert key.stat().st_mode & 0o777 == 0o600
    assert read_pair(certificate, key)[2] == "urn:robot.example:armsight"
    with pytest.raises(UsageError, match="it is kept"):
        make_pair(tmp_path, "robot.example")


def test_a_certificate_of_another_key_is_refused(keys):
    with pytest.raises(BadFile, match="not the key"):
        read_pair(keys.server[0], keys.client[1])


def signed(keys, folder, *, ends, uri="urn:a:b"):
    secret = load_pem_private_key(keys.server[1].read_bytes(), None)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "a")])
    made = x509.CertificateBuilder(name, name, secret.public_key(), 7)
    made = made.not_valid_before(datetime.now(UTC) - timedelta(days=9)).not_valid_after(ends)
    if uri:
        made = made.add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)]), critical=False)
    file = folder / "made.pem"
    file.write_bytes(made.sign(secret, hashes.SHA256()).public_bytes(Encoding.PEM))
    return file


def test_a_certificate_that_has_ended_is_refused(keys, tmp_path):
    with pytest.raises(BadFile, match="is valid from"):
        read_pair(signed(keys, tmp_path, ends=datetime.now(UTC) - timedelta(days=1)), keys.server[1])


def test_a_certificate_that_names_no_application_is_refused(keys, tmp_path):
    with pytest.raises(BadFile, match="names no application"):
        read_pair(signed(keys, tmp_path, ends=datetime.now(UTC) + timedelta(days=1), uri=""), keys.server[1])


@pytest.mark.parametrize("content", [b"", b"no certificate", b"-----BEGIN CERTIFICATE-----\nMIIB\n"])
def test_what_is_no_certificate_and_no_key_is_refused(keys, tmp_path, content):
    file = tmp_path / "file.pem"
    file.write_bytes(content)
    with pytest.raises(BadFile, match="is no certificate"):
        read_pair(file, keys.server[1])
    with pytest.raises(BadFile, match="no private key"):
        read_pair(keys.server[0], file)


def test_a_folder_that_trusts_nobody_is_refused(tmp_path):
    with pytest.raises(BadFile, match="holds no certificate"):
        read_trusted(tmp_path)


def test_certificates_are_looked_at_before_anything_is_opened(keys, tmp_path):
    own = {"opcua": URL, "opcua_certificate": keys.server[0], "opcua_users": keys.tokens}
    with pytest.raises(BadFile, match="the key of"):
        PlantFlags(**own, opcua_key=keys.client[1]).made(print)
    with pytest.raises(BadFile, match="holds no certificate"):
        PlantFlags(**own, opcua_key=keys.server[1], opcua_trusted=tmp_path).made(print)
    with pytest.raises(BadFile, match="is no certificate"):
        PlantFlags(mqtt="mqtts://broker/a", mqtt_ca=keys.tokens).made(print)


def test_an_authority_that_is_none_is_refused(tmp_path):
    file = tmp_path / "ca.pem"
    file.write_text("no certificate")
    with pytest.raises(BadFile, match="is no certificate"):
        publishers(PlantOptions(mqtt=mqtt_options("mqtts://broker/a", ca=file, user="", password_file=None)), quiet)


@pytest.mark.parametrize(
    ("package", "module", "extra", "options"),
    [
        ("asyncua", "opcua.publisher", "plant", {"opcua": OpcUaOptions(host="127.0.0.1", port=0, anonymous=True)}),
        ("paho", "mqtt", "plant", {"mqtt": MqttOptions(host="127.0.0.1", port=1, prefix="a", tls=False)}),
        ("foxglove", "foxglove", "foxglove", {"foxglove": FoxgloveOptions(host="127.0.0.1", port=0)}),
    ],
)
def test_a_package_that_is_missing_is_told_with_its_extra(monkeypatch, package, module, extra, options):
    for name in [one for one in sys.modules if one == package or one.startswith(f"{package}.")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, package, None)
    for name in [one for one in sys.modules if one.startswith(f"armsight_plant.{module.split('.')[0]}")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(DeviceNotFound) as missing:
        publishers(PlantOptions(**options), quiet)
    assert f"armsight[{extra}]" in missing.value.cure
