"""Mirror rigs, coloured beacons, targets of unknown geometry and a long run, all in the simulator's rooms.

What benchmarks/rooms.py leaves out. The truth is the simulator's, which shares no code with detection. `--quick` takes
a seventh of the scenes; `--only NAME` runs one part: run, mirror, beacon or unknown.

    python benchmarks/rooms_simulated.py [--quick] [--only mirror]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pipeline import Setup, measure_pair, warm_up
from armsight.ops.simulation.scenarios import load_scenario
from armsight.records import CameraTiming, Frame, PoseStatus, unmeasured_target
from armsight.store import read_poses, read_rig, rig_from_mapping, target_from_mapping, write_rig, write_target
from armsight_sim import LedCellOptions, beacon_cell, led_cell
from armsight_sim.cell import Cell
from armsight_sim.scenario_builder import build_world
from armsight_sim.scene import SmoothTrajectory
from bench import machine, table
from verdicts import BEYOND, BEYOND_MM, SIDES, Array, Verdict, judge, pose_error, reason, share, spread, within

REACH_PX = 1.5
"""A spot within this of a light's centre is that light."""
ROOMS = ("workshop", "office", "plain")
PIPELINES = ("machine", "webcam")
FRAMES = 5
"""Complex images of one room: the robot carries its rig along the arc between them."""
FAR_MM = 50.0
"""A beacon's position further off than this is that of something else."""
REDDER, CLIPPED = 40.0, 200.0
"""Grey levels of light: something is red by that, and a beacon before more than this is clipped."""
FPS = 30.0

RED_THINGS = {
    "indicators": [
        {"xyz_m": [-0.30, 0.10, 1.7], "level": 170.0, "sigma_px": 2.5, "bgr": [0.05, 0.08, 1.0]},
        {"xyz_m": [0.35, -0.15, 1.9], "level": 200.0, "sigma_px": 3.0, "bgr": [0.05, 0.08, 1.0]},
    ],
    "panels": [
        {"surface": "paint", "T_room_panel": {"xyz_m": [0.1, 0.3, 2.2]}, "size_m": [0.12, 0.12],
         "colour": [0.08, 0.08, 0.8]},
    ],
}  # fmt: skip
"""Two red lamps behind the beacon, and a painted sheet as large as a hand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """One pair with a beacon: status and why, error in mm and squared over its claim (NaN: no position), time.

    alone: nothing else in the room is red, and the beacon is not before what the cameras clip.
    """

    status: str
    why: str
    mm: float
    chi2: float
    ms: float
    seed: int
    alone: bool

    @property
    def given(self) -> bool:
        """Whether there is a position."""
        return not np.isnan(self.mm)

    @property
    def wrong(self) -> bool:
        """Whether it misleads."""
        return self.given and (self.mm > FAR_MM or (self.mm > BEYOND_MM and self.chi2 > BEYOND**2))


def mirror(count: int) -> None:
    """Print what becomes of complex images of a three-light target in rooms."""
    for pipeline in PIPELINES:
        seen = [verdict for n in range(-(-count // FRAMES)) for verdict in complex_images(n, pipeline)]
        mirror_rows(f"Mirror rig, {len(seen)} complex images in rooms, {pipeline}", seen)


def complex_images(seed: int, pipeline: str) -> Iterator[tuple[int, Verdict]]:
    """Yield (seed, verdict) of complex images of one room, the rig carried along Pachidis's arc."""
    model = load_scenario("pachidis2005-circle")[0]
    keys = model.model_dump()
    keys["room"] = {"preset": ROOMS[seed % len(ROOMS)], "level": 120.0}
    keys["cameras"]["pipeline"] = {"preset": pipeline}
    world = build_world(type(model).model_validate(keys), seed=seed)
    rig, target = rig_from_mapping(world.rig, "rig"), target_from_mapping(world.target, "target")
    setup = Setup(rig, target, overlaid=True)
    for index in np.linspace(0, world.n_frames - 1, FRAMES).astype(int).tolist():
        frame = world.frame(index, "image")
        T = pose_matrix(*world.truth[index][1:])
        uv = rig.project(target.xyz_m @ T[:3, :3].T + T[:3, 3])
        lights = {(side, name): uv[s][i] for s, side in enumerate(SIDES) for i, name in enumerate(target.names)}
        yield seed, judge(setup, (frame, frame), T, lights, reach_px=REACH_PX)


def pose_matrix(xyz_m: Array, quat_xyzw: Array) -> Array:
    """Return the (4, 4) of a place and a quaternion."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    T[:3, 3] = xyz_m
    return T


def mirror_rows(title: str, seen: Sequence[tuple[int, Verdict]]) -> None:
    """Print the outcome of whole poses, the reasons of the others, and the wrong ones."""
    verdicts = [verdict for _, verdict in seen]
    ok = [verdict for verdict in verdicts if verdict.ok]
    right = [verdict for verdict in ok if not verdict.mistaken]
    ms = [verdict.ms for verdict in verdicts]
    table(
        title,
        ["lights found %", "ok %", "position only %", "refused %", "wrong", "misplaced", "pose in 95 %",
         "position in 95 %", "middle error / claim", "position mm", "ms median", "ms max"],
        [[
            share(sum(len(v.found) for v in verdicts), 6 * len(verdicts)),
            share(len(ok), len(verdicts)),
            share(sum(v.status == PoseStatus.POSITION_ONLY for v in verdicts), len(verdicts)),
            share(sum(v.status == PoseStatus.LOST for v in verdicts), len(verdicts)),
            sum(v.wrong for v in verdicts),
            sum(v.misplaced for v in verdicts),
            within([v.chi2 for v in right], 6),
            within([v.chi2_position for v in right], 3),
            spread([v.chi2 for v in right], 6),
            float(np.median([v.position_mm for v in ok])) if ok else np.nan,
            float(np.median(ms)),
            float(np.max(ms)),
        ]],
    )  # fmt: skip
    why_not([(v.status, v.why) for v in verdicts if not v.ok])
    bad = [(seed, v) for seed, v in seen if v.wrong or v.misplaced]
    if bad:
        rows = [[seed, v.status, v.position_mm, v.orientation_deg, float(np.sqrt(v.chi2)), v.place_mm]
                for seed, v in bad]  # fmt: skip
        table("Wrong ones", ["seed", "status", "mm", "deg", "sigmas", "misplaced by mm"], rows)


def why_not(told: Sequence[tuple[str, str]]) -> None:
    """Print why there was no pose, most frequent first."""
    counted = Counter((status, reason(why)) for status, why in told)
    if counted:
        table("Why not", ["status", "why", "count"], [[*key, n] for key, n in counted.most_common(8)])


def beacon(count: int) -> None:
    """Print what becomes of pairs with a red beacon in rooms, alone and among other red things."""
    for title, things, shown in (
        ("Red beacon in rooms", {}, True),
        ("Red beacon among red lamps and a red sheet: to be refused", RED_THINGS, True),
        ("The same without the beacon: to be refused", RED_THINGS, False),
        ("Rooms without a beacon: to be refused", {}, False),
    ):
        n = max(count // 4, 10) if things else count
        seen: dict[str, list[Found]] = {pipeline: [] for pipeline in PIPELINES}
        for seed in range(-(-n // FRAMES)):
            for pipeline in PIPELINES:  # of the same room, which is furnished once
                seen[pipeline] += beacon_pairs(seed, pipeline, things, shown)
        for pipeline in PIPELINES:
            beacon_rows(f"{title}, {pipeline}, {len(seen[pipeline])} pairs", seen[pipeline])
            alone = [one for one in seen[pipeline] if one.alone and not things]
            if alone:
                beacon_rows(f"Of these, {len(alone)} pairs with nothing else red and no window behind it", alone)


def beacon_pairs(seed: int, pipeline: str, things: Mapping[str, object], shown: bool) -> Iterator[Found]:
    """Yield what becomes of pairs of 1280x720 colour images of the beacon at several places in one room."""
    room = {"preset": ROOMS[seed % len(ROOMS)], **things}
    cell = beacon_cell(seed, 25 * FRAMES, width=1280, height=720, room=room, pipeline=pipeline)
    if not shown:
        cell = replace(cell, lights=tuple(replace(light, level=0.0) for light in cell.lights))
    setup = setup_of(cell)
    for index in range(0, cell.n_frames, 25):
        xyz_m = cell.truth[index][1]
        alone = shown and stands_alone(cell, setup.rig.project(xyz_m[None]))
        yield found_beacon(setup, cell.pair(index), xyz_m if shown else np.full(3, np.inf), seed, alone)


def stands_alone(cell: Cell, uv_px: Sequence[Array]) -> bool:
    """Tell of a beacon at uv_px, [side] (1, 2), whether nothing else in the noise-free light is red or outshines it."""
    for side, uv in zip(SIDES, uv_px, strict=True):
        light = cell.cameras[side].backdrop.astype(np.float64)
        u, v = np.rint(uv[0]).astype(int)
        behind = light[max(v - 12, 0) : v + 13, max(u - 12, 0) : u + 13]
        redder = light[:, :, 2] - light[:, :, :2].max(axis=2)
        if redder.max() > REDDER or behind.max() > CLIPPED:
            return False
    return True


def found_beacon(setup: Setup, frames: tuple[Frame, Frame], xyz_m: Array, seed: int, alone: bool) -> Found:
    """Measure a pair; xyz_m: where the beacon is, infinite where there is none."""
    start = time.perf_counter()
    measured = measure_pair(setup, *frames)
    ms = (time.perf_counter() - start) * 1e3
    told = partial(Found, status=str(measured.pose.status), why=measured.pose.why, ms=ms, seed=seed, alone=alone)
    if not len(measured.points):
        return told(mm=np.nan, chi2=np.nan)
    d = measured.points.xyz_m[0] - xyz_m
    if not np.isfinite(d).all():
        return told(mm=np.inf, chi2=np.inf)
    return told(
        mm=1e3 * float(np.linalg.norm(d)),
        chi2=float(d @ np.linalg.solve(measured.points.covariance_m2[0], d)),
    )


def setup_of(cell: Cell) -> Setup:
    """Return how a cell is measured."""
    return Setup(rig_from_mapping(cell.rig, "rig"), target_from_mapping(cell.target, "target"))


def beacon_rows(title: str, seen: Sequence[Found]) -> None:
    """Print the outcome of beacons."""
    given = [one for one in seen if one.given]
    right = [one.chi2 for one in given if one.mm <= FAR_MM]
    table(
        title,
        ["position found %", "wrong", "in 95 %", "middle error / claim", "mm median", "ms both, median", "ms max"],
        [[
            share(len(given), len(seen)),
            sum(one.wrong for one in seen),
            within(right, 3),
            spread(right, 3),
            float(np.median([one.mm for one in given])) if given else np.nan,
            float(np.median([one.ms for one in seen])),
            float(np.max([one.ms for one in seen])),
        ]],
    )  # fmt: skip
    why_not([(one.status, one.why) for one in seen if one not in given])
    bad = [[one.seed, one.status, one.mm, float(np.sqrt(one.chi2))] for one in seen if one.wrong]
    if bad:
        table("Wrong ones", ["seed", "status", "mm", "sigmas"], bad)


def unknown(count: int) -> None:
    """Print what is told of three lights whose arrangement is not known, in rooms and in the dark."""
    rows, told = [], []
    for room in (*ROOMS, "dark"):
        n = max(count // 4, 8)
        pairs = [unknown_pair(seed, room) for seed in range(n)]
        states = Counter(str(measured.pose.status) for measured, _ in pairs)
        wrong = sum(error > FAR_MM / 10.0 for _, error in pairs)
        rows.append([room, n, *(states[status] for status in ("ok", "position_only", "lost")), wrong])
        told += [(str(m.pose.status), m.pose.why) for m, _ in pairs if m.pose.status is not PoseStatus.OK]
    table("Three lights of unknown geometry (wrong: any light off by 5 mm)",
          ["room", "pairs", "ok", "position only", "refused", "wrong"], rows)  # fmt: skip
    why_not(told)


def unknown_pair(seed: int, room: str) -> tuple[Measured, float]:
    """Measure a pair as if nothing were known of the target; the number is its largest error of a light in mm, or 0."""
    cell = led_cell(seed, 1, LedCellOptions(faults=False, hot_pixels=0), room=room, pipeline=PIPELINES[seed % 2])
    measured = measure_pair(Setup(rig_from_mapping(cell.rig, "rig"), unmeasured_target()), *cell.pair(0))
    T = pose_matrix(*cell.truth[0][1:])
    places = np.array([light.xyz_m for light in cell.lights]) @ T[:3, :3].T + T[:3, 3]
    away = [float(np.linalg.norm(places - point, axis=1).min()) for point in measured.points.xyz_m]
    if measured.pose.status is PoseStatus.LOST:
        away = []
    return measured, 1e3 * max(away, default=0.0)


def moving_run(seconds: float) -> None:
    """Print how fast `armsight measure` follows a target that moves in a room, with its errors."""
    lights: dict[str, dict[str, Any]] = {
        "round lights": {},
        "flat lights of 10 mm, clipped": {"diameter_m": 0.010, "level": 600.0},
    }
    for title, light in lights.items():
        with tempfile.TemporaryDirectory() as name:
            cell = moving_cell(round(seconds * FPS), light)
            folder = Path(name)
            write_frames(cell, folder)
            run_rows(f"{seconds:g} s of a moving target in a workshop, webcams, {title}", cell, folder)
            smoothed_rows(f"The same with --timing free: motion over the whole run, {title}", cell, folder)


def moving_cell(frames: int, light: Mapping[str, Any]) -> Cell:
    """Return a cell whose target moves at 0.2 to 0.5 m/s all the time."""
    cell = led_cell(1, frames, LedCellOptions(fps=FPS, faults=False, **light), room="workshop", pipeline="webcam")
    circling = SmoothTrajectory(
        centre_m=np.array([0.06, 0.0, 0.80]),
        tilt=Rotation.identity(),
        swing_m=np.array([0.13, 0.08, 0.07]),
        swing_rad=np.array([0.26, 0.26, 0.40]),
        period_s=np.array([2.4, 2.4, 3.1, 3.7, 4.7, 6.1]),
        phase_rad=np.array([0.0, 0.5 * np.pi, 1.0, 2.0, 3.0, 4.0]),
    )
    return replace(cell, path=circling)


def write_frames(cell: Cell, folder: Path) -> None:
    """Write the images as a camera's JPEG would be stored (quality 95), rig and target."""
    write_rig(folder / "rig.yaml", rig_from_mapping(cell.rig, "rig"))
    write_target(folder / "target.yaml", target_from_mapping(cell.target, "target"))
    for side in SIDES:
        (folder / side).mkdir()
    for pair in cell.frames():
        for side, frame in zip(SIDES, pair, strict=True):
            write_image(folder / side / f"{frame.sequence:06d}.jpg", frame)


def write_image(path: Path, frame: Frame) -> None:
    """Write one image."""
    if not cv2.imwrite(str(path), np.asarray(frame.image), [cv2.IMWRITE_JPEG_QUALITY, 95]):
        raise SystemExit(f"{path} could not be written")


def run_rows(title: str, cell: Cell, folder: Path) -> None:
    """Run the command on the folder and print its pace, its share of tracked pairs and its errors."""
    command(folder, folder / "start", ["--frames", "5"])
    start_s, _ = command(folder, folder / "start", ["--frames", "5", "--overwrite"])
    seconds, summary = command(folder, folder / "out", [])
    errors = pose_errors(cell, folder / "out")
    tracked, cpu_ms = tracked_share(cell, folder)
    n = cell.n_frames
    far = [one for one in errors if one[0] > 5.0 or one[1] > 5.0 or (one[0] > BEYOND_MM and one[2] > BEYOND**2)]
    table(
        title,
        ["", "value"],
        [
            ["pairs a second, start and report included", n / seconds],
            ["pairs a second without the start", (n - 5) / max(seconds - start_s, 1e-9)],
            ["ms a pair, median / p99 (wall)", slashed([summary["ms_per_frame"][k] for k in ("median", "p99")])],
            ["tracked %", share(tracked, n)],
            ["processor time of a tracked pair, ms, median / p99", slashed(np.percentile(cpu_ms, [50, 99]))],
            ["ok %", share(summary["n_ok"], n)],
            ["wrong", sum(q > BEYOND**2 for _, _, q, _ in far)],
            ["far off, and within its claim", sum(q <= BEYOND**2 for _, _, q, _ in far)],
            ["pose in 95 %", within([q for _, _, q, _ in errors], 6)],
            ["position in 95 %", within([q for _, _, _, q in errors], 3)],
            ["middle error / claim", spread([q for _, _, q, _ in errors], 6)],
            ["position mm, median / p99", slashed(np.percentile([mm for mm, *_ in errors], [50, 99]))],
        ],
    )  # fmt: skip


def smoothed_rows(title: str, cell: Cell, folder: Path) -> None:
    """Measure the folder as views of a motion, both cameras on one clock, and print the errors."""
    rig = read_rig(folder / "rig.yaml")
    write_rig(folder / "rig.yaml", replace(rig, timing=(CameraTiming(), CameraTiming())))
    seconds, summary = command(folder, folder / "smoothed", ["--timing", "free"])
    errors = pose_errors(cell, folder / "smoothed")
    far = [one for one in errors if one[0] > 5.0 or one[1] > 5.0 or (one[0] > BEYOND_MM and one[2] > BEYOND**2)]
    table(
        title,
        ["", "value"],
        [
            ["pairs a second, start, second reading and report included", cell.n_frames / seconds],
            ["ok %", share(summary["n_ok"], cell.n_frames)],
            ["found anew", summary["timing"]["n_starts"] - 1],
            ["wrong", sum(q > BEYOND**2 for _, _, q, _ in far)],
            ["far off, and within its claim", sum(q <= BEYOND**2 for _, _, q, _ in far)],
            ["pose in 95 % (axes as independent)", within([q for _, _, q, _ in errors], 6)],
            ["position mm, median / p99", slashed(np.percentile([mm for mm, *_ in errors], [50, 99]))],
            ["orientation deg, median / largest", slashed(np.percentile([deg for _, deg, *_ in errors], [50, 100]))],
        ],
    )


def slashed(values: Sequence[float] | Array) -> str:
    """Return numbers with a source between them."""
    return " / ".join(f"{value:.3f}" for value in values)


def command(folder: Path, out: Path, more: Sequence[str]) -> tuple[float, dict[str, Any]]:
    """Run armsight measure; return its seconds and what it says."""
    words = ["measure", "--rig", str(folder / "rig.yaml"), "--target", str(folder / "target.yaml"), "--left",
             str(folder / "left"), "--right", str(folder / "right"), "--fps", f"{FPS:g}", "-o", str(out), "--json",
             *more]  # fmt: skip
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", "from armsight.cli import main; main()", *words],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    seconds = time.perf_counter() - start
    if done.returncode:
        raise SystemExit(f"armsight measure failed: {done.stderr}")
    return seconds, json.loads(done.stdout)


def pose_errors(cell: Cell, out: Path) -> list[tuple[float, float, float, float]]:
    """Return (mm, deg, squared error over its claim of pose and of position) of every whole pose of a run."""
    found = []
    truth = {round(t_s * FPS): pose_matrix(xyz, quat) for t_s, xyz, quat in cell.truth}
    for row in read_poses(out / "poses.csv"):
        if row.pose is None or row.covariance is None or row.status is not PoseStatus.OK:
            continue
        C = np.asarray(row.covariance)
        d = pose_error(row.pose.as_matrix(), truth[round(row.t_s * FPS)])
        found.append((1e3 * float(np.linalg.norm(d[:3])), float(np.rad2deg(np.linalg.norm(d[3:]))),
                      float(d @ np.linalg.solve(C, d)), float(d[:3] @ np.linalg.solve(C[:3, :3], d[:3]))))  # fmt: skip
    return found


def tracked_share(cell: Cell, folder: Path) -> tuple[int, Array]:
    """Return how many of the folder's pairs are followed in windows, and the processor time in ms of each of those."""
    setup, track, times = setup_of(cell), None, []
    for number in range(cell.n_frames):
        pair = [read_frame(folder / side / f"{number:06d}.jpg", number) for side in SIDES]
        start = time.process_time()
        measured = measure_pair(setup, pair[0], pair[1], track)
        ms = (time.process_time() - start) * 1e3
        track = measured.track
        if measured.tracked:
            times.append(ms)
    return len(times), np.array(times)


def read_frame(path: Path, number: int) -> Frame:
    """Read one image."""
    image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
    return Frame(image=image, t_s=number / FPS, sequence=number, source=path.parent.name)


def main() -> None:
    parts: dict[str, tuple[Callable[..., None], float, float]] = {
        "run": (moving_run, 60.0, 5.0),
        "mirror": (mirror, 200, 30),
        "beacon": (beacon, 200, 30),
        "unknown": (unknown, 200, 30),
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="30 scenes in place of 200, 5 s in place of 60")
    parser.add_argument("--only", choices=parts)
    options = parser.parse_args()
    warm_up()
    print(machine())
    for name, (part, whole, quick) in parts.items():
        if options.only in (None, name):
            part(quick if options.quick else whole)


if __name__ == "__main__":
    main()
