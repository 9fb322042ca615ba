"""Coupled readings that `identify` suggests: of arms with a planted coupling, and of arms without any.

    python benchmarks/identify_coupling.py [--arms N]

The arms are simulated here by Denavit-Hartenberg matrices of this file's own: 3 to 6 joints, a beacon, sweeps of 12
readings with 0.2 mm of noise. Coupled: joint 3 moves along by 0.05 of joint 2's reading.
"""

from __future__ import annotations

import argparse

import numpy as np

from armsight.calibrate.identify import Sweeps, identify
from armsight.errors import ArmsightError
from bench import machine, table

NOISE_M = 2e-4


def place(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the beacon (3,) of rows (theta, d, a, alpha) at joint values."""
    x = np.zeros(3)
    for (theta, d, a, alpha), value in zip(rows[::-1], values[::-1], strict=True):
        c, s, ca, sa = np.cos(value + theta), np.sin(value + theta), np.cos(alpha), np.sin(alpha)
        x = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]]) @ x + [a * c, a * s, d]
    return x


def sweeps(seed: int, share: float) -> Sweeps:
    """Return the sweeps of a random arm whose joint 3 moves along by a share of joint 2's reading."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    rows = np.stack(
        [rng.uniform(-1, 1, n), rng.uniform(-0.3, 0.3, n), rng.uniform(0.1, 0.4, n), rng.uniform(0.5, 2.6, n)], axis=1
    )
    joint = np.repeat(np.arange(n), 12)
    q = np.tile(rng.uniform(-0.4, 0.4, n), (12 * n, 1))
    q[np.arange(12 * n), joint] = np.tile(np.linspace(-1.0, 1.2, 12), n)
    values = q.copy()
    values[:, 2] += share * q[:, 1]
    xyz = np.array([place(rows, row) for row in values])
    return Sweeps(joint=joint, q=q, xyz_m=xyz + rng.normal(0.0, NOISE_M, xyz.shape))


def count(arms: int, share: float) -> list[object]:
    """Return the counts of suggestions: the right pair, another, none, refused."""
    right = other = none = refused = 0
    for seed in range(arms):
        try:
            notes = identify(sweeps(seed, share)).notes
        except ArmsightError as error:
            refused += 1
            notes = (str(error),)
        said = [note for note in notes if "look coupled" in note or "times its readings" in note]
        hit = any("joint 3 moves along" in note and "of joint 2's" in note for note in said)
        right, other, none = right + hit, other + (bool(said) and not hit), none + (not said)
    return [share, arms, right, other, none, refused]


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=50)
    arms = parser.parse_args().arms
    print(machine())
    rows = [count(arms, share) for share in (0.0, 0.02, 0.05, 0.2)]
    table("Coupling suggested", ["share planted", "arms", "the right pair", "another", "none", "of all: refused"], rows)


if __name__ == "__main__":
    main()
