"""What `calibrate arm` claims for rows left out, against explicit refits and against the true arm at fresh positions.

    python benchmarks/calibrate_arm_crossval.py [--arms N] [--joints 3 6 10] [--good N]

The true arms are simulated here by Denavit-Hartenberg matrices of this file's own. Per arm:

refitted: the calibration as a person would repeat it, each fifth of the joint positions left out by hand, from the
file on, and the errors of those rows; wanted: claimed over refitted within 10 %.
fresh: errors of those same five arms at 200 joint positions that nobody has measured, measured with the same noise.
kept arm: errors of the arm that is kept, which has a quarter more rows; below the claim where rows are few.
one step: the claim without refits (one Gauss-Newton step from the fit to all rows), for comparison.

With --good N instead: how often a calibration of N arms that are exactly nominal is called a gain. Their measurements
have nothing but noise: normal, with heavy tails (Student's t of 3), or of joint positions (both points of a position
are off alike, twice the rest). Wanted: at most 5 %.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.arm import ArmPoints, ArmResult, calibrate_arm
from armsight.calibrate.arm.model_selection import FOLDS, left_out
from armsight.errors import ArmsightError
from armsight.kinematics import Arm, Joint
from bench import machine, table

NOISE_M = 1.3e-4
TWISTS = np.array([0.5, 0.0, 0.5, -0.5, 0.5, 0.0, -0.5, 0.5, 0.0, 0.5]) * np.pi
NOISES: dict[str, Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "heavy tails": lambda rng, shape: rng.standard_t(3, size=shape),
    "of joint positions": lambda rng, shape: rng.normal(size=shape) + 2.0 * rng.normal(size=(shape[0], 1, 3)),
}


class TrueArm:
    """A chain with zeros off by 0.5 degrees and lengths by 0.5 mm, two points on its tool, somewhere."""

    def __init__(self, n: int, seed: int, off: float = 1.0) -> None:
        """Draw the arm of n joints; off: how far from nominal, as a share of the above."""
        rng = np.random.default_rng([n, seed])
        links = np.stack([np.zeros(n), rng.uniform(0.05, 0.3, n), rng.uniform(0.0, 0.3, n), TWISTS[:n]], axis=1)
        self.nominal = Arm(
            name=f"chain{n}",
            joints=tuple(
                Joint(name=f"j{i}", theta_rad=t, d_m=d, a_m=a, alpha_rad=w) for i, (t, d, a, w) in enumerate(links, 1)
            ),
        )
        self.rows = links + rng.normal(size=(n, 4)) * [np.deg2rad(0.5), 5e-4, 5e-4, np.deg2rad(0.1)] * np.array(off)
        self.points = rng.normal([0.0, 0.0, 0.1], 0.06, (2, 3))
        self.R, self.t = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
        self.rng = rng

    def measured(self, m: int, noise: str = "normal") -> ArmPoints:
        """Return both points at m joint positions, with noise: of NOISES."""
        n = len(self.rows)
        q = self.rng.uniform(-1.2, 1.2, (m, n))
        xyz = np.empty((m, 2, 3))
        for k in range(m):
            x = self.points
            for (theta, d, a, alpha), value in zip(self.rows[::-1], q[k, ::-1], strict=True):
                c, s, ca, sa = np.cos(value + theta), np.sin(value + theta), np.cos(alpha), np.sin(alpha)
                R = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
                x = x @ R.T + [a * c, a * s, d]
            xyz[k] = x @ self.R.T + self.t
        xyz += NOISE_M * NOISES[noise](self.rng, xyz.shape)
        return ArmPoints(q=np.repeat(q, 2, axis=0), xyz_m=xyz.reshape(-1, 3), point=("A", "B") * m)


def rms(size: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(size**2)))


def sizes(result: ArmResult, points: ArmPoints) -> np.ndarray:
    """Return the errors (m,) of the arm kept, in m."""
    return np.linalg.norm(result.model.errors(result.fitted.p, points)[0], axis=1)


def one_arm(n: int, m: int, seed: int) -> tuple[float, float, float, float, float]:
    """Return claimed over refitted, claimed over fresh, kept arm's over claimed, one step over refitted, seconds."""
    true = TrueArm(n, seed)
    points, fresh = true.measured(m), true.measured(200)
    start = time.process_time()
    result = calibrate_arm(true.nominal, points)
    spent = time.process_time() - start
    fold = points.position % FOLDS
    refitted, unseen = np.empty(len(points)), []
    for k in range(FOLDS):
        again = calibrate_arm(true.nominal, points.take(np.flatnonzero(fold != k)))
        rows = np.flatnonzero(fold == k)
        refitted[rows] = sizes(again, points.take(rows))
        unseen.append(sizes(again, fresh))
    claimed, by_hand = result.cross_after.rms_m, rms(refitted)
    step = rms(left_out(result.model, points, result.fitted))
    return (
        claimed / by_hand,
        claimed / rms(np.concatenate(unseen)),
        rms(sizes(result, fresh)) / claimed,
        step / by_hand,
        spent,
    )


def false_gains(arms: int, joints: Sequence[int]) -> None:
    """Print how often arms that are exactly nominal are called better with corrections."""
    rows = []
    for n in joints:
        for m in (n + 2, 5 * n):
            for noise in NOISES:
                levels: list[str] = []
                refused = 0
                for seed in range(arms):
                    true = TrueArm(n, 1000 + seed, off=0.0)
                    try:
                        result = calibrate_arm(true.nominal, true.measured(m, noise))
                    except ArmsightError as error:
                        refused += 1
                        print(f"{n} joints, arm {seed}, {noise}: {error}", file=sys.stderr)
                        continue
                    levels += [result.level] if result.gain else []
                said = ", ".join(sorted(set(levels)))
                judged = arms - refused
                rows.append([n, m, noise, judged, refused, len(levels), 100.0 * len(levels) / max(judged, 1), said])
                print(*rows[-1], file=sys.stderr, flush=True)
    total, false = sum(row[3] for row in rows), sum(row[5] for row in rows)
    rows.append(["all", "", "", total, sum(row[4] for row in rows), false, 100.0 * false / total, ""])
    table(
        "Arms that are exactly nominal: called better with corrections (wanted: at most 5 %)",
        ["joints", "positions", "noise", "arms judged", "refused", "called better", "%", "by"],
        rows,
    )


def main() -> None:
    """Print the ratios by number of joints and positions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--joints", type=int, nargs="*", default=[3, 4, 5, 6, 7, 8, 9, 10])
    parser.add_argument("--good", type=int, default=0, help="arms that are exactly nominal, in place of all else")
    given = parser.parse_args()
    print(machine())
    if given.good:
        false_gains(given.good, given.joints)
        return
    rows = []
    for n in given.joints:
        for m in (5 * n, 10 * n):
            found, refused = [], 0
            for seed in range(given.arms):
                try:
                    found.append(one_arm(n, m, seed))
                except ArmsightError as error:
                    refused += 1
                    print(f"{n} joints, arm {seed}: {error}", file=sys.stderr)
            told = [f"{np.median(x):.3f} ({min(x):.3f}-{max(x):.3f})" for x in zip(*found, strict=True)]
            off = sum(not 0.9 <= x[0] <= 1.1 for x in found)
            rows.append([n, m, *told[:4], off, refused, told[4].split()[0]])
            print(*rows[-1], file=sys.stderr, flush=True)
    table(
        f"RMS of rows left out, {given.arms} arms each: median (range)",
        [
            "joints",
            "positions",
            "claimed / refitted",
            "claimed / fresh",
            "kept arm, fresh / claimed",
            "one step / refitted",
            "off by > 10 %",
            "refused",
            "CPU s",
        ],
        rows,
    )


if __name__ == "__main__":
    main()
