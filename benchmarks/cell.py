"""A cell calibrated from one recording, beside today's chain of single calibrations on as many pictures.

    python benchmarks/cell.py [--cells 100] [--first SEED] [--faults N] [--good N] [--printed-only] [--moving] [--quick]

Cells are drawn in tests/truth/cell_world.py: arm, target, two free-running webcams, two minutes. Error: the true lights
are seen without noise at joints over the work volume, the target's pose is measured with what was calibrated, and the
tip goes to base axes: its distance to the true tip, RMS. The chain has 60 pairs of a board, and 30 pictures of each of
118 rests of the arm, all without clutter. Its board is exact, or printed: its scale is off by 0.1 % (deviation).
--moving: the chain from a recording in motion as well. --faults: so many cells with one planted fault each; --good: so
many without, which must raise no alarm.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import ArmsightError
from bench import machine, table, test_scene
from cell_chain import chain
from cell_chain_moving import chain_moving
from cell_ours import Ours, ours
from cell_records import Calibrated, commanded_errors, tip_errors

made = test_scene("cell_world")

Array = NDArray[np.float64]
CHI2_3, NORMAL = 7.815, 1.96
WRONG = 3.0
"""Errors so many times the claimed 95 % are wrong."""
MM = MS = 1e-3
OURS, WITH_BOARD = "one recording", "one recording and the exact board's rig"
PRINTED, EXACT, MOVING = "chain at rests, printed board", "chain at rests, exact board", "chain in motion, exact board"
CAUSES = {
    "slipping_target": ("target slipped",),
    "touched_camera": ("camera moved",),
    "clock_jump": ("clock jumped",),
    "elastic_arm": ("give way", "gives way"),
    "wrong_arm": ("of this arm", "by the arm's lengths"),
    "degrees": ("degrees",),
    "mirrored": ("mirror",),
    "other_day": ("never move alike", "of this recording"),
    "wrong_target": ("target's file", "by the arm's lengths"),
    "joint_zero_jump": ("reading jumped",),
    "dark_frames": ("% of its frames",),
    "still_joint": ("did not move",),
    "one_camera_blind": ("spots that move", "% of its frames"),
}
"""Words of which one tells each fault's cause."""


@dataclass(kw_only=True)
class Tally:
    """Tip errors by seed (RMS, m), as measured and as commanded; refusals with their reasons, seconds."""

    rms_m: dict[int, float] = field(default_factory=dict)
    commanded_m: dict[int, float] = field(default_factory=dict)
    refused: dict[int, str] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)

    def take(self, seed: int, run: Callable[[], Calibrated], world: Any) -> Array | None:
        """Run one calibration and hold its tip errors; return them, None where it refused."""
        begin = time.perf_counter()
        try:
            found = run()
        except ArmsightError as error:
            self.refused[seed] = str(error)
            return None
        self.seconds.append(time.perf_counter() - begin)
        errors, lost = tip_errors(world, found)
        if 2 * lost > len(errors):
            self.refused[seed] = "most poses are lost with what was calibrated"
            return None
        self.rms_m[seed] = rms(errors)
        self.commanded_m[seed] = rms(commanded_errors(world, found))
        return errors

    def row(self, name: str, ours: Tally) -> list[object]:
        """Median, 95 % and largest error in mm; median and 95 % of ours over it, of cells that both calibrate."""
        if not self.rms_m:
            return [name, *["-"] * 7, len(self.refused), "-"]
        size = np.array(list(self.rms_m.values())) / MM
        commanded = np.array(list(self.commanded_m.values())) / MM
        ratio = [ours.rms_m[seed] / value for seed, value in self.rms_m.items() if seed in ours.rms_m]
        figures = [*of(size), float(size.max()), *(of(ratio) if ratio and ours is not self else ["-", "-"])]
        return [name, *figures, *of(commanded), len(self.refused), self.took()]

    def took(self) -> float | str:
        """Return the median of the seconds; "-" of a result that another row's calibration gave with its own."""
        median_s = float(np.median(self.seconds))
        return median_s if median_s > MS else "-"


def rms(errors: Array) -> float:
    """Return the RMS of errors (k, 3), of those that are known."""
    return float(np.sqrt(np.nanmean((errors**2).sum(axis=1))))


def of(values: ArrayLike) -> list[float]:
    """Return median and 95 %."""
    return [float(np.median(values)), float(np.percentile(values, 95))]


HEAD = ["", "measured tip off by, mm, median", "95 %", "largest", "ours over it, median", "95 %"]
HEAD += ["commanded tip off by, mm, median", "95 %", "refused", "s, median"]


@dataclass(kw_only=True)
class Claims:
    """What ours claims against the truth: squared Mahalanobis distances of tips, errors over deviations by kind of
    parameter, and over what no estimator beats, seeds that are wrong and called good, and those with an alarm.
    efficient_m: tip errors of an estimator at the bound, by seed."""

    tip: list[float] = field(default_factory=list)
    kinds: dict[str, list[float]] = field(default_factory=dict)
    bounds: dict[str, list[float]] = field(default_factory=dict)
    efficient_m: dict[int, Array] = field(default_factory=dict)
    wrong: list[int] = field(default_factory=list)
    alarms: dict[int, str] = field(default_factory=dict)

    def take(self, seed: int, found: Ours, errors: Array) -> None:
        """Hold one calibration's claims."""
        q = np.einsum("ni,ni->n", errors, np.linalg.solve(found.covariance, errors[..., None])[..., 0])
        self.tip += q[np.isfinite(q)].tolist()
        for tally, of_kind in ((self.kinds, found.parameters), (self.bounds, found.bounds)):
            for kind, values in of_kind.items():
                tally.setdefault(kind, []).extend(error / std for error, std in values if std > 0.0)
        self.efficient_m[seed] = found.efficient_m
        claimed = np.sqrt(CHI2_3 / 3.0 * np.trace(found.covariance, axis1=1, axis2=2).mean())
        if found.alarm:
            self.alarms[seed] = found.words
        elif rms(errors) > WRONG * claimed:
            self.wrong.append(seed)

    def print(self) -> None:
        """Print the tables."""
        rows = [["tip, place", len(self.tip), 100.0 * float(np.mean(np.array(self.tip) < CHI2_3)), "-", "-"]]
        for kind, values in sorted(self.kinds.items()):
            z, least = np.abs(values), float(np.sqrt(np.mean(np.square(self.bounds[kind]))))
            rows.append([kind, len(z), 100.0 * float(np.mean(z < NORMAL)), float(np.sqrt(np.mean(z**2))), least])
        head = ["", "values", "inside 95 %, %", "error over claimed deviation, RMS", "error over Cramer-Rao bound, RMS"]
        table("What is claimed", head, rows)
        print(f"\nwrong and called good: {len(self.wrong)} {self.wrong}; alarms: {len(self.alarms)}")
        for seed, words in self.alarms.items():
            print(f"  {seed}: {words[:300]}")


def cells(first: int, count: int, *, moving: bool, chains: bool, exact_board: bool) -> None:
    """Print the table of calibrations side by side, and what ours claims."""
    tallies = {name: Tally() for name in (OURS, WITH_BOARD, PRINTED, EXACT, MOVING)}
    claims = Claims()
    for seed in range(first, first + count):
        world, kept = made.make_cell(seed), {}

        def one(world: Any = world, kept: dict[str, Any] = kept) -> Calibrated:
            kept["ours"] = ours(world)
            return kept["ours"].measured_with

        errors = tallies[OURS].take(seed, one, world)
        if errors is not None:
            claims.take(seed, kept["ours"], errors)

        def exact(world: Any = world, kept: dict[str, Any] = kept) -> Calibrated:
            kept["chain"] = chain(world, made, printed=False)
            return kept["chain"].by_arm

        if chains:
            tallies[PRINTED].take(seed, lambda world=world: chain(world, made, printed=True).by_arm, world)
        if chains and exact_board:
            tallies[EXACT].take(seed, exact, world)
        if "chain" in kept:
            rig = kept["chain"].rig
            tallies[WITH_BOARD].take(seed, lambda world=world, rig=rig: ours(world, rig).measured_with, world)
        if moving:
            tallies[MOVING].take(seed, lambda world=world: chain_moving(world, made).by_arm, world)
        told = {name: f"{tally.rms_m[seed] / MM:.3f}" for name, tally in tallies.items() if seed in tally.rms_m}
        told |= {
            name: f"refused: {tally.refused[seed][:200]}" for name, tally in tallies.items() if seed in tally.refused
        }
        print(f"cell {seed}, {world.truth.arm.name}: {told}", flush=True)
    rows = [tally.row(name, tallies[OURS]) for name, tally in tallies.items() if tally.rms_m or tally.refused]
    table(f"{count} cells from seed {first}", HEAD, rows)
    print_efficient(claims, tallies[PRINTED])
    for name, tally in tallies.items():
        for why, n in Counter(tally.refused.values()).most_common():
            print(f"{name}: refused {n}: {why[:300]}")
    if claims.tip:
        claims.print()


def print_efficient(claims: Claims, chain_at_rests: Tally) -> None:
    """Print what of a chain's errors an estimator at the Cramer-Rao bound of the one recording would reach."""
    ratios = [
        claims.efficient_m[seed] / value for seed, value in chain_at_rests.rms_m.items() if seed in claims.efficient_m
    ]
    if ratios:
        every = np.concatenate(ratios)
        print(
            f"\nan estimator at the bound of one recording, over the {PRINTED}: median {np.median(every):.2f}, 95 % "
            f"{np.percentile(every, 95):.2f}, not above 1.0 in {100.0 * np.mean(every <= 1.0):.0f} %"
        )


def faults(first: int, count: int) -> None:
    """Print what is told of cells with one planted fault each."""
    rows: dict[str, list[list[object]]] = {}
    for seed in range(first, first + count):
        fault = made.FAULTS[seed % len(made.FAULTS)]
        world = made.make_cell(seed, fault=fault)
        off_mm: float | str = "-"
        try:
            found = ours(world)
        except ArmsightError as error:
            told, words = "refused", str(error)
        else:
            told, words = "doubtful" if found.alarm else "called good", found.words
            errors, _ = tip_errors(world, found.measured_with)
            off_mm = rms(errors) / MM if np.isfinite(errors).any() else "lost"
        held = told == "called good" and fault != "elastic_arm"  # which may be taken into the model, and told
        first_told = words.lower().partition("; less likely")[0]
        right = not held and any(word in first_told for word in CAUSES[fault])
        rows.setdefault(fault, []).append([told, right, off_mm])
        print(f"cell {seed}, {fault} {world.truth.told}: {told}, tip off {off_mm} mm: {words[:300]}", flush=True)
    out = []
    for fault, cases in rows.items():
        counts = Counter(case[0] for case in cases)
        good = [case[2] for case in cases if case[0] == "called good"]
        named = sum(bool(case[1]) for case in cases)
        out.append(
            [fault, len(cases), counts["refused"], counts["doubtful"], named, counts["called good"], good or "-"]
        )
    head = ["fault", "cells", "refused", "doubtful", "right cause first", "called good", "tip off in these, mm"]
    table(f"{count} cells with one fault each, from seed {first}", head, out)


def good(first: int, count: int) -> None:
    """Print how often a cell without a fault raises an alarm."""
    alarms = []
    for seed in range(first, first + count):
        try:
            found = ours(made.make_cell(seed))
        except ArmsightError as error:
            alarms.append(f"{seed}: refused: {error}")
        else:
            alarms += [f"{seed}: {found.words}"] if found.alarm else []
        print(f"{seed - first + 1} cells, {len(alarms)} alarms", end="\r", flush=True)
    print(f"\n{count} cells without a fault: {len(alarms)} alarms")
    for words in alarms:
        print(" ", words[:300])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--faults", type=int, default=0, help="cells with one planted fault each")
    parser.add_argument("--good", type=int, default=0, help="cells without a fault, looked at for false alarms alone")
    parser.add_argument("--without-chain", action="store_true", help="the one recording alone")
    parser.add_argument("--printed-only", action="store_true", help="the chain with the printed board alone")
    parser.add_argument("--moving", action="store_true", help="the chain in motion too")
    parser.add_argument("--quick", action="store_true", help="three cells, one of each fault")
    asked = parser.parse_args()
    print(machine())
    alone = asked.faults or asked.good
    count = 3 if asked.quick else 0 if alone else asked.cells
    if count:
        chains = not asked.without_chain
        cells(asked.first, count, moving=asked.moving, chains=chains, exact_board=not asked.printed_only)
    n_faults = asked.faults or (len(made.FAULTS) if asked.quick else 0)
    if n_faults:
        faults(asked.first, n_faults)
    if asked.good:
        good(asked.first, asked.good)
    print(f"\npeak memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
