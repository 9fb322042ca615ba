"""The door of pages: tokens in a cookie, and nobody without one where there are some."""

from __future__ import annotations

import pytest
from fastapi import FastAPI, Request, WebSocket
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from armsight.server.auth import Authenticator
from armsight.server.gate import COOKIE, IDENTITY, Gate
from armsight.store.tokens import add_token, read_tokens


def behind(auth, **client):
    app = FastAPI()

    @app.get("/live")
    def live(request: Request) -> str:
        return str(request.scope[IDENTITY].role)

    @app.websocket("/console/robot")
    async def robot(socket: WebSocket) -> None:
        await socket.accept()
        await socket.send_text(socket.scope[IDENTITY].who)
        await socket.close()

    return TestClient(
        Gate(app, auth, secure=False),
        base_url="http://localhost",
        client=("127.0.0.1", 50000),
        follow_redirects=False,
        **client,
    )


@pytest.fixture
def tokens(tmp_path):
    file = tmp_path / "tokens.yaml"
    made = {role: add_token(file, name, role) for name, role in (("ann", "drive"), ("eve", "watch"))}
    return made, Authenticator(read_tokens(file))


def test_without_tokens_this_machine_comes_in():
    assert behind(Authenticator()).get("/live").json() == "drive"


def test_without_tokens_a_foreign_name_stays_out():
    assert behind(Authenticator()).get("/live", headers={"host": "evil.example"}).status_code == 403


@pytest.mark.parametrize("role", ["drive", "watch"])
def test_a_token_is_asked_for_once_and_kept(tokens, role):
    made, auth = tokens
    client = behind(auth)
    asked = client.get("/live")
    assert asked.status_code == 401 and "token" in asked.text
    answer = client.post("/login", data={"token": made[role]})
    assert answer.status_code == 303 and "HttpOnly" in answer.headers["set-cookie"]
    assert client.get("/live").json() == role


def test_a_wrong_token_is_told_and_not_kept(tokens):
    client = behind(tokens[1])
    answer = client.post("/login", data={"token": "wrong"})
    assert answer.status_code == 401 and COOKIE not in client.cookies
    assert client.post("/login", data={"token": "x" * 5000}).status_code == 413


def test_opening_pages_without_a_token_is_no_attack(tokens):
    made, auth = tokens
    client = behind(auth)
    assert [client.get("/live").status_code for _ in range(10)] == [401] * 10
    assert client.post("/login", data={"token": made["watch"]}).status_code == 303


def test_a_socket_needs_the_token_too(tokens):
    made, auth = tokens
    client = behind(auth)
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/console/robot"):
        pass
    client.cookies.set(COOKIE, made["drive"])
    with client.websocket_connect("/console/robot") as socket:
        assert socket.receive_text() == "ann"
