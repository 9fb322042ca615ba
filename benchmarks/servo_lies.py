"""What cameras that lie can do to the servo, by where the arm truly went; and whether honest ones are ever stopped.

    python benchmarks/servo_lies.py [lies] [honest] [pictures] [--seeds 200] [--minutes M] [--only NAME]

The cell, the lies and the judge are in tests/truth/servo_lies.py. Each seed is one run, of which half are with the
cameras on the flange, half with cameras that stand; from a random moment on each lie is told in a copy of it, and what
the tool then does by itself, away from where the honest copy has it, is the harm. pictures: the same with rendered
pictures of the room, of which the last is shown again and again with new stamps.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from armsight.units import MM
from bench import machine, table, test_scene

cell = test_scene("servo_lies")
BOUND_MM = 30.0


def lies_of(job: tuple[int, tuple[str, ...]]) -> list[tuple[str, int, str, Any]]:
    """Return the verdicts of all lies about one seed."""
    seed, names = job
    out, starts = [], {}
    for name in names:
        kind = cell.LIES[name]
        key = (kind.hand, kind.mount, kind.well, kind.frame_s)
        if key not in starts:
            start = cell.begun(seed, hand=kind.hand, mount=kind.mount, well=kind.well, frame_s=kind.frame_s)
            starts[key] = (start, cell.honest(start))
        start, honest = starts[key]
        out.append((name, start.mount.value, cell.judged(cell.told(name, start), honest)))
    return [(name, seed, mount, verdict) for name, mount, verdict in out]


def until(done: Iterable[Any], end_s: float) -> Iterator[Any]:
    """Yield what is done until a moment of the clock."""
    for one in done:
        yield one
        if time.perf_counter() > end_s:
            return


def lies(pool: Any, seeds: int, names: tuple[str, ...], end_s: float, show: bool) -> None:
    """Print a row for each lie, and for each way the cameras are mounted."""
    jobs = [(seed, names) for seed in range(1, seeds + 1)]
    found = [row for rows in until(pool.imap_unordered(lies_of, jobs), end_s) for row in rows]
    rows = []
    for name in names:
        mine = [(seed, mount, verdict) for told, seed, mount, verdict in found if told == name]
        for mount in sorted({mount for _, mount, _ in mine}):
            some = [(seed, verdict) for seed, where, verdict in mine if where == mount]
            way = np.array([verdict.way_m for _, verdict in some]) / MM
            away = np.array([verdict.away_m for _, verdict in some]) / MM
            turn = np.degrees([verdict.turn_rad for _, verdict in some])
            stopped = np.mean([verdict.stopped for _, verdict in some])
            over = int((way > BOUND_MM).sum())
            worst = (float(np.median(way)), float(way.max()), float(away.max()), float(turn.max()))
            rows.append((name, mount, len(some), *worst, 100.0 * float(stopped), over, cell.LIES[name].open))
            if show:
                for seed, verdict in sorted(some, key=lambda row: -row[1].way_m)[:5]:
                    print(name, mount, seed, f"{verdict.way_m / MM:.1f} mm", verdict.stopped, verdict.why)
    header = ("lie", "cameras", "runs", "way mm, median", "way mm, worst", "furthest mm", "turned deg, worst")
    table("Harmful way of the true tool", (*header, "stopped %", f"above {BOUND_MM:.0f} mm", "same as"), rows)


def honest_of(seed: int) -> tuple[int, bool, set[str], float, float]:
    """Return whether an honest run was stopped falsely, why it held, how long, and how far the target was at most."""
    log = cell.honest_run(seed)
    false = [why for why in log.why if cell.for_good(why)]
    off = np.array(log.off_m)[np.array(log.t_s) > 1.0]
    return seed, bool(false), set(false), float(np.mean([bool(why) for why in log.why])), float(np.median(off))


def honest(pool: Any, seeds: int, end_s: float) -> None:
    """Print how many honest runs came to a hold that only a fresh enable ends."""
    found = list(until(pool.imap_unordered(honest_of, range(1, seeds + 1)), end_s))
    for seed, false, why, _, _ in found:
        if false:
            print(f"false stop: seed {seed}: {sorted(why)}")
    held = np.array([row[3] for row in found])
    table(
        "Honest cameras, hands of up to 0.5 m/s, targets hidden for 0.1 to 1 s",
        ("runs", "false stops", "held, mean %", "off mm, median of medians"),
        [
            (
                len(found),
                sum(row[1] for row in found),
                100.0 * float(held.mean()),
                float(np.median([r[4] for r in found]) / MM),
            )
        ],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["lies", "honest"])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--minutes", type=float, default=1e9, help="print what is done by then")
    parser.add_argument("--only", action="append", help="a part of a lie's name")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--show", action="store_true", help="print the worst seeds of each lie")
    asked = parser.parse_args()
    print(machine())
    names = tuple(name for name in cell.LIES if not asked.only or any(part in name for part in asked.only))
    begun_s = time.perf_counter()
    with multiprocessing.get_context("fork").Pool(asked.processes, initializer=os.nice, initargs=(10,)) as pool:
        if "lies" in asked.parts:
            lies(pool, asked.seeds, names, begun_s + 60.0 * asked.minutes, asked.show)
        if "honest" in asked.parts:
            honest(pool, asked.seeds, begun_s + 60.0 * asked.minutes)
    print(f"\n{time.perf_counter() - begun_s:.0f} s")


if __name__ == "__main__":
    main()
