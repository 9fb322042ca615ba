"""Spoilt answers on an emulated bus of six servos: this project's drivers beside the makers' own clients.

python benchmarks/servo_bus.py [feetech] [dynamixel] [--spoilt 1000] [--seed 1]

The bus runs on a pseudo terminal in a process of its own, its joints under way all the time; one answer in the course
of every third question is lost, late by one to three questions, exchanged with its neighbour, broken in one to four
bytes or cut off, or doubled, and after some that are late the same servo's next one is lost. Positions that a client
calls available are compared with the emulated encoders' steps when it asked. Prints how many were wrong, how many
questions gave none, and how long one took; bytes need no time there, which at 1 Mbit/s is 3 ms more for a
question that all answer. The makers' clients are run where they are installed
(pip install feetech-servo-sdk dynamixel-sdk).
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from armsight.clock import SystemClock
from armsight.drivers import ROBOTS, load
from armsight.errors import DeviceFailed
from armsight_sim.twins.base import small_arm, twin_home
from armsight_sim.twins.servo_bus import BusFault, ServoBus
from armsight_sim.twins.servo_twins import DynamixelBus, FeetechBus, bus_drive

KINDS: dict[str, tuple[type[ServoBus], str, float, int, int]] = {
    "feetech": (FeetechBus, "scservo_sdk", 0, 56, 2),
    "dynamixel": (DynamixelBus, "dynamixel_sdk", 2.0, 132, 4),
}
FAULTS = (BusFault.LOST, BusFault.LATE, BusFault.SWAPPED, BusFault.BROKEN, BusFault.DOUBLED)
JOINTS = 6


def bus(kind: str, seed: int) -> None:
    """Be the bus until standard input ends; spoil answers while it is told to, and log where the encoders were."""
    maker = KINDS[kind][0]
    clock, rng, ended = SystemClock(), np.random.default_rng(seed), False
    twin = maker(arm=small_arm(), drive=bus_drive(small_arm()), home=twin_home(small_arm()), clock=clock)
    started_s, n_asked, log, on, place = clock.now_s(), 0, [], False, 0
    read_all, read_motors = twin._read_all, twin._read_motors

    def moved() -> None:
        t_s = clock.now_s() - started_s
        q = twin_home(small_arm()) + 0.3 * np.sin(1.2 * t_s + np.arange(JOINTS))
        twin._motors = type(twin._motors)(twin._drive, q, clock.now_s(), keep=8)
        read_motors()

    def asked(body: bytes) -> Any:
        nonlocal n_asked, place
        n_asked += 1
        if on and n_asked % 3 == 1:
            place = int(rng.integers(JOINTS))
            twin.plant(FAULTS[n_asked // 3 % 5], place, rng)
        elif on and n_asked % 15 == 5:
            twin.plant(BusFault.LOST, place, rng)
        log.append((clock.now_s(), [twin._step(q) for q in twin.q]))
        return read_all(body)

    twin._read_motors, twin._read_all = moved, asked  # type: ignore[method-assign]
    print(twin.path, flush=True)
    gc.disable()
    with contextlib.suppress(OSError):  # servos answer whatever else this computer does
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    os.set_blocking(0, False)
    while not ended:
        twin.serve(0.005)
        order = sys.stdin.buffer.read()
        if order == b"":
            ended = True
        elif order:
            on = b"spoil" in order
    print(json.dumps({"spoilt": twin.wrong_answers, "log": log}))


@contextlib.contextmanager
def beside(kind: str, seed: int) -> Iterator[tuple[str, Callable[[], None], Callable[[], dict[str, Any]]]]:
    command = [sys.executable, __file__, "--bus", kind, "--seed", str(seed)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None  # noqa: S101
    assert process.stdout is not None  # noqa: S101
    path = process.stdout.readline().decode().strip()

    def spoil() -> None:
        process.stdin.write(b"spoil")  # type: ignore[union-attr]
        process.stdin.flush()  # type: ignore[union-attr]

    def end() -> dict[str, Any]:
        return dict(json.loads(process.communicate()[0]))

    yield path, spoil, end
    process.kill()


Said = list[tuple[float, float, list[int] | None]]
"""When it was asked and answered, and the steps that were given out; None where none were."""


def ours(kind: str, path: str, spoil: Callable[[], None], cycles: int) -> tuple[Said, str]:
    robot: Any = load(ROBOTS, kind)(path, settings={}, clock=SystemClock())
    said: Said = []
    cycle, lost, told = robot._cycle, 0, dict.fromkeys(("missed", "late", "repeated", "refused", "garbage_bytes"), 0)

    def noted(n: int) -> None:
        start_s, before = time.monotonic(), robot._reading
        asked_s = SystemClock().now_s()
        cycle(n)
        new = robot._reading is not before
        steps = [joint.steps(q) for joint, q in zip(robot.joints, robot._reading.q, strict=True)] if new else None
        said.append((asked_s, time.monotonic() - start_s, steps))

    robot._cycle = noted
    spoil()
    while len(said) < cycles:
        with contextlib.suppress(DeviceFailed), robot:
            while len(said) < cycles and not robot._lost:
                time.sleep(0.05)
            lost += bool(robot._lost)
            told = {key: n + getattr(robot.counts, key) for key, n in told.items()}
    return said, ", ".join(f"{key} {n}" for key, n in told.items()) + f", lost and opened again {lost} times"


def makers(kind: str, path: str, spoil: Callable[[], None], cycles: int) -> tuple[Said, str]:
    _, module, protocol, at, size = KINDS[kind]
    sdk = importlib.import_module(module)
    port = sdk.PortHandler(path)
    port.setBaudRate(1_000_000)
    group = sdk.GroupSyncRead(port, sdk.PacketHandler(protocol), at, size)
    ids = range(1, JOINTS + 1)
    for id in ids:
        group.addParam(id)
    said: Said = []
    spoil()
    clock = SystemClock()
    for _ in range(cycles):
        asked_s, start_s = clock.now_s(), time.monotonic()
        group.txRxPacket()
        # as its users read it: what is available is a position
        there = all(group.isAvailable(id, at, size) for id in ids)
        steps = [int(group.getData(id, at, size)) for id in ids] if there else None
        took_s = time.monotonic() - start_s
        said.append((asked_s, took_s, steps))
        clock.sleep_until(asked_s + 0.01)
    port.closePort()
    return said, "nothing"


def judge(said: Said, log: list[Any]) -> tuple[int, int, int]:
    """Return positions given out, those that were not the encoder's of that question, and questions without any."""
    stamps = np.array([t_s for t_s, _ in log])
    given = wrong = none = 0
    for asked_s, took_s, steps in said:
        if steps is None:
            none += 1
            continue
        first, last = np.searchsorted(stamps, [asked_s, asked_s + took_s + 1e-4])
        true = [row for _, row in log[first:last]]
        given += JOINTS
        wrong += sum(all(steps[j] != row[j] for row in true) for j in range(JOINTS))
    return given, wrong, none


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--spoilt", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bus", choices=list(KINDS), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.bus:
        bus(args.bus, args.seed)
        return
    for kind in args.kinds:
        for called, client in (("armsight", ours), (KINDS[kind][1], makers)):
            with beside(kind, args.seed) as (path, spoil, end):
                try:
                    said, told = client(kind, path, spoil, round(2.5 * args.spoilt))
                except ImportError:
                    print(f"{kind}: {called} is not installed")
                    continue
                found = end()
            given, wrong, none = judge(said, found["log"])
            ms = 1e3 * np.percentile([took_s for _, took_s, _ in said], [50, 99, 100])
            print(
                f"{kind}, {called}: {len(said)} questions to {JOINTS} servos, {found['spoilt']} answers spoilt: "
                f"{wrong} of {given} positions wrong; {none} questions gave none; told: {told}; a cycle took "
                f"{ms[0]:.2f} ms median, {ms[1]:.2f} p99, {ms[2]:.2f} at most",
                flush=True,
            )


if __name__ == "__main__":
    main()
