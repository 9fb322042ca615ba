"""From the pictures of two webcams to a calibrated cell: how long it takes, and how much memory, from videos.

    python benchmarks/cell_pictures.py [--seconds 120] [--seed 1]

A cell of tests/truth/cell_world.py whose cameras run at 30 frames a second without losing any; its lights are drawn as
Gaussian spots into frames of noise, coded as videos, and the command is run on them as a user runs it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.records import Motion
from armsight.store import write_target
from armsight.store.arm_file import write_arm
from armsight.store.tracks import write_joints
from bench import machine, table, test_scene
from cell_records import arm_of, target_of

made = test_scene("cell_world")
Array = NDArray[np.float64]
SIGMA_PX, PEAK, GROUND, NOISE = 1.6, 210.0, 14.0, 2.0
REACH = 8
"""Pixels about a spot's middle that are drawn."""
GROUNDS = 16
"""Frames of noise that are used by turns: the detector does not look from frame to frame."""


def steady_cell(seed: int, seconds: float) -> Any:
    """Return the cell of a seed with cameras that lose nothing and stamp exactly."""
    world = made.make_cell(seed, seconds=seconds)
    exact = {"rate_hz": 30.0, "lost": 0.0, "jitter_s": 1e-9, "late": False}
    truth = replace(world.truth, left=replace(world.truth.left, **exact), right=replace(world.truth.right, **exact))
    begin_s = float(truth.motion.begin_s[0])
    log_t, log_q, left, right = made.record(np.random.default_rng(seed), truth, begin_s, seconds)
    return replace(world, truth=truth, log_t_s=log_t, log_q=log_q, left=left, right=right)


def draw(track: Any, file: Path, rng: np.random.Generator) -> None:
    """Write a camera's frames as a video."""
    width, height = track.size
    grounds = np.clip(rng.normal(GROUND, NOISE, (GROUNDS, height, width)), 0.0, 255.0).astype(np.uint8)
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (width, height))
    edges = np.searchsorted(track.frame, np.arange(len(track.t_s) + 1))
    at = np.arange(-REACH, REACH + 1)
    for k in range(len(track.t_s)):
        grey = grounds[k % GROUNDS].copy()
        for u, v in track.uv_px[edges[k] : edges[k + 1]]:
            x, y = round(u), round(v)
            rows = slice(max(y - REACH, 0), y + REACH + 1)
            columns = slice(max(x - REACH, 0), x + REACH + 1)
            spot = PEAK * np.exp(-((at[None, :] + x - u) ** 2 + (at[:, None] + y - v) ** 2) / (2.0 * SIGMA_PX**2))
            part = grey[rows, columns]
            top, left = max(REACH - y, 0), max(REACH - x, 0)
            spot = spot[top : top + part.shape[0], left : left + part.shape[1]]
            grey[rows, columns] = np.clip(part + spot, 0.0, 255.0).astype(np.uint8)
        writer.write(cv2.merge([grey, grey, grey]))
    writer.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print(machine())
    world = steady_cell(asked.seed, asked.seconds)
    with tempfile.TemporaryDirectory() as folder:
        cell = Path(folder)
        write_arm(cell / "arm.yaml", arm_of(world))
        write_target(cell / "target.yaml", target_of(world))
        write_joints(cell / "joints.csv", Motion(t_s=world.log_t_s, q=world.log_q))
        rng = np.random.default_rng(asked.seed)
        for side in ("left", "right"):
            draw(getattr(world, side), cell / f"{side}.mp4", rng)
        words = [sys.executable, "-m", "armsight", "calibrate", "cell", "--robot-log", "joints.csv"]
        words += ["--left", "left.mp4", "--right", "right.mp4", "--target", "target.yaml", "--model", "arm.yaml"]
        begin = time.perf_counter()
        ran = subprocess.run([*words, "-o", "out", "--json"], cwd=cell, capture_output=True, text=True, check=False)
        took_s = time.perf_counter() - begin
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        if ran.returncode:
            raise SystemExit(ran.stderr)
        got = json.loads(ran.stdout)
    frames = len(world.left.t_s) + len(world.right.t_s)
    size = " and ".join(f"{w}x{h}" for w, h in (world.left.size, world.right.size))
    head = ["pictures", "size", "s", "processor s", "peak memory, MB", "load", "verdict"]
    row = [frames, size, took_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, os.getloadavg()[0]]
    table("From two videos to the cell", head, [[*row, got["verdict"]]])


if __name__ == "__main__":
    main()
