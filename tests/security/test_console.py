"""The console as somebody attacks it from the network: as nobody, as one who may only watch, out of a foreign page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from nicegui import Client
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from armsight.console import application, texts
from armsight.console.routes import PAGE_NAME, SAID
from armsight.console.state import Console
from armsight.errors import BadFile
from armsight.server.serving import background
from refusals import refuses

WAIT_S = 20.0
PAGES = sorted(application.PAGES)


def ask(served: Any, method: str, path: str, token: str = "", **headers: str) -> httpx.Response:
    known = {"authorization": f"Bearer {token}"} if token else {}
    return httpx.request(method, served.at + path, headers={**known, **headers}, timeout=WAIT_S)


def logged_in(served: Any) -> str:
    """Log a browser in as the driver; return its cookie."""
    answer = httpx.post(f"{served.at}/login", data={"token": served.drive}, timeout=WAIT_S)
    return answer.headers["set-cookie"].split(";")[0]


ALL = [("GET", f"/{page}") for page in PAGES] + [
    ("GET", "/"),
    ("GET", "/console/files/report.html"),
    ("PUT", "/console/files/rig.yaml"),
    ("POST", "/console/stop"),
    ("GET", "/console/static/robot.js"),
    ("GET", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"),
    ("GET", "/docs"),
    ("GET", "/openapi.json"),
]
SOCKETS = ["/console/robot", "/console/pictures/left", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"]


@pytest.mark.parametrize("origin", ["http://evil.example", "null"])
def test_a_foreign_page_reaches_nothing_even_with_the_cookie(served: Any, origin: str) -> None:
    cookie = logged_in(served)
    for method, path in ALL:
        assert ask(served, method, path, origin=origin, cookie=cookie).status_code == 403, path
    for path in SOCKETS:
        with pytest.raises(InvalidStatus):
            connect(served.socket + path, additional_headers={"origin": origin, "cookie": cookie}, proxy=None)


def test_what_is_no_path_of_the_interface_leaves_nothing_behind(served: Any) -> None:
    before = len(Client.instances)
    for path in ("/api/nothing", "/api/v1/../../live", "/api/", "/api/v1/stream"):
        assert ask(served, "GET", path).status_code in (401, 404)
    assert len(Client.instances) == before


@pytest.mark.parametrize("name", [page for page in PAGES if page != "live"])
def test_a_watcher_sees_no_page_that_changes_anything(served: Any, name: str) -> None:
    page = ask(served, "GET", f"/{name}", served.watch)
    assert texts.WATCHING in page.text and "field-" not in page.text


LISTENING = {"sub_pages_open", "sub_pages_navigate", "update:value", "update:modelValue"}
"""What NiceGUI itself hears of every page: navigation, and the dark mode's and the header's own state."""


@pytest.mark.parametrize("name", PAGES)
def test_no_element_of_a_watchers_page_hears_anything(served: Any, name: str) -> None:
    known = set(Client.instances)
    ask(served, "GET", f"/{name}", served.watch)
    (made,) = set(Client.instances) - known
    elements = Client.instances[made].elements.values()
    heard = {(element.tag, one.type) for element in elements for one in element._event_listeners.values()}
    assert {kind for _, kind in heard} <= LISTENING
    assert {tag for tag, _ in heard} <= {"q-layout", "nicegui-dark_mode", "nicegui-header"}


def test_a_drivers_page_hears_more(served: Any) -> None:
    known = set(Client.instances)
    ask(served, "GET", "/settings", served.drive)
    (made,) = set(Client.instances) - known
    elements = Client.instances[made].elements.values()
    assert any(one.type == "click" for element in elements for one in element._event_listeners.values())


@contextmanager
def driving(served: Any, page: str) -> Iterator[None]:
    """Drive from a page of ann's, with the enable held, while the block runs."""
    with connect(f"{served.socket}/console/robot", additional_headers=bearer(served.drive), proxy=None) as line:
        line.send(json.dumps({"do": "page", "page": page}))
        line.send(json.dumps({"do": "beat", "enable": True, "seen": json.loads(line.recv(timeout=WAIT_S))["t"]}))
        while not json.loads(line.recv(timeout=WAIT_S))["mine"]:
            pass
        yield
    while served.robot.service.authority.driver is not None:
        ask(served, "GET", "/api/v1/state", served.watch)


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


def test_a_watcher_does_not_learn_the_name_of_the_drivers_page(served: Any) -> None:
    page = page_of(served, "/live", served.drive)
    name = page.storage[PAGE_NAME]
    assert name != page.id, "that of NiceGUI stands in the address of its socket"
    with (
        driving(served, name),
        connect(f"{served.socket}/console/robot", additional_headers=bearer(served.watch), proxy=None) as watcher,
    ):
        told = [str(watcher.recv(timeout=WAIT_S)) for _ in range(3)]
    assert "ann" in told[-1], "who drives is told"
    assert not any(name in text for text in [*told, ask(served, "GET", "/live", served.watch).text])


def page_of(served: Any, path: str, token: str) -> Client:
    """Open a page and return it as the server has it."""
    known = set(Client.instances)
    ask(served, "GET", path, token)
    (made,) = set(Client.instances) - known
    return Client.instances[made]


@pytest.mark.parametrize("path", ["/live", "/nothing", "/console/files/none.html", "/console/static/robot.js"])
def test_every_answer_says_how_it_may_be_shown(served: Any, path: str) -> None:
    headers = ask(served, "GET", path, served.drive).headers
    assert {name: set(headers.get_list(name)) for name in SAID} == {name: {value} for name, value in SAID.items()}
    assert "server" not in headers and "x-powered-by" not in headers and "access-control-allow-origin" not in headers


@pytest.mark.parametrize("where", ["door", "server alone"])
def test_answers_of_the_door_and_of_a_server_alone_say_so_too(served: Any, service: Any, where: str) -> None:
    if where == "door":
        headers = ask(served, "GET", "/live").headers
    else:
        with background(service) as url:
            headers = httpx.get(url.replace("ws", "http", 1) + "/docs", timeout=WAIT_S).headers
    assert headers.get("x-frame-options") == "DENY" and headers.get("x-content-type-options") == "nosniff"


def test_the_cookie_is_for_this_server_and_no_script_and_is_not_the_token(served: Any) -> None:
    answer = httpx.post(f"{served.at}/login", data={"token": served.drive}, timeout=WAIT_S)
    kept = answer.headers["set-cookie"]
    assert all(flag in kept for flag in ("HttpOnly", "SameSite=strict", "Path=/"))
    assert served.drive not in f"{answer.headers} {answer.text}"


def test_a_foreign_page_cannot_log_a_browser_in(served: Any) -> None:
    sent = {"data": {"token": served.drive}, "headers": {"origin": "http://evil.example"}, "timeout": WAIT_S}
    answer = httpx.post(f"{served.at}/login", **sent)
    assert answer.status_code == 403 and "set-cookie" not in answer.headers


@pytest.mark.parametrize("token", ["<script>alert(1)</script>", "'\"><img src=x>", "{why}", "%00", "x" * 300])
def test_what_was_typed_as_token_does_not_come_back(served: Any, token: str) -> None:
    served.app.state.auth._failed.clear()
    answer = httpx.post(f"{served.at}/login", data={"token": token}, timeout=WAIT_S)
    assert answer.status_code == 401 and token not in answer.text
    served.app.state.auth._failed.clear()


def test_a_page_that_fails_tells_nothing_of_the_fault(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("/home/secret/place")

    monkeypatch.setattr("armsight.console.application.text_of", application.text_of)
    monkeypatch.setattr("armsight.console.layout.level_of", broken)
    monkeypatch.setattr(Console, "require_robot", broken)
    answer = ask(served, "GET", "/teach", served.drive)
    assert "secret" not in answer.text and "Traceback" not in answer.text
    assert answer.status_code == 500 and texts.PAGE_FAILED in answer.text


OUTSIDE = [
    "../secret.html",
    "..%2Fsecret.html",
    "%2e%2e/secret.html",
    "sub/../../secret.html",
    "sub%2f..%2f..%2fsecret.html",
    "..%5Csecret.html",
    "/etc/passwd",
    "%2Fetc%2Fpasswd",
    "cell.yaml",
    "link.html",
    "linked/secret.html",
    "report.html%00.yaml",
    ".hidden.html",
]


@pytest.fixture
def reports(served: Any) -> Path:
    folder: Path = served.folder
    (folder.parent / "secret.html").write_text("secret")
    (folder / "report.html").write_text("<script>told=1</script>")
    (folder / ".hidden.html").write_text("secret")
    (folder / "cell.yaml").write_text("secret")
    for name, goal in (("link.html", folder.parent / "secret.html"), ("linked", folder.parent)):
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(goal)
    return folder


@pytest.mark.parametrize("name", OUTSIDE)
def test_only_reports_of_the_cell_are_served(served: Any, reports: Path, said: Callable[..., bytes], name: str) -> None:
    head = f"GET /console/files/{name} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
    told = said(served.socket, f"{head}Authorization: Bearer {served.drive}\r\n\r\n".encode())
    assert told.split()[1] in (b"404", b"405", b"307") and b"\r\n\r\nsecret" not in told


@pytest.mark.parametrize("name", ["../rig.yaml", "..%2Frig.yaml", "rig.html", "x.mcap", "r%0d%0aig.yaml", "con.yaml/x"])
def test_only_files_of_a_cell_are_taken(served: Any, said: Callable[..., bytes], name: str) -> None:
    before = {path.name for path in served.folder.iterdir()}
    head = f"PUT /console/files/{name} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\n"
    told = said(served.socket, f"{head}Authorization: Bearer {served.drive}\r\n\r\nx".encode())
    assert told.split()[1] in (b"400", b"404", b"405")
    assert {path.name for path in served.folder.iterdir()} == before and not (
        served.folder.parent / "rig.yaml"
    ).exists()


def test_a_file_is_not_brought_through_a_link_that_leads_nowhere(served: Any) -> None:
    goal = served.folder.parent / "made.yaml"
    (served.folder / "new.yaml").symlink_to(goal)
    assert ask(served, "PUT", "/console/files/new.yaml", served.drive).status_code == 409
    assert not goal.exists()


def test_a_report_reaches_neither_robot_nor_console(served: Any, reports: Path) -> None:
    policy = ask(served, "GET", "/console/files/report.html", served.drive).headers["content-security-policy"]
    assert policy.startswith("sandbox ") and "allow-same-origin" not in policy and "frame-ancestors 'none'" in policy


@pytest.mark.parametrize("name", ["/etc/passwd", "../secret.yaml", "a/../../secret.yaml"])
@pytest.mark.parametrize("what", ["rig", "target", "world"])
def test_a_cell_names_no_file_elsewhere(served: Any, name: str, what: str) -> None:
    cell = served.console.cell.model_copy(update={what: name})
    with refuses(BadFile, name, "not in"):
        served.console.job_of(cell)


ODD = {
    "deep": "[" * 1900,
    "a huge share": '{"do": "override", "share": 1' + "0" * 400 + "}",
    "a huge time": '{"do": "beat", "enable": true, "seen": 1' + "0" * 400 + "}",
    "a digit that is no number": '{"do": "beat", "enable": true, "seen": 1, "push": "joints:\u00b2:1"}',
    "a share that is no number": '{"do": "override", "share": NaN}',
    "an axis without end": '{"do": "beat", "enable": true, "push": "joints:' + "9" * 1500 + ':1"}',
    "no mapping": "[1]",
    "too long": '{"do": "' + "x" * 5000 + '"}',
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_messages_of_a_page_do_nothing(served: Any, kind: str) -> None:
    path = f"{served.socket}/console/robot"
    with connect(path, additional_headers={"authorization": f"Bearer {served.drive}"}, proxy=None) as line:
        line.send(ODD[kind])
        assert [json.loads(line.recv(timeout=WAIT_S))["mine"] for _ in range(3)]
    served.robot.session.override = 0.5
