"""Identification: the rig of Kapucu and Baysec against the Cramer-Rao bound, random arms, real sweeps, time.

    python benchmarks/identify.py [--quick] [--only PART]

Truth and bound come from Denavit-Hartenberg matrices and pinholes written here; the bound is the numerical Fisher
information of 13 parameters with the joint values known (MATH 4.3's last column).
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.identify import Identification, Sweeps, even_ones, identify
from armsight.errors import DataRefused
from armsight.kinematics import fk
from armsight.ops.identification.solve import BeaconFrames
from armsight.ops.simulation.run import simulate
from armsight.optics import Camera, parallel_rig
from armsight.optics.parallelism import moved_rig
from armsight.records import NamedCovariance, Silent
from armsight.store import read_target
from armsight.store.arm_points import read_arm_points
from bench import machine, table

Array = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FU, FV, CX, CY, BASELINE = 757.6, 748.9, 319.5, 239.5, 0.126
RIG = parallel_rig(Camera.pinhole(640, 480, FU, FV, CX, CY), BASELINE)
WHERE = RigidTransform.from_components([2.618, -3.710, 0.785], Rotation.from_euler("ZYX", [36, 0, -90], degrees=True))
NAMES = ("d1 cm", "a1 cm", "d2 cm", "a2 cm", "alpha2 deg")
UNITS = np.array([100.0, 100.0, 100.0, 100.0, np.rad2deg(1.0)])
TRUTH = np.array([1.27, 0.0, -0.05, 0.1, np.pi / 2])
START = np.zeros(13)
START[6:] = 0.0, np.pi / 2, 0.0, -0.05, 0.1, np.pi / 2, 0.0


def step(theta: Array, d: Array, a: float, alpha: float) -> Array:
    """Return Denavit-Hartenberg matrices (m, 4, 4)."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    T = np.zeros((len(theta), 4, 4))
    T[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
    T[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
    T[:, 2, 1], T[:, 2, 2], T[:, 2, 3], T[:, 3, 3] = sa, ca, d, 1.0
    return T


def pixels(p: Array, q: Array) -> Array:
    """Return (m, 4): base moved by p[:6], then a1, alpha1, theta2, d2, a2, alpha2, d3."""
    m = len(q)
    T = step(q[:, 0], np.full(m, 1.27), p[6], p[7]) @ step(q[:, 1] + p[8], np.full(m, p[9]), p[10], p[11])
    X = T[:, :3, 3] + T[:, :3, 2] * (q[:, 2] + p[12])[:, None]
    X = Rotation.from_rotvec(p[3:6]).apply(X) + p[:3]
    X = WHERE.inv().apply(X)
    u, v = FU * X[:, 0] / X[:, 2] + CX, FV * X[:, 1] / X[:, 2] + CY
    return np.stack([u, v, u - FU * BASELINE / X[:, 2], v], axis=1)


def sweep(arc_deg: float) -> tuple[NDArray[np.intp], Array]:
    """Return joints and values of the rig's sweeps, ten readings each."""
    joint = np.repeat([0, 1, 2], 10)
    q = np.repeat([[0.0, np.deg2rad(95.33), 0.9735], [0.0, 0.0, 0.9548], [0.0, np.deg2rad(106.7), 0.0]], 10, axis=0)
    q[:10, 0] = np.deg2rad(np.linspace(0.0, 324.0, 10))
    q[10:20, 1] = np.deg2rad(np.linspace(106.7, 106.7 - arc_deg, 10))
    q[20:, 2] = np.linspace(0.6, 1.063, 10)
    return joint, q


def bound(q: Array, sigma: float) -> Array:
    """Return the Cramer-Rao standard deviations of NAMES in their units."""
    J = np.empty((4 * len(q), 13))
    for i in range(13):
        h = np.zeros(13)
        h[i] = 1e-6
        J[:, i] = (pixels(START + h, q) - pixels(START - h, q)).ravel() / 2e-6
    C = np.linalg.inv(J.T @ J) * sigma**2
    return np.sqrt(np.diag(C))[[2, 6, 9, 10, 11]] * UNITS


def entries(found: Identification) -> tuple[Array, Array]:
    """Return NAMES of an identified arm and their claimed standard deviations."""
    j, s = found.arm.joints, [one.std for one in found.joints]
    value = np.array([j[0].d_m, j[0].a_m, j[1].d_m, j[1].a_m, j[1].alpha_rad])
    claimed = np.array([s[0]["d_m"], s[0]["a_m"], s[1]["d_m"], s[1]["a_m"], s[1]["alpha_rad"]])
    return (value - TRUTH) * UNITS, claimed * UNITS


def kapucu(runs: int) -> None:
    """Print errors over the bound, the paper's method beside, and how often 95 % intervals hold."""
    rows, held = [], []
    for sigma in (0.05, 0.2, 0.5):
        for arc in (40.0, 60.0, 120.0):
            joint, q = sweep(arc)
            clean = pixels(START, q).reshape(-1, 2, 2)
            ours, sure, theirs, inside, refused, doubtful = [], [], [], [], 0, 0
            for seed in range(runs):
                uv = clean + np.random.default_rng(seed).normal(0.0, sigma, clean.shape)
                seen = Sweeps(joint=joint, q=q, xyz_m=np.zeros((len(q), 3)), uv_px=uv)
                try:
                    found = identify(seen, rig=RIG, base=WHERE.inv().as_matrix())
                except DataRefused:
                    refused += 1
                    continue
                error, claimed = entries(found)
                ours.append(error)
                if any("another arm explains" in note for note in found.notes):
                    doubtful += 1
                else:
                    sure.append(error)
                inside.append(np.abs(error) < 1.96 * claimed)
                if seed < runs // 4:
                    theirs.append(entries(identify(seen, rig=RIG, base=WHERE.inv().as_matrix(), method="paper"))[0])
            least = bound(q, sigma)
            rms = np.sqrt(np.mean(np.square(sure), axis=0)) / least
            held.append(np.mean(inside))
            typical = np.percentile(np.abs(ours), 68, axis=0)
            paper = np.percentile(np.abs(theirs), 68, axis=0)
            figures = (f"{a:.2f} ({r:.2f}) {b:.1f}" for a, r, b in zip(typical, rms, paper, strict=True))
            rows.append([f"{sigma} px, {arc:.0f} deg", refused, doubtful, *figures, f"{100 * held[-1]:.1f} %"])
    table(
        f"RRP rig, {runs} runs: 68 % error (RMS over Cramer-Rao bound, wanted 1.15, where no second arm is told), "
        "68 % error of the paper's method",
        ["noise, arc of joint 2", "refused", "said to be two arms", *NAMES, "95 % intervals hold"],
        rows,
    )


RIG_STD = np.array([0.25, 0.25, 0.3, 0.3, 0, 3e-4, 6e-4, 0, 0, 0] * 2 + [1.5e-5, 1.5e-5, 6e-5, 6e-5, 1e-4, 3e-5])
"""Of a rig calibrated with care: fx, fy, cx, cy px, k1, k2, then the right camera's place m and turn rad."""


def calibrated_anew(runs: int, sigma: float = 0.05) -> None:
    """Print how often 95 % intervals hold where each run has a rig calibrated anew, with its covariance and without."""
    joint, q = sweep(120.0)
    clean = pixels(START, q).reshape(-1, 2, 2)
    names = tuple(RIG.parameters)
    exact, claimed, coupled, off = [], [], 0, []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        seen = Sweeps(joint=joint, q=q, xyz_m=np.zeros((len(q), 3)), uv_px=clean + rng.normal(0.0, sigma, clean.shape))
        wrong = moved_rig(RIG, RIG_STD * rng.normal(size=len(names)))
        known = replace(wrong, covariance=NamedCovariance(names=names, matrix=np.diag(RIG_STD**2)))
        for rig, into in ((wrong, exact), (known, claimed)):
            try:
                found = identify(seen, rig=rig, base=WHERE.inv().as_matrix())
            except DataRefused:
                continue
            error, std = entries(found)
            into.append(np.abs(error) < 1.96 * std)
            if rig is known:
                off.append(error)
                coupled += any("coupled" in note or "times its readings" in note for note in found.notes)
    table(
        f"RRP rig calibrated anew in each of {runs} runs, {sigma} px, arc 120 deg: 95 % intervals hold",
        ["rig taken as", "runs", *NAMES],
        [[name, len(held), *(f"{100 * share:.1f} %" for share in np.mean(held, axis=0))]
         for name, held in (("exact", exact), ("its covariance", claimed))],
    )  # fmt: skip
    table("The same", ["false couplings", *(f"{name}, RMS" for name in NAMES)],
          [[coupled, *np.sqrt(np.mean(np.square(off), axis=0))]])  # fmt: skip


def pictures(runs: int) -> None:
    """Print how often 95 % intervals hold where a simulated cell is seen in pictures: skirting, shadows, tone curve."""
    held, over, claims, left_out, coupled, refused = [], [], [], 0, 0, 0
    for seed in range(runs):
        with TemporaryDirectory() as folder:
            cell = Path(folder) / "cell"
            simulate("kapucu2005-rrp", cell, seed=seed)
            frames = {"left": str(cell / "left"), "right": str(cell / "right"), "joints": cell / "sweep_joints.csv"}
            seen, _ = BeaconFrames(target=read_target(cell / "target.yaml"), **frames).sweeps(RIG, Silent())
        even, _ = even_ones(seen)
        left_out += len(seen) - len(even)
        try:
            found = identify(even, rig=RIG, base=WHERE.inv().as_matrix())
        except DataRefused:
            refused += 1
            continue
        error, std = entries(found)
        held.append(np.abs(error) < 1.96 * std)
        over.append(error / std)
        claims.append(std)
        coupled += any("coupled" in note or "times its readings" in note for note in found.notes)
    ratio = np.array(over)
    table(
        f"The cell in pictures, {runs} seeds: {refused} refused, {left_out} of {30 * runs} readings left out, "
        f"{coupled} false couplings",
        ["", *NAMES],
        [["95 % intervals hold", *(f"{100 * share:.1f} %" for share in np.mean(held, axis=0))],
         ["claimed, median", *np.median(claims, axis=0)],
         ["error over its claim, RMS", *np.sqrt(np.mean(ratio**2, axis=0))],
         ["error over its claim, mean", *ratio.mean(axis=0)],
         ["error over its claim, worst", *np.abs(ratio).max(axis=0)]],
    )  # fmt: skip
    print(f"  over all entries 95 % intervals hold {100 * np.mean(held):.1f} %")


def random_arm(rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Return rows theta, d, a, alpha (n, 4) of 3 to 7 joints, and which turn.

    Axes are skew, square, parallel, nearly parallel, meeting or coincident; the beacon is 0.25 m from the last one.
    """
    n = int(rng.integers(3, 8))
    alpha = np.where(rng.random(n) < 0.6, rng.choice([0.0, np.pi / 2, -np.pi / 2, 1e-3], n), rng.uniform(0.3, 2.8, n))
    a = np.where(rng.random(n) < 0.3, 0.0, rng.uniform(0.1, 0.5, n))
    a[-1] = 0.25
    return np.column_stack([rng.uniform(-1, 1, n), rng.uniform(-0.3, 0.3, n), a, alpha]), rng.random(n) < 0.7


def tip(rows: Array, turns: NDArray[np.bool_], q: Array) -> Array:
    """Return the beacon (m, 3) in base axes."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (theta, d, a, alpha), turn, value in zip(rows, turns, q.T, strict=True):
        still = np.zeros(len(q))
        T = T @ step(theta + (value if turn else still), d + (still if turn else value), a, alpha)
    return np.asarray(T[:, :3, 3])


def random_arms(count: int) -> None:
    """Print how random arms are told: types where decided, places at unseen joint values in claimed standard
    deviations."""
    decided, right, kept, ratios, single, joint3 = 0, 0, 0, [], [], []
    refused: Counter[str] = Counter()
    for seed in range(count):
        rng = np.random.default_rng(seed)
        rows, turns = random_arm(rng)
        n = len(rows)
        low = np.where(turns, rng.uniform(-1.2, -0.6, n), -0.15)
        high = np.where(turns, rng.uniform(0.8, 1.6, n), 0.25)
        joint = np.repeat(np.arange(n), 12)
        q = np.tile(rng.uniform(-0.4, 0.4, n), (12 * n, 1))
        q[np.arange(12 * n), joint] = np.concatenate([np.linspace(x, y, 12) for x, y in zip(low, high, strict=True)])
        xyz = tip(rows, turns, q) + rng.normal(0.0, 2e-4, (12 * n, 3))
        try:
            found = identify(Sweeps(joint=joint, q=q, xyz_m=xyz))
        except DataRefused as refusal:
            refused[str(refusal).split(" in the sweep")[0].split(" joint")[0]] += 1
            continue
        same = [one.axis.revolute == bool(t) for one, t in zip(found.joints, turns, strict=True)]
        decided += sum(one.decided for one in found.joints)
        right += sum(one.decided and ok for one, ok in zip(found.joints, same, strict=True))
        if not all(same) or found.uncertainty is None:
            continue
        further = rng.uniform(low, high, (20, n))
        off = fk(found.arm, further)[:, :3, 3] - tip(rows, turns, further)
        _, C = found.uncertainty.positions(further)
        ratios.append(np.linalg.norm(off, axis=1).max() / 2e-4)
        single.append(np.mean(np.abs(off) <= 3.0 * np.sqrt(np.einsum("mii->mi", C))))
        finite = np.isfinite(C[:, 0, 0])
        d2 = np.einsum("mi,mi->m", off[finite], np.linalg.solve(C[finite], off[finite][:, :, None])[:, :, 0])
        joint3.append(np.mean(d2 <= 14.16) if finite.any() else 1.0)
        kept += 1
    table(
        f"{count} random arms of 3 to 7 joints, all degenerate cases among them, 0.2 mm noise, 12 readings a joint",
        ["joints decided", "of these right", "arms compared", "largest error at unseen values over noise: median",
         "95 %", "coordinates within 3 sigma (99.7 % ideal)", "places in the 99.73 % ellipsoid"],
        [[decided, f"{100.0 * right / max(decided, 1):.3f} %", kept, float(np.median(ratios)),
          float(np.percentile(ratios, 95)), f"{100 * np.mean(single):.2f} %", f"{100 * np.mean(joint3):.2f} %"]],
    )  # fmt: skip
    table("Arms refused", ["why", "count"], [[why, number] for why, number in refused.most_common()])


def positioner() -> None:
    """Print the axes of the real positioner: from one sweep of each joint, and from all of them pooled."""
    if not DATA.is_dir():
        print("\nThe real measurements are not there and skipped.")
        return
    points = read_arm_points(DATA / "positioner" / "points.csv")
    label = [np.unique(np.round(points.q[:, j], 2), return_inverse=True)[1] for j in range(2)]
    rows = []
    for name, chosen in {"1": [1], "2": [2], "3": [3], "pooled": list(range(label[0].max() + 1))}.items():
        joint, at = [], []
        for j in range(2):  # every other value of the first joint serves its own sweeps, the rest the second's
            still = label[0] % 2 == j if name == "pooled" else np.isin(label[1 - j], chosen)
            order = np.flatnonzero(still)[np.lexsort((points.q[still, j], label[1 - j][still]))]
            at.append(order)
            joint.append(np.full(len(order), j))
        index = np.concatenate(at)
        q = points.q[index].copy()
        of = np.concatenate(joint)
        for j in range(2):  # what the resting joint reads differs by its encoder's noise
            for k in np.unique(label[1 - j]):
                same = (of == j) & (label[1 - j][index] == k)
                q[same, 1 - j] = q[same, 1 - j].mean() if same.any() else 0.0
        found = identify(Sweeps(joint=of, q=q, xyz_m=points.xyz_m[index]))
        link, std = found.arm.joints[0], found.joints[0].std
        rows.append([name, len(index), *(str(one.type) for one in found.arm.joints),
                     f"{1e3 * link.a_m:.2f} +- {1e3 * std['a_m']:.2f}",
                     f"{np.rad2deg(link.alpha_rad):.3f} +- {np.rad2deg(std['alpha_rad']):.3f}",
                     *(f"{1e3 * one.residual_rms_m:.3f}" for one in found.joints)])  # fmt: skip
    table("positioner, pairs of sweeps and all sweeps pooled (drawing: a 0 mm, alpha 90 deg)",
          ["pair", "readings", "joint 1", "joint 2", "a1 mm", "alpha1 deg", "residual 1 mm", "residual 2 mm"],
          rows)  # fmt: skip


def speed(repeats: int) -> None:
    """Print the time of one identification of the RRP arm."""
    rows = []
    for sigma in (0.05, 0.2, 0.5):
        for arc in (40.0, 60.0, 120.0):
            joint, q = sweep(arc)
            times = []
            for seed in range(-1, repeats):
                noise = np.random.default_rng(seed + 1).normal(0.0, sigma, (30, 2, 2))
                seen = Sweeps(
                    joint=joint, q=q, xyz_m=np.zeros((30, 3)), uv_px=pixels(START, q).reshape(-1, 2, 2) + noise
                )
                begin = time.perf_counter()
                identify(seen, rig=RIG)
                times.append(1e3 * (time.perf_counter() - begin))
            rows.append([f"{sigma} px, {arc:.0f} deg", float(np.median(times[1:])), min(times[1:])])
    table("Time of one identification, ms (wanted 50)", ["noise, arc of joint 2", "median", "least"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    parser.add_argument("--only", choices=PARTS, help="one of the parts")
    args = parser.parse_args()
    print(machine())
    for name, (part, runs) in PARTS.items():
        if args.only in (None, name):
            part(max(runs // 10, 3) if args.quick else runs)


PARTS = {
    "speed": (speed, 20),
    "positioner": (lambda _: positioner(), 1),
    "random": (random_arms, 1000),
    "kapucu": (kapucu, 400),
    "anew": (calibrated_anew, 500),
    "pictures": (pictures, 500),
}

if __name__ == "__main__":
    main()
