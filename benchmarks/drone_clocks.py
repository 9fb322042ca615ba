"""Clocks of six and seven free-running cameras that film a drone, against the drone's own satellite track.

    python benchmarks/drone_clocks.py DATA [--seconds 60] [--most N] [--flights 3 4]

DATA: a folder with dataset3, dataset4 and calibration of github.com/CenekAlbl/drone-tracking-datasets (Li et al. 2020;
CC BY-NC-SA 4.0: fetched by whoever runs this, nothing of it is kept here): text files of detections, tracks and lenses.

Each camera's pose, lens and line of time against the satellite clock are fitted to the track of the whole flight, by
code of this file alone. Poses and lenses are the rig; the lines of time are the truth, whose own scatter over blocks of
the flight is printed. Stamps are frame numbers over the nominal rate, put together by the published shifts rounded to
whole seconds. Clocks are then found window by window from the detections alone. Beside them: the published
synchronisation, and the two-camera estimate of each with the first one.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.timing import calibrate_clocks, calibrate_timing
from armsight.errors import DataRefused
from armsight.optics import Camera, MountedCamera, Rig
from armsight.records import CameraTiming, SpotTrack
from armsight.units import MS

LENSES = {(3, "mate10"): "mate10_1", (4, "mate10"): "mate10_2", (3, "sonyG"): "sonyG_1", (4, "sonyG"): "sonyG_2"}
UNSTEADY = ("mate7", "mate10")
"""Phones that film at a rate of their own choice, as the data's authors say; their frame numbers are no clock."""
TRACK_HZ, SIGMA_PX, LEAST_SEEN = 5.0, 0.5, 400
POSE, CLOCK, LENS = slice(0, 6), slice(6, 9), slice(9, 15)
PRIOR = np.array([300.0, np.nan, 0.02, 0.02, 30.0, 30.0, 0.02, 0.05])
"""Of rate (ppm), read-out (half a frame), focal lengths (shares), centre (px), k1 and k2."""


@dataclass
class Filmed:
    """A camera's lens as published, frame times by its nominal rate, and detections; x: what is fitted to the track.

    shift_s: published, of its frame 0 after the first camera's.
    """

    name: str
    K: np.ndarray
    distortion: np.ndarray
    size: tuple[int, int]
    fps: float
    t_s: np.ndarray
    uv: np.ndarray
    shift_s: float
    published: tuple[float, float]
    x: np.ndarray = field(default_factory=lambda: np.zeros(15))

    def lens(self) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix and distortion as fitted."""
        f, distortion = self.x[LENS], self.distortion.copy()
        K = self.K * np.array([[1.0 + f[0]], [1.0 + f[1]], [1.0]])
        K[:2, 2] = self.K[:2, 2] + f[2:4]
        distortion[:2] += f[4:]
        return K, distortion

    def at(self, t_s: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the satellite time of lines v of frames."""
        return t_s * (1.0 + 1e-6 * self.x[7]) + self.x[6] + self.x[8] * (v / (self.size[1] - 1) - 0.5)


def table_of(text: str, title: str) -> np.ndarray:
    """Return a table of the data's README."""
    rows = text.split(title)[1].split("###")[0].splitlines()
    cells = [[one for one in row.strip("| ").split("|") if one.strip()] for row in rows if re.match(r"\| \d", row)]
    return np.array([[float(one) for one in row[1:]] for row in cells])


def read(folder: Path, number: int) -> tuple[list[Filmed], CubicSpline]:
    """Return the cameras of a flight, and the drone's track over its time."""
    data = folder / f"dataset{number}"
    text = (data / "README.md").read_text(encoding="utf-8")
    alpha, beta = table_of(text, "Time scale (alpha)"), table_of(text, "Time shift (beta)")
    out: list[Filmed] = []
    for k, name in re.findall(r"cam(\d+) - (\S+)", (data / "cameras.txt").read_text(encoding="utf-8")):
        lens = json.loads((folder / "calibration" / name / f"{LENSES.get((number, name), name)}.json").read_text())
        rows = np.loadtxt(data / "detections" / f"cam{k}.txt", skiprows=1)
        rows = rows[rows[:, 1] > 0.0]
        rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
        distortion, fps = np.zeros(5), float(lens["fps"])
        distortion[: len(lens["distCoeff"])] = lens["distCoeff"]
        out.append(
            Filmed(
                name=name,
                K=np.array(lens["K-matrix"], float),
                distortion=distortion,
                size=tuple(lens["resolution"]),
                fps=fps,
                t_s=rows[:, 0] / fps,
                uv=rows[:, 1:3],
                shift_s=float(beta[0, int(k)]) / fps,
                published=(float(alpha[0, int(k)]), float(beta[0, int(k)])),
            )
        )
    track = np.loadtxt(data / "trajectory" / "rtk.txt")
    t = track[:, 0] if track.shape[1] == 4 else np.arange(len(track))
    return out, CubicSpline(t / TRACK_HZ, track[:, -3:])


def begun(one: Filmed, track: CubicSpline, tried: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the least median error in px over shifts against the track, and x (15,) there."""
    some = np.linspace(0, len(one.t_s) - 1, 150).astype(int)
    xy = cv2.undistortPoints(one.uv[some][:, None], one.K, one.distortion)[:, 0]
    best, x = np.inf, np.zeros(15)
    for shift in tried:
        at = one.t_s[some] + shift
        inside = (at > track.x[0]) & (at < track.x[-1])
        X = track(at[inside])
        if inside.sum() < 30 or np.ptp(X, axis=0).max() < 5.0:
            continue
        done, turn, place = cv2.solvePnP(X, xy[inside], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        seen = cv2.projectPoints(X, turn, place, np.eye(3), None)[0][:, 0]
        error = float(np.median(np.linalg.norm(seen - xy[inside], axis=1))) * one.K[0, 0]
        if done and error < best:
            best, x[POSE], x[6] = error, np.concatenate([turn, place]).ravel(), shift
    return best, x


def residuals(one: Filmed, track: CubicSpline, at: np.ndarray) -> np.ndarray:
    """Return the residuals (n, 2) in px of some detections at one.x."""
    K, distortion = one.lens()
    X = track(one.at(one.t_s[at], one.uv[at, 1]))
    return np.asarray(cv2.projectPoints(X, one.x[:3], one.x[3:6], K, distortion)[0][:, 0] - one.uv[at])


def fit_to_track(one: Filmed, track: CubicSpline, n: int = 2500) -> None:
    """Fit pose, lens and line of time to the track."""
    prior, half = PRIOR.copy(), 0.5 / one.fps
    prior[1] = one.x[8] = half
    t = one.t_s + one.x[6]
    at = np.flatnonzero((t > track.x[0] + 1.0) & (t < track.x[-1] - 1.0))
    at = at[np.linspace(0, len(at) - 1, min(n, len(at))).astype(int)]

    def cost(x: np.ndarray) -> np.ndarray:
        one.x = x
        known = (x[7:] - np.array([0.0, half, *np.zeros(6)])) / prior
        return np.concatenate([residuals(one, track, at).ravel() / 2.0, known])

    one.x = least_squares(cost, one.x.copy(), x_scale="jac", loss="cauchy", max_nfev=80).x


def truth_scatter(one: Filmed, track: CubicSpline, seconds: float) -> float:
    """Return the RMS over blocks of the flight of how late a block is against the line of time, the rest held, s."""
    late, x = [], one.x.copy()
    for begin in np.arange(one.t_s[0], one.t_s[-1], seconds):
        t = one.at(one.t_s, one.uv[:, 1])
        inside = (one.t_s >= begin) & (one.t_s < begin + seconds) & (t > track.x[0] + 1) & (t < track.x[-1] - 1)
        at = np.flatnonzero(inside)
        if len(at) < LEAST_SEEN:
            continue
        r = residuals(one, track, at)
        one.x = x + 1e-3 * (np.arange(15) == 6)
        J = (residuals(one, track, at) - r) / 1e-3
        one.x = x
        weight = 1.0 / (1.0 + (np.linalg.norm(r, axis=1, keepdims=True) / 2.0) ** 2)
        late.append(-np.sum(weight * J * r) / np.sum(weight * J * J))
    return float(np.sqrt(np.mean(np.square(late)))) if late else np.nan


def rig_of(cameras: list[Filmed], names: tuple[str, ...] | None = None) -> Rig:
    """Return the rig in the track's axes."""
    mounted = []
    for one, name in zip(cameras, names or [one.name for one in cameras], strict=True):
        K, distortion = one.lens()
        camera = Camera.pinhole(*one.size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], distortion=distortion)
        T = RigidTransform.from_components(one.x[3:6], Rotation.from_rotvec(one.x[:3])).inv()
        mounted.append(MountedCamera(name=name, camera=camera, T_rig_camera=T))
    return Rig(cameras=mounted)


def stamped(one: Filmed, cameras: list[Filmed]) -> float:
    """Return what is added to a camera's frame times to make its stamps: the published shift in whole seconds."""
    return float(np.round(cameras[0].shift_s - one.shift_s))


def seen(one: Filmed, plus_s: float, begin: float, end: float) -> SpotTrack:
    """Return a camera's detections in a window of stamps."""
    stamp = one.t_s + plus_s
    inside = (stamp >= begin) & (stamp < end)
    n = int(inside.sum())
    return SpotTrack(
        t_s=stamp[inside] - begin,
        frame=np.arange(n),
        names=("drone",) * n,
        uv_px=one.uv[inside],
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
    )


def true_late(one: Filmed, first: Filmed, plus: tuple[float, float], begin: float, stamp: float) -> float:
    """Return t_first - t of a camera at a stamp of a window, by both lines of time against the track."""
    t = stamp + begin - plus[1]
    satellite = t * (1.0 + 1e-6 * one.x[7]) + one.x[6]
    mine = (satellite - first.x[6]) / (1.0 + 1e-6 * first.x[7]) + plus[0] - begin
    return float(mine - stamp)


def published_late(one: Filmed, first: Filmed, plus: tuple[float, float], begin: float, stamp: float) -> float:
    """Return the same by the published table: frame i of the first is frame alpha i + beta of this one."""
    frame = (stamp + begin - plus[1]) * one.fps
    i = (frame - one.published[1]) / one.published[0]
    return float(i / first.fps + plus[0] - begin - stamp)


def windows(cameras: list[Filmed], track: CubicSpline, seconds: float) -> list[float]:
    """Return the first stamps of windows that do not overlap, over the flight."""
    first = cameras[0]
    begin, end = ((t - first.x[6]) + stamped(first, cameras) for t in (track.x[0] + 5.0, track.x[-1] - 5.0))
    return [float(one) for one in np.arange(begin, end - seconds, seconds)]


def pair_clock(cameras: list[Filmed], tracks: list[SpotTrack]) -> CameraTiming | None:
    """Return the clock of the second of two cameras against the first one, by these two alone."""
    try:
        return calibrate_timing(rig_of(cameras, ("left", "right")), *tracks).cameras()[1]
    except DataRefused:
        return None


def around(clocks: dict[tuple[int, int], CameraTiming | None], of: tuple[int, int, int], stamp: float) -> float | None:
    """Return by how many deviations the clocks of three pairs of cameras miss each other round their triangle."""
    ab, ac, bc = (clocks[pair] for pair in ((of[0], of[1]), (of[0], of[2]), (of[1], of[2])))
    if ab is None or ac is None or bc is None:
        return None
    at = float(bc.rig_time([stamp])[0])
    miss = float(ab.rig_time([at])[0] - ac.rig_time([stamp])[0])
    variance = ab.clock_std_s([at])[0] ** 2 + ac.clock_std_s([stamp])[0] ** 2 + bc.clock_std_s([stamp])[0] ** 2
    return miss / float(np.sqrt(variance))


def measured(
    used: list[Filmed], plus: list[float], begin: float, seconds: float
) -> tuple[list[list[float]], list[float], float] | None:
    """Return for one window errors (cameras, methods) in s with claims, triangles in deviations, and the CPU time."""
    tracks = [seen(one, add, begin, begin + seconds) for one, add in zip(used, plus, strict=True)]
    some = [k for k, track in enumerate(tracks) if len(track) >= LEAST_SEEN and used[k].name not in UNSTEADY]
    if len(some) < 3 or 0 not in some:
        return None
    cpu = time.process_time()
    try:
        found = calibrate_clocks(rig_of([used[k] for k in some]), {used[k].name: tracks[k] for k in some})
    except DataRefused as error:
        print(f"window at {begin:.0f} s: {error}")
        if error.kept is None:
            return None
        found = error.kept
    cpu = time.process_time() - cpu
    some = [k for k in some if used[k].name in found.clocks]
    clocks = {(a, b): pair_clock([used[a], used[b]], [tracks[a], tracks[b]]) for a, b in combinations(some, 2)}
    rows = []
    for k in some[1:]:
        one, stamp, both = found.clocks[used[k].name], found.clocks[used[k].name].middle_s, (plus[0], plus[k])
        true = true_late(used[k], used[0], both, begin, stamp)
        pair = clocks[0, k]
        alone = np.nan if pair is None else float(pair.rig_time([stamp])[0]) - stamp - true
        late = one.delay_s + 1e-6 * one.drift_ppm * stamp - true
        told = published_late(used[k], used[0], both, begin, stamp) - true
        rows.append([k, late, one.std_middle_s, alone, told, one.residual_px, one.left_out_px or np.nan])
    stamp = found.clocks[used[some[-1]].name].middle_s
    misses = [around(clocks, of, stamp) for of in combinations(some, 3)]
    return rows, [miss for miss in misses if miss is not None], cpu


def flight(folder: Path, number: int, seconds: float, most: int) -> None:
    """Print one flight."""
    cameras, track = read(folder, number)
    span = float(cameras[0].t_s[-1] + track.x[-1])
    first = cameras[0]
    for step, about, width in ((1.0, 0.0, span), (0.1, None, 1.5), (0.02, None, 0.15)):
        middle = first.x[6] if about is None else about
        _, first.x = begun(first, track, np.arange(middle - width, middle + width, step))
    for other in cameras[1:]:
        middle = first.x[6] + first.shift_s - other.shift_s
        _, other.x = begun(other, track, np.arange(middle - 2.0, middle + 2.0, 0.02))
    rows = []
    for each in cameras:
        fit_to_track(each, track)
        fit_to_track(each, track)
        late = truth_scatter(each, track, seconds)
        error = np.linalg.norm(residuals(each, track, np.arange(0, len(each.t_s), 7)), axis=1)
        note = "rate of its own choice: left out" if each.name in UNSTEADY else ""
        rows.append([each.name, each.fps, len(each.t_s), float(np.median(error)), late / MS, each.x[8] / MS, note])
    head = [
        "camera",
        "Hz",
        "detections",
        "median off track, px",
        f"line of time over {seconds:.0f} s, RMS ms",
        "read-out, ms",
    ]
    bench.table(f"Flight {number}: cameras against the satellite track", [*head, ""], rows)
    plus = [stamped(each, cameras) for each in cameras]
    done = [measured(cameras, plus, begin, seconds) for begin in windows(cameras, track, seconds)[:most]]
    found = [one for one in done if one is not None]
    if not found:
        return
    lines = np.array([row for window, _, _ in found for row in window])
    table = []
    for k in np.unique(lines[:, 0]).astype(int):
        own = lines[lines[:, 0] == k]
        rms = [float(np.sqrt(np.nanmean(np.square(own[:, m])))) / MS for m in (1, 3, 4)]
        px = [float(np.nanmedian(own[:, m])) for m in (5, 6)]
        largest = float(np.abs(own[:, 1]).max()) / MS
        table.append([cameras[k].name, len(own), rms[0], largest, float(np.median(own[:, 2])) / MS, *rms[1:], *px])
    rms = [float(np.sqrt(np.nanmean(np.square(lines[:, m])))) / MS for m in (1, 3, 4)]
    table.append(["all", len(lines), rms[0], float(np.abs(lines[:, 1]).max()) / MS, float(np.median(lines[:, 2])) / MS])
    table[-1] += [*rms[1:], *(float(np.nanmedian(lines[:, m])) for m in (5, 6))]
    head = ["camera", "windows", "all cameras at once", "largest", "claimed", "each with the first alone", "published"]
    head += ["RMS, px", "left out, px"]
    bench.table(f"Flight {number}: delays against {cameras[0].name}, RMS of the error in ms", head, table)
    misses = np.array([miss for _, window, _ in found for miss in window])
    within, rms_z = 100.0 * np.mean(np.abs(misses) < 2.0), rms_of(misses)
    print(f"{len(misses)} triangles of two-camera estimates: {within:.0f} % close within 2 deviations, RMS {rms_z:.2f}")
    print(f"CPU {np.mean([cpu for _, _, cpu in found]):.1f} s a window")


def rms_of(x: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of a window")
    parser.add_argument("--most", type=int, default=1000, help="windows of each flight at most")
    parser.add_argument("--flights", type=int, nargs="+", default=[3, 4])
    asked = parser.parse_args()
    print(bench.machine())
    for number in asked.flights:
        flight(asked.data, number, asked.seconds, asked.most)


if __name__ == "__main__":
    main()
