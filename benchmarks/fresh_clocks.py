"""Planted faults: stamps and clocks of logs, trackers and cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fresh_judge import Try, beyond, blamed, block, document, fault, healthy
from fresh_lost import TRACKER, arm_file, joined, streams
from fresh_world import (
    ELBOW,
    SEVEN,
    SIDEWAYS,
    Array,
    columns,
    joints,
    lights_yaml,
    motion,
    pair,
    pose,
    rig_yaml,
    shaken,
    table,
)


@fault(4)
def one_stamp_twice(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    log[333] = log[332]
    t[101] = t[100]
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), ELBOW, T)


@fault(4)
def the_line_holds_back_and_gives_at_once(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SIDEWAYS)
    stamps = log + 0.003
    for first in range(70, len(log) - 60, 190):
        stamps[first : first + 35] = log[first + 35] + 2e-5 * np.arange(35)
    return joined(folder, {"t_s": stamps} | joints(q), {"t_s": t} | columns(T), SIDEWAYS, T)


@fault(4)
def angles_jump_at_180_degrees(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SEVEN)
    shift = np.array([2.9, 0, 3.0, 0, -3.05, 0, 3.1])
    wave = motion(shift, 0.35, rng)
    q, T = wave(log), shaken(TRACKER @ SEVEN.fk(wave(t - 0.43)), rng, 8e-5, 3e-4)
    wrapped = np.rad2deg((q + np.pi) % (2 * np.pi) - np.pi)
    return joined(folder, {"t_s": log} | joints(wrapped, "_deg"), {"t_s": t} | columns(T), SEVEN, T)


@fault(4)
def the_log_counts_whole_milliseconds(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    stamps = np.round(1e3 * log + 4_812_333)
    return joined(folder, {"time": stamps} | joints(q), {"t_s": t} | columns(T), ELBOW, T)


@fault(4)
def the_tracker_counts_nanoseconds_since_1970(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SIDEWAYS)
    stamps = [str(1_790_000_000_000_000_000 + round(1e9 * s)) for s in t]
    return joined(folder, {"t_s": log} | joints(q), {"timestamp": stamps} | columns(T), SIDEWAYS, T)


@fault(4, r"ms|millisecond|unit|clock")
def seconds_that_are_milliseconds_with_a_fraction(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    return joined(folder, {"t_s": log} | joints(q), {"t_s": 1e3 * t + 0.25} | columns(T), ELBOW, T)


@fault(4)
def the_trackers_clock_runs_fast_by_900_ppm(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, seconds=16.0)
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t * 1.0009} | columns(T), ELBOW, T)


@fault(4, r"jump|step|set|clock|gap")
def the_clock_is_set_by_a_third_of_a_second(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    stamps = t + np.where(np.arange(len(t)) > 200, 0.31, 0.0)
    return joined(folder, {"t_s": log} | joints(q), {"t_s": stamps} | columns(T), ELBOW, T)


@fault(4, r"back|jump|order|clock")
def the_clock_is_set_back(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    stamps = log - np.where(np.arange(len(log)) > 600, 0.25, 0.0)
    return joined(folder, {"t_s": stamps} | joints(q), {"t_s": t} | columns(T), ELBOW, T)


@fault(4, "sort the rows")
def rows_of_the_log_in_another_order(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SIDEWAYS)
    mixed = np.arange(len(log))
    mixed[100:140] = rng.permutation(mixed[100:140])
    return joined(folder, {"t_s": log[mixed]} | joints(q[mixed]), {"t_s": t} | columns(T), SIDEWAYS, T)


@fault(4)
def a_third_of_the_log_is_missing(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    kept = (log < 3.1) | (log > 6.4)
    return joined(folder, {"t_s": log[kept]} | joints(q[kept]), {"t_s": t} | columns(T), ELBOW, T)


@fault(4, r"repeat|again|period|irregular|more than one|several")
def a_motion_that_repeats_itself(folder: Path, rng: np.random.Generator) -> Try:
    log, seen = np.arange(0, 14, 0.01), np.arange(1.2, 9.3, 0.025)
    middle = np.array([0, 0.25, -0.65, 0, 0, 0])

    def q(t: Array) -> Array:
        return middle + 0.3 * np.sin(2 * np.pi * 0.8 * t[:, None] + np.arange(6.0))

    T = shaken(TRACKER @ ELBOW.fk(q(seen)), rng, 8e-5, 3e-4)
    return joined(folder, {"t_s": log} | joints(q(log)), {"t_s": seen + 0.43} | columns(T), ELBOW, T)


@fault(4, r"out of step|order|another arm|do not agree|not of this|late|shift|rows")
def no_stamps_and_three_rows_dropped(folder: Path, rng: np.random.Generator) -> Try:
    q = motion([0, 0.25, -0.65, 0, 0, 0], 0.5, rng)(np.arange(120) * 0.2)
    T = shaken(TRACKER @ ELBOW.fk(q), rng, 8e-5, 3e-4)
    kept = np.delete(np.arange(120), [30, 31, 77])
    return joined(folder, joints(q), columns(T[kept]), ELBOW, T[kept])


def verified(folder: Path, log: dict[str, Array], seen: dict[str, Array], zero_deg: float) -> Try:
    table(folder / "log.csv", log)
    table(folder / "seen.csv", seen)
    words = ["verify", "--measured", folder / "seen.csv", "--joints", folder / "log.csv"]
    out = folder / "v"
    return Try([*words, "--arm", arm_file(folder, ELBOW), "-o", out], lambda: blamed(out, "joint 3", zero_deg))


@fault(4)
def a_knocked_joint_on_another_clock(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, _ = streams(rng, seconds=10.0)
    exact = np.stack([np.interp(t - 0.43, log, c) for c in q.T], 1)
    T = shaken(TRACKER @ ELBOW.knocked({3: np.deg2rad(0.29)}).fk(exact), rng, 8e-5, 3e-4)
    return verified(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), 0.29)


@fault(4)
def a_knocked_joint_and_a_stalling_log(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, _ = streams(rng, seconds=10.0)
    exact = np.stack([np.interp(t - 0.43, log, c) for c in q.T], 1)
    T = shaken(TRACKER @ ELBOW.knocked({3: np.deg2rad(0.41)}).fk(exact), rng, 8e-5, 3e-4)
    stamps = log.copy()
    for first in range(40, len(log) - 40, 120):
        stamps[first : first + 20] = log[first + 19] + 1e-5 * np.arange(20)
    return verified(folder, {"t_s": stamps} | joints(q), {"t_s": t} | columns(T), 0.41)


# Two cameras that run free, before three lights that are waved.

LIGHTS = {"A": [-0.048, 0.004, 0.0], "B": [0.037, 0.041, 0.006], "C": [0.029, -0.052, -0.011]}
DELAY_S, DRIFT_PPM, READOUT_S = 0.0131, 35.0, 0.0114


def waved(folder: Path, rng: np.random.Generator, seconds: float = 9.0) -> tuple[dict[str, Array], dict[str, Array]]:
    """Write rig and target; return both cameras' tables: 30 and 29.7 Hz, rolling, right stamps early by DELAY_S."""
    eyes = pair()
    rig_yaml(folder / "rig.yaml", eyes)
    lights_yaml(folder / "target.yaml", LIGHTS)
    way = motion([0.05, 0.0, 0.72, 0, 0, 0], 0.16, rng)
    fast = motion([0, 0, 0, 0, 0, 0], 0.05, rng)
    body = np.array(list(LIGHTS.values()))

    def place(t: Array) -> Array:
        v = way(1.5 * t) + fast(3.0 * t)
        return pose(v[:, :3], Rotation.from_rotvec(v[:, 3:]))

    tables = []
    for eye, hz in zip(eyes, (30.0, 29.7), strict=True):
        stamps = np.arange(0.3, seconds, 1 / hz) + rng.normal(0, 2e-4, len(np.arange(0.3, seconds, 1 / hz)))
        true = stamps + (DELAY_S + 1e-6 * DRIFT_PPM * stamps if hz < 30 else 0.0)
        rows: dict[str, list[object]] = {"t_s": [], "u_px": [], "v_px": [], "su_px": [], "sv_px": [], "spot": []}
        for stamp, t in zip(stamps, true, strict=True):
            for name, light in zip(LIGHTS, body, strict=True):
                at = t
                for _ in range(4):
                    uv = eye.see((place(np.array([at]))[0] @ np.r_[light, 1.0])[None, :3])[0]
                    at = t + READOUT_S * (uv[1] / (eye.size[1] - 1) - 0.5)
                seen = uv + rng.normal(0, 0.05, 2)
                for key, value in zip(rows, (stamp, *seen, 0.05, 0.05, name), strict=True):
                    rows[key].append(value)
        tables.append(rows)
    return tables[0], tables[1]  # type: ignore[return-value]


def timed(folder: Path, left: dict[str, Array], right: dict[str, Array]) -> Try:
    table(folder / "left.csv", left)
    table(folder / "right.csv", right)

    def miss() -> float | None:
        found = document(folder / "timed.yaml")
        if found is None:
            return None
        timing = found["cameras"]["right"]["timing"]
        error = np.array([timing["delay_s"] - DELAY_S, timing["drift_ppm"] - DRIFT_PPM])
        return beyond(error, block(timing, ["delay_s", "drift_ppm"]))

    words = ["calibrate", "timing", "--rig", folder / "rig.yaml", "--target", folder / "target.yaml"]
    tables = ["--left-spots", folder / "left.csv", "--right-spots", folder / "right.csv"]
    return Try([*words, *tables, "-o", folder / "timed.yaml"], miss, flag="")


def stamps_of(data: dict[str, Array]) -> Array:
    return np.array(data["t_s"])


@healthy(4)
def two_cameras_that_run_free(folder: Path, rng: np.random.Generator) -> Try:
    return timed(folder, *waved(folder, rng))


@fault(4, "need different times")
def free_cameras_one_stamp_again(folder: Path, rng: np.random.Generator) -> Try:
    left, right = waved(folder, rng)
    stamps = stamps_of(right)
    stamps[303:306] = stamps[300:303]
    return timed(folder, left, right | {"t_s": stamps})


@fault(4)
def free_cameras_frames_stamped_late(folder: Path, rng: np.random.Generator) -> Try:
    left, right = waved(folder, rng)
    stamps = stamps_of(left)
    for first in (60, 300, 420):
        stamps[first : first + 3] += 0.024
    return timed(folder, left | {"t_s": stamps}, right)


@fault(4, r"ms|millisecond|unit|rate|seconds")
def free_cameras_one_counts_milliseconds(folder: Path, rng: np.random.Generator) -> Try:
    left, right = waved(folder, rng)
    return timed(folder, left, right | {"t_s": 1e3 * stamps_of(right)})


@healthy(4)
def two_clocks_without_fault(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SEVEN)
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), SEVEN, T)
