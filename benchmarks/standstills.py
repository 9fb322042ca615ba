"""Each process of a served robot stopped by the system for 0.1 to 5 s, at rest and in motion; what the arm does then.

python benchmarks/standstills.py [alter] [rsi] [egm] [rtde] [sim] [--process loop web line client command] [--trials 20]

An emulated controller, a robot server (its loop with the driver, its web server, its line for stops) and a client that
holds the enable are processes of their own, in real time. One of them gets SIGSTOP and SIGCONT; command: `armsight
robot jog`, whose driver and loop are one process. Prints for each link and process the largest way of any axis after
the process went on, with the enable still held and nothing given anew, the largest step of the controller's goal then,
and what is told. By the emulated controller's own joints. Where the loop goes on while another process stands, the arm
has the age of an enable, 0.15 s, and its way to rest; what comes later counts, and what a stand-still does that ends
before that age.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.truth.lossy_links import ARM

import armsight
from armsight.clock import SystemClock, monotonic_s
from armsight.control.session.channels import JointTrack
from armsight.control.session.service import Service
from armsight.ops.robot.hosting import ProcessHost, RobotSpec
from armsight.ops.robot.opening import arm_model, driver_settings
from armsight.ops.robot.recorder import RecordingLog
from armsight.server.serving import serve
from armsight.server.web_server import ServeOptions
from armsight.store.arm_file import write_arm

KINDS = ("alter", "rsi", "egm", "rtde", "sim")
PROCESSES = ("loop", "web", "line", "client", "command")
TIMES_S = (0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 1.6, 2.5, 5.0)
REST_S = 0.45
"""After which an arm stands whose enable ended: its age, and the way to rest."""
AGE_S = 0.15
WATCH_S = 0.8
SETTINGS = {"rtde": {"cycle_s": 0.008}}
"""A CB3's cycle: two processes of 2 ms that go first leave a web server on two cores no turn."""
SWING = 0.15
"""The first joint goes to and fro by so much, rad."""
FIRST = 20
"""Of SCHED_FIFO: before the loop, as on a computer of its own."""


def controller(kind: str, track: JointTrack, goals: JointTrack, address: Any, over: Any) -> None:
    """Play the controller, and write down where its joints are and are told to go."""
    from armsight_sim.twins.alter import AlterTwin
    from armsight_sim.twins.egm import EgmTwin
    from armsight_sim.twins.rsi import RsiTwin
    from armsight_sim.twins.rtde import RtdeTwin

    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIRST))
    clock = SystemClock()
    ports: dict[str, dict[str, Any]] = {
        "rsi": {"connect": "127.0.0.1:49252"},
        "egm": {"connect": "127.0.0.1:6610"},
        "rtde": SETTINGS["rtde"],
    }
    maker = {"alter": AlterTwin, "rsi": RsiTwin, "egm": EgmTwin, "rtde": RtdeTwin}[kind]
    with maker(clock=clock, **ports.get(kind, {})) as twin:
        address.send(twin.address)
        its = twin.server.controller if kind == "rtde" else twin.controller

        def on() -> bool:
            track.write(clock.now_s(), its.q)
            goals.write(clock.now_s(), its._servo.goal)
            return not over.is_set()

        twin.run(on)


def serving(folder: str, spec: RobotSpec, track: JointTrack | None, told: Any) -> None:
    """Serve the robot; tells the ids of its processes and its address."""
    with (
        RecordingLog(Path(folder) / f"log{monotonic_s():.3f}.mcap") as log,
        ProcessHost(spec, track) as host,
    ):

        def ready(url: str) -> None:
            line = next(p for p in multiprocessing.active_children() if p.name == "armsight-stop-line")
            told.send((url, {"web": os.getpid(), "loop": host._process.pid, "line": line.pid}))

        serve(Service(host, log), ServeOptions(port=0), ready=ready)


def driving(url: str, orders: Any) -> None:
    """Drive as a program does: enable where told, go to and fro where told, and live."""
    time.sleep(2.0)
    with armsight.connect(url) as robot, robot.drive() as driver:
        home, sign, moving, asked_s = np.array(robot.state().q_sent), 1.0, False, 0.0
        while True:
            while orders.poll(0.01):
                what = orders.recv()
                if what == "end":
                    return
                if what in ("enable", "move"):
                    now = driver.state()
                    if "stopped" in (now.robot, now.guard):
                        driver.reset()
                    driver.enable()
                moving, asked_s = what == "move", 0.0
                orders.send("done")
            with contextlib.suppress(armsight.ArmsightError):
                driver.state()
                if moving and monotonic_s() - asked_s > 0.6:
                    sign, asked_s = -sign, monotonic_s()
                    driver.move_joints(home + sign * SWING * np.eye(len(home))[0], wait=False)


def rows(track: JointTrack, since_s: float) -> np.ndarray:
    """Return t_s and joints (m, 1 + n) since a time."""
    table, written = track._rows()
    number = int(written[0])
    kept = table[np.arange(max(0, number - track._count + 64), number) % track._count].copy()
    return kept[kept[:, 0] >= since_s]


class Found:
    """What one process of one link showed."""

    def __init__(self) -> None:
        self.way = self.step = self.short_way = 0.0
        self.n = self.short = self.jumps = 0
        self.told: Counter[str] = Counter()

    def take(self, q: np.ndarray, goals: np.ndarray, *, counts: bool, told: str, jump: float) -> None:
        """Add a trial: joints and goals (m, 1 + n) from when all has to stand; counts: else it was too short."""
        way = float(np.ptp(q[:, 1:], axis=0).max()) if len(q) else 0.0
        step = float(np.abs(np.diff(goals[:, 1:], axis=0)).max(initial=0.0)) if len(goals) > 1 else 0.0
        self.n += 1
        self.told[told] += 1
        if not counts:
            self.short += 1
            self.short_way = max(self.short_way, way)
            return
        self.way, self.step = max(self.way, way), max(self.step, step)
        self.jumps += step > jump

    def tell(self, kind: str, process: str) -> None:
        short = f"; {self.short} shorter than {AGE_S} s, the enable lived on: {self.short_way:.4f} rad" * (
            self.short > 0
        )
        print(
            f"{kind}, {process}: {self.n} trials; way after it at most {self.way:.5f} rad, goal's step "
            f"{self.step:.5f}, jumps {self.jumps}{short}; told: {dict(self.told)}",
            flush=True,
        )


class Bench:
    """A controller, a server and a client of one kind of link."""

    def __init__(self, kind: str, folder: str) -> None:
        self.kind, self.folder = kind, folder
        self.context = multiprocessing.get_context("spawn")
        self.track, self.goals = JointTrack(6, 8192), JointTrack(6, 8192)
        self.over = self.context.Event()
        self.twin: Any = None
        if kind == "sim":
            self.address, self.arm = "sim:webcam-cell", arm_model("sim:webcam-cell", None)
            return
        near, far = self.context.Pipe()
        self.twin = self.context.Process(target=controller, args=(kind, self.track, self.goals, far, self.over))
        self.twin.start()
        self.address, self.arm = near.recv(), ARM

    def serve(self) -> None:
        spec = RobotSpec(robot=self.address, arm=self.arm, settings=self.settings())
        track = self.track if self.kind == "sim" else None
        for _ in range(5):  # a busy computer may take a controller's first packets too late to know its cycle
            near, far = self.context.Pipe()
            self.server = self.context.Process(target=serving, args=(self.folder, spec, track, far))
            self.server.start()
            far.close()
            with contextlib.suppress(EOFError):
                self.url, self.pids = near.recv()
                break
        self.client_orders, orders = self.context.Pipe()
        self.client = self.context.Process(target=driving, args=(self.url, orders))
        self.client.start()
        self.pids["client"] = self.client.pid
        self.watcher = self.connected()
        self.order("rest")  # it is up

    def connected(self) -> Any:
        """Return a connection that watches; a busy computer takes long to begin."""
        for _ in range(5):
            with contextlib.suppress(armsight.ArmsightError):
                return armsight.connect(self.url)
        raise RuntimeError("the server does not answer")

    def settings(self) -> dict[str, Any]:
        """Return the driver's settings."""
        return driver_settings(self.address, SETTINGS.get(self.kind), arm=self.arm)

    def unserve(self) -> None:
        self.client.kill()
        self.watcher.close()
        self.server.terminate()
        self.server.join(15)
        if self.server.is_alive():
            self.server.kill()

    def order(self, what: str) -> None:
        self.client_orders.send(what)
        if not self.client_orders.poll(60.0):
            raise RuntimeError(f"the client does not {what}")
        self.client_orders.recv()

    def trial(self, process: str, stood_s: float, *, moving: bool, found: Found) -> None:
        for attempt in range(6):
            self.order("move" if moving else "enable")
            time.sleep(0.5 if moving else 0.2)
            if self.moves() if moving else self.watcher.state().guard == "running":
                break
            if attempt % 3 == 2:  # the controller has ended its session; else a busy computer ended the enable
                found.told["link opened anew"] += 1
                self.unserve()
                self.serve()
        else:
            found.told["not tried"] += 1
            return
        begun_s = monotonic_s()
        os.kill(self.pids[process], signal.SIGSTOP)
        time.sleep(stood_s)
        woke_s = monotonic_s()
        os.kill(self.pids[process], signal.SIGCONT)
        since_s = woke_s if process == "loop" else max(woke_s, begun_s + REST_S)
        time.sleep(max(0.0, since_s - monotonic_s()) + WATCH_S)
        told = "nothing"
        with contextlib.suppress(armsight.ArmsightError):
            state = self.watcher.state()
            told = f"{state.guard}: {' '.join(w for w in state.why.split() if not w[:1].isdigit())}"
        counts = process == "loop" or stood_s > AGE_S
        goals = rows(self.goals if self.kind != "sim" else self.track, since_s)
        found.take(rows(self.track, since_s), goals, counts=counts, told=told, jump=1e-3)
        self.client_orders.send("rest")
        self.client_orders.recv() if self.client_orders.poll(20.0) else None

    def moves(self) -> bool:
        until_s = monotonic_s() + 2.0
        while monotonic_s() < until_s:
            last = rows(self.track, monotonic_s() - 0.15)
            if len(last) > 2 and np.ptp(last[:, 1:], axis=0).max() > 1e-4:
                return True
            time.sleep(0.01)
        return False

    def command(self, stood_s: float, found: Found) -> None:
        """Stop `armsight robot jog` in its motion."""
        arm = Path(self.folder) / "arm.yaml"
        if not arm.exists():
            write_arm(arm, self.arm)
        words = ["robot", "jog", "--robot", self.address, "--joint", "1", "--by", "0.6", "--yes"]
        own = [] if self.kind == "sim" else ["--arm", str(arm)]
        own += [
            word for name, value in SETTINGS.get(self.kind, {}).items() for word in ("--robot-set", f"{name}={value}")
        ]
        jog = subprocess.Popen(
            [sys.executable, "-m", "armsight", *words, *own],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        if self.kind == "sim" or not self.waits_for_motion(jog):
            time.sleep(6.0 if self.kind == "sim" else 0.0)
        time.sleep(0.4)
        os.kill(jog.pid, signal.SIGSTOP)
        time.sleep(stood_s)
        woke_s = monotonic_s()
        os.kill(jog.pid, signal.SIGCONT)
        time.sleep(WATCH_S)
        q, goals = rows(self.track, woke_s), rows(self.goals, woke_s)
        _, text = jog.communicate(timeout=30)
        words = [word for word in text.split() if not word[:1].isdigit()]
        found.take(q, goals, counts=True, told=f"exit {jog.returncode}: {' '.join(words)[-90:]}", jump=1e-3)

    def waits_for_motion(self, jog: Any) -> bool:
        until_s = monotonic_s() + 60.0
        while monotonic_s() < until_s and jog.poll() is None:
            last = rows(self.track, monotonic_s() - 0.1)
            if len(last) > 2 and np.ptp(last[:, 1:], axis=0).max() > 1e-3:
                return True
            time.sleep(0.02)
        return False

    def end(self) -> None:
        self.over.set()
        if self.twin is not None:
            self.twin.join(5)
            self.twin.kill()


def run(kind: str, processes: list[str], trials: int, folder: str, seed: int) -> None:
    """Do the trials of one link, and print what each process showed."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    bench = Bench(kind, folder)
    try:
        if "command" in processes:
            found = Found()
            for i in range(trials):
                bench.command(TIMES_S[i % len(TIMES_S)], found)
            found.tell(kind, "command")
        served = [process for process in processes if process != "command"]
        if not served:
            return
        bench.serve()
        for process in served:
            found = Found()
            for i, stood_s in enumerate(rng.permutation(np.resize(TIMES_S, trials))):
                try:
                    bench.trial(process, float(stood_s), moving=bool(i % 2), found=found)
                except (RuntimeError, OSError, EOFError):
                    found.told["server begun anew"] += 1
                    bench.unserve()
                    bench.serve()
            found.tell(kind, process)
        bench.unserve()
    finally:
        bench.end()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=KINDS)
    parser.add_argument("--process", nargs="+", choices=PROCESSES, default=PROCESSES)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for kind in args.kinds:
        with tempfile.TemporaryDirectory() as folder:
            run(kind, args.process, args.trials, folder, args.seed)


if __name__ == "__main__":
    main()
