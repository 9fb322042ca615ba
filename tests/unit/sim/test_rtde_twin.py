"""The emulated controller's RTDE 2 as the guide has it: what UR's own client library asks, and garbage."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight_sim.arms import Drive, SimArm, SimJoint
from armsight_sim.twins.rtde import RtdeServer
from armsight_sim.twins.ur_controller import UrController

HOME = [0.1, -1.2, 1.5, -1.0, -1.3, 0.2]
HOST = f"127.9.{os.getpid() // 250 % 250}.{os.getpid() % 250}"

SERVO = """def follow():
  rtde_set_watchdog("input_int_register_0", 50, "stop")
  while True:
    if read_input_integer_register(0) == 1:
      q = get_target_joint_positions()
      q[0] = read_input_float_register(0)
      servoj(q, t=0.002, lookahead_time=0.05, gain=300)
    else:
      sync()
    end
    write_output_integer_register(0, read_input_integer_register(0))
  end
end
"""


@pytest.fixture
def server() -> Iterator[RtdeServer]:
    arm = SimArm(joints=tuple(SimJoint(name=f"j{i}", a_m=0.2, d_m=0.1, lower=-6.3, upper=6.3) for i in range(6)))
    drive = Drive(cycle_s=0.002, lag_s=0.004, max_speed=np.full(6, 3.0), encoder_step=np.full(6, 1e-5))
    server = RtdeServer(UrController(arm=arm, drive=drive, home=HOME), ManualClock(1.0), host=HOST, port=30004)
    yield server
    server.close()


class Client:
    """Speaks to the server from the same thread: bytes out, a look at the sockets, bytes in."""

    def __init__(self, server: RtdeServer, port: int = 30004) -> None:
        self.server = server
        self.link = socket.create_connection((HOST, port))
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.data = b""
        self.look()

    def look(self) -> None:
        for _ in range(3):
            self.server.serve(0.0)

    def send(self, kind: str, data: bytes = b"") -> None:
        self.link.sendall(struct.pack(">HB", 3 + len(data), ord(kind)) + data)
        self.look()

    def frame(self) -> tuple[str, bytes]:
        self.data += self.link.recv(3 - len(self.data), socket.MSG_WAITALL) if len(self.data) < 3 else b""
        size, kind = struct.unpack(">HB", self.data[:3])
        self.data = b""
        return chr(kind), self.link.recv(size - 3, socket.MSG_WAITALL) if size > 3 else b""

    def ask(self, kind: str, data: bytes = b"") -> bytes:
        self.send(kind, data)
        answer, payload = self.frame()
        assert answer == kind
        return payload

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()
        self.look()


def test_a_client_negotiates_receives_each_cycle_and_sends_registers(server: RtdeServer) -> None:
    with Client(server) as client:
        assert client.ask("V", struct.pack(">H", 2)) == b"\1"
        assert struct.unpack(">4I", client.ask("v"))[0] == 5
        outputs = b"timestamp,actual_q,output_int_register_0,runtime_state,input_double_register_3"
        assert client.ask("O", struct.pack(">d", 500.0) + outputs) == b"\1DOUBLE,VECTOR6D,INT32,UINT32,DOUBLE"
        assert client.ask("I", b"input_int_register_0,input_double_register_3") == b"\1INT32,DOUBLE"
        assert client.ask("S") == b"\1"
        client.send("U", struct.pack(">Bid", 1, 7, 2.5))
        stamps = []
        for _ in range(5):
            server.cycle()
            kind, data = client.frame()
            number, stamp_s, *q, register, runtime, mirrored = struct.unpack(">Bd6diId", data)
            assert (kind, number, register, runtime, mirrored) == ("U", 1, 0, 1, 2.5)
            assert np.abs(np.array(q) - HOME).max() < 1e-5
            stamps.append(stamp_s)
        assert np.allclose(np.diff(stamps), 0.002)
        assert client.ask("P") == b"\1"


def test_what_cannot_be_is_answered_as_the_guide_says(server: RtdeServer) -> None:
    with Client(server) as first, Client(server) as second:
        assert first.ask("V", struct.pack(">H", 9)) == b"\0"
        assert first.ask("O", struct.pack(">d", 500.0) + b"timestamp,no_such") == b"\0DOUBLE,NOT_FOUND"
        assert first.ask("S") == b"\0"
        assert first.ask("I", b"input_int_register_0") == b"\1INT32"
        assert first.ask("I", b"input_int_register_0,input_double_register_0") == b"\2INT32,DOUBLE"
        assert second.ask("I", b"input_int_register_0,input_int_register_1") == b"\0IN_USE,INT32"
    with Client(server) as third:
        assert third.ask("I", b"input_int_register_0") == b"\1INT32"


def test_garbage_ends_a_connection_at_most(server: RtdeServer) -> None:
    rng = np.random.default_rng(5)
    server.controller.play(SERVO)
    for i in range(150):
        with Client(server, (30004, 30003, 29999)[i % 3]) as client:
            data = rng.bytes(int(rng.integers(1, 300)))
            if i % 2:  # whole frames of a kind that is known, with garbage in them
                data = struct.pack(">HB", 3 + len(data), b"VvUOISPMx"[i % 9]) + data
            client.link.sendall(data)
            client.look()
            server.cycle()
    assert np.abs(server.controller.q - HOME).max() < 1e-9
    with Client(server) as client:
        assert client.ask("V", struct.pack(">H", 2)) == b"\1"
