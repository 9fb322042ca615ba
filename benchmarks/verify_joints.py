"""`armsight verify`: are joints of healthy arms blamed, and do a zero's deviations hold what lengths and axes may be?

    OMP_NUM_THREADS=1 python benchmarks/verify_joints.py [--arms 200] [--only "base and tool known"]

UR10s drawn at random: every length, axis and zero off by a normal deviation whose size is drawn too, from a tenth of a
millimetre and milliradian to twice that of a factory's. Half of the arms stay healthy, the other half have one joint
knocked by 0.1 to 1 degree. Workspaces of +-0.1, 0.25, 0.6 and 1.2 rad. The truth has forward kinematics of its own.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import Arm, dh_arm
from armsight.verify import Align, Measured, Reported, verify
from bench import machine, table
from verify import BASE, MIDDLE, TOOL, UR10

SPANS = (0.1, 0.25, 0.6, 1.2)
SIZES = (0.2, 0.5, 1.0)
"""Standard deviations of lengths in mm and of axes and zeros in mrad."""
NOISE_M, NOISE_RAD = (5e-5, 4e-4), (1e-4, 1e-3)
POSES = (30, 120)
MODES = {
    "base and tool known": (True, Align.NONE),
    "base and tool laid": (True, Align.BOTH),
    "positions, base and tool laid": (False, Align.BOTH),
}


def flange(rows: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return (m, 4, 4) for rows (a, alpha, d, theta, beta): Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)."""
    T = RigidTransform.from_translation(np.zeros((len(q), 3)))
    for (a, alpha, d, theta, beta), angle in zip(rows, q.T, strict=True):
        turn = angle + theta
        at = np.stack([a * np.cos(turn), a * np.sin(turn), np.full(len(q), d)], axis=1)
        R = Rotation.from_euler("Z", turn[:, None]) * Rotation.from_euler("XY", [alpha, beta])
        T = T * RigidTransform.from_components(at, R)
    return np.asarray(T.as_matrix())


def drawn(seed: int, knocked: bool) -> tuple[np.ndarray, int, float, np.random.Generator]:
    """Return the true rows (6, 5), which joint was knocked (-1: none), by how much in rad, and the generator."""
    rng = np.random.default_rng([seed, 471])
    size = 1e-3 * SIZES[seed % len(SIZES)]
    rows = np.array([(a, alpha, d, 0.0, 0.0) for a, alpha, d in UR10])
    rows[:, :4] += rng.normal(0.0, size, (6, 4))
    rows[1:3, 4] += rng.normal(0.0, size, 2)  # parallel axes
    joint, offset = -1, 0.0
    if knocked:
        joint = int(rng.integers(1, 5))
        offset = float(np.deg2rad(rng.uniform(0.1, 1.0)) * rng.choice([-1, 1]))
        rows[joint, 3] += offset
    return rows, joint, offset, rng


def nominal(known: bool) -> Arm:
    rows = [(a, alpha, d, 0.0) for a, alpha, d in UR10]
    return dh_arm("nominal", rows, **({"T_world_base": BASE, "T_flange_tool": TOOL} if known else {}))


def one(seed: int, span: float, knocked: bool, turned: bool, how: Align) -> tuple[str, int, float, list[float]]:
    """Return the cause, which joint was knocked and by how much, and each judged zero's error in its deviations."""
    rows, joint, offset, rng = drawn(seed, knocked)
    q = MIDDLE + rng.uniform(-span, span, (POSES[seed // 3 % 2], 6))
    T = BASE * RigidTransform.from_matrix(flange(rows, q)) * TOOL
    std = np.array([rng.uniform(*NOISE_M)] * 3 + [rng.uniform(*NOISE_RAD)] * 3)
    noise = rng.normal(0.0, std, (len(q), 6))
    R = (Rotation.from_rotvec(noise[:, 3:]) * T.rotation).as_matrix()
    said = np.tile(std, (len(q), 1)) if turned else None
    measured = Measured(xyz_m=T.translation + noise[:, :3], rotation=R if turned else None, std=said)
    cause = verify(nominal(how is Align.NONE), Reported(q=q), measured, how).cause
    if cause is None:
        return "none", joint, offset, []
    off = [
        abs(v.offset - rows[i, 3]) / max(v.std, 1e-12)
        for i, v in enumerate(cause.joints)
        if v.offset is not None and v.std is not None
    ]
    return cause.cause, joint, offset, off


def measure(mode: str, arms: int) -> list[list[object]]:
    turned, how = MODES[mode]
    lines: list[list[object]] = []
    for span in SPANS:
        for knocked in (False, True):
            found, off, wrong, small = Counter[str](), [], 0, []
            for seed in range(arms // 2):
                cause, joint, offset, errors = one(seed, span, knocked, turned, how)
                right = knocked and cause == f"joint {joint + 1}"
                named = cause.startswith("joint") or cause == "several joints"
                wrong += named and not right
                found["right joint" if right else "joint" if cause.startswith("joint") else cause] += 1
                off += errors
                if knocked and not right:
                    small.append(abs(np.rad2deg(offset)))
            inside = f"{100 * np.mean(np.array(off) < 1.96):.1f} %" if off else "-"
            worst = f"{max(off):.1f}" if off else "-"
            told = ", ".join(f"{k} {v}" for k, v in found.most_common())
            lines.append(
                [mode, f"{span:g}", "knocked" if knocked else "healthy", told, wrong, inside, worst,
                 f"{max(small):.2f}" if small else "-"]
            )  # fmt: skip
            print(*lines[-1], sep=" | ", flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--only", choices=MODES)
    args = parser.parse_args()
    machine()
    header = [
        "measured",
        "span rad",
        "arms",
        "told",
        "joints wrongly",
        "inside 95 %",
        "worst / std",
        "largest missed deg",
    ]
    lines = [line for mode in MODES if args.only in (None, mode) for line in measure(mode, args.arms)]
    table(f"Joints of arms whose geometry is off, {args.arms} arms at each workspace", header, lines)


if __name__ == "__main__":
    main()
