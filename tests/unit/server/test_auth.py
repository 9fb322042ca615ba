"""Who may come in."""

import pytest

from armsight.clock import ManualClock
from armsight.control.session.channels import SESSION_BYTES, Newest
from armsight.errors import BadFile, UsageError
from armsight.server.auth import DAY_S, FAILURES, MOST, WINDOW_S, Authenticator, BrowserSessions, Caller, Identity
from armsight.server.web_server import ServeOptions, check_options
from armsight.store.tokens import add_token, read_tokens
from refusals import refuses


@pytest.fixture(scope="module")
def issued(tmp_path_factory):
    path = tmp_path_factory.mktemp("tokens") / "tokens.yaml"
    return path, {"anna": add_token(path, "anna", "drive"), "bert": add_token(path, "bert", "watch")}


def caller(token=None, address="192.0.2.7", **headers):
    authorization = "" if token is None else f"Bearer {token}"
    return Caller(address=address, authorization=authorization, host=headers.pop("host", "robot:8765"), **headers)


def test_a_token_gives_its_name_and_role(issued):
    path, tokens = issued
    auth = Authenticator(read_tokens(path))
    assert auth.check(caller(tokens["anna"])) == Identity(who="anna", role="drive")
    assert auth.check(caller(tokens["bert"])) == Identity(who="bert", role="watch")


def test_the_file_holds_no_token(issued):
    path, tokens = issued
    assert not any(token in path.read_text() for token in tokens.values())
    assert path.stat().st_mode & 0o777 == 0o600


def test_after_failures_wrong_tokens_have_to_wait_and_a_right_one_comes_in(issued):
    path, tokens = issued
    clock = ManualClock(50.0)
    auth = Authenticator(read_tokens(path), clock=clock)
    for _ in range(FAILURES):
        assert auth.check(caller("wrong")).status == 401
    assert auth.check(caller("wrong")).status == 429
    assert isinstance(auth.check(caller(tokens["anna"])), Identity), "who stops the robot is not held up by others"
    assert auth.check(caller("wrong")).status == 429, "and does not make guessing free"
    assert auth.check(caller("wrong", address="192.0.2.8")).status == 401
    clock.advance(WINDOW_S + 1.0)
    assert auth.check(caller("wrong")).status == 401


def test_a_log_in_is_random_and_ends_with_its_token_by_hand_and_after_a_day(issued):
    path, tokens = issued
    clock = ManualClock(50.0)
    auth = Authenticator(path, clock=clock)
    anna = auth.check(caller(tokens["anna"]))
    first, second, third = (auth.log_in(anna) for _ in range(3))
    assert len({first, second, third}) == 3 and tokens["anna"] not in first
    found = {name: auth.check(caller(session=name)) for name in (first, second, third)}
    assert list(found.values()) == [anna] * 3 and all(auth.knows(one) for one in found.values())
    auth.sessions.end(first)
    assert auth.check(caller(session=first)).status == 401 and not auth.knows(found[first])
    assert auth.knows(found[second])
    clock.advance(DAY_S - 1.0)
    assert auth.knows(found[second])
    clock.advance(2.0)
    assert auth.check(caller(session=second)).status == 401 and not auth.knows(found[second])


def test_who_came_by_a_token_that_was_made_anew_is_known_no_more(tmp_path):
    path = tmp_path / "tokens.yaml"
    token = add_token(path, "anna", "drive")
    auth = Authenticator(path)
    anna = auth.check(caller(token))
    by_log_in = auth.check(caller(session=auth.log_in(anna)))
    assert auth.knows(anna) and auth.knows(by_log_in)
    add_token(path, "anna", "drive")
    assert not auth.knows(anna) and not auth.knows(by_log_in)


def test_an_id_that_is_none_is_no_guess(issued):
    """A browser that was open while the server was started anew sends its old one with every request."""
    auth = Authenticator(read_tokens(issued[0]))
    assert {auth.check(caller(session=f"old{i}")).status for i in range(2 * FAILURES)} == {401}
    assert auth.check(caller("wrong")).status == 401


def test_log_ins_beyond_the_most_end_the_oldest_of_the_token_with_most():
    sessions = BrowserSessions()
    own = sessions.begin("a" * 64)
    others = [sessions.begin("b" * 64) for _ in range(MOST)]
    assert sessions.token(BrowserSessions.digest(own)) == "a" * 64
    kept = [bool(sessions.token(BrowserSessions.digest(one))) for one in others]
    assert kept == [False] + [True] * (MOST - 1)


def test_another_process_reads_the_log_ins():
    memory = Newest(SESSION_BYTES)
    writer, reader = BrowserSessions(memory), BrowserSessions(memory)
    made = writer.begin("a" * 64)
    assert reader.token(BrowserSessions.digest(made)) == "a" * 64
    writer.end(made)
    assert reader.token(BrowserSessions.digest(made)) == ""


def test_every_entry_is_compared_in_constant_time(issued, monkeypatch):
    path, tokens = issued
    compared = []

    def compare(a, b):
        compared.append((len(a), len(b)))
        return a == b

    monkeypatch.setattr("hmac.compare_digest", compare)
    Authenticator(read_tokens(path)).check(caller(tokens["anna"]))
    assert compared == [(64, 64), (64, 64)]


@pytest.mark.parametrize("bind", ["0.0.0.0", "192.0.2.1", ""])
def test_other_addresses_need_tls_and_tokens(bind, issued, certificate):
    path, _ = issued
    cert, key = certificate
    for given in ({}, {"tokens": path}, {"tls_cert": cert, "tls_key": key}):
        with refuses(UsageError, "machines"):
            check_options(ServeOptions(bind=bind, **given))
    assert len(check_options(ServeOptions(bind=bind, tokens=path, tls_cert=cert, tls_key=key))) == 2


def test_a_certificate_needs_its_key(certificate, tmp_path):
    cert, key = certificate
    with refuses(UsageError, "key"):
        check_options(ServeOptions(tls_cert=cert))
    with refuses(BadFile, "certificate"):
        check_options(ServeOptions(tls_cert=key, tls_key=cert))
    with refuses(BadFile, "certificate"):
        check_options(ServeOptions(tls_cert=tmp_path / "none.pem", tls_key=key))


@pytest.mark.parametrize(("mode", "word"), [(0o644, "read"), (0o620, "write")])
def test_a_key_that_others_may_use_is_refused(certificate, tmp_path, mode, word):
    cert, key = certificate
    mine = tmp_path / "key.pem"
    mine.write_bytes(key.read_bytes())
    for kept in (0o600, 0o400, 0o640):  # a group that reads keys is usual on servers
        mine.chmod(kept)
        check_options(ServeOptions(tls_cert=cert, tls_key=mine))
    mine.chmod(mode)
    with refuses(BadFile, word, f"chmod 600 {mine}"):
        check_options(ServeOptions(tls_cert=cert, tls_key=mine))


def test_a_new_token_replaces_the_one_of_its_name(tmp_path):
    path = tmp_path / "tokens.yaml"
    old, new = add_token(path, "anna", "watch"), add_token(path, "anna", "drive")
    (entry,) = read_tokens(path)
    assert entry.role == "drive"
    assert entry.matches(new)
    assert not entry.matches(old)
