"""A waved target before one to four cameras that no wire joins: each view at its own time, beside nearest frames.

The world is that of tests/truth/test_free_cameras.py: 0.35 m/s, delays to 11 ms, rates of 25 to 50 Hz, rolling shutters
of 12 ms, spots of 0.05 px of which 15 % are hidden, clocks known to 0.1 ms. Nearest frames: one moment each, without
their times.

    python benchmarks/free_cameras.py              # 4 recordings of 5 s a row
    python benchmarks/free_cameras.py --runs 10
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.views import measure_views
from armsight.records import PoseStatus
from bench import machine, table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from tests.truth import test_free_cameras as free
from tests.truth import test_views as scene


def nearest(views: int, seed: int) -> np.ndarray:
    """Return the errors (n, 6) of moments of the frames nearest to the first camera's by their own stamps."""
    rng, world = np.random.default_rng(seed), free.ring(views)
    motion = free.Waved(rng.uniform(0.0, 2.0 * np.pi, 6))
    setup = free.timed(scene.setup_of(world), np.zeros(views))
    rng.normal(0.0, 1e-4, views - 1)
    seen = [list(one.read()) for one in free.streams(world, rng, motion)]
    out = []
    for frame in seen[0]:
        near = [min(one, key=lambda other: abs(other.t_s - frame.t_s)).spots for one in seen]
        measured = measure_spots(setup, frame.t_s, *near) if views == 2 else measure_views(setup, frame.t_s, near)
        if measured.pose.status is PoseStatus.OK:
            out.append(scene.difference(measured.pose.T_parent_target, motion.pose(frame.t_s)))
    return np.array(out).reshape(-1, 6)


def row(views: int, runs: int) -> list[object]:
    """Return a row of the table: errors and claims of all runs of a number of cameras."""
    d, q, delays, other = [], [], [], []
    for seed in range(runs):
        done, motion = free.run(views, seed)
        errors, squares = free.errors(done, motion)
        d.append(errors)
        q.append(squares)
        other.append(nearest(views, seed))
        for k, clock in enumerate((done.figures.by_camera or {}).values()):
            if k and clock.delay_std_s:
                delays.append(1e6 * (clock.delay_s + 2.5e-6 * (clock.drift_ppm - free.DRIFTS[k]) - free.DELAYS[k]))
    all_d, all_q, all_other = np.concatenate(d), np.concatenate(q), np.concatenate(other)
    n = 150.0 * runs

    def rms(errors: np.ndarray) -> tuple[float, float]:
        mm = 1e3 * float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1)))) if len(errors) else float("nan")
        return mm, float(np.degrees(np.sqrt(np.mean(np.sum(errors[:, 3:] ** 2, axis=1))))) if len(errors) else mm

    late = float(np.sqrt(np.mean(np.square(delays)))) if delays else ""
    inside = 100.0 * float(np.mean(all_q < chi2.ppf(0.95, 6)))
    return [
        views,
        100.0 * len(all_d) / n,
        *rms(all_d),
        inside,
        late,
        100.0 * len(all_other) / n,
        *rms(all_other),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--views", type=int, nargs="+", default=[1, 2, 3, 4])
    args = parser.parse_args()
    print(machine())
    head = ["cameras", "ok, %", "mm RMS", "degrees RMS", "in 95 %, %", "delays, us RMS"]
    head += ["nearest: ok, %", "mm RMS", "degrees RMS"]
    table("Poses of a waved target", head, [row(v, args.runs) for v in args.views])


if __name__ == "__main__":
    main()
