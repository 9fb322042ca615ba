"""Time of rendering a pair of frames on one core, and of its parts, beside the plain numpy way of the same noise.

python benchmarks/render.py [--quick]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
import yaml

import bench
from armsight_sim import Cell, LedCellOptions, Sensor, ambient, led_cell
from armsight_sim.scenario_builder import build_world
from armsight_sim.scenario_schema import Scenario

TARGETS_MS = {"dark": 8.0, "workshop, machine": 15.0, "workshop, webcam": 40.0}
"""A 1280x720 pair with six spots on one core, by room and pipeline."""

HAND = {
    "kind": "hand", "at_s": 0.0, "for_s": 1000.0, "from_m": [0.0, 0.05, 0.5], "to_m": [0.1, 0.05, 0.5], "size_m": 0.2,
}  # fmt: skip

HEXAGON_M = {
    name: (0.05 * np.cos(angle), 0.05 * np.sin(angle), 0.0)
    for name, angle in zip("ABCDEF", np.arange(6) * np.pi / 3, strict=True)
}


def six_lights(room: Any = "dark", pipeline: str = "ideal", **options: Any) -> Cell:
    """Return the webcam cell with six lights on a circle of 100 mm instead of three."""
    cell = led_cell(0, 1000, LedCellOptions(faults=False, **options), room=room, pipeline=pipeline)
    return replace(cell, lights=tuple(replace(cell.lights[0], name=n, xyz_m=xyz) for n, xyz in HEXAGON_M.items()))


def moving_rig() -> Callable[[], object]:
    """Return what takes the complex images of a mirror rig that a robot carries through a workshop."""
    text = (files("armsight_sim") / "scenarios/pachidis2005-static.yaml").read_text()
    keys = yaml.safe_load(text) | {"room": "workshop"}
    world = build_world(Scenario.model_validate(keys), frames=50)
    index = iter(range(10**9))
    return lambda: world.frame(next(index) % 50, "image")


def numpy_noise(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same sensor in plain numpy: Poisson electrons, normal read noise, rounding."""
    sensor = Sensor()
    electrons = rng.poisson(light * sensor.electrons_per_level)
    levels = electrons / sensor.electrons_per_level + sensor.read_noise_level * rng.standard_normal(
        light.shape, np.float32
    )
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    repeats = 20 if parser.parse_args().quick else 200
    cv2.setNumThreads(1)
    cells = {
        "6 point lights, 1280x720": six_lights(),
        "6 discs of 10 mm, 1280x720": six_lights(diameter_m=0.010, sigma_px=0.8),
        "6 point lights, 640x360": six_lights(width=640, height=360),
    }
    start = time.perf_counter()
    cells |= {
        "workshop, machine": six_lights(room="workshop", pipeline="machine"),
        "workshop, webcam": six_lights(room="workshop", pipeline="webcam"),
        "dark, webcam": six_lights(pipeline="webcam"),
        "workshop with a hand, webcam": six_lights(room={"preset": "workshop", "occluders": [HAND]}, pipeline="webcam"),
    }
    furnished_s = time.perf_counter() - start
    index = iter(range(10**9))
    runs = {name: (lambda cell=cell: cell.pair(next(index) % 1000)) for name, cell in cells.items()}
    runs["moving mirror rig, workshop, 768x576 image"] = moving_rig()
    light, rng = ambient(1280, 720, 9.0), np.random.default_rng(0)
    runs["noise of two frames, ours"] = lambda: (Sensor().develop(light, rng), Sensor().develop(light, rng))
    runs["noise of two frames, numpy"] = lambda: (numpy_noise(light, rng), numpy_noise(light, rng))
    wall = bench.interleaved_ms(runs, repeats)
    load = os.getloadavg()[0]
    print(f"Rendering, {bench.machine()}; {repeats} repeats, one thread; load of the machine {load:.1f}")
    rows = []
    for name, times in wall.items():
        start = time.process_time()
        for _ in range(10):
            runs[name]()
        cpu = (time.process_time() - start) * 100.0
        rows.append((name, float(np.median(times)), float(times.min()), cpu))
    bench.table("ms per pair of frames", ("what", "median", "least", "processor time"), rows)
    print(f"\nOne room furnished and lit, drawn for the cameras of three cells that stand: {furnished_s:.1f} s, once")
    medians = {name: median for name, median, _, _ in rows}
    medians["dark"] = rows[0][1]
    for name, target_ms in TARGETS_MS.items():
        verdict = "met" if medians[name] <= target_ms else "MISSED"
        print(f"1280x720 pair with six spots, {name}: {medians[name]:.2f} ms, target <= {target_ms} ms: {verdict}")


if __name__ == "__main__":
    main()
