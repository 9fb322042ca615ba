"""A guarded arm in real time behind each link, its emulated controller in a process of its own.

python benchmarks/links.py [alter] [rsi] [egm] [rtde] [linuxcnc] [feetech] [dynamixel] [--for 60] [--busy 2]
    [--jitter] [--fine] [--rsi-simulator "COMMAND"]

A restless source wants more than the limits allow. Prints the controller's cycles that were missed and the answers it
counts as late, how late the loop woke, and, by the emulated controller's own record and time, the largest speed over
three cycles as a share of its limit and how far ranges and walls were passed. --busy: processes that do nothing but
compute, beside all that. --fine: buses of servos of 15 bits in place of 12: what is then missing from a speed is made
by whole steps alone. --jitter (rtde): connections stand still for up to 40 ms now and then, each way by
itself. linuxcnc is the real one, where it is installed, recorded by HAL's sampler. --rsi-simulator: a program that
plays a KUKA controller, told address and port; its joints are jogged and read back.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import json
import multiprocessing
import os
import random
import shlex
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.truth.emulated_links import Model
from tests.truth.lossy_links import ARM, SPEED_TOLERANCE, WINDOW, Found, Restless, judge, limits_of

from armsight.clock import SystemClock
from armsight.control.guard import Guard, Limits
from armsight.control.loop import ControlLoop
from armsight.control.setpoints import GoalSource
from armsight.defaults import SERVO_CYCLE_S
from armsight.drivers import ROBOTS, load
from armsight.drivers.servo_bus import calibration, found, state, tables
from armsight.drivers.servo_bus import robot as servo_robot
from armsight.kinematics import Joint
from armsight.ops.robot.recorder import run_with_progress
from armsight_sim.twins import servo_bus, servo_twins
from armsight_sim.twins.alter import AlterTwin
from armsight_sim.twins.base import MAX_SPEED, small_arm_mapping
from armsight_sim.twins.egm import EgmTwin
from armsight_sim.twins.linuxcnc import SERVO_S
from armsight_sim.twins.rsi import RsiTwin
from armsight_sim.twins.rtde import RtdeTwin
from armsight_sim.twins.servo_twins import DynamixelTwin, FeetechTwin

BUSES = ("feetech", "dynamixel")
KINDS = ("alter", "rsi", "egm", "rtde", "linuxcnc", *BUSES)
CONTROLLER, NEARER = "127.77.0.1", "127.78.0.1"
RTDE_PORTS = (30004, 30003, 29999)
LONGEST_STILL_S = 0.04
FINE = 8
FIRST = 20
"""Of SCHED_FIFO: before the loop, as on a computer of its own."""


def refine() -> None:
    """Let servos and their driver have FINE times as many steps a turn."""
    for part in (calibration, found, servo_robot, state, tables):
        for name, factor in (("STEPS", FINE), ("STEP_RAD", 1 / FINE)):
            if hasattr(part, name):
                setattr(part, name, getattr(part, name) * factor)
    servo_bus.TURN, servo_bus.MIDDLE = servo_bus.TURN * FINE, servo_bus.MIDDLE * FINE
    for name in ("STS3215", "XL430"):
        setattr(servo_twins, name, getattr(servo_twins, name).replace(":4095", f":{4096 * FINE - 1}"))


def controller(kind: str, port: str, file: str) -> None:
    """Be the controller until standard input closes; then write down where its motors were."""
    made: dict[str, Any] = {
        "alter": lambda: AlterTwin(clock=SystemClock()),
        "rsi": lambda: RsiTwin(connect=f"127.0.0.1:{port}", clock=SystemClock()),
        "egm": lambda: EgmTwin(connect=f"127.0.0.1:{port}"),
        "rtde": lambda: RtdeTwin(port=f"{CONTROLLER}:{RTDE_PORTS[0]}"),
        "feetech": lambda: FeetechTwin(clock=SystemClock()),
        "dynamixel": lambda: DynamixelTwin(clock=SystemClock()),
    }
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    rows, stamps = [], []
    with made[kind]() as twin:
        inner = twin.server.controller if kind == "rtde" else twin.controller
        name = "serve" if kind in BUSES else "move" if kind == "alter" else "cycle"
        cycle = getattr(inner, name)
        if kind in BUSES:
            inner._sag = 0.0  # what sinks when torque comes on is no motion of the loop's

        def noted(*wait_s: float) -> None:
            cycle(*wait_s)
            if kind not in BUSES:
                rows.append(inner.q)
                stamps.append(time.monotonic())
            while kind in BUSES and (not stamps or stamps[-1] + inner._drive.cycle_s <= inner._motors.t_s):
                stamps.append(inner._motors.t_s if not stamps else stamps[-1] + inner._drive.cycle_s)
                rows.append(inner._motors.at(stamps[-1])[0])  # motors of their own, whenever they are asked

        setattr(inner, name, noted)
        print(twin.address, flush=True)
        gc.collect()
        gc.freeze()
        gc.disable()
        with contextlib.suppress(OSError):  # a controller is a real-time system, whatever else this machine does
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIRST))
        twin.run(lambda: not ended.is_set())
        counts = {} if kind in ("rtde", *BUSES) else {key: getattr(inner.counts, key) for key in inner.counts.__slots__}
        np.savez(file, q=np.array(rows), t_s=np.array(stamps), cycle_s=inner._drive.cycle_s)
        print(json.dumps(counts))


async def still(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, rng: random.Random) -> None:
    """Carry bytes one way; now and then nothing for a while, and then all at once."""
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            if rng.random() < 0.01:
                await asyncio.sleep(rng.uniform(0.0, LONGEST_STILL_S))
            writer.write(data)
            await writer.drain()
    writer.close()


def jittering(seed: int, ready: Any) -> None:
    """Carry the controller's connections over a line that stands still now and then."""
    rng = random.Random(seed)

    async def join(near_reader: Any, near_writer: Any, port: int) -> None:
        far_reader, far_writer = await asyncio.open_connection(CONTROLLER, port)
        for writer in (near_writer, far_writer):
            writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.gather(still(near_reader, far_writer, rng), still(far_reader, near_writer, rng))

    async def main() -> None:
        for port in RTDE_PORTS:
            await asyncio.start_server(lambda r, w, port=port: join(r, w, port), NEARER, port)
        ready.set()
        await asyncio.Event().wait()

    asyncio.run(main())


def busy() -> None:
    while True:
        pass


@contextlib.contextmanager
def beside(processes: list[multiprocessing.Process]) -> Iterator[None]:
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()


def driven(kind: str, device: str, for_s: float, seed: int, limits: Limits) -> dict[str, Any]:
    """Let a guarded loop move the arm for a while; return what loop and driver tell."""
    settings: dict[str, Any] = {"bind": "127.0.0.1"} if kind in ("rsi", "egm") else {}
    if kind == "alter":
        settings = {"arm": Model(), "speed_m_s": 1.5, "speed_rad_s": 6.0}
    clock = SystemClock()
    robot: Any = load(ROBOTS, kind)(device, settings=settings, clock=clock)
    source = Restless(np.random.default_rng(seed))
    with robot:
        last = getattr(robot, "_last", None)
        guard = Guard(ARM, limits, robot.cycle_s)
        loop = ControlLoop(robot, guard, source, clock, enabled=lambda: True, by_pose=False)
        timing = loop.run(for_s=for_s)
        counts = getattr(robot, "counts", None)
        missed = robot.missed if counts is None else counts.missed
        late = robot.late if counts is None else counts.late
        return {
            "timing": timing,
            "missed": missed,
            "late": late,
            "status": loop.status,
            "cycles": robot._pace.cycles,
            "began": getattr(last, "sample", 0),
        }


def linuxcnc(args: argparse.Namespace) -> None:
    """Drive the real LinuxCNC, whose joints HAL's sampler records in each servo cycle."""
    from linuxcnc import Recorded

    limits, cycle_s = limits_of(np.random.default_rng(args.seed)), 0.008
    arm = small_arm_mapping()
    for joint in arm["joints"]:
        joint["max_speed"] = MAX_SPEED
    others = [multiprocessing.get_context("spawn").Process(target=busy, daemon=True) for _ in range(args.busy)]
    with Recorded(arm=arm) as twin, twin.record() as record, beside(others):
        device = twin.address.partition(":")[2]
        said = run_with_progress(lambda: driven("linuxcnc", device, args.time_s, args.seed, limits), lambda: None)
    numbers, joints, _ = record
    q = np.radians(joints[numbers >= said["began"]])[:: round(cycle_s / SERVO_S)]
    shown("linuxcnc", said, args.time_s, "", q, cycle_s, limits)


def run(kind: str, args: argparse.Namespace) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    limits = limits_of(np.random.default_rng(args.seed))
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "controller.npz")
        command = [sys.executable, __file__, "--controller", kind, "--port", port, "--file", file]
        command += ["--fine"] * args.fine
        twin = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        told = twin.stdout.readline() if twin.stdout else ""
        device = told.strip().partition(":")[2]
        time.sleep(1.0 if kind in BUSES else 0.0)  # who speaks first is waited for, who answers must be there
        context = multiprocessing.get_context("spawn")
        others = [context.Process(target=busy, daemon=True) for _ in range(args.busy)]
        ready = context.Event()
        if kind == "rtde" and args.jitter:
            others.append(context.Process(target=jittering, args=(args.seed, ready), daemon=True))
        if kind == "rtde":
            device = NEARER if args.jitter else CONTROLLER
        with beside(others):
            if kind == "rtde" and args.jitter:
                ready.wait(60.0)
            said = run_with_progress(lambda: driven(kind, device, args.time_s, args.seed, limits), lambda: None)
        out, _ = twin.communicate("")
        record = np.load(file)
        every = round(SERVO_CYCLE_S / float(record["cycle_s"])) if kind in BUSES else 1  # a goal for so many rows
        cycle_s = every * float(record["cycle_s"])
        shown(kind, said, args.time_s, out.strip(), record["q"][::every], cycle_s, limits)
        if kind in BUSES:
            print(f"  goals are whole steps of {1e3 * tables.STEP_RAD:.2f} mrad, which make speeds of their own")
        stamps = record["t_s"]
        span_s = stamps[WINDOW:] - stamps[:-WINDOW]
        speed = np.abs(record["q"][WINDOW:] - record["q"][:-WINDOW]).max(axis=1) / span_s
    print(f"  by the stamps of its log: up to {float(speed.max()):.3f} rad/s", flush=True)


def shown(kind: str, said: dict[str, Any], time_s: float, counts: str, q: Any, cycle_s: float, limits: Limits) -> None:
    """Print what loop and driver tell, and what the controller's own record of its joints (n, 6) in rad does."""
    found = Found()
    judge((q,), limits, cycle_s, found)
    timing, status = said["timing"], said["status"]
    ms = [1e3 * value for value in timing.lateness_s]
    print(
        f"{kind}: {said['cycles']} of its controller's cycles in {time_s:g} s, missed {said['missed']}, answers "
        f"late {said['late']}; at the end {status.guard} {status.why}"
    )
    print(
        f"  loop: {timing.n_cycles} cycles, late {timing.late}, missed {timing.missed}, woke late by {ms[0]:.3f} ms "
        f"median, {ms[1]:.3f} p99, {ms[2]:.3f} at most; the controller counts {counts or 'nothing'}"
    )
    print(
        f"  by the controller's time, over {WINDOW} cycles: joints {found.joint_ratio:.3f} of their limit, tool "
        f"{found.tool_ratio:.3f} (allowed {1.0 + SPEED_TOLERANCE:g}); beyond a range by {1e3 * found.joint_beyond:.3f} "
        f"mrad, a wall by {1e3 * found.wall_beyond_m:.3f} mm; {found.moved} cycles in motion",
        flush=True,
    )


def simulated(args: argparse.Namespace) -> None:
    """Jog a KUKA controller that somebody else emulates."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    program = subprocess.Popen([*shlex.split(args.rsi_simulator), "127.0.0.1", port], stderr=subprocess.DEVNULL)
    clock = SystemClock()
    context = multiprocessing.get_context("spawn")
    robot: Any = load(ROBOTS, "rsi")(port, settings={"bind": "127.0.0.1", "open_s": 20.0}, clock=clock)
    joints = tuple(Joint(name=f"a{i}") for i in range(1, 7))

    def jogged() -> tuple[Any, ...]:
        with robot:
            guard = Guard(type(ARM)(name="kuka", joints=joints), Limits(turn_rad_s=0.3), robot.cycle_s)
            start, begun = robot.read().q, robot._pace.cycles
            goal = start + np.radians([2.0, -1.0, 1.5, 0.0, 3.0, -2.0])
            loop = ControlLoop(robot, guard, GoalSource(goal), clock, enabled=lambda: True, by_pose=False)
            timing = loop.run(for_s=args.time_s)
            off = float(np.degrees(np.abs(robot.read().q - goal).max()))
            return loop, timing, off, robot._pace.cycles - begun, robot.counts.missed

    try:
        with beside([context.Process(target=busy, daemon=True) for _ in range(args.busy)]):
            loop, timing, off, cycles, missed = run_with_progress(jogged, lambda: None)
    finally:
        program.kill()
    print(
        f"simulator: {cycles} cycles in {args.time_s:g} s, missed {missed} ({100.0 * missed / cycles:.3f} %), repeated "
        f"{robot.counts.repeated}, loop late {timing.late}, missed {timing.missed}; off by {off:.4f} deg; "
        f"{loop.status.guard} {loop.status.why}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--for", dest="time_s", type=float, default=60.0)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--jitter", action="store_true")
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rsi-simulator", default="")
    parser.add_argument("--controller", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--port", help=argparse.SUPPRESS)
    parser.add_argument("--file", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.fine:
        refine()
    if args.controller:
        controller(args.controller, args.port, args.file)
    elif args.rsi_simulator:
        simulated(args)
    else:
        for kind in args.kinds:
            linuxcnc(args) if kind == "linuxcnc" else run(kind, args)


if __name__ == "__main__":
    main()
