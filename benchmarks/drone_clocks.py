"""Clocks of four and five free-running cameras that film a drone, against the drone's own satellite track.

    python benchmarks/drone_clocks.py DATA [--flights 3 4] [--doubted]

DATA: a folder with dataset3, dataset4 and calibration of github.com/CenekAlbl/drone-tracking-datasets (Li et al. 2020;
CC BY-NC-SA 4.0: fetched by whoever runs this, nothing of it is kept here): text files of detections, tracks and lenses.

Each camera's pose, lens and line of time against the satellite clock are fitted to the track of the whole flight, by
code of this file alone. Poses and lenses are the rig, with their covariance; the lines of time are the reference. Both
covariances are by blocks of 10 s, because what a detection is off by stays for a second. Stamps are frame numbers over
the nominal rate, put together by the published shifts rounded to whole seconds. Clocks are then found from the
detections of the whole flight. Beside them: the published synchronisation, and each camera with the first one alone.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import dataclass, field, replace
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
from armsight.records import NamedCovariance, SpotTrack
from armsight.units import MS

LENSES = {(3, "mate10"): "mate10_1", (4, "mate10"): "mate10_2", (3, "sonyG"): "sonyG_1", (4, "sonyG"): "sonyG_2"}
UNSTEADY = ("mate7", "mate10")
"""Phones that film at a rate of their own choice, as the data's authors say; their frame numbers are no clock."""
TRACK_HZ, SIGMA_PX, LEAST_SEEN, BLOCK_S, LOSS_PX = 5.0, 0.5, 400, 10.0, 1.0
POSE, LENS, N = slice(0, 6), slice(9, 18), 18
PRIOR = np.array([300.0, np.nan, 0.02, 0.02, 30.0, 30.0, 0.02, 0.05, 2e-3, 2e-3, 0.05])
"""Of rate (ppm), read-out (half a frame), focal lengths (shares), centre (px), k1, k2, p1, p2 and k3."""
NUMBERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), ("tx", "ty", "tz", "rx", "ry", "rz")


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
    x: np.ndarray = field(default_factory=lambda: np.zeros(N))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((N, N)))

    def lens(self) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix and distortion as fitted."""
        f, distortion = self.x[LENS], self.distortion.copy()
        K = self.K * np.array([[1.0 + f[0]], [1.0 + f[1]], [1.0]])
        K[:2, 2] = self.K[:2, 2] + f[2:4]
        distortion += f[4:]
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
    """Return the least median error in px over shifts against the track, and x (18,) there."""
    some = np.linspace(0, len(one.t_s) - 1, 150).astype(int)
    xy = cv2.undistortPoints(one.uv[some][:, None], one.K, one.distortion)[:, 0]
    best, x = np.inf, np.zeros(N)
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


def fit_to_track(one: Filmed, track: CubicSpline, n: int = 6000) -> None:
    """Fit pose, lens and line of time to the track."""
    prior, half = PRIOR.copy(), 0.5 / one.fps
    mean = np.array([0.0, half, *np.zeros(9)])
    prior[1] = one.x[8] = half
    t = one.t_s + one.x[6]
    at = np.flatnonzero((t > track.x[0] + 1.0) & (t < track.x[-1] - 1.0))
    at = at[np.linspace(0, len(at) - 1, min(n, len(at))).astype(int)]

    def cost(x: np.ndarray) -> np.ndarray:
        one.x = x
        return np.concatenate([residuals(one, track, at).ravel() / LOSS_PX, (x[7:] - mean) / prior])

    one.x = least_squares(cost, one.x.copy(), x_scale="jac", loss="cauchy", max_nfev=80).x

    r, J = residuals(one, track, at), np.zeros((len(at), 2, N))
    best = one.x.copy()
    for i, step in enumerate(np.maximum(1e-6, 1e-6 * np.abs(best))):
        one.x = best + step * np.eye(N)[i]
        J[:, :, i] = (residuals(one, track, at) - r) / step
    one.x = best
    weight = 1.0 / (1.0 + (r / LOSS_PX) ** 2)
    H = np.einsum("nij,ni,nik->jk", J, weight, J) / LOSS_PX**2 + np.diag([*np.zeros(7), *prior**-2.0])
    block = np.floor((one.t_s[at] - one.t_s[at[0]]) / BLOCK_S).astype(int)
    score = np.zeros((block.max() + 1, N))
    np.add.at(score, block, np.einsum("nij,ni,ni->nj", J, weight, r) / LOSS_PX**2)
    inverse = np.linalg.inv(H)
    one.covariance = inverse @ (score.T @ score + np.diag([*np.zeros(7), *prior**-2.0])) @ inverse


def line_std_s(one: Filmed) -> float:
    """Return how well the satellite time of a camera's middle detection is known."""
    way = np.zeros(N)
    way[6:8] = 1.0, 1e-6 * one.t_s.mean()
    return float(np.sqrt(way @ one.covariance @ way))


def pose_of(x: np.ndarray) -> RigidTransform:
    """Return T_track_camera."""
    return RigidTransform.from_components(x[3:6], Rotation.from_rotvec(x[:3])).inv()


def numbers_of(cameras: list[Filmed], x: np.ndarray) -> np.ndarray:
    """Return a rig's numbers at x (v, 18) of its cameras, its axes held by the first one."""
    lenses, places = [], []
    back = pose_of(cameras[0].x[POSE]) * pose_of(x[0]).inv()
    for one, at in zip(cameras, x, strict=True):
        own = replace(one, x=at)
        K, distortion = own.lens()
        lenses.append([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *distortion])
        T, best = back * pose_of(at), pose_of(one.x)
        places.append([*(T.translation - best.translation), *(T.rotation * best.rotation.inv()).as_rotvec()])
    return np.concatenate([np.ravel(lenses), np.ravel(places[1:])])


def rig_covariance(cameras: list[Filmed], names: list[str]) -> NamedCovariance:
    """Return the covariance of a rig's numbers from those of its cameras, which were fitted one by one."""
    x = np.array([one.x for one in cameras])
    C = 0.0
    for k, one in enumerate(cameras):
        J = np.zeros((len(numbers_of(cameras, x)), N))
        for i in (*range(6), *range(9, N)):
            step = 1e-6 * max(1.0, abs(one.x[i])) * (np.arange(N) == i)
            ends = []
            for way in (1.0, -1.0):
                moved = x.copy()
                moved[k] += way * step
                ends.append(numbers_of(cameras, moved))
            J[:, i] = (ends[0] - ends[1]) / (2.0 * step.sum())
        C = C + J @ one.covariance @ J.T
    every = [f"{name}.{key}" for name in names for key in NUMBERS[0]]
    every += [f"{name}.{key}" for name in names[1:] for key in NUMBERS[1]]
    return NamedCovariance(names=tuple(every), matrix=0.5 * (C + np.transpose(C)))


def rig_of(cameras: list[Filmed], names: list[str]) -> Rig:
    """Return the rig in the track's axes."""
    mounted = []
    for one, name in zip(cameras, names, strict=True):
        K, distortion = one.lens()
        camera = Camera.pinhole(*one.size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], distortion=distortion)
        mounted.append(MountedCamera(name=name, camera=camera, T_rig_camera=pose_of(one.x)))
    return Rig(cameras=mounted, covariance=rig_covariance(cameras, names))


def stamped(one: Filmed, cameras: list[Filmed]) -> float:
    """Return what is added to a camera's frame times to make its stamps: the published shift in whole seconds."""
    return float(np.round(cameras[0].shift_s - one.shift_s))


def seen(one: Filmed, plus_s: float) -> SpotTrack:
    """Return a camera's detections."""
    n = len(one.t_s)
    return SpotTrack(
        t_s=one.t_s + plus_s,
        frame=np.arange(n),
        names=("drone",) * n,
        uv_px=one.uv,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
    )


def true_late(one: Filmed, first: Filmed, plus: tuple[float, float], stamp: float) -> float:
    """Return t_first - t of a camera at a stamp, by both lines of time against the track."""
    t = stamp - plus[1]
    satellite = t * (1.0 + 1e-6 * one.x[7]) + one.x[6]
    return float((satellite - first.x[6]) / (1.0 + 1e-6 * first.x[7]) + plus[0] - stamp)


def published_late(one: Filmed, first: Filmed, plus: tuple[float, float], stamp: float) -> float:
    """Return the same by the published table: frame i of the first is frame alpha i + beta of this one."""
    i = ((stamp - plus[1]) * one.fps - one.published[1]) / one.published[0]
    return float(i / first.fps + plus[0] - stamp)


def flight(folder: Path, number: int, *, doubted: bool) -> list[list[float]]:
    """Print one flight; return what is found of each camera's clock."""
    every, track = read(folder, number)
    cameras = [one for one in every if one.name not in UNSTEADY]
    first, span = cameras[0], float(cameras[0].t_s[-1] + track.x[-1])
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
        error = np.linalg.norm(residuals(each, track, np.arange(0, len(each.t_s), 7)), axis=1)
        rows.append(
            [each.name, each.fps, len(each.t_s), float(np.median(error)), line_std_s(each) / MS, each.x[8] / MS]
        )
    head = ["camera", "Hz", "detections", "median off track, px", "line of time known to, ms", "read-out, ms"]
    bench.table(f"Flight {number}: cameras against the satellite track", head, rows)
    plus = [stamped(each, cameras) for each in cameras]
    tracks = [seen(*each) for each in zip(cameras, plus, strict=True)]
    names, cpu = [one.name for one in cameras], time.process_time()
    rig = rig_of(cameras, names)
    every_track = dict(zip(names, tracks, strict=True))
    try:
        found = calibrate_clocks(rig if doubted else replace(rig, covariance=None), every_track)
    except DataRefused as error:
        print(f"Flight {number} is refused: {error}")
        return []
    cpu = time.process_time() - cpu
    lines = []
    for k in range(1, len(cameras)):
        one, both = found.clocks[names[k]], (plus[0], plus[k])
        stamp = one.middle_s
        true = true_late(cameras[k], first, both, stamp)
        late = one.delay_s + 1e-6 * one.drift_ppm * stamp - true
        try:
            pair = calibrate_timing(rig_of([first, cameras[k]], ["left", "right"]), tracks[0], tracks[k])
            alone = pair.delay_s + 1e-6 * pair.drift_ppm * stamp - true
        except DataRefused:
            alone = np.nan
        told = published_late(cameras[k], first, both, stamp) - true
        known = float(np.hypot(line_std_s(first), line_std_s(cameras[k])))
        lines.append([late / MS, one.std_middle_s / MS, known / MS, alone / MS, told / MS, one.wider, one.residual_px])
    head = ["camera", "all at once", "claimed", "reference known to", "with the first alone", "published"]
    head += ["widened, times", "RMS, px"]
    shown = [[name, *line] for name, line in zip(names[1:], lines, strict=True)]
    bench.table(f"Flight {number}: delays against {first.name}, error in ms", head, shown)
    print(f"rig off by {found.rig_off:.1f}, CPU {cpu:.0f} s; {found.verdict}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--flights", type=int, nargs="+", default=[3, 4])
    parser.add_argument("--doubted", action="store_true", help="give the rig's covariance too: half an hour a flight")
    asked = parser.parse_args()
    print(bench.machine())
    lines = np.array([line for number in asked.flights for line in flight(asked.data, number, doubted=asked.doubted)])
    of, n = lines[:, [0, 3, 4]], len(lines)
    kinds = zip(("all at once", "with the first alone", "published"), of.T, strict=True)
    rows = [
        [name, n, np.isnan(e).sum(), (np.abs(e) < 1.0).sum(), float(np.sqrt(np.nanmean(e**2)))] for name, e in kinds
    ]
    z = lines[:, 0] / np.hypot(lines[:, 1], lines[:, 2])
    bench.table("Delays of all flights", ["found by", "delays", "refused", "within 1 ms", "RMS, ms"], rows)
    print(f"error over claim and reference together: RMS {np.sqrt(np.mean(z**2)):.2f}, largest {np.abs(z).max():.1f}")


if __name__ == "__main__":
    main()
