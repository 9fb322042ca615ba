"""Addresses, certificates and secrets: what is refused before anything is opened, and in which words."""

import sys

import pytest

from armsight.errors import BadFile, DeviceNotFound, UsageError
from armsight.ops.requests.plant import PlantFlags
from armsight_plant.certificates import make_pair, read_pair
from armsight_plant.options import FoxgloveOptions, MqttOptions, OpcUaOptions, PlantOptions, mqtt_options, opcua_options
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
        ("4840", "there is no scheme"),
        ("opc.tcp://", "no address"),
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
        ("mqtts://broker/a+b", "no topic may"),
        ("mqtts://broker/$SYS/a", "no topic may"),
        ("mqtts://broker/a%ffb", "no topic may"),
        ("mqtt://broker.example/a", "in plain text"),
        ("mqtts://anna:secret@broker/a", "a name or a password"),
    ],
)
def test_a_broker_that_is_none_is_refused(url, why):
    with pytest.raises(UsageError, match=why) as refused:
        mqtt_options(url, **BROKER)
    assert "secret" not in str(refused.value)


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


def test_a_pair_is_made_once_with_a_key_for_its_owner(tmp_path):
    certificate, key = make_pair(tmp_path, "robot.example")
    assert key.stat().st_mode & 0o777 == 0o600
    assert read_pair(certificate, key)[2] == "urn:robot.example:armsight"
    with pytest.raises(UsageError, match="it is kept"):
        make_pair(tmp_path, "robot.example")


def test_a_certificate_of_another_key_is_refused(keys):
    with pytest.raises(BadFile, match="not the key"):
        read_pair(keys.server[0], keys.client[1])


def test_certificates_are_looked_at_before_anything_is_opened(keys, tmp_path):
    own = {"opcua": URL, "opcua_certificate": keys.server[0], "opcua_users": keys.tokens}
    with pytest.raises(BadFile, match="the key of"):
        PlantFlags(**own, opcua_key=keys.client[1]).made(print)
    with pytest.raises(BadFile, match="holds no certificate"):
        PlantFlags(**own, opcua_key=keys.server[1], opcua_trusted=tmp_path).made(print)
    with pytest.raises(BadFile, match="is no certificate"):
        PlantFlags(mqtt="mqtts://broker/a", mqtt_ca=keys.tokens).made(print)


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
