"""A stop, and an enable that is let go of, behind clients that flood the server and lines that delay.

python benchmarks/stops.py [--trials 100] [--flooders 0 1 10] [--seed 1]

A served arm goes at full speed. Then somebody stops it, or the hand lets go of the enable; in half of the trials the
line has begun to delay by up to 2 s each way meanwhile. Prints, for each number of flooders, how long after the stop
reached this machine, and after the last enable that was not too old, the arm stood: by the true joints of the
simulated arm, whose motors lag by 30 ms, at less than 10 mrad/s. Flooders read without end, read and take no answers,
send what is no message, messages of 16 kB, connect anew all the time, or hold half a request; on both ports.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import multiprocessing
import os
import random
import socket
import struct
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

import armsight
from armsight.app.robot.channels import JointTrack
from armsight.app.robot.event_log import RecordingLog
from armsight.app.robot.hosting import ProcessHost, RobotSpec
from armsight.app.robot.models import arm_model
from armsight.app.robot.service import Service
from armsight.drivers.remote import protocol as say
from armsight.server.serving import serve
from armsight.server.web_server import ServeOptions
from armsight.store.tokens import add_token

ROBOT = "sim:webcam-cell"
FAR = "127.0.0.2"
"""The address of this machine behind the line that delays."""
STILL_RAD_S = 10e-3
AWAY_RAD = 0.5
AGE_S = 0.15
KINDS = ("reads", "takes no answers", "no messages", "long messages", "connects anew", "half a request")


def serving(folder: str, port: int, track: JointTrack, ready) -> None:
    with (
        RecordingLog(Path(folder) / "log.mcap") as log,
        ProcessHost(RobotSpec(robot=ROBOT, arm=arm_model(ROBOT, None)), track) as host,
    ):
        serve(
            Service(host, log),
            ServeOptions(port=port, tokens=Path(folder) / "tokens.yaml"),
            ready=lambda _: ready.set(),
        )


def delaying(ports: tuple[int, ...], delay, ready) -> None:
    """Carry connections of FAR to this machine, each byte later by the shared delay, in their order."""

    async def carry(reader, writer) -> None:
        waiting: asyncio.Queue = asyncio.Queue()

        async def out() -> None:
            with suppress(OSError):
                while True:
                    due_s, data = await waiting.get()
                    await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                    if not data:
                        break
                    writer.write(data)
                    await writer.drain()
            writer.close()

        task = asyncio.create_task(out())
        last_s = 0.0
        with suppress(OSError):
            while data := await reader.read(65536):
                last_s = max(last_s, time.monotonic() + delay.value)
                waiting.put_nowait((last_s, data))
        waiting.put_nowait((time.monotonic() + delay.value, b""))
        await task

    async def join(near_reader, near_writer, port: int) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", port)
        for writer in (near_writer, far_writer):
            writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.gather(carry(near_reader, far_writer), carry(far_reader, near_writer))

    async def main() -> None:
        for port in ports:
            await asyncio.start_server(lambda r, w, port=port: join(r, w, port), FAR, port)
        ready.set()
        await asyncio.Event().wait()

    asyncio.run(main())


def frame(text: bytes) -> bytes:
    head = bytes([0x81]) + (bytes([0x80 | len(text)]) if len(text) < 126 else b"\xfe" + struct.pack("!H", len(text)))
    return head + b"\0\0\0\0" + text


def flooding(kind: str, port: int, path: str, token: str, over) -> None:
    """Flood one port until over is set; connect again whenever it is closed."""
    key = base64.b64encode(os.urandom(16)).decode()
    head = (
        f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nAuthorization: Bearer {token}\r\n\r\n"
    ).encode()
    held: list[socket.socket] = []
    while not over.is_set():
        with suppress(OSError, ValueError, IndexError):
            link = socket.create_connection(("127.0.0.1", port), timeout=1.0)
            if kind == "half a request":
                link.sendall(head[: len(head) // 2])
                held = [*held[-299:], link]
                time.sleep(0.002)
                continue
            link.sendall(head)
            hello = link.recv(65536)
            if kind == "connects anew":
                link.close()
                continue
            while b"session" not in hello:
                hello += link.recv(65536)
            session = hello.split(b'"session":"')[1][:32].decode()
            if kind != "takes no answers":
                threading.Thread(target=drain, args=(link,), daemon=True).start()
            number = 0
            while not over.is_set():
                if kind in ("reads", "takes no answers"):
                    texts = [f'{{"type":"read","session":"{session}","seq":{number + i + 1}}}' for i in range(200)]
                    number += 200
                elif kind == "no messages":
                    texts = ["{" * 20] * 200
                else:
                    texts = [" " * 16_000] * 10
                link.sendall(b"".join(frame(text.encode()) for text in texts))


def drain(link: socket.socket) -> None:
    with suppress(OSError):
        while link.recv(262_144):
            pass


def rest_s(track: JointTrack, since_s: float) -> tuple[float, float]:
    """Return when the arm last moved, and its speed at since_s (rad/s)."""
    rows, written = track._rows()
    number = int(written[0])
    table = rows[np.arange(max(0, number - 480), number) % track._count].copy()
    t, speed = table[1:, 0], np.abs(np.diff(table[:, 1:], axis=0)).max(axis=1) / np.diff(table[:, 0])
    moving = t[(speed > STILL_RAD_S) & (t > since_s - 0.5)]
    at = speed[np.searchsorted(t, since_s) - 3 : np.searchsorted(t, since_s) + 1]
    return (float(moving.max()) if len(moving) else since_s), float(np.median(at)) if len(at) else 0.0


class Trials:
    def __init__(self, port: int, token: str, track: JointTrack, delay, seed: int) -> None:
        self.url, self.token, self.track, self.delay = f"ws://{FAR}:{port}", token, track, delay
        self.rng = random.Random(seed)
        self.sign = 1.0
        self.found: dict[str, list[float]] = {}
        self.counts: Counter[str] = Counter()

    def run(self, trials: int) -> None:
        for _ in range(trials):
            for kind in ("stop", "let go"):
                try:
                    self.trial(kind, self.rng.choice((0.0, self.rng.uniform(0.05, 2.0))))
                except armsight.ArmsightError as error:
                    self.counts[f"{type(error).__name__}: {str(error)[:60]}"] += 1
                    self.delay.value = 0.0
                    time.sleep(0.5)

    def trial(self, kind: str, delay_s: float) -> None:
        self.delay.value = 0.0
        with (
            armsight.connect(self.url, token=self.token) as watcher,
            armsight.connect(self.url, token=self.token).drive() as driver,
        ):
            begun_s = time.monotonic()
            while not self.moves(driver):
                if time.monotonic() - begun_s > 10.0:
                    self.counts["never moved"] += 1
                    return
            slow_s = time.monotonic()
            self.delay.value = delay_s
            if delay_s:
                time.sleep(self.rng.uniform(0.0, 0.1))
            said_s = time.monotonic()
            threading.Thread(target=self.say, args=(kind, watcher, driver), daemon=True).start()
            time.sleep(delay_s + 0.7)
            # the line's delay begins at slow_s: enables sent later come, but count for nothing once they are too old
            enabled_s = said_s if delay_s < AGE_S else min(said_s, slow_s)
            last_s, _ = rest_s(self.track, said_s)
            self.note(
                "after the last valid enable" if kind == "let go" or delay_s else "stop", last_s - enabled_s, delay_s
            )
            if kind == "stop":
                self.note("after the stop reached it", last_s - said_s - delay_s, delay_s)
            self.delay.value = 0.0
            time.sleep(2.2 * delay_s)
            if kind == "stop":
                with suppress(armsight.ArmsightError):
                    driver.reset()

    def moves(self, driver) -> bool:
        """Let the arm go, and say whether it goes at speed."""
        with suppress(armsight.ArmsightError):
            if driver.state().robot == "stopped":
                driver.reset()
            driver.enable()
            q = np.array(driver.state().q_sent)
            self.sign = -1.0 if q[0] > 0.3 else 1.0 if q[0] < -0.3 else self.sign
            driver.move_joints(q + self.sign * AWAY_RAD * np.eye(6)[0], wait=False)
        until_s = time.monotonic() + 0.6
        while time.monotonic() < until_s:
            with suppress(armsight.ArmsightError):
                driver._heart.touch()
            time.sleep(0.02)
            if rest_s(self.track, time.monotonic())[1] > 0.05:
                time.sleep(0.15)
                return True
        return False

    def say(self, kind: str, watcher, driver) -> None:
        with suppress(armsight.ArmsightError):
            watcher.stop() if kind == "stop" else driver.disable()

    def note(self, what: str, took_s: float, delay_s: float) -> None:
        self.found.setdefault(what, []).append(took_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20, help="stops, and as many enables let go of, each")
    parser.add_argument("--flooders", type=int, nargs="+", default=[0, 1, 10])
    parser.add_argument("--port", type=int, default=8785)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    ports = (args.port, args.port + 1)
    print(
        f"{os.cpu_count()} cores; {args.trials} stops and {args.trials} enables let go of for each number of flooders"
    )
    with tempfile.TemporaryDirectory() as folder:
        token = add_token(Path(folder) / "tokens.yaml", "anna", "drive")
        track, delay = JointTrack(6), context.Value("d", 0.0, lock=False)
        up, line = context.Event(), context.Event()
        server = context.Process(target=serving, args=(folder, args.port, track, up))
        proxy = context.Process(target=delaying, args=(ports, delay, line), daemon=True)
        server.start()
        proxy.start()
        up.wait(60)
        line.wait(10)
        for flooders in args.flooders:
            over = context.Event()
            crowd = [
                context.Process(
                    target=flooding,
                    args=(
                        KINDS[i % len(KINDS)],
                        ports[i % 4 == 3],
                        (say.STREAM_PATH, say.STOP_PATH)[i % 4 == 3],
                        token,
                        over,
                    ),
                    daemon=True,
                )
                for i in range(flooders)
            ]
            for one in crowd:
                one.start()
            time.sleep(2.0 if crowd else 0.0)
            trials = Trials(args.port, token, track, delay, args.seed)
            trials.run(args.trials)
            over.set()
            for one in crowd:
                one.join(3.0)
                one.kill()
            for what, took in trials.found.items():
                ms = 1e3 * np.array(took)
                print(
                    f"{flooders:2d} flooders, {what}: n {len(ms)}, median {np.median(ms):.0f} ms, "
                    f"99 % {np.percentile(ms, 99):.0f}, most {ms.max():.0f}"
                )
            if trials.counts:
                print(f"   {dict(trials.counts)}", flush=True)
        server.terminate()
        server.join(10)


if __name__ == "__main__":
    main()
