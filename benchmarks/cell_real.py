"""A whole cell in one bundle on a real set, beside the chain: dots of pictures left out, the pitch, what stays unknown.

    python benchmarks/cell_real.py [--folds N]

15 pictures of a board of 10 x 10 dots by a camera on a robot's wrist (../shared/data/dots_10x10_handeye); says so where
it is not there. Every method sees the pictures of the other folds alone (lens, hand-eye, noise, pitch), and predicts
the dots of those left out from the robot's pose. Judged for all by one function: px in the image; mm at the target,
from where the method's own camera and board see the board. One run, same folds. How the set becomes a cell:
tests/truth/cell_real_set.py.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from scipy.stats import ttest_rel

import bench

real = bench.test_scene("cell_real_set")
UNLEARNED_BITS = 0.2
OURS = "joint bundle"
OTHER_PRINTS_MM = (0.02, 0.5)
"""How well each dot's place in the print might be taken to be known instead: what the pitch hangs on."""


def predictors() -> dict[str, object]:
    """Return what makes a prediction of given pictures from the others, and the pitch it holds: by name."""

    def chain(make: object) -> object:
        def run(given: object, rest: list[int], out: list[int]) -> tuple[list[object], float]:
            found = make(given.take(rest))
            return [found.predict(given.robot[k]) for k in out], found.pitch_m

        return run

    def bundle(given: object, rest: list[int], out: list[int]) -> tuple[list[object], float]:
        cell = real.bundle_of(given, rest)
        x = real.fit_bundle(cell).x
        return [cell.predict(x, k) for k in out], cell.pitch_m(x)[0]

    told = {"25.4 (config)": real.CONFIG_M, "24.82 (robot, all pictures)": real.ROBOT_M}
    methods = {}
    for freed in (False, True):
        camera = ", camera freed" * freed
        for name, pitch_m in told.items():
            methods[f"chain{camera}, pitch told {name}"] = chain(
                lambda some, pitch_m=pitch_m, freed=freed: real.chain_of(some, pitch_m, free_camera=freed)
            )
        methods[f"chain{camera}, run again with the pitch it found"] = chain(
            lambda some, freed=freed: real.advised_chain(some, free_camera=freed)
        )
    return methods | {OURS: bundle}


def left_out(given: object, folds: int) -> dict[str, np.ndarray]:
    """Return of every method the errors (n, 3) px, mm, mm of the board's origin, and the pitch in mm (n, 4)."""
    n = len(given.views)
    errors = {name: np.full((n, 4), np.nan) for name in predictors()}
    for fold in range(folds):
        out = list(range(fold, n, folds))
        rest = [k for k in range(n) if k not in out]
        for name, run in predictors().items():
            start = time.perf_counter()
            seen, pitch_m = run(given, rest, out)
            for k, each in zip(out, seen, strict=True):
                errors[name][k] = [*real.missed(each, given.views[k]), 1e3 * pitch_m]
            took = time.perf_counter() - start
            print(fold, name, errors[name][out].round(3).tolist(), f"{took:.1f} s", file=sys.stderr, flush=True)
    return errors


def errors_table(errors: dict[str, np.ndarray], folds: int) -> None:
    """Print the errors side by side, and how sure the bundle's difference from each is."""
    ours = errors[OURS]
    rows = []
    for name, each in errors.items():
        rms, middle = np.sqrt((each[:, :3] ** 2).mean(axis=0)), np.median(each[:, :3], axis=0)
        better = int((ours[:, 0] < each[:, 0]).sum())
        chance = "" if each is ours else f"{ttest_rel(ours[:, 1], each[:, 1]).pvalue:.2g}"
        pitch = f"{each[:, 3].mean():.3f} ({np.ptp(each[:, 3]):.3f})"
        rows.append(
            [name, *rms[:1], *middle[:1], *rms[1:2], *middle[1:2], rms[2], "" if each is ours else better, chance, pitch]
        )
    bench.table(
        f"dots_10x10_handeye, {len(ours)} pictures left out in {folds} folds",
        [
            "method", "px RMS", "px median", "dots mm RMS", "dots mm median", "board's origin mm RMS",
            "pictures the bundle is nearer in (px)", "p of mm (paired t)", "pitch mm (span of folds)",
        ],
        rows,
    )  # fmt: skip


def whole(given: object) -> None:
    """Print what all pictures say: pitch, noise, and what they do not tell."""
    every = range(len(given.views))
    cell = real.bundle_of(given, every)
    found = real.fit_bundle(cell)
    model, C = cell.model, found.covariance(cell.model)
    chain = real.chain_of(given, real.CONFIG_M)
    pitch_m, slope = cell.pitch_m(found.x)
    std = float(np.sqrt(slope @ C @ slope))
    others = []
    for mm in OTHER_PRINTS_MM:
        other = real.bundle_of(given, every, print_m=1e-3 * mm)
        fit = real.fit_bundle(other)
        value, row = other.pitch_m(fit.x)
        spread = float(np.sqrt(row @ fit.covariance(other.model) @ row))
        others.append([f"joint bundle, each dot taken to be in place to {mm} mm", f"{1e3 * value:.3f}", f"{1e3 * spread:.3f}"])
    bench.table(
        "the dots' pitch, mm",
        ["by", "pitch", "+-"],
        [
            ["configuration", "25.4", ""],
            ["the sheet, printed for", "20", ""],
            ["robot's motion, by others", f"{1e3 * real.ROBOT_M:.3f}", f"{1e3 * real.ROBOT_STD_M:.3f}"],
            ["chain (the scale it tells)", f"{1e3 * chain.pitch_found_m:.3f}", f"{1e3 * chain.pitch_std_m:.3f}"],
            ["joint bundle (freed)", f"{1e3 * pitch_m:.3f}", f"{1e3 * std:.3f}"],
            *others,
        ],
    )
    size = zip(real.STRAYS, found.wander.std[::3], strict=True)
    print("\nnoise: dots", f"{real.SPOT_PX * found.scale[0]:.3f} px;", "; ".join(f"{name} {s:.2g}" for name, s in size))
    rows = []
    for one in real.told(cell, found):
        if one.bits is None or one.bits < UNLEARNED_BITS or one.name.startswith("left."):
            before, bits = ("", "") if one.bits is None else (f"{one.prior_std:.3g}", f"{one.bits:.2f}")
            told = "NO" if one.bits is not None and one.bits < UNLEARNED_BITS else "yes"
            rows.append([one.name, f"{one.value:.5g}", f"{one.std:.2g}", before, bits, told])
    bench.table("camera, and all that is not told", ["parameter", "value", "+-", "before", "bits", "told"], rows)
    held = [name for name in model.names if name not in found.free and name.startswith("left.")]
    print(f"\nheld, standing pictures of one camera say nothing of it: {', '.join(held)}; the right camera")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folds", type=int, default=15)
    folds = parser.parse_args().folds
    print(bench.machine())
    if not real.FOLDER.exists():
        print("skipped: the recording dots_10x10_handeye is not here")
        return
    given = real.read_set()
    whole(given)
    errors_table(left_out(given, folds), folds)


if __name__ == "__main__":
    main()
