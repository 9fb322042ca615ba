"""Speed and limits of a guarded arm behind links that lose, delay and bunch packets, by the controller's own time.

python benchmarks/lossy_links.py [alter] [egm] [rsi] [rtde] [--histories 300] [--fault pace | confirm]

Prints, for each link, the largest speed over any three cycles of the controller as a share of its limit, of the motors
and of where they are told to go, and by how much a range or a wall was passed. --fault takes a rule away, to see that
the judge finds it. The judge has its own kinematics (tests/truth/lossy_links.py).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.truth.lossy_links import SPEED_TOLERANCE, WINDOW, Found, history


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=["alter", "egm", "rsi", "rtde"])
    parser.add_argument("--histories", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fault", default="")
    args = parser.parse_args()
    for kind in args.kinds:
        found, begun_s = Found(), time.monotonic()
        for seed in range(args.seed, args.seed + args.histories):
            history(kind, seed, found, fault=args.fault)
        print(
            f"{kind}: {found.histories} histories, {found.cycles} cycles, {found.moved} in motion, {found.lost} "
            f"packets lost, {found.stopped} stopped; {time.monotonic() - begun_s:.0f} s"
        )
        print(
            f"  largest speed over {WINDOW} cycles: joints {found.joint_ratio:.3f} of their limit, tool "
            f"{found.tool_ratio:.3f}; {found.too_fast} histories beyond {1.0 + SPEED_TOLERANCE:g}"
        )
        print(
            f"  beyond a joint's range by {1e3 * found.joint_beyond:.3f} mrad at most, beyond a wall by "
            f"{1e3 * found.wall_beyond_m:.3f} mm; {found.beyond} times by more than rounding",
            flush=True,
        )


if __name__ == "__main__":
    main()
