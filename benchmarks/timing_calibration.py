"""Timing of two free-running cameras from a waved target: errors, claims, how often 95 % intervals hold, and time.

Run with --quick for a tenth of the runs, --many for rigs of 3, 4 and 7 cameras alone. A target of three lights (or one
beacon) is waved irregularly at 0.5 m/s, RMS, 0.8 m before 1280x720 cameras (f = 950 px) for 15 s; spots have 0.05 px,
2 % of the frames are lost, stamps jitter. The delay's error is that in the middle of the recording. The recordings are
made in tests/truth/test_timing_calibration.py; of more cameras, with delays of -120 to 30 ms, rates of 24 to 60 Hz,
stamps that jitter by 1 ms and one light at 1.3 m, in tests/truth/test_clocks.py.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

import bench
from armsight.calibrate.timing import calibrate_timing
from armsight.errors import DataRefused
from armsight.units import MS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    parser.add_argument("--many", action="store_true", help="rigs of more cameras alone")
    asked = parser.parse_args()
    runs = 20 if asked.quick else 200
    print(bench.machine())
    if not asked.many:
        two_cameras(runs)
    many_cameras(runs)


def many_cameras(runs: int) -> None:
    """Print errors and claims of the clocks of 3, 4 and 7 cameras."""
    made = bench.test_scene("test_clocks")
    rows = []
    for views in (3, 4, 7):
        wave, late, z, left_out, begin = made.Wave(views=views, seconds=10.0), [], [], [], time.process_time()
        for seed in range(runs):
            found = made.calibrate_clocks(*made.recorded(wave, 1000 + seed))
            e, s = made.off(wave, found)
            late.append(e[: views - 1])
            z.append((e / s)[: views - 1])
            left_out += [one.left_out_px for one in found.clocks.values()]
        took_s = (time.process_time() - begin) / runs
        e = np.abs(late) / MS
        rms = float(np.sqrt(np.mean(np.square(z))))
        rows.append(
            [views, *map(float, (np.median(e), np.percentile(e, 95), e.max(), 100.0 * np.mean(np.abs(z) < 1.96), rms))]
        )
        rows[-1] += [float(np.median(left_out)), took_s]
    head = ["cameras", "median, ms", "95th percentile", "largest", "in 95 %, %", "RMS of error over claim"]
    bench.table(f"Delays of several cameras, {runs} runs of 10 s", [*head, "left out, px", "CPU s a run"], rows)


def two_cameras(runs: int) -> None:
    """Print errors and claims of pairs."""
    made = bench.test_scene("test_timing_calibration")
    base = made.Truth(jitter_s=(1e-3, 5e-4), drift_ppm=80.0)
    cases = {
        "30 and 30": replace(base, delay_s=3.217),
        "25 and 50": replace(base, rates=(25.0, 50.0), readout_s=(0.03, 0.012), delay_s=-7.3),
        "29.97 and 60, left global": replace(base, rates=(29.97, 60.0), readout_s=(0.0, 0.014), delay_s=0.4),
        "30 and 30, no jitter": replace(base, jitter_s=(0.0, 0.0)),
        "30 and 30, 0.2 m/s": replace(base, speed=0.2),
        "30 and 30, one beacon, right camera on its side": replace(
            base, lights=1, portrait=True, baseline_m=0.3, turned_rad=0.3
        ),
        "30 and 30, one beacon, parallel cameras": replace(base, lights=1),
    }
    errors, holds = [], []
    for name, truth in cases.items():
        off, claims, refused, lost, begin = [], [], 0, 0, time.perf_counter()
        for seed in range(runs):
            rig, left, right = made.record(truth, np.random.default_rng(seed))
            try:
                found = calibrate_timing(rig, left, right, made.PLACES)
            except DataRefused:
                refused += 1
                continue
            e, s = made.off(truth, found)
            off.append(e)
            claims.append(s)
            frames = [int(truth.seconds * rate) for rate in truth.rates]
            lost += found.lost == (frames[0] - len(left), frames[1] - len(right))
        took_s = (time.perf_counter() - begin) / runs
        e, s = np.abs(off), np.array(claims)
        unit = np.array([MS, 1.0, MS, MS])
        p95 = np.percentile(e, 95, axis=0) / unit
        errors.append([name, *(float(x) for x in np.median(e, axis=0) / unit), *(float(x) for x in p95), took_s])
        inside = 100.0 * np.mean(e < 1.96 * s, axis=0)
        holds.append([name, *(float(x) for x in inside), f"{lost} of {runs - refused}", refused])
    figures = ["delay ms", "drift ppm", "left read-out ms", "right read-out ms"]
    head = ["rates, Hz", *(f"{f}, median" for f in figures), *(f"{f}, 95th percentile" for f in figures), "s a run"]
    bench.table(f"Absolute errors, {runs} runs of 15 s", head, errors)
    head = ["rates, Hz", *figures, "lost frames counted right", "refused"]
    bench.table("How often 95 % intervals hold, %", head, holds)


if __name__ == "__main__":
    main()
