"""Random histories against the guard: arms inside and outside limits of every kind, asked for anything.

python benchmarks/guard_limits.py [--histories 10000]

Prints by how much a violation grew at most, for each kind of limit, and how often by more than rounding. The judge has
its own kinematics (tests/truth/guard_histories.py).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.truth.guard_histories import CYCLE_S, CYCLES, SLACK, Found, history


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args()
    found, begun_s = Found(), time.monotonic()
    for seed in range(args.seed, args.seed + args.histories):
        history(seed, found)
    print(
        f"{args.histories} histories of {CYCLES} cycles of {CYCLE_S * 1e3:g} ms, {found.outside} begun outside, "
        f"{found.refused} refused; {found.moved} of {found.cycles} cycles in motion; {time.monotonic() - begun_s:.0f} s"
    )
    for kind, worst in found.worst.items():
        print(f"{kind}: grew by {worst:.2e} at most, {found.grown[kind]} times by more than {SLACK:g}")


if __name__ == "__main__":
    main()
