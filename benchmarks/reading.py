"""armsight measure on videos, PNG pairs and recordings: its time beside that of reading their pictures alone.

    python benchmarks/reading.py [video] [png] [mcap] [batch] [--minutes 10] [--pairs 300] [--repeats 3] [--scene CELL]

The pictures are a simulated cell's, 1280x720, there and back. "Alone" is a process that reads both cameras side by side
and keeps nothing: OpenCV in a thread for each video, and in one for each core for image files and messages. Both run in
turn from the start of a process to its end, so that a busy machine hits both alike; the ratio is the median of each
turn's. H.264 is coded by ffmpeg, on PATH or of the package imageio-ffmpeg; where the package av is there, its decoder
is timed too. batch: four videos of a quarter of the minutes by `armsight batch`, beside reading them, one a core.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import NamedTuple

from bench import machine, table

FPS, DISTINCT, CRF, JOBS = 30, 150, 18, 4
SIDES = ("left", "right")
KINDS = ("video", "png", "mcap", "batch")
ARMSIGHT = (sys.executable, "-c", "from armsight.cli import main; main()")
START = "import os, sys; from collections import deque; from concurrent.futures import ThreadPoolExecutor; import cv2\n"
VIDEO = """
def read(path):
    video = cv2.VideoCapture(path)
    while video.read()[0]:
        pass
with ThreadPoolExecutor(2) as pool:
    deque(pool.map(read, sys.argv[1:]), 0)
"""
AV = """
import av
def read(path):
    with av.open(path) as video:
        video.streams.video[0].thread_type = "AUTO"
        deque((frame.to_ndarray(format="bgr24") for frame in video.decode(video=0)), 0)
with ThreadPoolExecutor(2) as pool:
    deque(pool.map(read, sys.argv[1:]), 0)
"""
PNG = """
folders = [sorted(os.scandir(one), key=lambda it: it.name) for one in sys.argv[1:]]
with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
    files = (file.path for pair in zip(*folders) for file in pair)
    deque(pool.map(lambda file: cv2.imread(file, cv2.IMREAD_GRAYSCALE).size, files), 0)
"""
MCAP = """
import numpy as np
from mcap.reader import make_reader
def read(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8)[data.index(b"\\x89PNG"):], cv2.IMREAD_UNCHANGED).size
with open(sys.argv[1], "rb") as file, ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
    messages = (m.data for _, channel, m in make_reader(file).iter_messages() if channel.topic.endswith("/image"))
    for first in messages:
        deque(pool.map(read, [first, *(data for _, data in zip(range(31), messages))]), 0)
"""


class Run(NamedTuple):
    """A process from its start to its end: its time, its processor time, its most memory in MB."""

    wall_s: float
    cpu_s: float
    most_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="kind", help=f"{', '.join(KINDS)}; all where none is named")
    parser.add_argument("--minutes", type=float, default=10.0, help=f"of video, {FPS} frames a second")
    parser.add_argument("--pairs", type=int, default=300, help="of image files and of the recording")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--scene", default="webcam-cell")
    compare(parser.parse_args())


def compare(options: argparse.Namespace) -> None:
    """Print the table of the kinds that are named in it, of all where none is."""
    kinds = options.kinds or KINDS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(*ARMSIGHT, "simulate", options.scene, "--frames", str(DISTINCT), "-o", str(folder / "cell"))
        print(machine(), f"; {options.scene}; processes running {os.getloadavg()[0]:.1f}", sep="")
        rows = [row for kind in kinds for row in rows_of(kind, folder, options)]
    head = ["", "pairs", "alone, s", "measure, s", "ratio", "processor time alone, s", "measure, s", "ratio", "most MB"]
    table(f"armsight measure beside reading alone, medians of {options.repeats}", head, rows)


def rows_of(kind: str, folder: Path, options: argparse.Namespace) -> list[list[object]]:
    """Return the rows of a kind of source."""
    cell, out = folder / "cell", folder / "out"
    setup = ["--rig", str(cell / "rig.yaml"), "--target", str(cell / "target.yaml")]
    n = int(60 * FPS * options.minutes) if kind == "video" else options.pairs
    if kind == "video":
        sources = [video(folder, side, n, f"{side}.mp4") for side in SIDES]
        alone = {"video": VIDEO} | ({"video, av for OpenCV": AV} if find_spec("av") else {})
    elif kind == "png":
        sources, alone = [pictures(folder, side, n) for side in SIDES], {"png": PNG}
    elif kind == "mcap":
        both = folder / "both.mcap"
        given = [word for side in SIDES for word in (f"--{side}", pictures(folder, side, n))]
        run(*ARMSIGHT, "record", *given, "--fps", str(FPS), "-o", str(both), "--overwrite")
        sources, alone = [str(both)], {"mcap": MCAP}
    else:
        n = int(15 * FPS * options.minutes)
        sources, alone = [video(folder, side, n, f"short-{side}.mp4") for side in SIDES], {"batch": VIDEO}
    given = [word for side, one in zip(SIDES, sources, strict=False) for word in (f"--{side}", one)]
    words = ["measure", *setup, *given, "-o", str(out), "--overwrite"]
    if kind == "batch":
        jobs = folder / "jobs.csv"
        words = ["batch", str(jobs), "-o", str(out), "--overwrite"]
        row = ",".join(["measure", *setup[1::2], *given[1::2]])
        jobs.write_text("name,command,rig,target,left,right\n" + "".join(f"j{k},{row}\n" for k in range(JOBS)))
        sources, n = sources * JOBS, n * JOBS
    run(*ARMSIGHT, "measure", *setup, *given, "--frames", "3", "-o", str(folder / "warm"), "--overwrite")
    turns = [
        [run(*ARMSIGHT, *words), *(run(sys.executable, "-c", START + code, *sources) for code in alone.values())]
        for _ in range(options.repeats)
    ]
    return [[name, n, *compared([(turn[k], turn[0]) for turn in turns])] for k, name in enumerate(alone, start=1)]


def compared(turns: list[tuple[Run, Run]]) -> list[object]:
    """Return the medians of reading alone and of measuring, and of their ratios turn by turn."""
    found: list[object] = []
    for k in range(2):  # wall, then processor time
        found += [median(alone[k] for alone, _ in turns), median(whole[k] for _, whole in turns)]
        found.append(median(whole[k] / alone[k] for alone, whole in turns))
    return [*found, max(whole.most_mb for _, whole in turns)]


def run(*words: str) -> Run:
    """Run a program to its end; its children that it has waited for count."""
    start_s = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    said = process.stderr.read() if process.stderr else b""
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(said.decode()[-2000:])
    return Run(time.perf_counter() - start_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)


def there_and_back(n: int) -> list[int]:
    """Return which picture each of n is."""
    period = [*range(DISTINCT), *range(DISTINCT - 2, 0, -1)]
    return [period[k % len(period)] for k in range(n)]


def video(folder: Path, side: str, n: int, name: str) -> str:
    """Write n frames as H.264: those of one way there and back are coded, and repeated as they are."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        import imageio_ffmpeg

        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    once, path = folder / f"once-{side}.mp4", folder / name
    quiet = (ffmpeg, "-v", "error", "-y")
    if not once.exists():
        there = ("-framerate", str(FPS), "-i", str(folder / "cell" / side / "%06d.png"))
        back = "[0:v]split[a][b];[b]reverse,trim=start_frame=1[r];[a][r]concat"
        coded = ("-c:v", "libx264", "-crf", str(CRF), "-g", str(FPS), "-pix_fmt", "yuv420p")
        run(*quiet, *there, "-filter_complex", back, *coded, str(once))
    run(*quiet, "-stream_loop", "-1", "-i", str(once), "-c", "copy", "-frames:v", str(n), str(path))
    return str(path)


def pictures(folder: Path, side: str, n: int) -> str:
    """Return a folder of n PNG files: links, so that each is opened and decoded."""
    out = folder / side
    if out.exists():
        return str(out)
    out.mkdir()
    for index, original in enumerate(there_and_back(n)):
        os.link(folder / "cell" / side / f"{original:06d}.png", out / f"{index:06d}.png")
    return str(out)


if __name__ == "__main__":
    main()
