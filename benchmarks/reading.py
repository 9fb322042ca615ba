"""armsight measure on videos, PNG pairs, recordings and bags: its time beside that of reading their pictures alone.

    python benchmarks/reading.py [video] [png] [mcap] [bag] [--minutes 10] [--pairs 300] [--repeats 3] [--batch 4]

The pictures are those of a simulated cell, 1280x720, there and back. Alone: a process that reads both cameras side by
side and keeps nothing: OpenCV in a thread for each video, in one for each core for image files, recordings and bags.
Both are run in turn, from the start of their process to its end, so that a busy machine hits both alike. --minutes: of
video at 30 frames a second; H.264 is coded by ffmpeg, found on PATH or in the package imageio-ffmpeg. Where the package
av is there, its decoder is timed beside OpenCV's. --batch: so many short videos by `armsight batch`, beside reading
them one a core.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np

from bench import machine, table

FPS, DISTINCT, SIZE = 30, 150, (1280, 720)
SIDES = ("left", "right")
KINDS = ("video", "png", "mcap", "bag")
ARMSIGHT = (sys.executable, "-c", "from armsight.cli import main; main()")
HEAD = "import sys, threading; from concurrent.futures import ThreadPoolExecutor\n"
ALONE = {
    "video": """
import cv2
def read(path):
    video = cv2.VideoCapture(path)
    while video.read()[0]:
        pass
with ThreadPoolExecutor(len(sys.argv) - 1) as pool:
    list(pool.map(read, sys.argv[1:]))
""",
    "av": """
import av
def read(path):
    with av.open(path) as video:
        video.streams.video[0].thread_type = "AUTO"
        for frame in video.decode(video=0):
            frame.to_ndarray(format="bgr24")
with ThreadPoolExecutor(len(sys.argv) - 1) as pool:
    list(pool.map(read, sys.argv[1:]))
""",
    "png": """
import cv2, glob, os
from collections import deque
with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
    files = [file for both in zip(*(sorted(glob.glob(f"{folder}/*.png")) for folder in sys.argv[1:])) for file in both]
    deque(pool.map(lambda file: cv2.imread(file, cv2.IMREAD_GRAYSCALE).size, files), 0)
""",
    "mcap": """
import cv2, numpy as np, os
from mcap.reader import make_reader
from armsight.store.recording.images import decode
from armsight.drivers import ordered_map
with open(sys.argv[1], "rb") as file:
    read = ((one.name, message.data) for one, channel, message in make_reader(file).iter_messages()
            if channel.topic.endswith("/image"))
    for image in ordered_map(lambda it: decode(it[0], memoryview(it[1]), ""), read):
        pass
""",
}
"""What reads the pictures of each kind and nothing else."""


class Run(NamedTuple):
    """A process from its start to its end."""

    wall_s: float
    cpu_s: float
    most_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], help="all where none is named")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--pairs", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--batch", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command("simulate", "hand-cell", "--frames", str(DISTINCT), "-o", str(folder / "cell"))
        print(machine())
        rows = [
            row
            for kind in options.kinds or KINDS
            for row in compared(folder, kind, options)
        ]
    table(
        f"armsight measure beside reading alone, 1280x720, medians of {options.repeats}",
        ["", "pairs", "alone, s", "measure, s", "ratio", "processor alone, s", "measure", "ratio", "most MB", "first half"],
        rows,
    )


def compared(folder: Path, kind: str, options: argparse.Namespace) -> list[list[object]]:
    """Return the rows of a kind of source."""
