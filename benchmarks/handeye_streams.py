"""Hand-eye calibration from streams whose errors drift: do the claimed deviations hold, and the left-out error?

`--streams N` recordings (200), `--first SEED`. Beside it the claim as if the poses were independent. Then the offset of
the clocks, drawn over +-1000 s: both streams over the same time, with little in common, and of two recordings.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from armsight.calibrate.handeye import calibrate_eye_in_hand, pairs_of_streams
from armsight.calibrate.handeye.stream_pairing import time_offset
from armsight.errors import ArmsightError
from bench import machine, table, test_scene

scene = test_scene("drifting_streams")
NAMES = ("x", "y", "z", "rx", "ry", "rz")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    with_drift, without, ratio, alone_ratio, worth, refused = [], [], [], [], [], 0
    for seed in range(asked.first, asked.first + asked.streams):
        made = scene.streams(seed)
        try:
            pairs, _ = pairs_of_streams(made.t_s, made.flange, made.t_s, made.camera)
            found = calibrate_eye_in_hand(pairs)
            alone = calibrate_eye_in_hand(replace(pairs, t_s=None))
        except ArmsightError:
            refused += 1
            continue
        for one, out in ((found, with_drift), (alone, without)):
            out.append(scene.error(one.T_parent_camera) / list(one.std.values()))
        true = predicted(found)
        ratio.append(found.loo_rms_m / true)
        alone_ratio.append(alone.loo_rms_m / predicted(alone))
        worth.append(found.correlation.n_effective)
    print(machine())
    rows = []
    for name, z, r in (("with the drift", with_drift, ratio), ("as if independent", without, alone_ratio)):
        z = np.abs(np.array(z))
        held = 100.0 * (z < 1.96).mean(axis=0)
        rows.append([name, *(f"{one:.1f}" for one in held), f"{held.mean():.1f}", f"{np.median(r):.2f}"])
    table(
        f"{len(with_drift)} streams ({refused} refused): share of the truth inside the claimed 95 %, %",
        ["", *NAMES, "all", "left-out error over that of a fresh recording, median"],
        rows,
    )
    low, middle, high = np.percentile(worth, [5, 50, 95])
    print(f"\nthe 60 poses are worth {middle:.0f} independent ones in the median ({low:.0f} to {high:.0f})")
    offsets(asked.first, asked.streams)


def offsets(first: int, count: int) -> None:
    """Print how often clocks are laid on each other, and how far off."""
    rows = []
    for name in ("the same time", "40 % in common", "two recordings"):
        off, outside, refused = [], 0, 0
        for seed in range(first, first + count):
            made, other = scene.streams(seed), scene.streams(seed + 10_000)
            zero_s = np.random.default_rng([seed, 9]).uniform(-1000.0, 1000.0)
            seen = other if name == "two recordings" else made
            t, all_ = made.t_s, np.arange(len(seen.t_s))
            early = np.flatnonzero(t <= (0.7 * t[-1] if "%" in name else t[-1]))
            late = all_[seen.t_s >= (0.3 * t[-1] if "%" in name else 0.0)]
            robot, camera = made.flange.rotation[early], seen.camera.rotation[late]
            try:
                found = time_offset(t[early], robot, seen.t_s[late] - zero_s, camera)
            except ArmsightError:
                refused += 1
                continue
            off.append(abs(found.offset_s - zero_s))
            outside += name == "two recordings" or off[-1] > 0.05
        told = f"{1e3 * np.median(off):.2g}" if off and name != "two recordings" else "-"
        rows.append([name, len(off), outside, refused, told])
    table(
        f"Clocks of {count} pairs of streams each, +-1000 s apart",
        ["", "offset given", "wrong: by more than 50 ms, or of other recordings", "refused", "error ms, median"],
        rows,
    )


def predicted(found: object) -> float:
    """Return the RMS (m) of the used pairs' true camera poses against the calibration, with their noise in it."""
    return float(np.sqrt((found.residuals[found.used, :3] ** 2).sum(axis=1).mean() + error2(found)))  # type: ignore[attr-defined]


def error2(found: object) -> float:
    """Return the squared error (m^2) that the calibration's own error adds at the target, 0.45 m away."""
    error = scene.error(found.T_parent_camera)  # type: ignore[attr-defined]
    return float((error[:3] ** 2).sum() + 0.45**2 * (error[3:] ** 2).sum())


if __name__ == "__main__":
    main()
