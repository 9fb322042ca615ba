"""A whole cell in one bundle on a real set, beside the chain: dots of pictures left out, the pitch, what stays unknown.

    python benchmarks/cell_real.py [--folds N] [--prints MM ..]

15 pictures of a board of 10 x 10 dots by a camera on a robot's wrist (../shared/data/dots_10x10_handeye); says so where
it is not there. Every method sees the pictures of the other folds alone (lens, hand-eye, noise, pitch), and predicts
the dots of those left out from the robot's pose. Judged for all by one function: px in the image; mm at the target,
from where the method's own camera and board see the board. One run, same folds. How the set becomes a cell:
cell_real_set.py.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from scipy.stats import ttest_rel

import bench
import cell_real_set as real

UNLEARNED_BITS = 0.2
MOVED = 3.0
"""Standard deviations by which a parameter may move with what is believed of the print, and still is told."""
PRINT_MM = 1e3 * real.PRINT_M
OTHER_PRINTS_MM = (0.2, 0.5)
"""How well each dot's place in the print might be taken to be known instead: what the pitch hangs on."""


def predictors(prints_mm: list[float]) -> dict[str, object]:
    """Return what makes a prediction of given pictures from the others, and the pitch it holds: by name."""

    def chain(make: object) -> object:
        def run(given: object, rest: list[int], out: list[int]) -> tuple[list[object], float]:
            found = make(given.take(rest))
            return [found.predict(given.robot[k]) for k in out], found.pitch_m

        return run

    def bundle(print_mm: float) -> object:
        def run(given: object, rest: list[int], out: list[int]) -> tuple[list[object], float]:
            cell = real.bundle_of(given, rest, print_m=1e-3 * print_mm)
            x = real.fit_bundle(cell).x
            return [cell.predict(x, k) for k in out], cell.pitch_m(x)[0]

        return run

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
    return methods | {ours(mm): bundle(mm) for mm in prints_mm}


def ours(print_mm: float) -> str:
    """Return the bundle's name, where each dot is taken to be in its place in the print to so much."""
    return f"joint bundle, dots in place to {print_mm:g} mm"


def left_out(given: object, folds: int, prints_mm: list[float]) -> dict[str, np.ndarray]:
    """Return of every method the errors (n, 3) px, mm, mm of the board's origin, and the pitch in mm (n, 4)."""
    n = len(given.views)
    errors = {name: np.full((n, 4), np.nan) for name in predictors(prints_mm)}
    for fold in range(folds):
        out = list(range(fold, n, folds))
        rest = [k for k in range(n) if k not in out]
        for name, run in predictors(prints_mm).items():
            start = time.perf_counter()
            seen, pitch_m = run(given, rest, out)
            for k, each in zip(out, seen, strict=True):
                errors[name][k] = [*real.missed(each, given.views[k]), 1e3 * pitch_m]
            took = time.perf_counter() - start
            print(fold, name, errors[name][out].round(3).tolist(), f"{took:.1f} s", file=sys.stderr, flush=True)
    return errors


def errors_table(errors: dict[str, np.ndarray], folds: int, first: str) -> None:
    """Print the errors side by side, and by how many pictures and what chance the first bundle differs from each."""
    mine = errors[first]
    rows = []
    for name, each in errors.items():
        row: list[object] = [name]
        for k in (0, 1, 2):
            row += [float(np.sqrt((each[:, k] ** 2).mean())), float(np.median(each[:, k]))]
        for k in (0, 1):
            nearer = int((mine[:, k] < each[:, k]).sum())
            row.append("" if each is mine else f"{nearer}, p {ttest_rel(mine[:, k], each[:, k]).pvalue:.2g}")
        rows.append([*row, f"{each[:, 3].mean():.3f}, {np.ptp(each[:, 3]):.3f}"])
    bench.table(
        f"dots_10x10_handeye, {len(mine)} pictures left out in {folds} folds; nearer: pictures of which the first "
        "bundle is nearer than this method, and the chance of the difference (paired t)",
        [
            "method", "dots px RMS", "median", "dots mm RMS", "median", "board's origin mm RMS", "median",
            "nearer in px", "nearer in mm", "pitch mm: mean, span over folds",
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
    others, elsewhere = [], {}
    for mm in OTHER_PRINTS_MM:
        other = real.bundle_of(given, every, print_m=1e-3 * mm)
        fit = real.fit_bundle(other)
        value, row = other.pitch_m(fit.x)
        spread = float(np.sqrt(row @ fit.covariance(other.model) @ row))
        others.append([f"joint bundle, each dot in place to {mm} mm", f"{1e3 * value:.3f}", f"{1e3 * spread:.3f}"])
        elsewhere = elsewhere or {one.name: one.value for one in real.told(other, fit)}
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
    rows, prints = [], []
    for one in real.told(cell, found):
        if one.name.startswith("print:"):
            prints.append(one.bits)
            continue
        before, bits = ("", "") if one.bits is None else (f"{one.prior_std:.3g}", f"{one.bits:.2f}")
        off = abs(elsewhere[one.name] - one.value) / one.std
        told = "hangs on the print" if off > MOVED else "yes"
        if one.bits is not None and one.bits < UNLEARNED_BITS:
            told = "NO"
        rows.append([one.name, f"{one.value:.5g}", f"{one.std:.2g}", before, bits, f"{elsewhere[one.name]:.5g}", told])
    bench.table(
        "what all pictures tell of camera and pitch",
        ["parameter", "value", "+-", "before", "bits", f"dots in place to {OTHER_PRINTS_MM[0]} mm", "told"],
        rows,
    )
    open_ = sum(bits < UNLEARNED_BITS for bits in prints)
    print(f"\ndots in the print: {open_} of {len(prints)} coordinates not told ({np.median(prints):.2f} bits)")
    held = [name for name in model.names if name not in found.free and name.startswith("left.")]
    print(f"\nheld, standing pictures of one camera say nothing of it: {', '.join(held)}; the right camera")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folds", type=int, default=15, help="0: only what all pictures say")
    parser.add_argument("--prints", type=float, nargs="+", default=[PRINT_MM, 0.2], metavar="MM")
    asked = parser.parse_args()
    print(bench.machine())
    if not real.FOLDER.exists():
        print("skipped: the recording dots_10x10_handeye is not here")
        return
    given = real.read_set()
    whole(given)
    if asked.folds:
        errors_table(left_out(given, asked.folds, asked.prints), asked.folds, ours(asked.prints[0]))


if __name__ == "__main__":
    main()
