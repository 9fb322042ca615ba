"""Whoever speaks to a served robot, every message and route that there is to say, and what comes of one."""

from __future__ import annotations

import json
import pickle
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
from nicegui import Client
from websockets.sync.client import connect

from armsight.app.operator.robot_cell import RobotCell
from armsight.console.application import PAGES, add_console
from armsight.console.routes import PAGE_NAME
from armsight.console.state import Console
from armsight.control.guard import Limits
from armsight.control.session.operator_session import OperatorSession, Person
from armsight.control.session.service import Service
from armsight.control.setpoints import Hold, Reset
from armsight.drivers.remote import protocol as say
from armsight.kinematics import preset
from armsight.server import stop_line as lines
from armsight.server.application import create_app
from armsight.server.auth import Authenticator, BrowserSessions
from armsight.server.connections import LINE, Connections
from armsight.server.gate import LOGOUT, Gate
from armsight.server.waiting import listening
from armsight.server.web_server import ServeOptions, web_server
from armsight.store.tokens import add_token

WAIT_S = 30.0
ANN = Person(who="ann")
Q = [0.0, -1.0, 1.0, -0.5, 0.5, 0.1]

CALLERS = {
    "none": "no token",
    "expired": "expired",
    "watch": "watcher",
    "watch as": "watcher with the driver's names",
    "drive as": "another driver with the driver's names",
    "drive": "driver",
}
"""As: what it says carries the driver's page, session, key or NiceGUI's name of the driver's page."""


@dataclass
class Caller:
    """Who speaks: a token, and whether in names of their own; expire: take the token out."""

    who: str
    token: str
    mine: bool = True
    expire: Callable[[], object] = lambda: None

    @property
    def headers(self) -> dict[str, str]:
        return {"authorization": f"Bearer {self.token}"} if self.token else {}


POSE = {"xyz_m": [-0.997226, -0.244854, 0.561936], "quat_xyzw": [0.619769, -0.031014, -0.303241, 0.723166]}
"""Of ur10's flange at Q."""

PROGRAM: dict[str, dict[str, Any]] = {
    "heartbeat": {"enable": True},
    "joint_goal": {"q": Q},
    "joint_velocity": {"qd": [0.1] * 6},
    "joint_step": {"step": [0.001] * 6},
    "flange_pose": {"T_base_flange": POSE},
    "tool_twist": {"velocity_m_s": [0.01] * 3, "angular_rad_s": [0.0] * 3},
    "hold": {},
    "stop": {},
    "reset": {},
    "read": {},
}
PAGE: dict[str, dict[str, Any]] = {
    "page": {"do": "page"},
    "beat: enable": {"do": "beat", "enable": True},
    "beat: key": {"do": "beat", "enable": True, "push": {"frame": "joints", "axis": 0, "sense": "1"}},
    "beat: let go": {"do": "beat", "enable": False},
    "stop": {"do": "stop"},
    "reset": {"do": "reset"},
    "override": {"do": "override", "share": 0.25},
}
NICEGUI: dict[str, dict[str, Any]] = {
    "event": {"args": []},
    "javascript_response": {"request_id": "x"},
    "ack": {"next_message_id": 0},
    "log": {"level": "info", "message": "hello"},
    "handshake": {"tab_id": "t", "document_id": "d"},
}
ROUTES: dict[tuple[str, str], str] = {
    **{("GET", f"/{name}"): f"/{name}" for name in PAGES},
    ("GET", "/"): "/",
    ("GET", "/docs"): "/docs",
    ("GET", "/openapi.json"): "/openapi.json",
    ("GET", say.STATE_PATH): say.STATE_PATH,
    ("GET", "/api/v1/protocol"): "/api/v1/protocol",
    ("GET", "/console/files/{name:path}"): "/console/files/report.html",
    ("PUT", "/console/files/{name}"): "/console/files/new.yaml",
    ("POST", "/console/stop"): "/console/stop",
    ("GET", "/console/static"): "/console/static/robot.js",
    ("GET", "/_nicegui"): f"/_nicegui/{__import__('nicegui').__version__}/static/nicegui.js",
    ("GET", "/favicon.ico"): "/favicon.ico",
    ("POST", LOGOUT): LOGOUT,
    ("POST", say.STOP_PATH): say.STOP_PATH,
}
MOUNTED = {"", "/api", "/_nicegui_ws"}
"""NiceGUI's own application; what is no path of the interface; NiceGUI's socket, which is the row of its own."""


class World:
    """A served robot in memory with its pages and its line for stops; tokens: ann and ben drive, eve watches."""

    def __init__(self, folder: Path, fakes: Any, stack: ExitStack) -> None:
        self.folder, self.file = folder / "cell", folder / "tokens.yaml"
        self.folder.mkdir()
        (self.folder / "report.html").write_text("<p>")
        self.tokens = {name: add_token(self.file, name, "drive") for name in ("ann", "ben", "cy")}
        self.tokens["eve"] = add_token(self.file, "eve", "watch")
        self.host = fakes.FakeHost(6)
        self.host.description = self.host.description.model_copy(update={"takes_poses": True})
        for joint in self.host.description.joints:
            assert joint.lower is not None and joint.lower <= min(Q)
        self.host.arm = preset("ur10")
        self.service = Service(self.host, fakes.KeptLog())
        self.session = OperatorSession(self.service)
        robot = RobotCell(robot="fake:0", service=self.service, session=self.session, limits=Limits())
        self.auth = Authenticator(self.file, sessions=BrowserSessions(self.host.line.sessions))
        self.app = create_app(self.service, self.auth)
        self.console = Console(folder=self.folder, robot=robot)
        add_console(self.app, self.console)
        self.line_auth = Authenticator(self.file, sessions=BrowserSessions(self.host.line.sessions))
        line = lines.StopLine(self.host.line, self.line_auth).app()
        self.at = self._run(stack, fakes, Gate(self.app, self.auth), Connections(lambda _: None), lifespan=True)
        self.line_at = self._run(stack, fakes, line, Connections(lambda _: None, LINE), lifespan=False)
        self.http = stack.enter_context(httpx.Client(timeout=WAIT_S))
        self.taps: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.clicked = threading.Event()
        self.click = (0, "")
        self.links, self.gone = 0, threading.Semaphore(0)
        self._pages: dict[str, Client] = {}

    @staticmethod
    def _run(stack: ExitStack, fakes: Any, app: Any, limits: Connections, *, lifespan: bool) -> str:
        options = ServeOptions(port=0)
        listener = stack.enter_context(listening(options.bind, options.port))
        stack.enter_context(fakes.running(web_server(app, options, limits, lifespan=lifespan), listener))
        return f"127.0.0.1:{listener.getsockname()[1]}"

    def page_of(self, who: str) -> Client:
        """Open the page Settings, or what a watcher sees of it; a click on ann's first button is heard."""
        known = set(Client.instances)
        self.http.get(f"http://{self.at}/settings", headers={"authorization": f"Bearer {self.tokens[who]}"})
        (made,) = set(Client.instances) - known
        page = Client.instances[made]
        found = [(one, its) for one in page.elements.values() for its in one._event_listeners.values()]
        for element, listener in found:
            if who == "ann" and listener.type == "click":
                listener.handler = lambda *_: self.clicked.set()
                self.click = (element.id, listener.id)
        return page

    def page_by(self, who: str) -> Client:
        """Return a page that somebody opened; NiceGUI forgets those whose socket was closed."""
        if who not in self._pages or self._pages[who].is_deleted:
            self._pages[who] = self.page_of(who)
        return self._pages[who]

    @property
    def page(self) -> Client:
        """A page of ann's."""
        return self.page_by("ann")

    def caller(self, kind: str) -> Caller:
        if kind == "none":
            return Caller("ann", "")
        if kind == "expired":
            self.tokens["cy"] = add_token(self.file, "cy", "drive")
            self._pages.pop("cy", None)
            return Caller("cy", self.tokens["cy"], expire=lambda: add_token(self.file, "cy", "drive"))
        who = {"watch": "eve", "watch as": "eve", "drive as": "ben", "drive": "ann"}[kind]
        return Caller(who, self.tokens[who], mine=not kind.endswith(" as"))

    def at_rest(self) -> None:
        """Nobody drives, and nothing is stopped; what pages said of the robot before has been let go of."""
        while self.links:
            assert self.gone.acquire(timeout=WAIT_S)
            self.links -= 1
        authority = self.service.authority
        if self.session.browser:
            self.session.beat(self.session.browser, ANN, enable=False)
            self.session.leave(self.session.browser)
        if authority.driver is not None:
            authority.leave(authority.driver, "the test goes on")
        lease = authority.take("test")
        authority.perform(lease, Reset())
        authority.leave(lease, "the test goes on")
        self.session.override = 0.5
        (self.folder / "new.yaml").unlink(missing_ok=True)
        for auth in (self.auth, self.line_auth):
            auth._failed.clear()
        self.effects()

    def effects(self) -> set[str]:
        """Return what came of what was said since this was last asked."""
        orders = [pickle.loads(data) for data in iter(self.host.line.orders.get, None)]
        found = {effect(*what) for what in self.host.told} | {effect(*order) for order in orders}
        self.host.told.clear()
        found |= {"heard"} if self.clicked.is_set() else set()
        self.clicked.clear()
        found |= {"set"} if self.session.override != 0.5 else set()
        found |= {"written"} if (self.folder / "new.yaml").exists() else set()
        return found - {""}


def effect(kind: str, value: Any = None, *_: Any) -> str:
    match kind, value:
        case "beat", (bool(enable), _):
            return "enabled" if enable else "let go"
        case "beat", bool(enable):
            return "enabled" if enable else "let go"
        case "post", Hold():
            return "held"
        case "post", _:
            return "moved"
        case "reset", _:
            return "released"
        case "stop", _:
            return "stopped"
    return "" if kind == "release" else kind


STRONGEST = ("moved", "released", "enabled", "stopped", "held", "set", "written", "heard", "let go")


def outcome(effects: set[str], answered: str) -> str:
    """Return what a cell says: the strongest effect; else whether an answer came."""
    return next((one for one in STRONGEST if one in effects), answered)


OUT, REFUSED, TOLD = "not let in", "refused", "told"


class Line:
    """A WebSocket, and what came of what was said on it."""

    def __init__(self, stack: ExitStack, at: str, path: str, caller: Caller) -> None:
        """Raises InvalidStatus where it is not let in."""
        line = connect(f"ws://{at}{path}", additional_headers=caller.headers, proxy=None, compression=None)
        self.socket = stack.enter_context(line)

    def next(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return the next message that is wanted."""
        while True:
            message = json.loads(self.socket.recv(timeout=WAIT_S))
            if wanted(message):
                return dict(message)

    def program(self, kind: str, session: str, seq: int, **fields: Any) -> str:
        """Say a program's message; return what is answered."""
        self.socket.send(json.dumps({"type": kind, "session": session, "seq": seq, **fields}))
        found = self.next(lambda one: one.get("reply_to") is not None or one["type"] == "refused")
        return REFUSED if found["type"] == "refused" else TOLD

    def page(self, taps: queue.SimpleQueue[str], text: str) -> str:
        """Say a page's message; return how the server took it, refused where it closes instead."""
        self.socket.send(text)
        for _ in range(3000):
            if not taps.empty():
                return taps.get()
            with suppress(TimeoutError):
                self.socket.recv(timeout=0.01)  # raises where it is closed
        raise AssertionError(f"nothing came of {text}")


@contextmanager
def program_drives(world: World, phase: str) -> Iterator[SimpleNamespace]:
    """Let ann's program drive, before a stop or after it; before: nobody does, and there are no names of theirs."""
    world.at_rest()
    with ExitStack() as stack:
        driver = SimpleNamespace(line=None, session="0" * 32, key="0" * 32)
        if phase != "before":
            driver.line = Line(stack, world.at, say.DRIVE_PATH, world.caller("drive"))
            hello = driver.line.next(lambda one: one["type"] == "welcome")
            driver.session, driver.key = hello["session"], hello["enable_key"]
            driver.line.program("heartbeat", driver.session, 1, enable=True)
        if phase == "stopped":
            world.service.authority.stop("test")
        world.effects()
        yield driver


def on_interface(world: World, path: str, kind: str, caller: Caller, phase: str) -> str:
    """Say a program's message on a connection to watch or to drive."""
    with program_drives(world, phase) as driver, ExitStack() as stack:
        if path == say.DRIVE_PATH and driver.line is not None and caller.who == "ann" and caller.token:
            answered = driver.line.program(kind, driver.session, 2, **PROGRAM[kind])
            return outcome(world.effects(), answered)
        line = Line(stack, world.at, path, caller)
        hello = line.next(lambda one: one["type"] in ("welcome", "refused"))
        if hello["type"] == "refused":
            return outcome(world.effects(), OUT)
        if path == say.DRIVE_PATH:
            line.program("heartbeat", hello["session"], 1, enable=True)
        caller.expire()
        world.effects()
        session = hello["session"] if caller.mine else driver.session
        answered = line.program(kind, session, 2, **PROGRAM[kind])
        return outcome(world.effects(), answered)


def on_line(world: World, kind: str, caller: Caller, phase: str) -> str:
    """Say a program's message on the line for stops; the driver's key is with the driver, and with who steals it."""
    with program_drives(world, phase) as driver, ExitStack() as stack:
        line = Line(stack, world.line_at, say.STOP_PATH, caller)
        hello = line.next(lambda one: one["type"] == "line")
        caller.expire()
        steals = not caller.mine or caller.who == "ann"
        more = {"key": driver.key} if kind == "heartbeat" and steals else {}
        answered = line.program(kind, hello["session"], 1, **PROGRAM[kind], **more)
        return outcome(world.effects(), answered)


def page_drives(world: World, phase: str) -> None:
    """Let ann drive from her page, before a stop or after it; before: nobody does."""
    world.at_rest()
    page = world.page.storage[PAGE_NAME]
    world.session.beat(page, ANN, enable=False)  # if it was lost while it drove
    if phase != "before":
        world.session.beat(page, ANN, enable=True, number=1, key="key")
    if phase == "stopped":
        world.session.stop(ANN)
    world.effects()


def on_page(world: World, kind: str, caller: Caller, phase: str) -> str:
    """Say what a page says of the robot: in the name of ann's page, or of one's own."""
    page_drives(world, phase)
    with ExitStack() as stack:
        line = Line(stack, world.at, "/console/robot", caller)
        world.links += 1
        seen = line.next(lambda one: "t" in one)["t"]
        anns = caller.who == "ann" or not caller.mine
        page = {"do": "page", "page": world.page_by("ann" if anns else "eve").storage[PAGE_NAME]}
        if kind != "page" and anns:
            line.page(world.taps, json.dumps(page))
        caller.expire()
        world.effects()
        said = {**(page if kind == "page" else PAGE[kind]), **({"seen": seen} if kind.startswith("beat") else {})}
        answered = line.page(world.taps, json.dumps(said))
        return outcome(world.effects(), answered)


def on_nicegui(world: World, kind: str, caller: Caller, phase: str) -> str:
    """Say what NiceGUI's socket carries: for ann's page, on a socket of one's own page."""
    page_drives(world, phase)
    with ExitStack() as stack:
        target = world.page if not caller.mine else world.page_by(caller.who)
        own = world.page_by(caller.who)
        query = f"EIO=4&transport=websocket&implicit_handshake=true&client_id={own.id}&tab_id=t&document_id=d"
        line = Line(stack, world.at, f"/_nicegui_ws/socket.io/?{query}&next_message_id=0", caller)
        line.page(world.taps, "40")
        caller.expire()
        world.effects()
        element, listener = world.click if target.id == world.page.id else (0, "none")
        more = {"id": element, "listener_id": listener} if kind == "event" else {}
        answered = line.page(world.taps, "42" + json.dumps([kind, {"client_id": target.id, **NICEGUI[kind], **more}]))
        if kind == "event" and answered == TOLD:
            assert world.clicked.wait(WAIT_S)
        return outcome(world.effects(), answered)


def on_pictures(world: World, caller: Caller, phase: str) -> str:
    """Say how wide a picture is shown."""
    page_drives(world, phase)
    with ExitStack() as stack:
        line = Line(stack, world.at, "/console/pictures/left", caller)
        line.page(world.taps, "640")
        caller.expire()
        return outcome(world.effects(), line.page(world.taps, "641"))


def on_http(world: World, method: str, url: str, caller: Caller, phase: str) -> str:
    """Ask for what a route gives."""
    page_drives(world, phase)
    caller.expire()
    given = {"content": b"x"} if method == "PUT" else {}
    at = world.line_at if url == say.STOP_PATH else world.at
    found = world.http.request(method, f"http://{at}{url}", headers=caller.headers, **given)  # type: ignore[arg-type]
    words = {401: OUT, 403: REFUSED}.get(found.status_code, TOLD if found.status_code < 400 else str(found.status_code))
    return outcome(world.effects(), words)


Row = tuple[str, str]
Cell = Callable[[World, Caller, str], str]
DRIVE, STREAM, STOPS = f"`{say.DRIVE_PATH}`", f"`{say.STREAM_PATH}`", f"`{say.STOP_PATH}`"
ROBOT, FRAMEWORK, PICTURES, HTTP = "`/console/robot`", "`/_nicegui_ws`", "`/console/pictures`", "HTTP"
ROWS: dict[Row, Cell] = {
    **{(DRIVE, kind): lambda w, c, p, kind=kind: on_interface(w, say.DRIVE_PATH, kind, c, p) for kind in PROGRAM},
    **{(STREAM, kind): lambda w, c, p, kind=kind: on_interface(w, say.STREAM_PATH, kind, c, p) for kind in PROGRAM},
    **{(STOPS, kind): lambda w, c, p, kind=kind: on_line(w, kind, c, p) for kind in PROGRAM},
    **{(ROBOT, kind): lambda w, c, p, kind=kind: on_page(w, kind, c, p) for kind in PAGE},
    **{(FRAMEWORK, kind): lambda w, c, p, kind=kind: on_nicegui(w, kind, c, p) for kind in NICEGUI},
    (PICTURES, "width"): on_pictures,
    **{
        (HTTP, f"{method} `{path}`"): lambda w, c, p, m=method, u=url: on_http(w, m, u, c, p)
        for (method, path), url in ROUTES.items()
    },
}
