"""A laboratory with an arm, a tracker and a robot's log, made by formulas of this file alone: a table of Denavit and
Hartenberg, products of 4 x 4 matrices, two clocks. The arm's joint 2 reads 0.3 degrees too little."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from tracker_writers import Take, turned_about

D = (0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922)
A = (0.0, -0.612, -0.5723, 0.0, 0.0, 0.0)
ALPHA = np.deg2rad([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
"""A UR10's, as its maker publishes it."""
ZERO = np.deg2rad([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
RATE, N, LATE_S = 25.0, 160, 3.7
"""Of the tracker, and by how much the robot's clock is ahead."""
NOISE_M, NOISE_RAD = 5e-5, 2e-4
LOST = (40, 41, 42, 90)
SHAPE = {"Flange:A": (0, 0, 0.03), "Flange:B": (0.11, 0.01, 0.0), "Flange:C": (-0.02, 0.14, 0.01)}
SHAPE |= {"Flange:D": (0.06, 0.05, 0.09), "Flange:E": (-0.07, -0.03, 0.05)}
"""Markers in the body's axes, m."""


def pose(xyz, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


TRACKER_BASE = pose([1.5, -0.3, 0.2], Rotation.from_euler("xyz", [20.0, -10.0, 100.0], degrees=True))
FLANGE_BODY = pose([0.02, -0.01, 0.12], Rotation.from_euler("xyz", [5.0, 40.0, -70.0], degrees=True))
MIDDLE = np.mean(list(SHAPE.values()), axis=0)
"""Where the origin of a body of markers is, in the body's axes."""


def flange(readings):
    """T_base_flange (n, 4, 4) where joints read so much."""
    T = np.tile(np.eye(4), (len(readings), 1, 1))
    for k in range(6):
        c, s = np.cos(readings[:, k] + ZERO[k]), np.sin(readings[:, k] + ZERO[k])
        ca, sa = np.cos(ALPHA[k]), np.sin(ALPHA[k])
        link = np.zeros((len(readings), 4, 4))
        link[:, 0] = np.stack([c, -s * ca, s * sa, A[k] * c], axis=1)
        link[:, 1] = np.stack([s, c * ca, -c * sa, A[k] * s], axis=1)
        link[:, 2] = [0.0, sa, ca, D[k]]
        link[:, 3] = [0.0, 0.0, 0.0, 1.0]
        T = T @ link
    return T


def motion(t_s):
    """Readings (n, 6) of a motion that does not repeat itself."""
    k = np.arange(6)
    t = np.asarray(t_s)[:, None]
    return [0.2, -1.1, 1.2, -0.4, 1.0, 0.3] + 0.35 * np.sin((0.7 + 0.31 * k) * t + k) + 0.2 * np.sin(1.713 * t + 2 * k)


def take_of(T, rate=RATE, lost=(), seed=1):
    """A take of body poses T_tracker_body (n, 4, 4): a body, another that stands, and its markers, with noise."""
    rng = np.random.default_rng(seed)
    R, t = Rotation.from_matrix(T[:, :3, :3]), T[:, :3, 3].copy()
    exact = turned_about(R, t, SHAPE)
    t += rng.normal(0.0, NOISE_M, t.shape)
    t[list(lost)] = np.nan
    markers = {name: xyz + rng.normal(0.0, NOISE_M, xyz.shape) for name, xyz in exact.items()}
    for xyz in markers.values():
        xyz[list(lost)] = np.nan
    R = Rotation.from_rotvec(rng.normal(0.0, NOISE_RAD, t.shape)) * R
    still = (
        Rotation.concatenate([Rotation.from_rotvec([0.1, 0.2, 0.3])] * len(t)),
        np.tile([0.3, 0.2, 0.9], (len(t), 1)),
    )
    return Take(rate=rate, bodies={"Flange": (R, t), "Wand": still}, markers=markers)


@cache
def moving():
    """A take of the arm in motion."""
    return take_of(TRACKER_BASE @ flange(motion(np.arange(N) / RATE)) @ FLANGE_BODY, lost=LOST)


def log(seconds=N / RATE, rate=50.0, of=motion):
    """The robot's log on its own clock, in degrees."""
    t = np.arange(-0.5, seconds + 0.5, 1.0 / rate)
    rows = [",".join(f"{v:.6f}" for v in (at + LATE_S, *np.rad2deg(q))) for at, q in zip(t, of(t), strict=True)]
    return "\n".join(["t_s," + ",".join(f"q{k}_deg" for k in range(1, 7)), *rows, ""])


def robot_poses(seconds=N / RATE, rate=50.0):
    """The flange's poses on the robot's clock, as a KUKA writes them: mm, A B C about z, y', x''."""
    t = np.arange(-0.5, seconds + 0.5, 1.0 / rate)
    T = flange(motion(t))
    abc = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = [
        ";".join(f"{v:.6f}" for v in (at + LATE_S, *(1e3 * one[:3, 3]), *turn))
        for at, one, turn in zip(t, T, abc, strict=True)
    ]
    return "\n".join(["time;X;Y;Z;A;B;C", *rows, ""])


TIP = np.array([0.03, -0.02, 0.21])
"""A tool's end in the body's axes."""


@cache
def pivoting():
    """A take of the body while its tip rests on a point."""
    t = np.arange(N) / RATE
    R = Rotation.from_euler("XYZ", np.stack([0.5 * np.sin(1.3 * t), 0.45 * np.cos(0.9 * t), 1.1 * np.sin(0.5 * t)], 1))
    T = np.tile(np.eye(4), (N, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R.as_matrix(), np.array([0.4, 0.9, 0.1]) - R.apply(TIP)
    return take_of(T, seed=2)


@cache
def rests(count=40):
    """Readings (n, 6) at which the arm rests, by chance, and the marker A there, in the order of the visits."""
    rng = np.random.default_rng(4)
    q = np.array([0.2, -1.1, 1.2, -0.4, 1.0, 0.3]) + rng.uniform(-0.9, 0.9, (count, 6))
    T = TRACKER_BASE @ flange(q) @ FLANGE_BODY
    xyz = T[:, :3, :3] @ np.array(SHAPE["Flange:A"]) + T[:, :3, 3] + rng.normal(0.0, NOISE_M, (count, 3))
    return q, Take(rate=1.0, markers={"Flange": xyz})


CYCLES, STEP_S, REST_S, LEAD_S = 6, 2.0, 1.2, 4.0
SCATTER = 2e-4
"""Of each visit's joints, rad: more than the readings show."""


def visiting(t_s):
    """Readings (n, 6): a motion that finds the clocks, then three poses in turn, six times, at rest in each."""
    goals = np.array([0.2, -1.1, 1.2, -0.4, 1.0, 0.3]) + np.random.default_rng(5).uniform(-0.5, 0.5, (3, 6))
    t = np.asarray(t_s) - LEAD_S
    k = np.maximum(np.floor(t / STEP_S).astype(int), 0)
    share = np.clip((t - k * STEP_S - REST_S) / (STEP_S - REST_S), 0.0, 1.0)
    s = 0.5 - 0.5 * np.cos(np.pi * share)
    there = goals[k % 3] * (1.0 - s)[:, None] + goals[(k + 1) % 3] * s[:, None]
    lead = np.clip(t / -LEAD_S, 0.0, 1.0)[:, None]  # begins at the first pose's end, and comes to rest there
    return np.where(t[:, None] < 0.0, goals[0] + lead**2 * (motion(t) - goals[0]), there)


@cache
def visited():
    """A take of these visits, each with joints a little elsewhere; and where the body's origin was (18, 3) at each."""
    t = np.arange(int((LEAD_S + CYCLES * 3 * STEP_S - (STEP_S - REST_S)) * RATE)) / RATE
    k = np.maximum(np.floor((t - LEAD_S) / STEP_S).astype(int), 0)
    off = np.random.default_rng(6).normal(0.0, SCATTER, (CYCLES * 3, 6))
    T = TRACKER_BASE @ flange(visiting(t) + off[k]) @ FLANGE_BODY
    at = LEAD_S + STEP_S * np.arange(CYCLES * 3) + 0.5
    there = TRACKER_BASE @ flange(visiting(at) + off) @ FLANGE_BODY
    return take_of(T, seed=3), there


def rested(q, rest_s=1.2, move_s=0.6):
    """A take of an arm that goes from each of these readings (n, 6) to the next and rests there."""
    t = np.arange(int((len(q) * (rest_s + move_s) - move_s) * RATE)) / RATE
    k = np.minimum((t / (rest_s + move_s)).astype(int), len(q) - 1)
    share = np.clip((t - k * (rest_s + move_s) - rest_s) / move_s, 0.0, 1.0)
    s = 0.5 - 0.5 * np.cos(np.pi * share)[:, None]
    return take_of(TRACKER_BASE @ flange(q[k] * (1.0 - s) + q[np.minimum(k + 1, len(q) - 1)] * s) @ FLANGE_BODY, seed=5)
