"""Who may say what, when: every message of every socket and page, by every kind of caller, as the robot's loop sees it.

The rows are the code's own registries of messages and routes: one that is added without a row fails here. The table of
roles.csv is this one, which `make docs` shows; `ARMSIGHT_WRITE_TABLES=1` before pytest writes it.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, get_args

import pytest
from nicegui import core
from tests.security.callers import (
    CALLERS,
    DRIVE,
    FRAMEWORK,
    HTTP,
    MOUNTED,
    NICEGUI,
    OUT,
    PAGE,
    PICTURES,
    PROGRAM,
    REFUSED,
    ROBOT,
    ROUTES,
    ROWS,
    STOPS,
    STREAM,
    TOLD,
    Row,
    World,
    outcome,
)
from websockets.exceptions import ConnectionClosed, InvalidStatus

from armsight.console import page_socket, robot_link, routes
from armsight.console.page_socket import MESSAGES
from armsight.drivers.remote import protocol as say
from armsight.errors import UsageError
from armsight.server.gate import LOGOUT

KEPT = Path(__file__).with_name("roles.csv")
PHASES = ("before", "while", "stopped")


def expected(row: Row, caller: str, phase: str) -> str:
    """Return what a cell must say, written down here and not derived from the code."""
    where, kind = row
    others = phase != "before" and caller != "drive"  # somebody else drives
    if kind == f"POST `{LOGOUT}`":
        return TOLD
    if (
        caller == "none"
        or (caller == "expired" and where == HTTP)
        or (where == DRIVE and (caller.startswith("watch") or others))
    ):
        return OUT
    if caller == "expired":
        return REFUSED
    if kind in ("stop", f"POST {STOPS}", "POST `/console/stop`"):
        return "stopped"
    return EXPECTED[where](kind, caller, phase)


def on_drive_expected(kind: str, caller: str, phase: str) -> str:
    moves = REFUSED if phase == "stopped" else "moved"
    does = {"heartbeat": "enabled", "hold": "held", "reset": "released", "read": TOLD}
    return does.get(kind, moves) if caller == "drive" else REFUSED


def on_nicegui_expected(kind: str, caller: str, _: str) -> str:
    if caller.endswith(" as"):
        return REFUSED
    return TOLD if kind != "event" else "heard" if caller == "drive" else "ignored"


def on_page_expected(kind: str, caller: str, phase: str) -> str:
    if kind == "page":
        return REFUSED if caller.endswith(" as") else TOLD
    if kind == "beat: let go":
        return "let go" if caller == "drive" and phase != "before" else TOLD
    if caller.startswith("watch") or (phase != "before" and caller != "drive"):
        return REFUSED
    moves = "enabled" if phase == "stopped" else "moved"
    return {"beat: enable": "enabled", "beat: key": moves, "reset": "released", "override": "set"}[kind]


EXPECTED: dict[str, Callable[[str, str, str], str]] = {
    DRIVE: on_drive_expected,
    STREAM: lambda kind, caller, _: TOLD if kind == "read" and not caller.endswith(" as") else REFUSED,
    STOPS: lambda kind, caller, phase: (
        "enabled" if (kind, caller) == ("heartbeat", "drive") and phase != "before" else REFUSED
    ),
    ROBOT: on_page_expected,
    FRAMEWORK: on_nicegui_expected,
    PICTURES: lambda *_: TOLD,
    HTTP: lambda kind, caller, _: (
        TOLD if not kind.startswith("PUT") else "written" if caller.startswith("drive") else REFUSED
    ),
}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, fakes: Any, new_nicegui: None, patient: None) -> Iterator[World]:
    with pytest.MonkeyPatch.context() as patched, ExitStack() as stack:
        made = World(tmp_path_factory.mktemp("roles"), fakes, stack)
        patched.setattr(robot_link, "STATE_S", 0.005)
        taps = made.taps
        take, admit, said = robot_link.RobotLink.take, page_socket._Line._admit, routes._said
        give_up = robot_link.RobotLink._give_up

        def tapped_take(self: Any, text: str | None, age_s: float = 0.0) -> None:
            self._refused = ""
            take(self, text, age_s)
            taps.put(REFUSED if self._refused else TOLD)

        def tapped_admit(self: Any, text: str) -> bool:
            try:
                found = admit(self, text)
            except UsageError:
                taps.put(REFUSED)
                raise
            taps.put(TOLD if found or '"log"' in text else "ignored")
            return found

        async def tapped_said(socket: Any) -> str:
            found = await said(socket)
            taps.put(TOLD)
            return found

        def tapped_give_up(self: Any) -> None:
            give_up(self)
            made.gone.release()

        patched.setattr(robot_link.RobotLink, "take", tapped_take)
        patched.setattr(robot_link.RobotLink, "_give_up", tapped_give_up)
        patched.setattr(page_socket._Line, "_admit", tapped_admit)
        patched.setattr(routes, "_said", tapped_said)
        yield made


def cell(world: World, row: Row, caller: str, phase: str) -> str:
    """Return what one caller reaches with one message in one phase."""
    while not world.taps.empty():
        world.taps.get()
    try:
        return ROWS[row](world, world.caller(caller), phase)
    except InvalidStatus:
        return outcome(world.effects(), OUT)
    except ConnectionClosed:
        return outcome(world.effects(), REFUSED)


ALIKE = {
    (where, kind)
    for where in (STREAM, STOPS)
    for kind in ("joint_velocity", "joint_step", "flange_pose", "tool_twist", "hold", "reset")
}
"""Refused to everybody on these, as joint_goal is, which is said in all phases."""


@pytest.mark.parametrize("row", ROWS, ids=lambda row: " ".join(row))
def test_every_message_does_what_its_sender_may(world: World, row: Row) -> None:
    phases = ("while",) if row[1].startswith("GET") or row in ALIKE else PHASES  # what is read is the same in all
    callers = [one for one in CALLERS if row[0] != HTTP or not one.endswith(" as")]  # a request carries no names
    found = {caller: [cell(world, row, caller, phase) for phase in phases] for caller in callers}
    assert found == {caller: [expected(row, caller, phase) for phase in phases] for caller in callers}


def test_no_message_and_no_route_is_left_out(world: World) -> None:
    kinds = {kind.model_fields["type"].default for kind in get_args(say.Command)}
    assert set(PROGRAM) == kinds and set(say.ALLOWED) == {"watch", "drive", "stop"}
    assert {kind.partition(":")[0] for kind in PAGE} == {
        get_args(kind.model_fields["do"].annotation)[0] for kind in get_args(robot_link.RobotMessage)
    }
    assert set(NICEGUI) == set(MESSAGES)
    sockets, asked = set(), {("GET", "/_nicegui"), ("POST", LOGOUT), ("POST", say.STOP_PATH)}
    for route in [*world.app.routes, *core.app.routes]:
        path = str(getattr(route, "path", ""))
        methods = getattr(route, "methods", None)
        if methods is None:
            (sockets.add(path) if "WebSocket" in type(route).__name__ else asked.add(("GET", path)))
        else:
            asked |= {(method, path) for method in methods - {"HEAD"}}
    assert sockets == {say.STREAM_PATH, say.DRIVE_PATH, "/console/robot", "/console/pictures/{side}"}
    mounted = {("GET", path) for path in MOUNTED}
    assert {one for one in asked if not one[1].startswith("/_nicegui/")} - mounted == set(ROUTES)


def table() -> str:
    """Return the table as CSV."""
    lines = [["where", "what", *CALLERS.values()]]
    grouped: dict[tuple[str, ...], list[str]] = {}
    for where, kind in ROWS:
        cells = [[expected((where, kind), caller, phase) for phase in PHASES] for caller in CALLERS]
        words = [found[0] if len(set(found)) == 1 else " / ".join(found) for found in cells]
        grouped.setdefault((where, *words), []).append(kind)
    lines += [[where, ", ".join(kinds), *words] for (where, *words), kinds in grouped.items()]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def test_the_table_of_the_documentation_is_this_one() -> None:
    if os.environ.get("ARMSIGHT_WRITE_TABLES"):
        KEPT.write_text(table(), encoding="utf-8")
        return
    assert KEPT.read_text(encoding="utf-8") == table(), "ARMSIGHT_WRITE_TABLES=1 writes it"
