"""A stop, and an enable that is let go of, behind clients that flood the server and lines that delay.

python benchmarks/stops.py [--trials 167] [--flooders 0 1 10] [--minutes 40] [--seed 1]

A served arm goes at full speed. Then somebody who watches stops it, or the hand lets go of the enable; in half of the
trials that one's line delays by 50 ms to 2 s each way from then on. Prints, for each number of flooders, how long after
the stop reached this machine, and after the last enable that was not too old, the arm stood: by the true joints of the
simulated arm, whose motors lag by 30 ms, at less than 10 mrad/s. And of each stop where the time went: until the loop
saw it, until the set point rested, until the arm did.

The motion is the first joint's at the tool's full speed, which the guard brakes as fast as the limits of acceleration
and jerk let it; the floor, printed first, is the same loop on a clock without computer and network.

Flooders read without end, read and take no answers, send what is no message, messages of 16 kB, connect anew all the
time, or hold half a request; on both ports. They have the token and the address of those who drive and watch. Hand,
watcher and line run before other work where the system allows that, since they stand for other machines.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import websockets.frames

import armsight
from armsight.clock import ManualClock
from armsight.control.guard import Guard, Limits
from armsight.control.loop import ControlLoop
from armsight.control.session.channels import JointTrack
from armsight.control.session.service import Service
from armsight.control.setpoints import JointGoal
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceFailed, StaleData
from armsight.ops.robot.hosting import ProcessHost, RobotSpec
from armsight.ops.robot.opening import arm_model, open_robot
from armsight.ops.robot.recorder import RecordingLog
from armsight.server.serving import serve
from armsight.server.web_server import ServeOptions
from armsight.store.tokens import add_token

ROBOT = "sim:webcam-cell"
LINES = {"watcher": "127.0.0.2", "driver": "127.0.0.3"}
"""Addresses of this machine behind lines that delay, each by its own time."""
STILL_RAD_S = 10e-3
FULL_RAD_S = 0.1
"""Of the first joint; the tool then has 0.094 of its 0.1 m/s."""
AWAY_RAD = 0.5
AGE_S = 0.15
WANTED_S = {"stop": 0.15, "let go": AGE_S + 0.15}
PATIENCE_S = 1.0
KINDS = ("reads", "takes no answers", "no messages", "long messages", "connects anew", "half a request")


class TimedLog(RecordingLog):
    """Tells besides when the loop saw the newest stop, and when it last changed the set point."""

    def __init__(self, path: Path, times) -> None:
        super().__init__(path)
        self._times, self._q = times, None

    def event(self, t_s: float, level: str, message: str) -> None:
        if message.startswith("stopped: "):
            self._times[0] = t_s
        super().event(t_s, level, message)

    def command(self, t_s: float, who: str, kind: str, values: dict) -> None:
        if who == "loop":
            if self._q is not None and values["q"] != self._q:
                self._times[1] = t_s
            self._q = values["q"]
        super().command(t_s, who, kind, values)


def serving(folder: str, port: int, track: JointTrack, times, ready) -> None:
    with (
        TimedLog(Path(folder) / "log.mcap", times) as log,
        ProcessHost(RobotSpec(robot=ROBOT, arm=arm_model(ROBOT, None)), track) as host,
    ):
        serve(
            Service(host, log),
            ServeOptions(port=port, tokens=Path(folder) / "tokens.yaml"),
            ready=lambda _: ready.set(),
        )


def first() -> None:
    """Run before other work, as another machine would; what this process starts runs as usual."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def delaying(ports: tuple[int, ...], delays, stops, ready) -> None:
    """Carry connections of LINES to this machine, each byte later by its line's delay, in their order.

    stops: how many stops were handed on, and when the first of them was.
    """
    first()

    async def carry(reader, writer, line: int, up: bool) -> None:
        waiting: asyncio.Queue = asyncio.Queue()

        async def out() -> None:
            with suppress(OSError):
                while True:
                    due_s, data = await waiting.get()
                    await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                    if not data:
                        break
                    if up and b'"type":"stop"' in data:
                        stops[1] = stops[1] if stops[0] else time.monotonic()
                        stops[0] += 1
                    writer.write(data)
                    await writer.drain()
            writer.close()

        task = asyncio.create_task(out())
        last_s = 0.0
        with suppress(OSError):
            while data := await reader.read(65536):
                last_s = max(last_s, time.monotonic() + delays[line])
                waiting.put_nowait((last_s, data))
        waiting.put_nowait((time.monotonic() + delays[line], b""))
        await task

    async def join(near_reader, near_writer, port: int, line: int) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", port)
        for writer in (near_writer, far_writer):
            writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.gather(carry(near_reader, far_writer, line, True), carry(far_reader, near_writer, line, False))

    async def main() -> None:
        for line, address in enumerate(LINES.values()):
            for port in ports:
                await asyncio.start_server(lambda r, w, p=port, n=line: join(r, w, p, n), address, port)
        ready.set()
        await asyncio.Event().wait()

    asyncio.run(main())


def rest_s(track: JointTrack, since_s: float) -> tuple[float, float]:
    """Return when the arm last moved, and its speed at since_s (rad/s)."""
    rows, written = track._rows()
    number = int(written[0])
    table = rows[np.arange(max(0, number - 480), number) % track._count].copy()
    t, speed = table[1:, 0], np.abs(np.diff(table[:, 1:], axis=0)).max(axis=1) / np.diff(table[:, 0])
    moving = t[(speed > STILL_RAD_S) & (t > since_s - 0.5)]
    at = speed[np.searchsorted(t, since_s) - 3 : np.searchsorted(t, since_s) + 1]
    return (float(moving.max()) if len(moving) else since_s), float(np.median(at)) if len(at) else 0.0


def floor_s() -> tuple[float, float]:
    """Return how long after a stop set point and arm stand where computer and network take no time."""
    clock, arm = ManualClock(), arm_model(ROBOT, None)
    robot = open_robot(ROBOT, clock, {})
    with robot:
        begin = robot.step_joints(np.zeros(6)).q
        source = SimpleNamespace(name="goal", next=lambda _: JointGoal(q=begin + AWAY_RAD * np.eye(6)[0]))
        guard = Guard(arm, Limits(), robot.cycle_s)
        loop = ControlLoop(robot, guard, source, clock, enabled=lambda: clock.now_s() > 0.05)
        loop._begin()
        rows = []
        for cycle in range(150):
            clock.advance(robot.cycle_s)
            if cycle == 75:
                stopped_s = clock.now_s()
                loop.stop()
            sent = loop._cycle(clock.now_s(), 0.0).q_sent
            rows.append((clock.now_s(), sent[0], robot.true_joints(clock.now_s())[0]))
    table = np.array(rows)
    speed = np.abs(np.diff(table[:, 1:], axis=0)) / robot.cycle_s
    set_point, arm_still = (table[1:, 0][speed[:, i] > least].max() for i, least in ((0, 1e-6), (1, STILL_RAD_S)))
    return float(set_point - stopped_s), float(arm_still - stopped_s)


class Trials:
    """One number of flooders. found: times in s by what was asked and whether the line delayed."""

    def __init__(self, port: int, token: str, track: JointTrack, delays, stops, times, seed: int, crowd) -> None:
        self.crowd = crowd
        self.port, self.token, self.track, self.delays = port, token, track, delays
        self.stops, self.times = stops, times
        self.rng = random.Random(seed)
        self.sign = 1.0
        self.found: dict[str, list[float]] = {"stop": [], "let go": []}
        self.delayed: dict[str, list[bool]] = {"stop": [], "let go": []}
        self.legs: list[tuple[float, float, float]] = []
        self.counts: Counter[str] = Counter()

    def run(self, trials: int, until_s: float) -> None:
        while min(map(len, self.found.values())) < trials and time.monotonic() < until_s:
            try:
                with self.connect("watcher") as watcher, self.connect("driver").drive() as driver:
                    for _ in range(10):  # then anew: who comes while others flood has to find room as well
                        self.trial("stop", watcher, driver)
                        self.trial("let go", watcher, driver)
            except armsight.ArmsightError as error:
                self.counts[f"{type(error).__name__}: {str(error)[:70]}"] += 1
                self.delays[0] = self.delays[1] = 0.0

    def connect(self, who: str):
        return armsight.connect(f"ws://{LINES[who]}:{self.port}", token=self.token)

    def trial(self, kind: str, watcher, driver) -> None:
        if not self.moves(driver):
            self.counts["did not move"] += 1
            return
        delay_s = self.rng.choice((0.0, self.rng.uniform(0.05, 2.0)))
        (self.stop if kind == "stop" else self.let_go)(watcher, driver, delay_s)
        self.delayed[kind].append(delay_s > 0.0)

    def stop(self, watcher, driver, delay_s: float) -> None:
        self.stops[0] = 0
        self.delays[0] = delay_s
        for wire in (watcher._link._line, watcher._link._wire):
            wire.send(say.StopMessage)
        time.sleep(0.02)
        self.delays[0] = 0.0  # what was said is under way; what follows need not wait as long
        until_s = time.monotonic() + delay_s + 1.0
        while self.stops[0] < 2 and time.monotonic() < until_s:
            driver._heart.touch()
            time.sleep(0.005)
        reached_s = self.stops[1]
        time.sleep(max(0.0, reached_s + 0.25 - time.monotonic()))
        last_s, _ = rest_s(self.track, reached_s)
        if last_s > time.monotonic() - 0.03:  # it moves yet
            time.sleep(0.5)
            last_s, _ = rest_s(self.track, reached_s)
        self.found["stop"].append(last_s - reached_s)
        saw_s, sent_s = self.times
        if reached_s <= saw_s <= sent_s <= last_s:
            self.legs.append((saw_s - reached_s, sent_s - saw_s, last_s - sent_s))

    def let_go(self, watcher, driver, delay_s: float) -> None:
        slow_s = time.monotonic()
        self.delays[1] = delay_s
        time.sleep(self.rng.uniform(0.0, 0.1) if delay_s else 0.0)
        said_s = time.monotonic()
        driver._heart._enable = False
        driver._link.beat(enable=False, waits=False)
        # the delay begins at slow_s: enables sent later come, but count for nothing where they are too old by then
        enabled_s = said_s if delay_s < AGE_S else min(said_s, slow_s)
        time.sleep(0.4)
        self.delays[1] = 0.0
        last_s, _ = rest_s(self.track, enabled_s)
        if last_s > time.monotonic() - 0.03:
            time.sleep(0.5)
            last_s, _ = rest_s(self.track, enabled_s)
        self.found["let go"].append(last_s - enabled_s)
        time.sleep(max(0.0, slow_s + delay_s - time.monotonic()))

    def moves(self, driver) -> bool:
        """Let the arm go, and say whether it goes at full speed.

        Where a flood keeps the set point away for PATIENCE_S it pauses until the arm goes, and 0.3 s more of the flood
        pass before the trial; how often that was is told.
        """
        if self.gets_going(driver, PATIENCE_S if self.crowd else 6.0):
            return True
        if not self.crowd:
            return False
        self.counts["arm went off only while the flood paused"] += 1
        self.flood(signal.SIGSTOP)
        try:
            going = self.gets_going(driver, 6.0)
        finally:
            self.flood(signal.SIGCONT)
        until_s = time.monotonic() + 0.3
        while time.monotonic() < until_s:
            driver._heart.touch()
            time.sleep(0.01)
        return going and rest_s(self.track, time.monotonic())[1] > FULL_RAD_S

    def flood(self, number: int) -> None:
        for one in self.crowd:
            one.send_signal(number)

    def gets_going(self, driver, for_s: float) -> bool:
        until_s, asked_s = time.monotonic() + for_s, -1.0
        while time.monotonic() < until_s:
            if time.monotonic() - asked_s > 0.5:
                with suppress(DeviceFailed, StaleData):
                    self.go(driver)
                asked_s = time.monotonic()
            driver._heart.touch()
            if rest_s(self.track, time.monotonic())[1] > FULL_RAD_S:
                return True
            time.sleep(0.01)
        return False

    def go(self, driver) -> None:
        state = driver.state()
        if state.robot == "stopped":
            driver.reset()
        driver.enable()
        q = np.array(state.q_sent)
        self.sign = -1.0 if q[0] > 0.3 else 1.0 if q[0] < -0.3 else self.sign
        driver.move_joints(q + self.sign * AWAY_RAD * np.eye(6)[0], wait=False)

    def tell(self, flooders: int) -> None:
        for kind, took in self.found.items():
            slow = np.array(self.delayed[kind], dtype=bool)
            for words, which in (("", slow | True), (", line at once", ~slow), (", line delays", slow)):
                ms = 1e3 * np.array(took[: len(slow)])[which]
                if len(ms):
                    print(
                        f"{flooders:2d} flooders, {kind}{words}: "
                        f"n {len(ms)}, median {np.median(ms):.0f} ms, 99 % {np.percentile(ms, 99):.0f}, "
                        f"most {ms.max():.0f}; over {1e3 * WANTED_S[kind]:.0f} ms: {(ms > 1e3 * WANTED_S[kind]).sum()}"
                    )
        if self.legs:
            legs = 1e3 * np.array(self.legs)
            words = ("until the loop saw it", "then until the set point rested", "then until the arm did")
            told = ", ".join(
                f"{word} {np.median(leg):.0f} (99 % {np.percentile(leg, 99):.0f}, most {leg.max():.0f})"
                for word, leg in zip(words, legs.T, strict=True)
            )
            print(f"   of {len(legs)} stops, ms: {told}")
        if self.counts:
            print(f"   {dict(self.counts)}")
        print(f"   load {os.getloadavg()[0]:.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=167, help="stops, and as many enables let go of, each")
    parser.add_argument("--flooders", type=int, nargs="+", default=[0, 1, 10])
    parser.add_argument("--minutes", type=float, default=40.0, help="longest time of all together")
    parser.add_argument("--port", type=int, default=8785)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    ports = (args.port, args.port + 1)
    print(
        f"{os.cpu_count()} cores; {args.trials} stops and {args.trials} enables let go of for each number of flooders"
    )
    print("floor: set point at rest {:.0f} ms after the stop, arm {:.0f} ms".format(*(1e3 * t for t in floor_s())))
    websockets.frames.secrets = SimpleNamespace(token_bytes=bytes)  # the line has to see which message is a stop
    with tempfile.TemporaryDirectory() as folder:
        token = add_token(Path(folder) / "tokens.yaml", "anna", "drive")
        track, delays, stops, times = JointTrack(6), *(context.Array("d", [0.0, 0.0], lock=False) for _ in range(3))
        up, line = context.Event(), context.Event()
        server = context.Process(target=serving, args=(folder, args.port, track, times, up))
        proxy = context.Process(target=delaying, args=(ports, delays, stops, line), daemon=True)
        server.start()
        proxy.start()
        end_s = time.monotonic() + 60.0 * args.minutes
        try:
            up.wait(60)
            line.wait(10)
            first()
            for done, flooders in enumerate(args.flooders):
                crowd = [
                    subprocess.Popen(
                        [
                            sys.executable,
                            str(Path(__file__).parent / "flooding.py"),
                            KINDS[i % len(KINDS)],
                            str(ports[i % 4 == 3]),
                            (say.STREAM_PATH, say.STOP_PATH)[i % 4 == 3],
                        ],
                        env={**os.environ, "FLOOD_TOKEN": token},
                    )
                    for i in range(flooders)
                ]
                time.sleep(2.0 if crowd else 0.0)
                trials = Trials(args.port, token, track, delays, stops, times, args.seed, crowd)
                trials.run(args.trials, time.monotonic() + (end_s - time.monotonic()) / (len(args.flooders) - done))
                for one in crowd:
                    one.kill()
                    one.wait()
                trials.tell(flooders)
        finally:
            server.terminate()
            server.join(10)


if __name__ == "__main__":
    main()
