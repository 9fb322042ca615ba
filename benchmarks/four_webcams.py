"""Four webcams that nothing triggers: the board's corners left out by blocks of time, beside other programs.

    python benchmarks/four_webcams.py [DATA] [--peers PYTHON ...]
    python benchmarks/four_webcams.py --drawn 40

DATA: a folder with NAME.npz, NAME.lenses.toml and NAME.timestamps.csv of two sessions (corners of caliscope's own test
films, BSD-2-Clause). Lenses are held as given there. One judge for all: the cameras' places, and the delays where a
program finds any, are held, and the pose of each board that was left out is fitted by all views of it; RMS of one
coordinate, px, over every corner. --peers: interpreters of environments in which caliscope, aniposelib, multical or
OpenCV 5 are installed; what cannot be imported there is skipped and said.

--drawn: so many sets each of four cameras that OpenCV projects (tests/truth): a plate with two prints between cameras
on opposite sides, a crown of lights that is waved, a film of a waved board by rolling shutters. Errors over the
Cramer-Rao bound (RMS of all numbers over their bounds), the share of numbers within their 95 % interval and of sets
within the 95 % ellipsoid, and processor seconds.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import time
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats.distributions import chi2 as chi2_of

import bench
from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.bundle_adjustment import (
    Bundle,
    adjust,
    delays_of,
    names_of,
    readouts_of,
    residuals_px,
)
from armsight.calibrate.cameras.graph import boards_of
from armsight.calibrate.cameras.many import each_alone, solve_cameras
from armsight.calibrate.cameras.observations import pack
from armsight.calibrate.cameras.pairing import as_pose
from armsight.calibrate.cameras.preconditions import KnownLens
from armsight.calibrate.cameras.two_sides import TwoSided
from armsight.optics import Camera
from armsight.records import BoardView, spot_target
from armsight.store.targets import parse_board

DATA = bench.DATA / "four_webcams"
BOARD = parse_board("charuco:4x5:0.054:0.0405:DICT_4X4_1000")
SESSIONS = ("post_optimization", "charuco_calibration")
BLOCKS, LEAST = 5, 6
PEERS = {"caliscope": "caliscope", "aniposelib": "aniposelib", "multical": "multical", "opencv": "cv2"}
"""Programs, and the module that each is; multical takes its own detections alone, from pictures."""
BEFORE = {
    "opencv": ("1.17", "-", "0.92", "-"),
    "multical": ("1.14", "-", "-", "-"),
    "caliscope": ("1.11", "-", "0.92", "-"),
    "aniposelib": ("1.32", "-", "1.03", "-"),
}
"""All corners in the fit; measured on these corners with these lenses in 2026: OpenCV 5.1 by whole boards, multical
0.4.0, caliscope 0.11.8, aniposelib 0.8.0."""


def read(
    folder: Path, name: str
) -> tuple[dict[str, list[BoardView | None]], dict[str, KnownLens], dict[str, list[float]]]:
    """Return the views, lenses and times of one session; moments with stamps that two cameras see at least."""
    uv = np.load(folder / f"{name}.npz")["cv"]
    with (folder / f"{name}.lenses.toml").open("rb") as file:
        given = tomllib.load(file)["cameras"]
    lenses = {}
    for c in range(4):
        K, d = given[str(c)]["matrix"], given[str(c)]["distortions"]
        camera = Camera.pinhole(*given[str(c)]["size"], K[0][0], K[1][1], K[0][2], K[1][2], distortion=d)
        lenses[f"cam{c}"] = KnownLens(camera=camera)
    stamps: dict[int, dict[int, float]] = defaultdict(dict)
    with (folder / f"{name}.timestamps.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            stamps[int(row["sync_index"])][int(row["cam_id"])] = float(row["frame_time"])
    t_s = np.array([[stamps[k].get(c, np.nan) for c in range(4)] for k in sorted(stamps)])
    t_s -= np.nanmin(t_s)
    seen = np.isfinite(uv[: len(t_s), ..., 0])
    whole = seen.sum(axis=2) >= LEAST
    kept = np.flatnonzero(whole.sum(axis=1) >= 2)
    views = {
        f"cam{c}": [
            BoardView(
                uv_px=uv[g, c, seen[g, c]],
                index=np.flatnonzero(seen[g, c]),
                sigma_px=0.1,
                width=lenses[f"cam{c}"].camera.width,
                height=lenses[f"cam{c}"].camera.height,
                source=f"{c}/{g}",
            )
            if whole[g, c]
            else None
            for g in kept
        ]
        for c in range(4)
    }
    return views, lenses, {f"cam{c}": t_s[kept, c].tolist() for c in range(4)}


def judged(views: dict, lenses: dict, times: dict, sides: np.ndarray, delays_s: np.ndarray | None) -> np.ndarray:
    """Return the residuals (m,) px of all corners, the cameras held, the boards' poses fitted.

    delays_s: None takes the board as still for each moment.
    """
    options = BoardOptions()
    kinds = tuple(lens.camera.lens for lens in lenses.values())
    seen = replace(pack(list(views.values()), BOARD, kinds, tuple(views)), t_s=np.array(list(times.values())).T)
    poses, k, _ = each_alone(seen, options, lenses)
    T = [RigidTransform.identity(), *map(as_pose, sides)]
    _, _, boards = boards_of(poses, np.eye(3)[None], T)  # what does not agree stays in: it is to be judged
    t_s = None if delays_s is None else seen.t_s
    state = Bundle(k=k, sides=sides, poses=boards, delays_s=np.zeros(0) if delays_s is None else delays_s)
    seen = replace(seen, t_s=t_s, known=None)
    fit = adjust(seen, state, frozenset(names_of(seen)), max_iterations=200)
    return residuals_px(seen, fit)[seen.weight > 0.0].ravel()


def taken(each: dict[str, list], at: np.ndarray) -> dict[str, list]:
    """Return some of the moments."""
    return {name: [one[g] for g in at] for name, one in each.items()}


def rms(residual: np.ndarray) -> float:
    """Return the RMS of one coordinate, px."""
    return float(np.sqrt(np.mean(residual**2)))


def blocks(n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the moments that stay and those left out, for each block of time."""
    parts = np.array_split(np.arange(n), BLOCKS)
    return [(np.setdiff1d(np.arange(n), out), out) for out in parts]


def armsight(views: dict, lenses: dict, times: dict, timed: bool) -> tuple[float, float, np.ndarray, float]:
    """Return RMS in the fit and left out, px, the delays, ms, and seconds for one calibration."""
    options = BoardOptions(folds=0)

    def solved(at: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        stamps = taken(times, at) if timed else None
        done = solve_cameras(taken(views, at), BOARD, options, lenses=lenses, times_s=stamps)
        return done.state.sides, done.delays_s[1:] if timed else None

    n = len(views["cam0"])
    started = time.process_time()
    found = solved(np.arange(n))
    took = time.process_time() - started
    left = [judged(taken(views, out), lenses, taken(times, out), *solved(stay)) for stay, out in blocks(n)]
    own = rms(judged(views, lenses, times, *found))
    return own, rms(np.concatenate(left)), 1e3 * (found[1] if found[1] is not None else np.zeros(3)), took


def peer(python: str, name: str, views: dict, lenses: dict, at: np.ndarray) -> np.ndarray | str:
    """Return T_first_camera (3, 6) that a program finds, or why there is none."""
    sent = {
        "X": BOARD.xyz_m.tolist(),
        "K": [lens.camera.matrix.tolist() for lens in lenses.values()],
        "d": [lens.camera.distortion.tolist() for lens in lenses.values()],
        "size": [lens.camera.width for lens in lenses.values()][:1]
        + [lens.camera.height for lens in lenses.values()][:1],
        "views": [
            [None if one is None else [one.index.tolist(), one.uv_px.tolist()] for one in taken(views, at)[camera]]
            for camera in views
        ],
    }
    worker = Path(__file__).with_name("four_webcams_peers.py")
    done = subprocess.run(
        [python, str(worker), name], input=json.dumps(sent), capture_output=True, text=True, timeout=900, check=False
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no answer"])[-1]
    return np.array(json.loads(done.stdout.strip().splitlines()[-1]))


def has(python: str, program: str) -> bool:
    """Whether an interpreter has a program; of OpenCV, which all of them bring, the version that can."""
    asks = f"import {PEERS[program]} as it; assert it.__name__ != 'cv2' or it.__version__ >= '5'"
    return subprocess.run([python, "-c", asks], capture_output=True, check=False).returncode == 0


def of_peer(python: str, program: str, sessions: dict) -> list[object]:
    """Return what a program leaves in the fit and on blocks left out (px), session by session, or why nothing."""
    cells: list[object] = []
    for views, lenses, times in sessions.values():
        n = len(views["cam0"])
        found = peer(python, program, views, lenses, np.arange(n))
        if isinstance(found, str):
            return [found, *[""] * (2 * len(sessions) - 1)]
        parts = [(out, peer(python, program, views, lenses, stay)) for stay, out in blocks(n)]
        left = [
            judged(taken(views, out), lenses, taken(times, out), part, None)
            for out, part in parts
            if not isinstance(part, str)
        ]
        held = rms(np.concatenate(left)) if len(left) == BLOCKS else float("nan")
        cells += [rms(judged(views, lenses, times, found, None)), held]
    return cells


def drawn(n: int) -> None:
    """Print how errors, claims and the bound compare over n drawn sets of each kind."""
    world, plates = bench.test_scene("ring_of_cameras"), bench.test_scene("turning_plate")
    names, options = ("a", "b", "c", "d"), BoardOptions(folds=0)
    both = TwoSided(plates.FRONT, plates.BACK)
    lights = spot_target({name: tuple(xyz) for name, xyz in zip("ABCDEF", plates.LIGHTS.tolist(), strict=True)})
    around = (-60.0, -20.0, 20.0, 60.0)
    kinds = {
        "two sides, opposite": (lambda s: plates.plate((-25.0, 25.0, 155.0, 205.0), s), both, 0.1),
        "two sides, round": (lambda s: plates.plate((0.0, 80.0, 180.0, 260.0), s), both, 0.1),
        "waved lights": (lambda s: plates.crown(around, s), lights, 0.05),
        "rolling shutters": (lambda s: world.ring(np.random.default_rng(s)), world.BOARD, 0.1),
    }
    print("| set | RMS over bound | numbers within 95 % | sets within 95 % | chi2 / numbers | s, mean, most |")
    print("|---|---|---|---|---|---|")
    for kind, (make, shown, sigma_px) in kinds.items():
        over, inside, chi2, took = [], [], [], []
        for seed in range(n):
            rng, true, times = np.random.default_rng(1000 + seed), make(100 + seed), None
            lenses = {
                name: KnownLens(camera=Camera(width=world.SIZE[0], height=world.SIZE[1], intrinsics=k))
                for name, k in zip(names, true.k, strict=True)
            }
            if shown is world.BOARD:
                film, at = world.waved(true)
                late, read = rng.uniform(-0.05, 0.05, 4) * [0, 1, 1, 1], rng.uniform(0.005, 0.03, 4)
                uv = world.rolled(film, at, late, read)
                views = world.views(uv + rng.normal(0.0, sigma_px, uv.shape), names, sigma_px)
                times = {name: [0.1 * g for g in range(len(film.boards))] for name in names}
            else:
                views = true.views(names, sigma_px, rng)
            started = time.process_time()
            done = solve_cameras(views, shown, options, lenses=lenses, times_s=times)
            took.append(time.process_time() - started)
            if times is None:
                e, block = plates.errors(done, true), true.names(names)
                over.append(e**2 / np.diag(true.bound(sigma_px)))
            else:
                places = [world.off(world.matrix(s), T) for s, T in zip(done.state.sides, true.T[1:], strict=True)]
                e = np.concatenate([np.ravel(places), done.delays_s[1:] - late[1:], done.readouts_s - read])
                block = (*(f"{c}.{p}" for c in names[1:] for p in world.POSE), *delays_of(names), *readouts_of(names))
                kept = np.array([one in done.covariance.names for one in block])
                e, block = e[kept], tuple(np.array(block)[kept])
            claimed = done.covariance.block(block)
            inside += (np.abs(e) < 1.96 * np.sqrt(np.diag(claimed))).tolist()
            chi2.append((float(e @ np.linalg.solve(claimed, e)), len(e)))
        within = np.mean([one < chi2_of.ppf(0.95, k) for one, k in chi2])
        bound = f"{np.sqrt(np.mean(over)):.3f}" if over else "-"
        ratio = sum(one for one, _ in chi2) / sum(k for _, k in chi2)
        seconds = f"{np.mean(took):.2f}, {max(took):.2f}"
        shares = f"{100 * np.mean(inside):.1f} % | {100 * within:.0f} %"
        print(f"| {kind} | {bound} | {shares} | {ratio:.3f} | {seconds} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drawn", type=int, default=0)
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--peers", nargs="*", default=[])
    asked = parser.parse_args()
    if asked.drawn:
        drawn(asked.drawn)
        return
    if not asked.data.is_dir():
        raise SystemExit(f"{asked.data} is not there: give the folder with the corners")
    print(bench.machine())
    sessions = {name: read(asked.data, name) for name in SESSIONS}
    rows = []
    for words, timed in (("armsight, delays", True), ("armsight, no times", False)):
        cells = []
        for name in SESSIONS:
            own, left, delays, took = armsight(*sessions[name], timed)
            cells += [own, left]
            print(f"{words}, {name}: delays {np.round(delays, 1)} ms, {took:.2f} s of processor", flush=True)
        rows.append([words, *cells])
    found = {program: python for program in PEERS for python in reversed(asked.peers) if has(python, program)}
    rows += [[program, *of_peer(python, program, sessions)] for program, python in found.items()]
    rows += [[f"{program}: skipped, as measured before", *BEFORE[program]] for program in PEERS if program not in found]
    head = ["program", *(f"{name}, {what}, px" for name in SESSIONS for what in ("in the fit", "left out"))]
    bench.table("Corners of four webcams, RMS of one coordinate", head, rows)


if __name__ == "__main__":
    main()
