"""`calibrate arm` from recordings whose errors drift: do the claimed deviations hold, and the errors of rows left out?

`--fits N` recordings (200), of which joint zeros are fitted, `--lengths N` (40) of arms whose lengths, which are held,
are off within their tolerance, and `--streams N` (20), of which everything is done. Each
is taken with its times and, as if its rows were independent, without them; so are the same errors in random order. The
arm has wrong zeros only; judged are those that base and tool cannot stand for. Fresh: the kept arm at other positions
in the recording's joint ranges, with noise of the same size.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from armsight.calibrate.arm import ArmResult, calibrate_arm
from armsight.calibrate.arm.covariance import believed, drift_of, in_blocks, widened
from armsight.calibrate.arm.fit import Tolerance, fit_arm
from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
from armsight.errors import ArmsightError
from bench import machine, table, test_scene

scene = test_scene("arm_streams")
KINDS = ("with times", "as if independent")
ORDER = {True: "drifting", False: "in random order"}


def deviations(found: ArmResult, true: dict[str, float]) -> list[float]:
    """Return error over claim of the judged zeros; those that are not corrected are not claimed."""
    std = found.std()
    return [(found.change(name) - value) / std[name] for name, value in true.items() if name in found.free]


def fresh(made: object, found: ArmResult) -> float:
    """Return the RMS error in m at other joint positions, with noise of the same size."""
    rng = np.random.default_rng(7)
    q = rng.uniform(made.points.q.min(axis=0), made.points.q.max(axis=0), (400, made.points.q.shape[1]))  # type: ignore[attr-defined]
    xyz = made.places(q) + made.sigma_m * rng.normal(size=(400, 3))  # type: ignore[attr-defined]
    there = replace(made.points, q=q, xyz_m=xyz, t_s=None, point=("",) * 400)  # type: ignore[attr-defined]
    return float(np.sqrt((found.model.errors(found.fitted.p, there)[0] ** 2).sum(axis=1).mean()))


def zeros_alone(first: int, count: int) -> None:
    """Print how far the zeros are off over what is claimed, where it is known that zeros alone are wrong."""
    rows: list[list[object]] = []
    for drifts in (True, False):
        z: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for seed in range(first, first + count):
            made = scene.stream(seed, drifts=drifts)
            model = ArmModel(arm=scene.NOMINAL, labels=made.points.labels, turned=False)
            names = list(made.true)
            fitted = fit_arm(model, made.points, start(model, made.points), names, Tolerance())
            drift = drift_of(model, made.points, fitted)
            points = in_blocks(made.points, None if drift is None else drift.correlation)
            for kind, one in zip(KINDS, (believed(model, points, fitted, Tolerance())[0], fitted), strict=True):
                std = one.fit.std()
                z[kind] += [(one.fit.value(name) - made.true[name]) / std[name] for name in names]
        for kind in KINDS:
            size = np.abs(np.array(z[kind]))
            held = f"{100.0 * (size < 1.96).mean():.1f}"
            rows.append([ORDER[drifts], kind, len(size), held, float(np.sqrt((size**2).mean())), float(size.max())])
    header = ["errors", "taken", "zeros", "inside 95 %, %", "error / claim, RMS", "largest"]
    table(f"Three zeros of an arm, {count} recordings, no other parameter in doubt", header, rows)


def lengths_off(first: int, count: int) -> None:
    """Print the same of zeros beside lengths that are held, and how much wider their claims are for it."""
    rows: list[list[object]] = []
    for kind in ("exact", "one, by 2 mm", "all, by 1 mm"):
        z: list[list[float]] = [[], []]
        wider = []
        for seed in range(first, first + count):
            built = np.zeros((5, 2))
            if kind == "one, by 2 mm":
                built[1, 1] = 2e-3 * (-1.0) ** seed
            elif kind == "all, by 1 mm":
                built = np.random.default_rng([seed, 9]).normal(0.0, 1e-3, (5, 2))
            made = scene.stream(seed, built_m=built)
            model, names = ArmModel(arm=scene.NOMINAL, labels=made.points.labels, turned=False), list(made.true)
            fitted = fit_arm(model, made.points, start(model, made.points), names, Tolerance())
            drift = drift_of(model, made.points, fitted)
            points = in_blocks(made.points, None if drift is None else drift.correlation)
            exact = fitted if drift is None or points.block is None else widened(model, points, fitted, drift)
            fits = exact, believed(model, points, fitted, Tolerance())[0]
            for own, one in zip(z, fits, strict=True):
                own += [(one.fit.value(name) - made.true[name]) / one.fit.std()[name] for name in names]
            wider += [fits[1].fit.std()[name] / fits[0].fit.std()[name] for name in names]
        for how, one in zip(("exact", "as off as residuals say"), np.abs(z), strict=True):
            held = f"{100.0 * (one < 1.96).mean():.1f}"
            rows.append([kind, how, held, float(np.sqrt((one**2).mean())), float(one.max()), float(np.median(wider))])
    header = ["lengths off", "taken as", "inside 95 %, %", "error / claim, RMS", "largest", "wider, median"]
    table(f"Three zeros of an arm beside lengths that are held, {count} recordings", header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--lengths", type=int, default=40)
    parser.add_argument("--streams", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    print(machine())
    if asked.fits:
        zeros_alone(asked.first, asked.fits)
    if asked.lengths:
        lengths_off(asked.first, asked.lengths)
    if asked.streams:
        whole(asked.first, asked.streams)


def whole(first: int, count: int) -> None:
    """Print the same of whole calibrations, their left-out errors, and how often more than zeros was corrected."""
    runs = [(drifts, kind) for drifts in (True, False) for kind in KINDS]
    z: dict[tuple[bool, str], list[float]] = {run: [] for run in runs}
    ratio: dict[tuple[bool, str], list[float]] = {run: [] for run in runs}
    more: dict[tuple[bool, str], int] = dict.fromkeys(runs, 0)
    refused = 0
    for seed in range(first, first + count):
        for drifts, kind in runs:
            made = scene.stream(seed, drifts=drifts)
            points = made.points if kind == KINDS[0] else replace(made.points, t_s=None)
            try:
                found = calibrate_arm(scene.NOMINAL, points, scale=False)
            except ArmsightError:
                refused += 1
                continue
            z[drifts, kind] += deviations(found, made.true)
            ratio[drifts, kind].append(found.cross_after.rms_m / fresh(made, found))
            more[drifts, kind] += found.level not in ("nominal", "joint zeros")
    rows = []
    for drifts, kind in runs:
        size = np.abs(np.array(z[drifts, kind]))
        rows.append(
            [
                ORDER[drifts],
                kind,
                len(size),
                f"{100.0 * (size < 1.96).mean():.1f}",
                float(np.sqrt((size**2).mean())),
                float(np.median(ratio[drifts, kind])),
                more[drifts, kind],
            ]
        )
    table(
        f"Zeros of an arm from {count} recordings each ({refused} refused)",
        ["errors", "taken", "zeros", "inside 95 %, %", "error / claim, RMS", "left-out / fresh, median", "overfitted"],
        rows,
    )


if __name__ == "__main__":
    main()
