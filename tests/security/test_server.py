"""The robot server as somebody attacks it from the network: what it says to what no client of ours sends."""

from __future__ import annotations

import json
import socket
import ssl
import struct
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from armsight.clock import ManualClock
from armsight.control.session.service import Service
from armsight.drivers.remote import protocol as say
from armsight.server import auth as doors
from armsight.server.messages import Session
from armsight.server.serving import background
from armsight.server.web_server import ServeOptions
from armsight.store.tokens import add_token, read_tokens

WAIT_S = 20.0
ODD_HOSTS = ("[::1].evil", "evil@localhost", "localhost#x", "[")
FOREIGN = ["http://evil.example", "https://127.0.0.1.evil.example", "http://localhost.evil.example", "null", "file://"]


@pytest.fixture(scope="module")
def url(fakes):
    """A server without tokens, for requests that change nothing."""
    with background(Service(fakes.FakeHost(), fakes.KeptLog())) as url:
        yield url


@pytest.fixture
def guarded(service, tokens):
    with background(service, ServeOptions(port=0, tokens=tokens.file)) as url:
        yield url, tokens


def opened(url: str, path: str, token: str = "", **headers: str) -> ClientConnection:
    known = {"Authorization": f"Bearer {token}"} if token else {}
    return connect(url + path, additional_headers={**known, **headers}, proxy=None, compression=None)


def message(line: ClientConnection) -> dict[str, Any]:
    found = json.loads(line.recv(timeout=WAIT_S))
    assert isinstance(found, dict)
    return found


def answer(line: ClientConnection, **fields: Any) -> dict[str, Any]:
    """Return the answer to a message."""
    line.send(json.dumps(fields))
    while True:
        told = message(line)
        if told.get("reply_to") is not None or told["type"] == "refused":
            return told


def test_who_has_lost_the_lease_moves_nothing(guarded, host, service):
    url, tokens = guarded
    with opened(url, say.DRIVE_PATH, tokens.drive) as line:
        session = message(line)["session"]
        host.tick(1000)  # silent for so long that another may drive
        service.authority.take("another")
        told = answer(line, type="joint_goal", session=session, seq=1, q=[0.1, 0.1])
        assert told["type"] == "refused"
    assert [what for what in host.told if what[0] == "post"] == []


@pytest.mark.parametrize("origin", FOREIGN)
@pytest.mark.parametrize("path", [say.STREAM_PATH, say.DRIVE_PATH])
def test_a_foreign_page_opens_no_socket(url, path, origin):
    with pytest.raises(InvalidStatus) as caught:
        opened(url, path, Origin=origin)
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize("said", [{"origin": "http://["}, {"host": "["}])
def test_headers_that_are_no_addresses_are_refused_in_words(said):
    found = doors.Authenticator().check(doors.Caller(address="127.0.0.1", **{"host": "localhost", **said}))
    assert isinstance(found, doors.Denied)


@pytest.mark.parametrize("origin", FOREIGN)
def test_a_foreign_page_reads_no_state_even_with_a_token(guarded, said, origin):
    url, tokens = guarded
    head = f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: robot\r\nOrigin: {origin}\r\nAuthorization: Bearer {tokens.drive}"
    told = said(url, f"{head}\r\n\r\n".encode())
    assert told.startswith(b"HTTP/1.1 403") and b"access-control" not in told.lower()


@pytest.mark.parametrize("name", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "", *ODD_HOSTS])
def test_a_foreign_name_that_leads_here_is_kept_out(url, said, name):
    told = said(url, f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: {name}\r\n\r\n".encode())
    assert told.split()[1] in (b"403", b"400")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "TRACE", "CONNECT", "OPTIONS", "BREW"])
def test_the_state_is_only_read(url, said, method):
    told = said(url, f"{method} {say.STATE_PATH} HTTP/1.1\r\nHost: localhost\r\nX-Told: secret\r\n\r\n".encode())
    assert told.split()[1] in (b"405", b"400") and b"secret" not in told


SMUGGLED = {
    "two lengths": b"Content-Length: 0\r\nContent-Length: 30\r\n",
    "a list of lengths": b"Content-Length: 5, 6\r\n",
    "a length that is no number": b"Content-Length: +1\r\n",
    "an unknown coding": b"Transfer-Encoding: xchunked\r\n",
    "codings over each other": b"Transfer-Encoding: gzip, chunked\r\n",
    "a blank before the colon": b"Transfer-Encoding : chunked\r\n",
    "a zero byte": b"X-A: b\x00c\r\n",
    "a lone carriage return": b"X-A: b\rContent-Length: 3\r\n",
    "two hosts": b"Host: evil.example\r\n",
}


@pytest.mark.parametrize("head", SMUGGLED.values(), ids=SMUGGLED)
def test_a_request_that_can_be_read_in_two_ways_is_refused(url, said, head):
    told = said(url, b"GET " + say.STATE_PATH.encode() + b" HTTP/1.1\r\nHost: localhost\r\n" + head + b"\r\n")
    assert told.split()[1] in (b"400", b"501")


def test_after_a_request_with_length_and_chunks_no_second_one_is_read(url):
    where, _, port = url.rpartition("//")[2].rpartition(":")
    hidden = b"GET /docs HTTP/1.1\r\nHost: localhost\r\n\r\n"
    head = f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n".encode()
    both = (
        head
        + f"Content-Length: {len(hidden) + 5}\r\nTransfer-Encoding: chunked\r\n\r\n".encode()
        + b"0\r\n\r\n"
        + hidden
    )
    with socket.create_connection((where, int(port)), timeout=WAIT_S) as line:
        line.sendall(both)
        told = b""
        while more := line.recv(65536):
            told += more
    assert told.count(b"HTTP/1.1 ") == 1 and b"<h1>" not in told


@pytest.mark.parametrize(
    "path", ["/nothing", "/api/v1/state/../../etc/passwd", "/%2e%2e/etc/passwd", "/docs/%00", "//"]
)
def test_what_is_not_there_tells_nothing(url, said, path):
    told = said(url, f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
    assert told.split()[1] in (b"404", b"400")
    assert not any(word in told for word in (b"Traceback", b"site-packages", b"uvicorn", b"python", b"server:"))


def test_a_fault_within_tells_the_caller_nothing_of_it(service, said, monkeypatch):
    def broken(*_: object) -> None:
        raise RuntimeError("/home/secret/place")

    monkeypatch.setattr(service.authority, "status", broken)
    with background(service) as url:
        told = said(url, f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    assert told.startswith(b"HTTP/1.1 500") and b"secret" not in told


@pytest.mark.parametrize(
    "text", ["[" * 60_000, '{"a":' * 10_000, "9" * 60_000, '{"type":"stop","seq":1e400}', "\ud800"]
)
def test_json_that_is_deep_or_huge_is_refused_and_nothing_more(text):
    with pytest.raises(say.Inconsistent):
        Session("drive").admit(text)


def test_a_socket_that_unpacks_is_not_agreed_on(url):
    with connect(url + say.STREAM_PATH, compression="deflate", proxy=None) as line:
        assert line.protocol.extensions == []


def test_a_frame_that_says_it_is_huge_ends_the_connection(url):
    with opened(url, say.STREAM_PATH) as line:
        line.socket.sendall(b"\x81\xff" + struct.pack(">Q", 1 << 40) + b"\0\0\0\0")
        with pytest.raises(ConnectionClosed) as caught:
            while True:
                line.recv(timeout=WAIT_S)
        assert caught.value.rcvd is not None and caught.value.rcvd.code == 1009


def test_wrong_tokens_are_counted_by_the_address_of_the_connection(guarded, said):
    url, tokens = guarded
    ask = f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: robot\r\n"
    ask += "Authorization: Bearer {}\r\nX-Forwarded-For: 10.0.0.{}\r\n\r\n"
    codes = [said(url, ask.format(f"guess{i}", i).encode()).split()[1] for i in range(doors.FAILURES)]
    assert codes == [b"401"] * doors.FAILURES
    assert said(url, ask.format("guess", 99).encode()).split()[1] == b"429"
    assert said(url, ask.format(tokens.drive, 99).encode()).split()[1] == b"200"


@pytest.mark.parametrize("form", ["{}", "Basic {}", "Bearer {}x", "bearer  ", "Token {}"])
def test_a_token_in_another_form_is_none(tokens, form):
    caller = doors.Caller(address="192.0.2.1", authorization=form.format(tokens.drive), host="robot")
    assert isinstance(tokens.auth.check(caller), doors.Denied)


@pytest.mark.parametrize("where", ["?token={}", "?access_token={}", "#{}"])
def test_a_token_in_the_address_opens_nothing_and_is_not_kept(guarded, log, said, where):
    url, tokens = guarded
    told = said(url, f"GET {say.STATE_PATH}{where.format(tokens.drive)} HTTP/1.1\r\nHost: robot\r\n\r\n".encode())
    assert told.split()[1] in (b"401", b"400", b"404")
    assert not any(tokens.drive in text for _, text in log.events)


def test_no_refusal_writes_a_token_into_the_log(guarded, log, said, caplog):
    url, tokens = guarded
    for form in ("Basic {}", "Bearer {}x"):
        head = f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: robot\r\nAuthorization: {form.format(tokens.drive)}\r\n\r\n"
        said(url, head.encode())
    assert log.events and not any(tokens.drive in text for _, text in log.events)
    assert tokens.drive not in caplog.text


def test_an_origin_cannot_write_a_line_of_its_own_into_the_log(tokens):
    caller = doors.Caller(address="192.0.2.1", host="robot", origin="http://x\nerror: forged")
    found = tokens.auth.check(caller)
    assert isinstance(found, doors.Denied) and "\n" not in found.why


@pytest.fixture
def secured(service, tokens, certificate):
    cert, key = certificate
    with background(service, ServeOptions(port=0, tokens=tokens.file, tls_cert=cert, tls_key=key)) as url:
        yield url, cert


def tls(url: str, context: ssl.SSLContext) -> ssl.SSLSocket:
    port = int(url.rpartition(":")[2])
    return context.wrap_socket(
        socket.create_connection(("127.0.0.1", port), timeout=WAIT_S), server_hostname="localhost"
    )


@pytest.mark.filterwarnings("ignore:ssl.TLSVersion:DeprecationWarning")
@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1])
def test_old_versions_of_tls_are_not_spoken(secured, version):
    url, cert = secured
    context = ssl.create_default_context(cafile=str(cert))
    context.set_ciphers("ALL:@SECLEVEL=0")
    context.minimum_version, context.maximum_version = version, version
    with pytest.raises(ssl.SSLError):
        tls(url, context)


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_what_is_agreed_on_has_forward_secrecy_and_is_authenticated(secured, version):
    url, cert = secured
    context = ssl.create_default_context(cafile=str(cert))
    context.minimum_version = context.maximum_version = version
    with tls(url, context) as line:
        name = line.cipher()[0]
    assert "GCM" in name or "CHACHA20" in name
    assert version is ssl.TLSVersion.TLSv1_3 or name.startswith("ECDHE")


@pytest.mark.parametrize("ciphers", ["NULL", "3DES", "RC4", "aNULL", "AES128-SHA", "ECDHE-ECDSA-AES128-SHA"])
def test_weak_ciphers_are_not_agreed_on(secured, ciphers):
    url, cert = secured
    context = ssl.create_default_context(cafile=str(cert))
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.set_ciphers(f"{ciphers}:@SECLEVEL=0")
    except ssl.SSLError:
        pytest.skip("this OpenSSL does not know them at all")
    with pytest.raises(ssl.SSLError):
        tls(url, context)


def test_a_certificate_that_nobody_trusts_is_not_taken(secured):
    with pytest.raises(ssl.SSLCertVerificationError):
        tls(secured[0], ssl.create_default_context())


def test_plain_text_gets_no_answer_on_a_port_with_tls(secured, said):
    try:
        told = said(secured[0], f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    except ConnectionResetError:
        told = b""
    assert b"HTTP" not in told


@pytest.mark.parametrize("what", ["taken out", "made anew"])
def test_a_token_that_is_no_more_in_the_file_opens_nothing(guarded, said, what):
    url, tokens = guarded
    ask = f"GET {say.STATE_PATH} HTTP/1.1\r\nHost: robot\r\nAuthorization: Bearer {tokens.watch}\r\n\r\n".encode()
    assert said(url, ask).split()[1] == b"200"
    if what == "made anew":
        add_token(tokens.file, "eve", "watch")
    else:
        (ann,) = [entry for entry in read_tokens(tokens.file) if entry.name == "ann"]
        text = tokens.file.read_text()
        tokens.file.write_text(text[: text.index("- ")] + f"- {{name: ann, role: drive, sha256: {ann.sha256}}}\n")
    assert said(url, ask).split()[1] == b"401"


def test_wrong_tokens_do_not_keep_the_right_one_from_a_machine_others_share(tokens):
    auth = doors.Authenticator(read_tokens(tokens.file), clock=ManualClock(0.0))
    for i in range(doors.FAILURES):
        auth.check(doors.Caller(address="192.0.2.1", authorization=f"Bearer guess{i}", host="robot"))
    found = auth.check(doors.Caller(address="192.0.2.1", authorization=f"Bearer {tokens.drive}", host="robot"))
    assert isinstance(found, doors.Identity)
