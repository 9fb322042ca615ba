"""The door of pages: tokens in a cookie, and nobody without one where there are some."""

import asyncio
from typing import Any

import httpx
import pytest
from fastapi import FastAPI, Request

from armsight.server.auth import Authenticator
from armsight.server.gate import IDENTITY, Gate
from armsight.store.tokens import add_token, read_tokens


def behind(auth: Authenticator) -> Gate:
    app = FastAPI()

    @app.get("/live")
    def live(request: Request) -> str:
        return str(request.scope[IDENTITY].role)

    return Gate(app, auth)


def asked(gate: Gate, *requests: tuple[str, str, dict[str, Any]], scheme: str = "http") -> list[httpx.Response]:
    """Return the answers to requests (method, path, more) of one browser, which keeps its cookies."""

    async def ask() -> list[httpx.Response]:
        way = httpx.ASGITransport(gate, client=("127.0.0.1", 50000))
        async with httpx.AsyncClient(transport=way, base_url=f"{scheme}://localhost") as browser:
            return [await browser.request(method, path, **more) for method, path, more in requests]

    return asyncio.run(ask())


def page(**more: Any) -> tuple[str, str, dict[str, Any]]:
    return "GET", "/live", more


def logout(**headers: str) -> tuple[str, str, dict[str, Any]]:
    return "POST", "/logout", {"headers": headers}


def login(token: str) -> tuple[str, str, dict[str, Any]]:
    return "POST", "/login", {"data": {"token": token}}


@pytest.fixture
def tokens(tmp_path):
    file = tmp_path / "tokens.yaml"
    made = {role: add_token(file, name, role) for name, role in (("ann", "drive"), ("eve", "watch"))}
    return made, Authenticator(read_tokens(file))


def test_without_tokens_this_machine_comes_in():
    (answer,) = asked(behind(Authenticator()), page())
    assert answer.json() == "drive"


@pytest.mark.parametrize("role", ["drive", "watch"])
def test_a_token_is_asked_for_once_and_kept(tokens, role):
    made, auth = tokens
    first, let_in, then = asked(behind(auth), page(), login(made[role]), page())
    assert first.status_code == 401 and "token" in first.text
    assert let_in.status_code == 303 and "HttpOnly" in let_in.headers["set-cookie"]
    assert then.json() == role


def test_guessing_has_to_wait_and_opening_pages_does_not(tokens):
    made, auth = tokens
    *_, then = asked(behind(auth), *[page() for _ in range(10)], login(made["watch"]))
    assert then.status_code == 303
    *_, late = asked(behind(auth), *[login(f"guess{i}") for i in range(5)], login(made["watch"]))
    assert late.status_code == 303, "who has the right one comes in"
    *_, late = asked(behind(auth), *[login(f"guess{i}") for i in range(6)])
    assert late.status_code == 429


def test_the_cookie_is_no_token_and_ends_at_log_out(tokens):
    made, auth = tokens
    let_in, inside, out, then = asked(behind(auth), login(made["drive"]), page(), logout(), page())
    assert made["drive"] not in str(let_in.headers)
    assert (inside.status_code, out.status_code, then.status_code) == (200, 303, 401)
    old = let_in.headers["set-cookie"].split(";")[0]
    (again,) = asked(behind(auth), page(headers={"cookie": old}))
    assert again.status_code == 401, "the log-in has ended, not the cookie alone"


def test_a_second_log_in_of_a_browser_ends_the_first(tokens):
    made, auth = tokens
    first, second = asked(behind(auth), login(made["watch"]), login(made["drive"]))
    cookies = [answer.headers["set-cookie"].split(";")[0] for answer in (first, second)]
    codes = [asked(behind(auth), page(headers={"cookie": cookie}))[0].status_code for cookie in cookies]
    assert codes == [401, 200]


def test_a_foreign_page_logs_nobody_out(tokens):
    made, auth = tokens
    _, out, then = asked(behind(auth), login(made["drive"]), logout(origin="http://evil.example"), page())
    assert (out.status_code, then.status_code) == (403, 200)


def test_over_tls_the_cookie_is_bound_to_this_host(tokens):
    made, auth = tokens
    (let_in,) = asked(behind(auth), login(made["drive"]), scheme="https")
    cookie = let_in.headers["set-cookie"]
    assert cookie.startswith("__Host-") and all(f"; {flag}" in cookie for flag in ("Secure", "Path=/", "HttpOnly"))
    (plain,) = asked(behind(auth), page(headers={"cookie": cookie.split(";")[0]}))
    assert plain.status_code == 401, "plain text does not use it"
