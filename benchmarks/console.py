"""The operator's console: pictures a second in a browser, what browsers cost the measuring loop, and hours of use.

    python benchmarks/console.py [--quick] [--two] [--visits N] [--blocks N] [--seconds S]

Two streams of 1280x720 at 30 a second are files played at their own pace. What the loop took is what it tells with
each picture. Browsers are real Chromiums on this machine: once beside the console as any program is, once behind it
(nice 19), which stands for browsers on machines of their own. Needs Debian's Chromium and Linux's /proc.

--two measures two consoles with robots side by side instead: how long a page takes, and what another program gets.
"""

from __future__ import annotations

import argparse
import gc
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import cv2
import numpy as np
import uvicorn
import yaml
from fastapi import FastAPI
from playwright.sync_api import sync_playwright

from armsight.app.live.station import Snapshot
from armsight.app.live.views import Counts, LiveView, SideView
from armsight.console.application import add_console
from armsight.console.state import Console
from armsight.ops.simulation.cells import load_cell
from bench import machine, table

CHROMIUM = "/usr/bin/chromium"
PAIRS = 150
"""So many that the files' beginning anew, when nothing is read ahead yet, is behind the p99."""
ROOMS = {"dark": (0, 19), "workshop": (0,)}
"""Rooms of the streams, and how nice the browsers are."""
PAGES = ("live", "calibrate", "identify", "teach", "verify", "settings")
HOURS, RATE_HZ, TICK_HZ = 8.0, 30.0, 10.0
VISITS_PER_HOUR = 60.0
"""Pages that people open in a busy hour."""
LIVE_HZ, SETTLED_S = 4.0, 15.0
"""Pages asked of each console in a second; time that a console gets to begin."""
MB = 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--two", action="store_true", help="only two consoles side by side; needs no Chromium")
    parser.add_argument("--visits", type=int, default=300, help="pages opened and closed")
    parser.add_argument("--blocks", type=int, default=5, help="alternating blocks of each kind")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a block")
    asked = parser.parse_args()
    if asked.quick:
        asked.visits, asked.blocks, asked.seconds = 24, 2, 3.0
    print(machine())
    if asked.two:
        side_by_side(2.0 * asked.seconds)
        return
    with tempfile.TemporaryDirectory() as name, sync_playwright() as player:
        folder = Path(name)
        for room in ROOMS:
            frames(folder / room, room)
        with served(folder / "cell") as (address, console):
            for room, nices in ROOMS.items():
                show(console, folder / room)
                if room == "dark":
                    pictures(player, address, asked.seconds)
                for nice in nices:
                    latencies(player, address, console, asked.blocks, asked.seconds, nice, room)
        with begun(folder) as (address, pid):
            visits(player, address, pid, asked.visits)
    accelerated()


def frames(folder: Path, room: str) -> None:
    """Write PAIRS pairs of a lit target that swings to and fro, raw as cameras send them, with its rig and target.

    In the dark it is followed; in the workshop one pair in ten is lost and the whole pictures are searched anew.
    """
    cell = load_cell("led-cell", seed=3, frames=PAIRS, room=room)
    there = list(cell.frames())
    for number, pair in enumerate(there + there[-2:0:-1]):
        for side, frame in zip(("left", "right"), pair, strict=True):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{number:03d}.bmp"), np.asarray(frame.image))
    for name, content in (("rig", cell.rig), ("target", cell.target)):
        text = yaml.safe_dump({"format": f"armsight/{name}", "version": 1, **content})
        (folder / f"{name}.yaml").write_text(text)


def show(console: Console, folder: Path) -> None:
    """Measure the two streams of a folder, again and again."""
    entries = {"left": "left", "right": "right", "rig": "rig.yaml", "target": "target.yaml"}
    paths = {name: str(folder / file) for name, file in entries.items()}
    console.apply(console.cell.model_copy(update={**paths, "play_again": True}))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def await_port(port: int) -> None:
    while socket.socket().connect_ex(("127.0.0.1", port)):
        time.sleep(0.05)


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, Console]]:
    """Serve a console from this process, which so sees what its station tells."""
    folder.mkdir()
    console, port = Console.of_folder(folder), free_port()
    pages = FastAPI()
    add_console(pages, console)
    server = uvicorn.Server(uvicorn.Config(pages, port=port, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        await_port(port)
        yield f"http://127.0.0.1:{port}", console
    finally:
        console.close()
        server.should_exit = True
        thread.join(20.0)


@contextmanager
def begun(folder: Path) -> Iterator[tuple[str, int]]:
    """Start the console of the simulated cell as a person does; give its address and process."""
    port = free_port()
    command = [sys.executable, "-m", "armsight", "console", "--port", str(port), "--robot", "sim:webcam-cell"]
    process = subprocess.Popen([*command, "--folder", str(folder / "robot")], stderr=subprocess.DEVNULL)
    try:
        await_port(port)
        yield f"http://127.0.0.1:{port}", process.pid
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def launched(player: Any, nice: int = 0) -> Any:
    """Return a browser of its own, nice as told."""
    script = Path(tempfile.mkdtemp()) / "chromium"
    script.write_text(f'#!/bin/sh\nexec nice -n {nice} {CHROMIUM} "$@"\n')
    script.chmod(0o755)
    return player.chromium.launch(executable_path=str(script), args=["--no-sandbox"])


def shown(page: Any, side: str) -> int:
    return int(page.evaluate(f"Number(document.querySelector('[data-testid=camera-{side}]').dataset.shown || 0)"))


def pictures(player: Any, address: str, seconds: float) -> None:
    browser = launched(player)
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto(f"{address}/live")
    page.wait_for_function("Number(document.querySelector('[data-testid=camera-right]')?.dataset.shown || 0) > 20")
    before, begun_s = {side: shown(page, side) for side in ("left", "right")}, time.monotonic()
    page.wait_for_timeout(1e3 * seconds)
    rates = {side: (shown(page, side) - before[side]) / (time.monotonic() - begun_s) for side in before}
    measured = page.inner_text("[data-testid=fps]")
    table(
        "Pictures a second of two streams of 1280x720, 30 a second (wanted: 20 in a browser)",
        ("measured by the station", "shown, left", "shown, right"),
        [(measured, f"{rates['left']:.1f}", f"{rates['right']:.1f}")],
    )
    browser.close()


def latencies(player: Any, address: str, console: Console, blocks: int, seconds: float, nice: int, room: str) -> None:
    """Print the loop's latency and measuring time without browsers and with three, block by block in turn."""
    browsers = [launched(player, nice) for _ in range(3)]
    pages = [browser.new_page(viewport={"width": 1400, "height": 900}) for browser in browsers]
    found: dict[str, list[np.ndarray]] = {"without": [], "with three": []}
    for _ in range(blocks):
        for kind, where in (("without", "about:blank"), ("with three", f"{address}/live")):
            for page in pages:
                page.goto(where)
            if kind != "without":
                for page in pages:
                    page.wait_for_function(
                        "Number(document.querySelector('[data-testid=camera-right]')?.dataset.shown || 0) > 5"
                    )
            told(console, 2.0)
            found[kind].append(told(console, seconds))
    for browser in browsers:
        browser.close()
    rows, values = [], {kind: 1e3 * np.concatenate(parts) for kind, parts in found.items()}
    for kind, ms in values.items():
        middle, late = np.median(ms, axis=0), np.percentile(ms, 99, axis=0)
        rows.append((kind, len(ms), float(middle[0]), float(late[0]), float(middle[1]), float(late[1])))
    ratios = [b / a for a, b in zip(rows[0][2:], rows[1][2:], strict=True)]
    rows.append(("ratio", "", *ratios))
    table(
        f"Measuring, {room}, browsers at nice {nice}, {blocks} blocks of {seconds:g} s in turn (p99 wanted: 1.1)",
        ("browsers on /live", "pairs", "latency median ms", "p99 ms", "measuring median ms", "p99 ms"),
        rows,
    )


def told(console: Console, seconds: float) -> np.ndarray:
    """Return (n, 2): latency and measuring time in s, as told with each pair."""
    out, last, until_s = [], None, time.monotonic() + seconds
    while time.monotonic() < until_s:
        now = console.require_station().shown
        if now is not None and now is not last:
            last = now
            out.append((now.view.latency_s, now.view.measuring_s))
        time.sleep(0.005)
    return np.array(out)


def side_by_side(seconds: float) -> None:
    """Print how long pages of none, one and two consoles take, and which share of a processor another program gets."""
    rows = []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        addresses: list[str] = []
        for n in range(3):
            if n:
                addresses.append(stack.enter_context(begun(Path(name) / str(n)))[0])
                waited(addresses, SETTLED_S)
            other = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
            begun_s = time.monotonic()
            took_ms = 1e3 * waited(addresses, seconds)
            share = busy_s(other.pid) / (time.monotonic() - begun_s)
            other.kill()
            other.wait()
            figures = [f"{f(took_ms):.0f}" for f in (np.median, np.max)] if n else ["", ""]
            rows.append((n, *figures, f"{100 * share:.0f} %"))
    table(
        f"Consoles side by side with a program that always works, {os.cpu_count()} processors, {seconds:g} s each",
        ("consoles", "GET /live median ms", "longest ms", "the program's share of a processor"),
        rows,
    )


def waited(addresses: list[str], seconds: float) -> np.ndarray:
    """Ask every console for its page LIVE_HZ times a second; return (n,) how long each took in s."""
    out, until_s = [], time.monotonic() + seconds
    while time.monotonic() < until_s:
        for address in addresses:
            begun_s = time.monotonic()
            with urlopen(f"{address}/live", timeout=60.0) as page:
                page.read()
            out.append(time.monotonic() - begun_s)
        time.sleep(1.0 / LIVE_HZ)
    return np.array(out)


def busy_s(pid: int) -> float:
    """Return the time that a process has worked, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss(pid: int) -> float:
    """Return the resident bytes of a process without its children."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def family(pid: int) -> dict[str, int]:
    """Return the processes of a console by what they do."""
    out = {"console": pid}
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            command = Path(f"/proc/{child}/cmdline").read_bytes().decode().replace("\0", " ")
            if "spawn_main" in command:
                out[f"child {len(out)}"] = int(child)
    return out


def visits(player: Any, address: str, pid: int, n: int) -> None:
    """Open and close pages; print how the processes' memory goes with it."""
    with ExitStack() as stack:
        browser = launched(player)
        stack.callback(browser.close)
        rows: list[tuple[int, float, dict[str, float]]] = []
        for visit in range(n):
            page = browser.new_page()
            page.goto(f"{address}/{PAGES[visit % len(PAGES)]}")
            page.wait_for_function("document.querySelector('[data-testid=state]')?.textContent.length > 3")
            if visit % 30 == 10:
                page.goto(f"{address}/live")
                for _ in range(2):  # a short recording
                    page.click("[data-testid=record]")
                    page.wait_for_timeout(300)
            page.close()
            rows.append((visit, time.monotonic(), {name: rss(one) for name, one in family(pid).items()}))
    warm = rows[len(rows) // 3 :]
    hours = (rows[-1][1] - rows[0][1]) / 3600.0
    out = []
    for name in rows[-1][2]:
        at = np.array([row[0] for row in warm])
        mb = np.array([row[2].get(name, np.nan) for row in warm]) / MB
        slope = float(np.polyfit(at[np.isfinite(mb)], mb[np.isfinite(mb)], 1)[0])
        first = rows[0][2].get(name, np.nan) / MB
        out.append((name, first, float(mb[0]), float(mb[-1]), 1e3 * slope, VISITS_PER_HOUR * slope))
    table(
        f"Memory over {n} pages opened and closed in {60 * hours:.1f} minutes, with recordings (a third is warm-up)",
        ("process", "start MB", "warm MB", "end MB", "kB a page", f"MB an hour at {VISITS_PER_HOUR:.0f} pages"),
        out,
    )


def accelerated() -> None:
    """Print how the console's own state grows over as many pictures and updates as hours bring."""
    console = Console(folder=Path(tempfile.mkdtemp()))
    console.station = Stream()  # type: ignore[assignment]
    n = int(HOURS * 3600 * TICK_HZ)
    for _ in range(4000):
        console.remember()
    gc.collect()
    tracemalloc.start()
    before, begun = tracemalloc.take_snapshot(), rss(os.getpid())
    for _ in range(n):
        console.remember()
    gc.collect()
    after, ended = tracemalloc.take_snapshot(), rss(os.getpid())
    grown = sorted(after.compare_to(before, "lineno"), key=lambda one: -one.size_diff)[:3]
    tracemalloc.stop()
    table(
        f"The state that pages share, over the {n} updates of {HOURS:g} hours",
        ("RSS before MB", "RSS after MB", "what grew most"),
        [(begun / MB, ended / MB, "; ".join(f"{one.traceback}: {one.size_diff / 1e3:.0f} kB" for one in grown))],
    )


class Stream:
    """Stands for a station that shows something new at every look."""

    failure, ended = "", False
    n = 0

    @property
    def shown(self) -> Snapshot:
        """A moment of a 1280x720 pair; its pictures of their usual size."""
        self.n += 1
        side = SideView(
            width=1280, height=720, spots=[], epipolar=[], advice="good", background=9.0, brightest=200.0, sigma_px=2.0
        )
        view = LiveView(
            sequence=self.n, t_s=self.n / RATE_HZ, fps=RATE_HZ, latency_s=0.01, measuring_s=0.005, status="ok", why="",
            parent="rig", xyz_m=(0.0, 0.0, 0.8), euler_rad=(0.0,) * 3, quat_xyzw=(0.0, 0.0, 0.0, 1.0),
            std=(1e-4,) * 6, residual_px=0.1, counts=Counts(ok=self.n, doubtful=0, position_only=0, lost=0),
            cameras={"left": side, "right": side},
        )  # fmt: skip
        return Snapshot(view=view, jpegs={"left": bytes(60_000), "right": bytes(60_000)})


if __name__ == "__main__":
    main()
