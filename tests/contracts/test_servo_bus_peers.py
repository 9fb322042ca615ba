"""The emulated buses as the makers' own clients see them, on a pseudo terminal; skipped where none is installed.

pip install feetech-servo-sdk dynamixel-sdk
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from armsight.clock import SystemClock
from armsight_sim.twins.base import small_arm, twin_home
from armsight_sim.twins.servo_twins import DynamixelBus, FeetechBus, bus_drive

ADDRESSES = {
    "feetech": ("scservo_sdk", FeetechBus, 0, (40, 1), (42, 2), (56, 2), (3, 2)),
    "dynamixel": ("dynamixel_sdk", DynamixelBus, 2.0, (64, 1), (116, 4), (132, 4), (0, 2)),
}


@pytest.fixture(params=list(ADDRESSES))
def peer(request: Any) -> Iterator[tuple[Any, Any, Any, Any, Any]]:
    module, bus, protocol, *fields = ADDRESSES[request.param]
    sdk = pytest.importorskip(module, reason=f"the makers' own client ({module}) is not installed")
    twin = bus(arm=small_arm(), drive=bus_drive(small_arm()), home=twin_home(small_arm()), clock=SystemClock())
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            twin.serve(0.01)

    thread = threading.Thread(target=run)
    thread.start()
    port = sdk.PortHandler(twin.path)
    port.setBaudRate(1_000_000)
    yield sdk, port, sdk.PacketHandler(protocol), twin, fields
    port.closePort()
    ended.set()
    thread.join()
    twin.close()


def test_the_makers_client_reads_what_the_servos_hold_and_moves_them(peer: Any) -> None:
    sdk, port, packets, twin, ((torque, _), (goal, size), (position, _), (model, _)) = peer
    read = packets.read2ByteTxRx if size == 2 else packets.read4ByteTxRx
    write = packets.write2ByteTxRx if size == 2 else packets.write4ByteTxRx
    number, result, error = packets.ping(port, 3)
    assert (number, result, error) == (twin.servos[2].get(model, 2), 0, 0)
    group = sdk.GroupSyncRead(port, packets, position, size)
    for servo in twin.servos:
        assert group.addParam(servo.id)
    assert group.txRxPacket() == 0
    steps = [group.getData(servo.id, position, size) for servo in twin.servos]
    assert steps == [twin._step(q) for q in twin.q]
    assert packets.write1ByteTxRx(port, 2, torque, 1) == (0, 0)
    assert write(port, 2, goal, steps[1] + 40) == (0, 0)
    told = sdk.GroupSyncWrite(port, packets, goal, size)
    for servo in twin.servos:
        told.addParam(servo.id, list((steps[servo.id - 1] + 50).to_bytes(size, "little")))
    assert told.txPacket() == 0
    for _ in range(400):
        here, result, error = read(port, 2, position)
        assert (result, error) == (0, 0)
        if here == steps[1] + 50:
            return
    raise AssertionError(f"servo 2 stands at {here}, and was told {steps[1] + 50}")
