"""How often `calibrate arm` takes another arm's nominal figures for this arm's, and the other way round.

    python benchmarks/other_arm.py [--runs N] [--only TEXT]

Arms are simulated by a generator of its own (Denavit-Hartenberg matrices, no code of the package), built to a
tolerance, and measured at one tool point with 0.1 mm of noise per coordinate. Told: the verdict says, or the refusal,
that the nominal figures are another arm's. Named: with a parameter that is wrong, first.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, calibrate_arm
from armsight.errors import DataRefused
from armsight.kinematics import Arm, in_convention, preset
from bench import machine, table

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator], float]

WHERE = RigidTransform.from_components([0.4, -0.2, 0.7], Rotation.from_rotvec([0.3, -0.5, 1.1])).as_matrix()
NOISE_M = 1e-4


@dataclass(frozen=True)
class Case:
    """What is built, what is given as nominal, which parameters are rightly named first, and how it is measured."""

    name: str
    built: Arm
    nominal: Arm
    wrong: tuple[str, ...]
    length: Draw
    rows: int = 40
    reach: float = 1.4
    zero_rad: float = np.deg2rad(0.3)
    noise_m: float = NOISE_M


def makers(rng: np.random.Generator) -> float:
    """Return a maker's deviation of a length in m: 0.3 mm."""
    return float(rng.normal() * 3e-4)


def by_hand(rng: np.random.Generator) -> float:
    """Return a rebuilt arm's: 1 to 3 mm, to either side."""
    return float(rng.uniform(1e-3, 3e-3) * rng.choice([-1.0, 1.0]))


def typed(name: str, joint: int, **values: float) -> Arm:
    """Return an arm known by name with one figure typed wrong."""
    arm = preset(name)
    changed = tuple(replace(j, **values) if k == joint else j for k, j in enumerate(arm.joints, 1))  # type: ignore[arg-type]
    return replace(arm, name="typed", joints=changed)


def measured(case: Case, seed: int) -> ArmPoints:
    """Return measurements of one arm of this case."""
    rng = np.random.default_rng(seed)
    arm, n = in_convention(case.built, "standard"), case.rows
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    middle, half = (low + high) / 2, np.minimum((high - low) / 2, case.reach)
    q = middle + rng.uniform(-1.0, 1.0, (n, arm.n)) * half
    T = np.tile(WHERE, (n, 1, 1))
    for k, joint in enumerate(arm.joints):
        a, d = joint.a_m + case.length(rng), joint.d_m + case.length(rng)
        alpha = joint.alpha_rad + rng.normal() * np.deg2rad(0.05)
        theta = joint.sign * q[:, k] + joint.theta_rad + rng.normal() * case.zero_rad
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        A = np.zeros((n, 4, 4))
        A[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
        A[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
        A[:, 2, 1], A[:, 2, 2], A[:, 2, 3], A[:, 3, 3] = sa, ca, d, 1.0
        T = T @ A
    tool = rng.normal([0.0, 0.0, 0.1], 0.06)
    return ArmPoints(q=q, xyz_m=T[:, :3, :3] @ tool + T[:, :3, 3] + rng.normal(0.0, case.noise_m, (n, 3)))


def cases() -> list[Case]:
    """Return the right nominal figures, then the wrong ones."""
    right = [
        Case(f"{name}, built to 0.3 mm", preset(name), preset(name), (), makers)
        for name in ("ur5e", "ur10", "kr6", "panda", "iiwa14", "irb120")
    ]
    right += [
        Case(f"{name}, lengths off by 1-3 mm, zeros by 2 deg", preset(name), preset(name), (), by_hand, zero_rad=0.035)
        for name in ("ur5e", "kr6", "irb120")
    ]
    right += [
        Case("ur5e, 15 rows, 0.3 mm", preset("ur5e"), preset("ur5e"), (), makers, rows=15),
        Case("ur5e, 1-3 mm, 15 rows of small reach, 1 mm of noise", preset("ur5e"), preset("ur5e"), (), by_hand,
             rows=15, reach=0.6, noise_m=1e-3),
    ]  # fmt: skip
    d4 = ("j4.d_m",)
    wrong = [
        Case(f"{built} as {nominal}", preset(built), preset(nominal), d4, makers)
        for built, nominal in (("ur5e", "ur5"), ("ur5", "ur5e"), ("ur10", "ur10e"), ("ur10e", "ur10"), ("ur3e", "ur3"))
    ]
    wrong += [
        Case("ur10e as ur16e", preset("ur10e"), preset("ur16e"), ("j2.a_m", "j3.a_m"), makers),
        Case("panda as iiwa14", preset("panda"), preset("iiwa14"), (), makers),
        Case("iiwa14 as panda", preset("iiwa14"), preset("panda"), (), makers),
        Case("KR 6 R700 as kr6 (R900)", _r700(), preset("kr6"), ("j2.a_m", "j4.d_m"), makers),
        Case("ur5e, 425 typed as 452", preset("ur5e"), typed("ur5e", 2, a_m=-0.452), ("j2.a_m",), makers),
        Case("irb120, 302 typed as 320", preset("irb120"), typed("irb120", 4, d_m=0.320), ("j4.d_m",), makers),
        Case("kr6, 35 typed as 25", preset("kr6"), typed("kr6", 3, a_m=0.025), ("j3.a_m",), makers),
        Case("panda, 384 typed as 348", preset("panda"), typed("panda", 5, d_m=0.348), ("j5.d_m",), makers),
        Case("ur5e as ur5, 15 rows", preset("ur5e"), preset("ur5"), d4, makers, rows=15),
        Case("ur5e as ur5, 20 rows of small reach", preset("ur5e"), preset("ur5"), d4, makers, rows=20, reach=0.7),
        Case("ur5e as ur5, 1 mm of noise", preset("ur5e"), preset("ur5"), d4, makers, noise_m=1e-3),
    ]
    return right + wrong


def _r700() -> Arm:
    """Return a KR 6 R700 sixx: 315 and 365 mm in place of 455 and 420."""
    arm = preset("kr6")
    j = list(arm.joints)
    j[1], j[3] = replace(j[1], a_m=0.315), replace(j[3], d_m=0.365)
    return replace(arm, name="kr6r700", joints=tuple(j))


def count(case: Case, runs: int) -> list[object]:
    """Return a row of the table: told, named, BETTER, no gain."""
    told = named = better = 0
    for seed in range(runs):
        try:
            result = calibrate_arm(case.nominal, measured(case, seed))
        except DataRefused as error:
            text = str(error)
            told += 1
            named += any(f"of this arm: {name}" in text or f"; {name}" in text for name in case.wrong)
            continue
        better += result.gain
        if result.other_arm is not None:
            told += 1
            named += bool(result.other_arm.found) and result.other_arm.found[0].name in case.wrong
    return [case.name, case.rows, told, named if case.wrong else "-", better, runs - told - better]


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--only", default="", help="Cases whose name holds this text.")
    options = parser.parse_args()
    machine()
    rows = [count(case, options.runs) for case in cases() if options.only in case.name]
    table(
        f"Another arm's nominal figures: {options.runs} simulated arms each",
        ["case", "rows", "told as another arm", "with the wrong figure first", "BETTER", "no gain"],
        rows,
    )


if __name__ == "__main__":
    main()
