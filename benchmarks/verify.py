"""`armsight verify`: a real arm before a laser tracker, injected errors found, time offsets found.

    python benchmarks/verify.py [--quick] [--only real|causes|offsets]

The simulated arms have their own forward kinematics, written here: nothing of what is tested makes the truth.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import calibrate_arm
from armsight.calibrate.arm.points import ArmPoints
from armsight.kinematics import Arm, dh_arm, preset
from armsight.store.verify_files import read_measured
from armsight.verify import Align, Measured, Reported, Verification, verify
from bench import machine, table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "ur10_tmac"
UR10 = (
    (0.0, np.pi / 2, 0.1273),
    (-0.612, 0.0, 0.0),
    (-0.5723, 0.0, 0.0),
    (0.0, np.pi / 2, 0.163941),
    (0.0, -np.pi / 2, 0.1157),
    (0.0, 0.0, 0.0922),
)
NOISE_M, NOISE_RAD = 1e-4, 2e-4
POSES = 60
MIDDLE = np.array([0.0, -1.2, 1.5, -0.5, 1.0, 0.0])
BASE = RigidTransform.from_components([2.0, 1.0, -0.5], Rotation.from_rotvec([0.3, 1.0, -2.0]))
TOOL = RigidTransform.from_components([0.05, -0.08, 0.12], Rotation.from_rotvec([0.5, 0.2, 0.1]))


def true_flange(dh: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return (m, 4, 4) for rows (a, alpha, d, theta), link after link."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (a, alpha, d, theta), angle in zip(dh, q.T, strict=True):
        c, s, ca, sa = np.cos(angle + theta), np.sin(angle + theta), np.cos(alpha), np.sin(alpha)
        A = np.zeros((len(q), 4, 4))
        A[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
        A[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
        A[:, 2, 1:] = sa, ca, d
        A[:, 3, 3] = 1.0
        T = T @ A
    return T


def measured_at(
    flange: np.ndarray, rng: np.random.Generator, turned: bool, said: bool, t_s: np.ndarray | None = None
) -> Measured:
    T = BASE * RigidTransform.from_matrix(flange) * TOOL
    m = len(flange)
    xyz = T.translation + rng.normal(0.0, NOISE_M, (m, 3))
    R = (Rotation.from_rotvec(rng.normal(0.0, NOISE_RAD, (m, 3))) * T.rotation).as_matrix()
    std = np.tile([NOISE_M] * 3 + [NOISE_RAD] * 3, (m, 1))
    return Measured(xyz_m=xyz, rotation=R if turned else None, std=std if said else None, t_s=t_s)


def nominal(known: bool) -> Arm:
    rows = [(a, alpha, d, 0.0) for a, alpha, d in UR10]
    return dh_arm("nominal", rows, **({"T_world_base": BASE, "T_flange_tool": TOOL} if known else {}))


def simulated(kind: str, seed: int, *, turned: bool, said: bool, how: Align) -> tuple[Verification, int, float]:
    rng = np.random.default_rng(seed)
    q = MIDDLE + rng.uniform(-1.2, 1.2, (POSES, 6))
    dh = np.array([(a, alpha, d, 0.0) for a, alpha, d in UR10])
    joint, offset = -1, 0.0
    if kind == "one joint zero":
        joint = int(rng.choice([1, 2, 3, 4] if how is Align.BOTH else 6))
        offset = float(np.deg2rad(rng.uniform(0.05, 1.0)) * rng.choice([-1, 1]))
        dh[joint, 3] += offset
    elif kind == "wrong geometry":
        dh[:, [0, 2]] += rng.normal(0.0, 5e-4, (6, 2))
        dh[:, 1] += rng.normal(0.0, np.deg2rad(0.05), 6)
    measured = measured_at(true_flange(dh, q), rng, turned, said)
    return verify(nominal(how is Align.NONE), Reported(q=q), measured, how), joint, offset


def causes(n: int) -> None:
    """Print which causes were found of injected ones."""
    rows = []
    for told, turned, said, how in (
        ("poses, base and tool free", True, True, Align.BOTH),
        ("poses, noise not said", True, False, Align.BOTH),
        ("positions, base and tool free", False, True, Align.BOTH),
        ("poses, base and tool known", True, True, Align.NONE),
    ):
        for kind in ("one joint zero", "good", "wrong geometry"):
            begun, found, off, missed = time.perf_counter(), Counter[str](), [], []
            for seed in range(n):
                result, joint, offset = simulated(kind, seed, turned=turned, said=said, how=how)
                cause = result.cause
                right = cause is not None and cause.cause == f"joint {joint + 1}"
                found["right joint" if right else "none" if cause is None else cause.cause] += 1
                if cause is not None and right:
                    verdict = cause.joints[joint]
                    off.append(abs(((verdict.offset or 0.0) - offset) / (verdict.std or 1.0)))
                elif kind == "one joint zero":
                    missed.append(f"{seed}: joint {joint + 1} by {np.rad2deg(offset):.3f} deg")
            far = f"{max(off):.2f}, {sum(x > 3 for x in off)} > 3" if off else "-"
            per = (time.perf_counter() - begun) / n
            rows.append([told, kind, ", ".join(f"{k} {v}" for k, v in found.most_common()), far, per])
            for text in missed[:5]:
                print(f"  missed {text}")
    table(f"Causes found, {n} arms each", ["measured", "injected", "found", "largest error / sigma", "s each"], rows)


def stream(seed: int, turned: bool) -> tuple[Reported, Measured, float]:
    """Joints at 125 Hz, poses at 100 Hz in bursts of ten with late stamps, 1 % of both lost, clocks up to 5 s apart."""
    rng = np.random.default_rng(seed)
    size, rate, phase = rng.uniform(0.05, 0.3, (6, 4)), rng.uniform(0.05, 0.4, (6, 4)), rng.uniform(0, 6, (6, 4))

    def q_at(t: np.ndarray) -> np.ndarray:
        return MIDDLE + (size * np.sin(2 * np.pi * rate * t[:, None, None] + phase)).sum(axis=2)

    offset = float(rng.uniform(-5.0, 5.0))
    t_q, t_m = np.arange(0.0, 40.0, 0.008), np.arange(3.0, 37.0, 0.01)[:3400]
    stamp = np.repeat(t_m[9::10] - offset + rng.normal(0.0, 1e-3, 340), 10)
    kept, held = rng.random(3400) > 0.01, rng.random(len(t_q)) > 0.01
    dh = np.array([(a, alpha, d, 0.0) for a, alpha, d in UR10])
    measured = measured_at(true_flange(dh, q_at(t_m[kept])), rng, turned, False, stamp[kept])
    return Reported(q=q_at(t_q[held]), t_s=t_q[held]), measured, offset


def offsets(n: int) -> None:
    """Print how well time offsets are found."""
    rows = []
    for turned in (True, False):
        off, sigma, begun = [], [], time.perf_counter()
        for seed in range(n):
            reported, measured, offset = stream(seed, turned)
            clock = verify(nominal(False), reported, measured, Align.BOTH).paired.clock
            off.append(1e3 * abs(clock.offset_s - offset) if clock is not None else np.inf)
            sigma.append(off[-1] / (1e3 * clock.std_s) if clock is not None else np.inf)
        within = f"{sum(x <= 2.0 for x in off)} of {n}"
        per = (time.perf_counter() - begun) / n
        name = "poses" if turned else "positions"
        rows.append([name, within, max(off), float(np.median(off)), float(np.sqrt(np.mean(np.square(sigma)))), per])
    header = ["measured", "within 2 ms", "largest ms", "median ms", "RMS error / sigma", "s each"]
    table("Time offsets of +-5 s, bursts of ten, 1 % lost", header, rows)


def real() -> None:
    """Print the figures of the UR10 before the laser tracker."""
    if not DATA.is_dir():
        print(f"\nThe real measurements are not there and skipped: {DATA.name}")
        return
    arm, files, rows = preset("ur10"), {}, []
    for name in ("grid", "configurations"):
        file = read_measured(DATA / f"{name}.csv")
        files[name] = file
        reported = file.reported
        if reported is None:
            raise SystemExit(f"{name}.csv has no joints")
        found = verify(arm, reported, file.measured, Align.BOTH, pose=file.pose)
        place, turn = (np.sqrt((found.task[:, k : k + 3] ** 2).sum(axis=1).mean()) for k in (0, 3))
        cause = found.cause.cause if found.cause is not None else "-"
        rows.append([name, len(found.task), 1e3 * place, np.rad2deg(turn), cause, len(found.rejected)])
        pairs = found.configurations
        if pairs is not None:
            print(
                f"{name}: {pairs.n} pairs of configurations differ by {1e3 * pairs.mean_m:.3f} mm in the mean, ", end=""
            )
            print(f"{1e3 * pairs.p95_m:.3f} (95 %), {1e3 * pairs.max_m:.3f} at most")
        open_ = [f"joint {i + 1}" for i, v in enumerate(found.cause.joints if found.cause else ()) if not v.judged]
        print(f"{name}: not determined: {', '.join([*found.undetermined, *open_])}")
    table("UR10 nominal, aligned", ["series", "rows", "mm RMS", "deg RMS", "cause", "rows left out"], rows)
    done = calibrate_arm(arm, points_of(files["grid"].measured, files["grid"].reported))
    corrected = []
    for name, each in (("nominal", arm), ("calibrated on the grid", done.arm)):
        file = files["configurations"]
        found = verify(each, file.reported or Reported(), file.measured, Align.BOTH, pose=file.pose)
        place, turn = (np.sqrt((found.task[:, k : k + 3] ** 2).sum(axis=1).mean()) for k in (0, 3))
        corrected.append([name, 1e3 * place, np.rad2deg(turn)])
    table("Configurations, left out of the calibration", ["arm", "mm RMS", "deg RMS"], corrected)


def points_of(measured: Measured, reported: Reported | None) -> ArmPoints:
    if reported is None or reported.q is None:
        raise SystemExit("no joints")
    return ArmPoints(q=reported.q[measured.rows - 1], xyz_m=measured.xyz_m, rotation=measured.rotation)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", choices=("real", "causes", "offsets"))
    told = parser.parse_args(words)
    machine()
    if told.only in (None, "real"):
        real()
    if told.only in (None, "causes"):
        causes(10 if told.quick else 200)
    if told.only in (None, "offsets"):
        offsets(5 if told.quick else 100)


if __name__ == "__main__":
    main()
