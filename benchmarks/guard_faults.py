"""A thousand faults of the simulated cell at random moments of servo-like and play-like motion (--trials).

Each trial ends where the arm rests in the state that its fault leads to. The judge uses the true arm's joints and the
simulator's own kinematics: largest share of each limit that was used, states in time or not. The trials are made in
tests/truth/test_guard_faults.py. Ends with exit code 1 where any trial is not as it shall be.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor

import bench

LIMITS = ("speed", "turning", "acceleration", "turning acceleration", "joint speed")


def run(job: tuple[str, str, int]) -> tuple[str, dict[str, float], list[str]]:
    """Run one trial: fault, motion, seed."""
    outcome = bench.test_scene("test_guard_faults").trial(*job)
    return job[0], outcome.used, [f"{job}: {fault}" for fault in outcome.faults]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--workers", type=int, default=None)
    asked = parser.parse_args()
    cases = bench.test_scene("test_guard_faults").CASES
    kinds = [(fault, motion) for fault, case in cases.items() for motion in case.motions]
    jobs = [(*kinds[i % len(kinds)], asked.first + i // len(kinds)) for i in range(asked.trials)]
    used: dict[str, list[dict[str, float]]] = defaultdict(list)
    wrong: list[str] = []
    with ProcessPoolExecutor(asked.workers) as pool:
        for fault, shares, faults in pool.map(run, jobs, chunksize=4):
            used[fault].append(shares)
            wrong += faults
    print(bench.machine())
    rows = []
    for fault, shares in used.items():
        most = [max(share[name] for share in shares) for name in LIMITS]
        rows.append([fault, str(cases[fault].ends), str(len(shares)), *(f"{100.0 * m:.0f}" for m in most)])
    bench.table("Largest share of each limit, in %", ["fault", "ends", "trials", *LIMITS], rows)
    print(f"\n{len(jobs)} trials, {len(wrong)} not as they shall be")
    print("\n".join(wrong))
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
