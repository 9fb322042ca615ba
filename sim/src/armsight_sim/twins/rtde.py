"""The sockets of an emulated Universal Robots controller: RTDE 2, dashboard, and the ports that take programs.

Where RTDE listens at another port than 30004, the others keep their distance to it: dashboard 5 below, programs 1 and
2 below. The program ports take programs and send no state.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from armsight.clock import Clock, SystemClock
from armsight.errors import DeviceFailed, UsageError
from armsight_sim.twins.base import host_port, note_silence, twin_arm, twin_drive, twin_home
from armsight_sim.twins.rtde_wire import INPUTS, OUTPUTS, BadFrame, Kind, Recipe, frame, frames, names_of
from armsight_sim.twins.ur_controller import UrController
from armsight_sim.twins.urscript import complete

RTDE_PORT = 30004
DASHBOARD, SCRIPT, SECONDARY = -5, -1, -2
"""Distances of the other ports."""

CYCLE_S = 0.002
"""An e-Series controller's cycle."""

JOINTS = 6

VERSION = (5, 11, 0, 108249)
"""The PolyScope that is emulated."""

LONGEST_TEXT = 1_000_000
"""Characters of a program or a line at most."""

LATE_CYCLES = 10
"""A controller so far behind time lets the cycles go that it has missed."""


@dataclass(slots=True)
class RtdeTwinCounts:
    """Frames taken, refused (bad, or out of place), and clients dropped because they do not read."""

    taken: int = 0
    refused: int = 0
    dropped: int = 0


@dataclass(eq=False, slots=True)
class _Client:
    """One connection. take: what to do with what it has sent; False ends it."""

    link: socket.socket
    take: Callable[[_Client], bool]
    data: bytearray = field(default_factory=bytearray)
    out: Recipe | None = None
    every: int = 1
    inputs: dict[int, Recipe] = field(default_factory=dict)
    started: bool = False


class RtdeServer:
    """A controller behind its sockets at host. Raises DeviceFailed where a port is taken."""

    def __init__(
        self, controller: UrController, clock: Clock, *, host: str = "127.0.0.1", port: int = RTDE_PORT
    ) -> None:
        self.controller = controller
        self.counts = RtdeTwinCounts()
        self._clock = clock
        self._cycles = 0
        self._silent = False
        self._selector = selectors.SelectSelector()  # epoll counts in ms: too coarse for a cycle of 2 ms
        self._clients: list[_Client] = []
        self._servers: list[socket.socket] = []
        takers = ((0, self._take_frames), (DASHBOARD, self._take_lines), (SCRIPT, self._take_program))
        for distance, take in (*takers, (SECONDARY, self._take_program)):
            self._listen(host, port + distance, take)

    def close(self) -> None:
        """Close all sockets."""
        for client in list(self._clients):
            self._end(client)
        for server in self._servers:
            server.close()
        self._selector.close()

    def silence(self, on: bool = True) -> None:
        """Send no more data, as where a cable is cut."""
        self._silent = on

    def restart(self) -> None:
        """Start anew, as a controller does: every connection ends, and so does the program."""
        for client in list(self._clients):
            self._end(client)
        self.controller.halt("the controller starts anew")

    def run(self, on: Callable[[], bool]) -> None:
        """Serve in real time as long as on() holds."""
        next_s = self._clock.now_s()
        while on():
            next_s += self.controller.cycle_s
            late_s = self._clock.now_s() - next_s
            if late_s > LATE_CYCLES * self.controller.cycle_s:
                note_silence(self.controller.messages, late_s)
                next_s += late_s
            self.serve(next_s)
            self.cycle()

    def serve(self, until_s: float) -> None:
        """Answer what comes until a moment of the clock, or until nothing comes for as long as that is off."""
        while True:
            rest_s = until_s - self._clock.now_s()
            ready = self._selector.select(max(0.0, rest_s))
            for key, _ in ready:
                key.data()
            if rest_s <= 0.0 or not ready:
                return

    def cycle(self) -> None:
        """Let the controller do one cycle, and send to every client what it asked for."""
        self.controller.cycle()
        self._cycles += 1
        if self._silent:
            return
        for client in list(self._clients):
            if client.started and client.out is not None and self._cycles % client.every == 0:
                row = [value for name in client.out.names for value in self.controller.output(name)]
                self._send(client, client.out.pack(row))

    def _listen(self, host: str, port: int, take: Callable[[_Client], bool]) -> None:
        server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((host, port))
        except (OSError, OverflowError) as error:
            server.close()
            self.close()
            raise DeviceFailed(
                f"port {port} of {host} cannot be taken: {error}",
                consequence="There is no twin",
                cure="Stop the other program, or choose another port",
            ) from error
        server.listen()
        server.setblocking(False)
        self._servers.append(server)
        self._selector.register(server, selectors.EVENT_READ, lambda: self._accept(server, take))

    def _accept(self, server: socket.socket, take: Callable[[_Client], bool]) -> None:
        try:
            link, _ = server.accept()
        except OSError:
            return
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(link, take)
        self._clients.append(client)
        self._selector.register(link, selectors.EVENT_READ, lambda: self._receive(client))
        if take == self._take_lines:
            self._send(client, b"Connected: Universal Robots Dashboard Server\n")

    def _receive(self, client: _Client) -> None:
        try:
            data = client.link.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        client.data += data
        if not data or len(client.data) > LONGEST_TEXT:
            self._end(client)
            return
        try:
            if not client.take(client):
                self._end(client)
        except BadFrame:
            self.counts.refused += 1
            self._end(client)

    def _send(self, client: _Client, data: bytes) -> None:
        try:
            sent = client.link.send(data)
        except OSError:
            sent = 0
        if sent < len(data):  # it does not read: half a frame would put it out of step for ever
            self.counts.dropped += 1
            self._end(client)

    def _end(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(client.link)
            client.link.close()

    def _take_frames(self, client: _Client) -> bool:
        for kind, data in frames(client.data):
            self.counts.taken += 1
            self._take_frame(client, kind, data)
        return True

    def _take_frame(self, client: _Client, kind: int, data: bytes) -> None:
        if kind == Kind.DATA:
            self._take_data(client, data)
        elif kind == Kind.PROTOCOL:
            good = len(data) == 2 and struct.unpack(">H", data)[0] == 2
            self._send(client, frame(kind, bytes([good])))
        elif kind == Kind.VERSION:
            self._send(client, frame(kind, struct.pack(">4I", *VERSION)))
        elif kind == Kind.OUTPUTS:
            self._set_outputs(client, data)
        elif kind == Kind.INPUTS:
            self._set_inputs(client, data)
        elif kind in (Kind.START, Kind.PAUSE):
            client.started = kind == Kind.START and (client.out is not None or bool(client.inputs))
            self._send(client, frame(kind, bytes([client.started or kind == Kind.PAUSE])))
        elif kind != Kind.TEXT:
            self.counts.refused += 1

    def _set_outputs(self, client: _Client, data: bytes) -> None:
        """Answer with the types of the variables that a client wants to receive."""
        if len(data) < 8:
            raise BadFrame("no frequency")
        (frequency_hz,) = struct.unpack_from(">d", data)
        names = names_of(data[8:])
        most_hz = 1.0 / self.controller.cycle_s
        if not 1.0 <= frequency_hz <= most_hz * 1.001:
            frequency_hz = most_hz
        types = [OUTPUTS.get(name, "NOT_FOUND") for name in names]
        found = bool(names) and "NOT_FOUND" not in types
        client.out = Recipe(1, names, types) if found else None
        client.every = max(1, round(most_hz / frequency_hz))
        self._send(client, frame(Kind.OUTPUTS, bytes([found]) + ",".join(types).encode()))

    def _set_inputs(self, client: _Client, data: bytes) -> None:
        """Answer with the types of the variables that a client wants to send; one that another client has is in use."""
        names = names_of(data)
        others = {name for c in self._clients if c is not client for r in c.inputs.values() for name in r.names}
        types = ["IN_USE" if name in others else INPUTS.get(name, "NOT_FOUND") for name in names]
        found = bool(names) and not {"IN_USE", "NOT_FOUND"} & set(types)
        number = len(client.inputs) + 1 if found else 0
        if number > 255:
            raise BadFrame("too many recipes")
        if found:
            client.inputs[number] = Recipe(number, names, types)
        self._send(client, frame(Kind.INPUTS, bytes([number]) + ",".join(types).encode()))

    def _take_data(self, client: _Client, data: bytes) -> None:
        recipe = client.inputs.get(data[0]) if data and client.started else None
        if recipe is None:
            self.counts.refused += 1
            return
        for name, values in zip(recipe.names, recipe.unpack(data[1:]), strict=True):
            self.controller.write(name, values)

    def _take_lines(self, client: _Client) -> bool:
        """Answer the dashboard's commands."""
        while b"\n" in client.data:
            line, _, rest = bytes(client.data).partition(b"\n")
            client.data[:] = rest
            command = line.decode("ascii", "replace").strip()
            if command == "quit":
                self._send(client, b"Disconnected\n")
                return False
            self._send(client, f"{self._dashboard(command)}\n".encode())
        return True

    def _dashboard(self, command: str) -> str:
        running = self.controller.running
        if command == "stop":
            self.controller.halt("stopped at the dashboard")
        answers = {
            "stop": "Stopped",
            "running": f"Program running: {str(running).lower()}",
            "programState": "PLAYING rtde" if running else "STOPPED",
            "robotmode": "Robotmode: RUNNING",
            "safetystatus": "Safetystatus: NORMAL",
            "safetymode": "Safetymode: NORMAL",
            "get serial number": "20225500000",
            "get robot model": "UR10",
            "is in remote control": "true",
            "PolyscopeVersion": f"URSoftware {'.'.join(map(str, VERSION))}",
        }
        return answers.get(command, f'Could not understand: "{command}"')

    def _take_program(self, client: _Client) -> bool:
        """Run a program once it is there as a whole."""
        text = client.data.decode("utf-8", "replace")
        if complete(text):
            client.data.clear()
            self.controller.play(text)
        return True


class RtdeTwin:
    """An emulated Universal Robots controller in real time, that listens at port of this machine.

    Raises UsageError for a port that is none, and for an arm without six joints.
    """

    def __init__(
        self,
        *,
        port: str | None = None,
        connect: str | None = None,
        arm: Mapping[str, Any] | None = None,
        cycle_s: float | None = None,
        clock: Clock | None = None,
    ) -> None:
        if connect is not None:
            raise UsageError(
                "this controller waits for its driver and connects nowhere", cure="Leave --connect out, or give --port"
            )
        self._host, self._port = host_port(port or str(RTDE_PORT))
        self._arm = twin_arm(arm)
        if self._arm.n != JOINTS:
            raise UsageError(
                f"the emulated controller has {JOINTS} joints, not {self._arm.n}",
                consequence="There is no twin",
                cure="Give an arm of six joints",
            )
        self._drive = twin_drive(self._arm, cycle_s or CYCLE_S)
        self._clock = clock or SystemClock()
        self._server: RtdeServer | None = None

    @property
    def address(self) -> str:
        """What opens the driver."""
        return f"rtde:{self._host}" + (f":{self._port}" if self._port != RTDE_PORT else "")

    @property
    def messages(self) -> list[str]:
        """Why its program ended or it fell silent, and what the program says."""
        return [] if self._server is None else self._server.controller.messages

    @property
    def server(self) -> RtdeServer:
        """Its sockets. Raises DeviceFailed where it is not open."""
        if self._server is None:
            raise DeviceFailed("the twin is not open", cure="Open it first")
        return self._server

    def __enter__(self) -> Self:
        """Take its ports. Raises DeviceFailed where one is taken."""
        controller = UrController(arm=self._arm, drive=self._drive, home=twin_home(self._arm))
        self._server = RtdeServer(controller, self._clock, host=self._host, port=self._port)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None

    def run(self, on: Callable[[], bool]) -> None:
        """Serve in real time as long as on() holds."""
        self.server.run(on)
