"""What a servo does on a wrong premise, by where the true arm comes to rest; and whether honest runs are ever stopped.

    python benchmarks/servo_premises.py [wrong] [honest] [--seeds 20] [--runs 500] [--hand 0.0] [--minutes M]

The cell and the premises are in tests/truth/servo_premises.py. From rest the arm is to bring its cameras to a target
that is held still 20 to 80 mm and 3 to 12 degrees from where it is wanted (--hand: led at so many m/s). Way: of the
true tool from its start, at most. Harm: that part of it that is away from where an honest run had the tool.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from typing import Any

import numpy as np

from armsight.units import MM
from bench import machine, table, test_scene

cell = test_scene("servo_premises")
HONEST: dict[tuple[int, float], Any] = {}


def wrong_of(job: tuple[int, str, float]) -> tuple[str, float, float, bool, str]:
    """Return a premise, the tool's way and its harmful part in m, whether it was stopped, and the cause named."""
    seed, name, hand_m_s = job
    if (seed, hand_m_s) not in HONEST:
        HONEST[seed, hand_m_s] = cell.PremiseCell(seed, None, hand_m_s).go(cell.SECONDS)
    run = cell.run(name, seed, hand_m_s)
    at, other = np.array(run.log.tool), np.array(HONEST[seed, hand_m_s].log.tool)
    start = other[0, :3, 3] - at[0, :3, 3]  # a joint that goes the other way has the flange elsewhere from the start
    at[:, :3, 3] += start
    stood = np.linalg.norm(at[:-1, :3, 3] - other[1 : len(at), :3, 3], axis=1)
    apart = np.linalg.norm(at[1:, :3, 3] - other[1 : len(at), :3, 3], axis=1)
    harm = cell.scene.harm(apart, stood)[0]
    cause = "" if run.source.wrong is None else run.source.wrong.cause.value
    return name, run.way_m, harm, run.stopped(), cause


def wrong(pool: Any, seeds: int, hand_m_s: float, end_s: float) -> None:
    """Print a row for each premise."""
    jobs = [(seed, name, hand_m_s) for seed in range(1, seeds + 1) for name in cell.WRONG]
    found = []
    for one in pool.imap(wrong_of, jobs, chunksize=len(cell.WRONG)):
        found.append(one)
        if time.perf_counter() > end_s:
            break
    rows = []
    for name, premise in cell.WRONG.items():
        mine = [row for row in found if row[0] == name]
        way, harm = np.array([row[1] for row in mine]) / MM, np.array([row[2] for row in mine]) / MM
        named = 100.0 * float(np.mean([row[4] == premise.cause for row in mine]))
        stopped = 100.0 * float(np.mean([row[3] for row in mine]))
        over = int((way > 15.0).sum())
        rows.append(
            (
                name,
                len(mine),
                float(np.median(way)),
                float(way.max()),
                over,
                float(harm.max()),
                stopped,
                premise.cause,
                named,
            )
        )
    header = (
        "premise",
        "runs",
        "way mm, median",
        "worst",
        "above 15 mm",
        "harm mm, worst",
        "stopped %",
        "cause",
        "named %",
    )
    table(f"Wrong premises, target {'still' if not hand_m_s else f'led at up to {hand_m_s:g} m/s'}", header, rows)
    right = [row[4] == cell.WRONG[row[0]].cause for row in found]
    print(f"all: {sum(row[1] > 0.015 for row in found)} of {len(found)} above 15 mm of way, ", end="")
    print(f"{sum(row[2] > 0.015 for row in found)} above 15 mm of harm; cause right in {100.0 * np.mean(right):.1f} %")


def honest_of(seed: int) -> tuple[int, str, float]:
    """Return an honest run's seed, why it was stopped, and how long it was held."""
    run = cell.honest_run(seed)
    wrong = run.source.wrong
    return seed, "" if wrong is None else wrong.says, float(np.mean([bool(why) for why in run.log.why]))


def honest(pool: Any, runs: int, end_s: float) -> None:
    """Print how many honest runs were stopped."""
    found = []
    for one in pool.imap_unordered(honest_of, range(1, runs + 1)):
        found.append(one)
        if one[1]:
            print(f"false stop: seed {one[0]}: {one[1]}", flush=True)
        if time.perf_counter() > end_s:
            break
    held = 100.0 * float(np.mean([row[2] for row in found]))
    rows = [(len(found), sum(bool(row[1]) for row in found), held)]
    table(
        "Honest cameras on the flange, hands of up to 0.5 m/s, targets hidden for 0.1 to 1 s",
        ("runs", "stops", "held, mean %"),
        rows,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["wrong", "honest"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--hand", type=float, default=0.0)
    parser.add_argument("--minutes", type=float, default=1e9, help="print what is done by then")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    print(machine())
    begun_s = time.perf_counter()
    end_s = begun_s + 60.0 * asked.minutes
    with multiprocessing.get_context("fork").Pool(asked.processes, initializer=os.nice, initargs=(10,)) as pool:
        if "wrong" in asked.parts:
            wrong(pool, asked.seeds, asked.hand, end_s)
        if "honest" in asked.parts:
            honest(pool, asked.runs, end_s)
    print(f"\n{time.perf_counter() - begun_s:.0f} s")


if __name__ == "__main__":
    main()
