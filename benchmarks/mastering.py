"""`armsight verify --mastering`: simulated crashes, ten poses each, and whether the joint that moved is named.

    OMP_NUM_THREADS=1 python benchmarks/mastering.py [--quick] [--kind "one joint"]

(Small matrices: a second thread of the linear algebra only stands in the way.)

A UR10 before cameras that measure a pose to 0.2 mm and 0.5 mrad. The simulated arm has its own forward kinematics
(benchmarks/verify.py). The poses are those that the product proposes. Crashes: one joint's zero off by 0.05 to 1
degree, none, or the tool bent by 1 to 10 mm and 0.2 to 3 degrees.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import Arm, dh_arm
from armsight.verify import Align, Measured
from armsight.verify.mastering import CANDIDATES, SPAN_RAD, check_mastering, propose
from bench import machine, table
from verify import BASE, MIDDLE, TOOL, UR10, true_flange

NOISE = np.array([2e-4, 5e-4])
KINDS = ("one joint", "nothing", "tool bent", "geometry off by 0.2 mm, 0.02 deg")


def nominal() -> Arm:
    rows = [(a, alpha, d, 0.0) for a, alpha, d in UR10]
    return dh_arm("ur10", rows, T_world_base=BASE, T_flange_tool=TOOL)


def crashed(kind: str, seed: int, how: Align) -> tuple[np.ndarray, RigidTransform, int, float]:
    """Return the true table, the true tool, which joint's zero moved (-1: none) and by how much in rad."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    dh = np.array([(a, alpha, d, 0.0) for a, alpha, d in UR10])
    joint, offset, tool = -1, 0.0, TOOL
    if kind == "one joint":
        joint = int(rng.choice(6 if how is Align.NONE else [1, 2, 3, 4]))
        offset = float(np.deg2rad(rng.uniform(0.05, 1.0)) * rng.choice([-1, 1]))
        dh[joint, 3] += offset
    elif kind == "tool bent":
        way, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        size, angle = 1e-3 * rng.uniform(1.0, 10.0), np.deg2rad(rng.uniform(0.2, 3.0))
        tool = TOOL * RigidTransform.from_components(size * way, Rotation.from_rotvec(angle * turn))
    elif kind != "nothing":
        dh[:, [0, 2]] += rng.normal(0.0, 2e-4, (6, 2))
        dh[:, 1] += rng.normal(0.0, np.deg2rad(0.02), 6)
    return dh, tool, joint, offset


def measured(dh: np.ndarray, tool: RigidTransform, q: np.ndarray, seed: int) -> Measured:
    rng = np.random.default_rng([seed, 99])
    T = BASE * RigidTransform.from_matrix(true_flange(dh, q)) * tool
    turn = Rotation.from_rotvec(rng.normal(0.0, NOISE[1], (len(q), 3)))
    return Measured(
        xyz_m=T.translation + rng.normal(0.0, NOISE[0], (len(q), 3)),
        rotation=(turn * T.rotation).as_matrix(),
        std=np.tile(np.repeat(NOISE, 3), (len(q), 1)),
    )


def crashes(n: int, kinds: tuple[str, ...]) -> None:
    """Print what is found of n crashes of each kind."""
    arm, rows = nominal(), []
    for told, how in (("base and tool known", Align.NONE), ("base and tool free", Align.BOTH)):
        rng = np.random.default_rng(5)
        plan = propose(arm, MIDDLE + rng.uniform(-SPAN_RAD, SPAN_RAD, (CANDIDATES, 6)), how, NOISE)
        for kind in kinds:
            found, off, missed = Counter[str](), [], []
            for seed in range(n):
                dh, tool, joint, offset = crashed(kind, seed, how)
                result = check_mastering(arm, plan.q, measured(dh, tool, plan.q, seed), how)
                right = joint >= 0 and result.cause == f"joint {joint + 1}"
                found["right joint" if right else result.cause] += 1
                if right and result.offset is not None and result.std is not None:
                    off.append((result.offset - offset) / result.std)
                elif joint >= 0:
                    missed.append(f"{seed}: joint {joint + 1} by {np.rad2deg(offset):.3f} deg: {result.cause}")
            z = np.abs(off)
            far = f"{np.sqrt(np.mean(z**2)):.2f}, {z.max():.2f}, {(z > 3).sum()}" if off else "-"
            rows.append([told, kind, ", ".join(f"{k} {v}" for k, v in found.most_common()), far])
            print(f"{told}, {kind}: {rows[-1][2]}; {far}", flush=True)
            for text in missed[:5]:
                print(f"  missed {text}", flush=True)
        std = ", ".join("-" if not np.isfinite(s) else f"{np.rad2deg(s):.4f}" for s in plan.expected)
        print(f"{told}: standard deviations of the zeros to expect, deg: {std}")
    table(
        f"{n} crashes each, ten poses",
        ["", "crash", "found", "error of the zero over its standard deviation: RMS, largest, beyond 3"],
        rows,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="20 crashes each")
    parser.add_argument("--kind", choices=KINDS, action="append")
    told = parser.parse_args()
    print(machine())
    crashes(20 if told.quick else 200, tuple(told.kind or KINDS))


if __name__ == "__main__":
    main()
