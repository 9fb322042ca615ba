"""Faults of every kind that strangers' data had, planted anew in a world of its own: is any wrong answer called good?

    python benchmarks/fresh_faults.py [--kind 3] [--only WORDS] [--verbose]

Right: the answer is right in spite of the fault, within 1.5 times what it claims. Refused or told: by its true cause.
Told otherwise: by another cause. Wrong called good: exit code 0 with --check, and nothing said. Healthy controls must
be right and good. Each case's command runs as its user would type it.
"""

from __future__ import annotations

import argparse
from collections import Counter

import bench
import fresh_arms
import fresh_cameras
import fresh_clocks
import fresh_fits
import fresh_lost
import fresh_valid
from fresh_judge import CASES, KINDS, REFUSED, RIGHT, TOLD, VERDICTS, WRONG, Found, judged

MODULES = (fresh_arms, fresh_cameras, fresh_clocks, fresh_fits, fresh_lost, fresh_valid)
"""Each adds its cases as it is imported."""


def line(found: Found) -> str:
    off = "no answer" if found.miss is None else f"{found.miss:.2g} claims off"
    kind = "healthy, " if found.case.healthy else ""
    return f"- {found.case.name} ({kind}{KINDS[found.case.kind]}): {found.verdict}, exit {found.exit_code}, {off}"


def rows(done: list[Found]) -> list[list[object]]:
    out: list[list[object]] = []
    for kind, name in KINDS.items():
        planted = Counter(f.verdict for f in done if f.case.kind == kind and not f.case.healthy)
        controls = Counter(f.verdict for f in done if f.case.kind == kind and f.case.healthy)
        good = f"{controls[RIGHT]} of {controls.total()}"
        out.append([name, planted.total(), *(planted[v] for v in VERDICTS if v != REFUSED), good])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", type=int, choices=KINDS)
    parser.add_argument("--only", default="", help="cases whose name holds these words")
    parser.add_argument("--verbose", action="store_true", help="what the product printed, of every case")
    asked = parser.parse_args()
    done: list[Found] = []
    for case in CASES:
        if (asked.kind in {None, case.kind}) and asked.only in case.name:
            done.append(judged(case))
            if asked.verbose or done[-1].verdict not in {RIGHT, TOLD}:
                print(line(done[-1]), f"{done[-1].seconds:.1f} s", flush=True)
                print(f"    {done[-1].text[-1500 if asked.verbose else -700 :]}", flush=True)
    bench.table(
        "Faults planted anew", ["kind", "planted", *(v for v in VERDICTS if v != REFUSED), "healthy right"], rows(done)
    )
    print(f"{len(done)} cases, {sum(f.verdict == WRONG for f in done)} wrong and called good")
    print(*(line(f) for f in done if f.verdict not in {RIGHT, TOLD}), sep="\n")


if __name__ == "__main__":
    main()
