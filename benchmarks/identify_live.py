"""Identification online: the accuracy told before moving beside that claimed and made, and what planning gains.

    python benchmarks/identify_live.py [--quick]

The rig and the arm of Kapucu and Baysec; pixels come from benchmarks/identify.py, which shares no code with the
product.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify import Sweeps, identify
from armsight.calibrate.identify.plan import expected_deviations, probe, propose_sweeps
from armsight.calibrate.identify.rough_arm import known_arm, rough_arm
from armsight.errors import DataRefused
from armsight.kinematics import preset
from bench import machine, table
from identify import NAMES, RIG, START, UNITS, WHERE, entries, pixels

Array = NDArray[np.float64]
BASE = WHERE.inv().as_matrix()
LIMITS = np.array([[-0.5, 5.2], [-0.4, 1.9], [0.3, 1.1]])
POSE = np.array([0.0, 1.6638, 0.9735])
LARGEST_SHARE = 0.4


def seen(joint: NDArray[np.intp], q: Array, sigma: float, rng: np.random.Generator) -> Sweeps:
    """Return readings with noise; the benchmark's own chain counts the slide from its start."""
    uv = pixels(START, q).reshape(-1, 2, 2)
    return Sweeps(joint=joint, q=q, xyz_m=np.zeros((len(q), 3)), uv_px=uv + rng.normal(0.0, sigma, uv.shape))


def wanted(expected: tuple[dict[str, float], ...]) -> Array:
    """Return the standard deviations of NAMES in their units."""
    one, two = expected[:2]
    return np.array([one["d_m"], one["a_m"], two["d_m"], two["a_m"], two["alpha_rad"]]) * UNITS


def probed(sigma: float, rng: np.random.Generator) -> tuple[Sweeps, float]:
    """Return the readings of probes grown as the product grows them, and the largest share of the travel used."""
    shares, todo = np.full(3, 0.05), [0, 1, 2]
    while True:
        poses = [probe(LIMITS, POSE, j, share=float(shares[j])) for j in range(3)]
        readings = seen(np.repeat([0, 1, 2], 6), np.concatenate(poses), sigma, rng)
        try:
            found = identify(readings, rig=RIG)
            todo = [j for j in range(3) if not found.joints[j].decided and shares[j] < LARGEST_SHARE]
        except DataRefused:
            todo = [j for j in range(3) if shares[j] < LARGEST_SHARE]
        if not todo:
            return readings, float(shares[:2].max())
        shares[todo] = np.minimum(2.0 * shares[todo], LARGEST_SHARE)


def announced(runs: int) -> None:
    """Print expected over claimed standard deviations, and the errors made over the expected ones."""
    rows = []
    for sigma in (0.02, 0.05, 0.2, 0.5):
        ratios, errors, shares, refused = [], [], [], 0
        for seed in range(runs):
            rng = np.random.default_rng(seed)
            try:
                readings, share = probed(sigma, rng)
                arm = rough_arm(identify(readings, rig=RIG), readings.q, RIG)
                plan = propose_sweeps(arm, RIG, LIMITS, POSE, base=BASE)
                q = np.concatenate([sweep.q for sweep in plan.sweeps])
                joint = np.repeat([sweep.joint for sweep in plan.sweeps], 10)
                error, claimed = entries(identify(seen(joint, q, sigma, rng), rig=RIG, base=BASE))
            except DataRefused:
                refused += 1
                continue
            ratios.append(wanted(plan.expected) / claimed)
            errors.append(error / wanted(plan.expected))
            shares.append(share)
        spread = np.sqrt(np.mean(np.square(errors), axis=0))
        told = [float(np.median(ratios)), f"{np.min(ratios):.2f} .. {np.max(ratios):.2f}"]
        rows.append(
            [f"{sigma} px", refused, f"{100 * np.median(shares):.0f} %", *told, *(f"{value:.2f}" for value in spread)]
        )
    table(
        f"RRP rig, {runs} runs: probe, plan, sweeps (wanted: told over claimed within 2; errors over told: 1)",
        ["noise", "refused", "probe of turning joints (median)", "told over claimed: median", "all runs",
         *(f"RMS error over told: {name}" for name in NAMES)],
        rows,
    )  # fmt: skip


def gained() -> None:
    """Print standard deviations of planned sweeps beside those of sweeps over the same limits from where the arm
    stands."""
    arm = known_arm(preset("stanford-rrp"), BASE, 0.2)
    planned = wanted(propose_sweeps(arm, RIG, LIMITS, POSE, base=BASE).expected)
    plain = np.concatenate([probe(LIMITS, POSE, j, share=1.0, readings=10) for j in range(3)])
    usual = wanted(expected_deviations(arm, RIG, plain, BASE)[0])
    table(
        "Deviations at 0.2 px, ten readings a joint, the same limits",
        ["sweeps", *NAMES],
        [["planned", *planned.tolist()], ["from the start pose", *usual.tolist()],
         ["ratio", *(usual / planned).tolist()]],
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    quick = parser.parse_args().quick
    print(machine())
    gained()
    announced(5 if quick else 50)


if __name__ == "__main__":
    main()
