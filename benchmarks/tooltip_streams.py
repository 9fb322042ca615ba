"""The tool's tip from recordings whose errors drift: do the claimed deviations hold, and the left-out error?

`--streams N` recordings (200), `--first SEED`. Beside it the claim as if the poses were independent, and both for the
same errors in random order. The error of a fresh recording: of poses made with the same noise, anywhere.
"""

from __future__ import annotations

import argparse

import numpy as np

from armsight.calibrate.tooltip import calibrate_tooltip
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.errors import ArmsightError
from bench import machine, table, test_scene

scene = test_scene("drifting_pivot")
KINDS = ("with the drift", "as if independent")


def fresh(made: object, found: ToolTipResult) -> float:
    """Return the RMS distance in m of the tip found from the point found, over fresh poses of the same noise."""
    rng = np.random.default_rng(7)
    R = scene.Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (500, 3)))
    size = np.sqrt(1.0 + made.white**2)  # type: ignore[attr-defined]
    t = scene.POINT_M - R.apply(scene.TIP_M) + size * made.sigma_m * rng.normal(size=(500, 3))  # type: ignore[attr-defined]
    turned = scene.Rotation.from_rotvec(size * made.sigma_rad * rng.normal(size=(500, 3))) * R  # type: ignore[attr-defined]
    return float(np.sqrt(((turned.apply(np.array(found.tip_m)) + t - found.point_m) ** 2).sum(axis=1).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    print(machine())
    rows, worth, refused = [], [], 0
    for drifts, errors in ((True, "drifting"), (False, "in random order")):
        z: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
        off: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
        ratio: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for seed in range(asked.first, asked.first + asked.streams):
            made = scene.pivot(seed, drifts=drifts)
            try:
                both = [calibrate_tooltip(made.poses, t_s=t) for t in (made.t_s, None)]
            except ArmsightError:
                refused += 1
                continue
            for kind, found in zip(KINDS, both, strict=True):
                off[kind].append(found.tip_m - scene.TIP_M)
                z[kind].append(off[kind][-1] / list(found.std.values()))
                ratio[kind].append((found.loo_rms_m or np.nan) / fresh(made, found))
            if drifts:
                worth.append(both[0].correlation.n_effective / both[0].n_used)
        for kind in KINDS:
            size = np.abs(np.array(z[kind]))
            held = 100.0 * (size < 1.96).mean(axis=0)
            rms = float(np.sqrt(np.mean(np.square(off[kind])))) * 1e3
            told = [*(f"{one:.1f}" for one in held), f"{held.mean():.1f}", float(np.sqrt((size**2).mean()))]
            rows.append([errors, kind, *told, rms, f"{np.nanmedian(ratio[kind]):.2f}"])
    table(
        f"Tool tip from {asked.streams} recordings ({refused} refused): share of the truth inside the claimed 95 %, %",
        ["errors", "taken", "x", "y", "z", "all", "error / claim, RMS", "error mm RMS", "left-out / fresh, median"],
        rows,
    )
    low, middle, high = np.percentile(worth, [5, 50, 95])
    print(f"\na drifting pose is worth {middle:.2f} independent ones in the median ({low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
