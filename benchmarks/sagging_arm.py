"""Joints that give way under the arm's weight: a humanoid's arm before a motion capture, and simulated arms.

    python benchmarks/sagging_arm.py [--data FOLDER] [--runs N]

FOLDER holds talos_left_arm_02_10_contact.csv and talos_full_v2.urdf, as examples/talos/data of
github.com/thanhndv212/figaroh-plus has them (the description is not free to be copied, so neither is here). Simulated
arms are those of tests/truth/test_sagging_arm.py: links, masses and springs of their own.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from armsight.calibrate.arm import ArmPoints, ArmResult, calibrate_arm
from armsight.calibrate.arm.model import ArmModel
from armsight.errors import DataRefused
from armsight.kinematics import Arm
from armsight.store.urdf import read_urdf
from bench import machine, table, test_scene

ARMS = test_scene("test_sagging_arm")

TRAINED = 44
DRAWS = 8


def talos(folder: Path) -> None:
    """Print errors at rows left out, of draws of 44 rows, with and without sag, with masses and without."""
    arm = read_urdf(folder / "talos_full_v2.urdf", tip="arm_left_7_link")
    with (folder / "talos_left_arm_02_10_contact.csv").open() as file:
        found = list(csv.DictReader(file))
    q = np.array([[float(row[joint.name]) for joint in arm.joints] for row in found])
    points = ArmPoints(q=q, xyz_m=np.array([[float(row[key]) for key in ("x1", "y1", "z1")] for row in found]))
    bare = replace(arm, joints=tuple(replace(joint, mass_kg=0.0) for joint in arm.joints))
    draws = {"first": np.arange(TRAINED)} | {
        f"draw {seed}": np.sort(np.random.default_rng(seed).permutation(len(q))[:TRAINED]) for seed in range(DRAWS)
    }
    rows = []
    for name, first in draws.items():
        rest = np.setdiff1d(np.arange(len(q)), first)
        with patch.object(ArmModel, "sags", ()):
            stiff = calibrate_arm(bare, points.take(first), holdout=points.take(rest))
        results = [calibrate_arm(each, points.take(first), holdout=points.take(rest)) for each in (bare, arm)]
        rows.append([name, 1e3 * stiff.left_before.mean_m, *(_told(one) for one in (stiff, *results))])
    header = ["rows", "nominal", "no sag", "one load at the flange", "the links' masses"]
    table(f"TALOS's left arm, {len(q)} rows: mean error in mm at rows left out of {TRAINED}", header, rows)
    whole = calibrate_arm(arm, points)
    soft = [joint for joint in whole.arm.joints if joint.compliance]
    print(
        f"all rows, cross-validated: {1e3 * whole.cross_before.mean_m:.2f} -> {1e3 * whole.cross_after.mean_m:.2f} mm"
    )
    print("compliance:", ", ".join(f"{joint.name} {1e3 * joint.compliance:.2f} mrad/Nm" for joint in soft))


def _told(result: ArmResult) -> str:
    kind = "another arm" if result.other_arm is not None else result.level
    return f"{1e3 * result.left_after.mean_m:.2f} ({kind})"


def simulated(runs: int) -> None:
    """Print how often sag is found, and how far compliance is off in its own standard deviations."""
    rows = []
    for name, compliance, nominal in (
        ("stiff, masses known", 0.0, ARMS.with_masses()),
        ("stiff, masses not known", 0.0, None),
        ("2e-4 rad/Nm, masses known", 2e-4, ARMS.with_masses()),
        ("4e-4 rad/Nm, masses known", 4e-4, ARMS.with_masses()),
        ("4e-4 rad/Nm, masses not known", 4e-4, None),
    ):
        rows.append([name, runs, *_counted(compliance, nominal, runs)])
    header = ["joints", "arms", "with sag", "refused", "median error / sigma", "largest", "mm left out before", "after"]
    table("Simulated arms of 44 rows, 0.4 mm of noise, zeros off by 0.1 degrees", header, rows)


def _counted(compliance: float, nominal: Arm | None, runs: int) -> list[object]:
    soft, refused, off, before, after = 0, 0, [0.0], [], []
    for seed in range(runs):
        try:
            result = ARMS.calibrated(seed, compliance, nominal=nominal, zero_rad=2e-3)
        except DataRefused:
            refused += 1
            continue
        refused += result.other_arm is not None
        soft += result.arm.compliant
        before.append(1e3 * result.left_before.mean_m)
        after.append(1e3 * result.left_after.mean_m)
        carried, std = result.model.carried, result.std()
        for k, joint in enumerate(result.arm.joints):
            if nominal is not None and f"{joint.name}.sag" in result.free:
                off.append(abs(joint.compliance - compliance * ARMS.SOFT[k]) * carried[k] / std[f"{joint.name}.sag"])
    known = nominal is not None and len(off) > 1
    figures = [float(np.median(off[1:])), max(off)] if known else ["-", "-"]
    return [soft, refused, *figures, float(np.mean(before)), float(np.mean(after))]


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    told = parser.parse_args()
    machine()
    if told.data is None or not told.data.is_dir():
        print("\nTALOS's measurements are not there and skipped")
    else:
        talos(told.data)
    simulated(told.runs)


if __name__ == "__main__":
    main()
