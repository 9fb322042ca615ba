"""Controllers that take what they are sent otherwise than they should: how far the arm goes, and what is said of them.

python benchmarks/wrong_controllers.py [rsi] [egm] [alter] [rtde] [--trials 20] [--right 100]

On the controller's clock. Each trial has another posture, lag of the drives (0 to 50 ms), noise of the readings, axis.
Motion beyond the probe: of the joint that goes farthest, less what that of right controllers goes while the link is
proven. Of an RTDE link, what is behind ur-rtde: its program takes absolute joints alone, so that there only the cycle,
which it asks the controller for, can be another; the rest is what a controller would have to do to its own program.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from wrong_controller_trials import FAULTS, KINDS, Outcome, trial


def right(kind: str, trials: int) -> float:
    """Print how right controllers fare; return the largest way of any joint in degrees."""
    outcomes = [trial(kind, "", seed) for seed in range(trials)]
    proven_s = np.array([outcome.proven_s for outcome in outcomes])
    most = max(np.degrees(outcome.largest_rad) for outcome in outcomes)
    passed = int(np.isfinite(proven_s).sum())
    print(
        f"{kind}: right: {passed} of {trials} proven in {np.nanmedian(proven_s):.2f} s (at most "
        f"{np.nanmax(proven_s):.2f}), by a probe of {most:.3f} degrees at most",
        flush=True,
    )
    for outcome in outcomes:
        if not np.isfinite(outcome.proven_s):
            print(f"    {outcome.cause}")
    return float(most)


def wrong(kind: str, fault: str, trials: int, probe_deg: float) -> None:
    """Print how controllers with one fault fare."""
    outcomes = [trial(kind, fault, seed) for seed in range(trials)]
    beyond = max(0.0, *(float(np.degrees(o.largest_rad)) - probe_deg for o in outcomes))
    missed = [o for o in outcomes if not named(fault, o)]
    print(
        f"{kind}: {fault}: named in {trials - len(missed)} of {trials}, {sum(o.refused for o in outcomes)} not opened; "
        f"beyond the probe {beyond:.3f} degrees at most",
        flush=True,
    )
    for outcome in missed[:3]:
        print(f"    {outcome.cause or 'not found'}")


def named(fault: str, outcome: Outcome) -> bool:
    """Tell whether the cause was named."""
    return re.search(FAULTS[fault][1], outcome.cause) is not None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("links", nargs="*", default=["rsi", "egm", "alter", "rtde"])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--right", type=int, default=100)
    args = parser.parse_args()
    for kind in (kind for kind in KINDS if kind.split()[0] in args.links):
        probe_deg = right(kind, args.right)
        for fault in FAULTS:
            wrong(kind, fault, args.trials, probe_deg)


if __name__ == "__main__":
    main()
