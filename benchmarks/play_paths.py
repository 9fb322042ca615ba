"""Random paths planned, run and judged from outside: what was told of each, and what the arm was sent.

    python benchmarks/play_paths.py [--paths 500] [--seed 0] [--peer]

Lines, arcs, weaves and tools that turn by up to 360 degrees, also in one place, for five arms and limits of many kinds;
half of them at an override that changes in every cycle or in steps, with pauses. The judge (tests/truth/play_paths.py)
has its own kinematics and knows what was sent. Time is simulated: only how long planning takes depends on this machine.

--peer: the durations beside those of toppra, where it is installed, for the same joints' ways under the joints' limits
of speed and acceleration alone. toppra keeps no limit of jerk, nor room for overrides.
"""

from __future__ import annotations

import argparse
import re
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from armsight.control.guard.limits import joint_bounds
from armsight.control.play import plan_path
from armsight.control.play.timing import timed
from armsight.errors import DataRefused, UsageError
from armsight.units import MM, MS
from bench import machine, table, test_scene

FREE = 1e3  # m/s, rad/s and more: a limit of the tool that binds nowhere


def compared(world, seeds: range) -> list[list[object]]:
    """Return rows on durations and planning times of ours and toppra's."""
    import toppra
    from toppra import algorithm, constraint

    toppra.setup_logging("ERROR")
    ours, theirs, ours_ms, theirs_ms = [], [], [], []
    for seed in seeds:
        case = world.cases(seed)
        try:
            plan = plan_path(case.path, case.arm, case.limits, case.q, case.settings)
        except (DataRefused, UsageError):
            continue
        way, bounds = plan.track.samples, joint_bounds(case.arm, case.limits)
        free = replace(
            case.limits,
            **dict.fromkeys(("speed_m_s", "turn_rad_s", "acceleration_m_s2", "turn_acceleration_rad_s2"), FREE),
            **dict.fromkeys(("jerk_m_s3", "turn_jerk_rad_s3"), 100.0 * FREE),
        )
        way = replace(way, wanted_m_s=np.full(len(way.u), FREE))
        begun = time.perf_counter()
        law, _ = timed(way, case.arm, free, bounds)
        ours_ms.append((time.perf_counter() - begun) / MS)
        begun = time.perf_counter()
        path = toppra.SplineInterpolator(way.u, way.q)
        limits = [
            constraint.JointVelocityConstraint(np.stack([-bounds.speed, bounds.speed], axis=1)),
            constraint.JointAccelerationConstraint(np.stack([-bounds.acceleration, bounds.acceleration], axis=1)),
        ]
        found = algorithm.TOPPRA(limits, path, gridpoints=way.u, parametrizer="ParametrizeConstAccel")
        trajectory = found.compute_trajectory(0.0, 0.0)
        theirs_ms.append((time.perf_counter() - begun) / MS)
        if trajectory is not None:
            ours.append(law.duration_s)
            theirs.append(float(trajectory.duration))
    ratio = np.array(ours) / np.array(theirs)
    return [
        ["duration, s, median", float(np.median(ours)), float(np.median(theirs)), float(np.median(ratio))],
        ["duration, ratio 5 % to 95 %", "", "", " to ".join(f"{x:.2f}" for x in np.quantile(ratio, [0.05, 0.95]))],
        [
            "timing, ms, median",
            *(float(np.median(x)) for x in (ours_ms, theirs_ms)),
            float(np.median(ours_ms) / np.median(theirs_ms)),
        ],
    ]


def why(refused: str) -> str:
    """Return the kind of trouble that a refusal names."""
    found = re.search(r"cannot run it: (\w+)", refused)
    return found[1] if found else refused[:60]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peer", action="store_true")
    asked = parser.parse_args()
    print(machine(), flush=True)
    world = test_scene("play_paths")
    seeds = range(asked.seed, asked.seed + asked.paths)
    if asked.peer:
        table("Joints' limits alone", ("", "armsight", "toppra", "ratio"), compared(world, seeds))
        return
    ran = []
    for seed in seeds:
        ran.append(world.run(world.cases(seed)))
        last = ran[-1]
        if last.faults or last.limited:
            print(f"seed {seed}: {', '.join(last.faults) or 'limited'}: {last}", flush=True)
        if len(ran) % 25 == 0:
            print(f"{len(ran)} paths, {sum(bool(one.faults) for one in ran)} not as told", flush=True)
    told = Counter(why(one.refused) for one in ran if one.refused)
    rows = []
    for arm in world.ARMS:
        of_arm = [one for one in ran if arm in one.arm]
        run = [one for one in of_arm if not one.refused]
        if not run:
            continue
        rows.append(
            [
                arm,
                len(run),
                len(of_arm) - len(run),
                sum(bool(one.faults) for one in run),
                sum(one.limited for one in run),
                max(one.off_m - one.told_m for one in run) / MM,
                max(one.speed for one in run),
                float(np.nanmax([abs(one.time - 1.0) for one in run])),
                sum(one.cycles for one in run),
            ]
        )
    head = (
        "arm",
        "run",
        "refused",
        "not as told",
        "limited cycles",
        "beyond told, mm",
        "speed / asked",
        "time off",
        "cycles",
    )
    table("Paths run, against what was told", head, rows)
    table("Refused before motion", ("why", "paths"), sorted(told.items(), key=lambda one: -one[1]))


if __name__ == "__main__":
    main()
