"""Poses by one to eight cameras: error over the Cramer-Rao bound, 95 % ellipsoids, wrong poses called ok, time.

The world (tests/truth/camera_ring.py) has its own projection and bound. Six lights with 30 mm of relief at 1.3 m, focal
length 950 px, spots of 0.05 px, cameras on an arc of 115 degrees; lights are hidden from each camera at random, and
reflections lie within 80 px of the target. Times are of the processor, of spots found to a pose. Two cameras have their
own way, by which a light must be seen by both.

    python benchmarks/views.py                  # 2,000 poses a row
    python benchmarks/views.py --poses 200
    python benchmarks/views.py --rig            # with the uncertainty of the rig's calibration
    python benchmarks/views.py --times --views 2 4
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.moments import measure_moment
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.views import measure_views
from armsight.measure.settings import Pace
from armsight.ops.sources.pace import SideBySide
from armsight.records import PoseStatus
from bench import machine, table
from knocked_camera import drawn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from tests.truth import camera_ring as world
from tests.truth import test_views as scene

LIGHTS = {"discs, 10 px": 6.5, "points, 3 px": 2.0}
"""Radius of the lights in px at 1 m."""
SCENES = ((0.0, 0), (0.2, 0), (0.2, 2))
WRONG = float(chi2.isf(1e-8, 6))


def run(views: int, hidden: float, reflections: int, poses: int, seed: int) -> list[object]:
    """Return one row of the table."""
    rng, cameras = np.random.default_rng(seed), world.ring(views)
    setup = scene.setup_of(cameras)
    q: list[float] = []
    squares: list[np.ndarray] = []
    bounds: list[np.ndarray] = []
    ms: list[float] = []
    for _ in range(poses):
        T = world.pose(rng)
        seen = world.look(cameras, world.LIGHTS, T, rng, hidden=hidden, reflections=reflections)
        spots = [scene.spots(uv) for uv in seen.uv]
        start = time.process_time()
        measured: Measured = measure_spots(setup, 0.0, *spots) if views == 2 else measure_views(setup, 0.0, spots)
        ms.append(1e3 * (time.process_time() - start))
        if measured.pose.status is not PoseStatus.OK:
            continue
        sights = np.ones((len(measured.names), views), bool) if measured.sights is None else measured.sights
        shown = np.zeros((len(world.LIGHTS), views), bool)
        shown[["ABCDEF".index(name) for name in measured.names]] = sights
        q.append(scene.mahalanobis2(measured, T))
        squares.append(scene.difference(measured.pose.T_parent_target, T) ** 2)
        bounds.append(np.diag(cameras.bound(world.LIGHTS, T, shown, scene.SIGMA_PX)))
    if not q:
        return [views, hidden, reflections, 0.0, "", "", "", 0, float(np.median(ms))]
    e, b = np.array(squares), np.array(bounds)
    ratios = [float(np.sqrt((e / b)[:, part].mean())) for part in (slice(3), slice(3, 6))]
    inside = 100.0 * float((np.array(q) < chi2.ppf(0.95, 6)).mean())
    wrong = int((np.array(q) > WRONG).sum())
    return [views, hidden, reflections, 100.0 * len(q) / poses, *ratios, inside, wrong, float(np.median(ms))]


def of_rigs(views: int, poses: int) -> list[object]:
    """Return one row: poses by rig files drawn from a calibration's covariance, errors over what is claimed in all."""
    rng, cameras = np.random.default_rng(100 + views), world.ring(views)
    q: list[float] = []
    squares: list[np.ndarray] = []
    for _ in range(poses):
        setup, T = drawn(views, rng), world.pose(rng)
        seen = world.look(cameras, world.LIGHTS, T, rng, hidden=0.1)
        spots = [scene.spots(uv) for uv in seen.uv]
        measured = measure_spots(setup, 0.0, *spots) if views == 2 else measure_views(setup, 0.0, spots)
        if measured.pose.status is PoseStatus.OK:
            q.append(scene.mahalanobis2(measured, T))
            off = scene.difference(measured.pose.T_parent_target, T)
            squares.append(off**2 / np.diag(measured.pose.covariance))
    ratios = [float(np.sqrt(np.array(squares)[:, part].mean())) for part in (slice(3), slice(3, 6))]
    return [views, 100.0 * len(q) / poses, *ratios, 100.0 * float((np.array(q) < chi2.ppf(0.95, 6)).mean())]


def of_pictures(views: int, lights: str, passes: int = 30) -> list[object]:
    """Return the least times in ms of 1280x720 pictures in memory, searched as a whole and tracked.

    Of the processor on one core, then by the clock with the views side by side on two, as live pictures are.
    """
    rng, cameras = np.random.default_rng(views), world.ring(views)
    setup, T, moments = scene.setup_of(cameras), world.pose(rng, tilt_rad=0.1), []
    for number in range(6):
        T[0, 3] += 0.001
        pictures = scene.draw(cameras, T, rng, radius_px_m=LIGHTS[lights])
        moments.append([replace(one, t_s=0.01 * number, sequence=number) for one in pictures])
    row: list[object] = [views, lights]
    for pace, clock in ((Pace(), time.process_time), (Pace(each=SideBySide()), time.perf_counter)):
        least, setup = {False: np.inf, True: np.inf}, replace(setup, pace=pace)
        for _ in range(passes):
            track = None
            for frames in moments:
                start = clock()
                measured = measure_moment(setup, frames, track)
                least[measured.tracked] = min(least[measured.tracked], 1e3 * (clock() - start))
                track = measured.track
        row += [least[False], least[True]]
    return row


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=2000)
    parser.add_argument("--views", type=int, nargs="+", default=[1, 2, 3, 4, 8])
    parser.add_argument("--rig", action="store_true", help="rigs as uncertain as a calibration leaves them")
    parser.add_argument("--times", action="store_true", help="the times of pictures alone")
    args = parser.parse_args()
    print(machine())
    if args.rig:
        head = ["cameras", "ok, %", "position / claimed", "rotation / claimed", "in 95 %, %"]
        table("Poses by rigs drawn from their covariance", head, [of_rigs(v, args.poses) for v in args.views])
        return
    rows = (
        []
        if args.times
        else [run(v, *scene_, args.poses, 10 * v + i) for v in args.views for i, scene_ in enumerate(SCENES)]
    )
    head = [
        "cameras",
        "hidden",
        "reflections",
        "ok, %",
        "position / bound",
        "rotation / bound",
        "in 95 %, %",
        "wrong",
        "ms",
    ]
    table("Poses from spots without a track", head, rows)
    head = ["cameras", "lights", "whole pictures, ms", "tracked, ms", "whole, two cores, ms", "tracked, two cores, ms"]
    timed = [of_pictures(v, lights) for v in args.views for lights in LIGHTS]
    table("Time of a moment, least of many: of the processor, and by the clock on two cores", head, timed)


if __name__ == "__main__":
    main()
