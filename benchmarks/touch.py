"""Arms calibrated by touching spikes, beside the least that any method can reach; and which joints run the other way.

    python benchmarks/touch.py [spikes] [right] [points] [touched] [--seeds 20] [--arms irb120 ur5e]

spikes: two spikes 0.27 m apart, 25 postures each, arms drawn within the tolerances: RMS of error over the bound (by
finite differences of a kinematics of its own) and the share within 1.96 claimed deviations, of what is told; and of an
estimate that reaches the bound on the same rows. right: worn but right arms of which a sense or zero is invented.
points, touched: all 64 choices of senses of six joints.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.arm import ArmModel, ArmPoints, Tolerance
from armsight.calibrate.arm.senses import other_senses
from armsight.calibrate.arm.touch import Kind, KnownLength, Touches
from armsight.calibrate.arm.touch import faults as touch_senses
from armsight.calibrate.arm.touch.faults import told
from armsight.calibrate.arm.touch.fit import fit_touches
from armsight.calibrate.arm.touch.model import start
from armsight.kinematics import Arm, Convention, preset

scene = bench.test_scene("touch_world")

LENGTH_M, ANGLE_RAD = 1e-3, 5e-3
"""Standard deviations by which the arms are drawn, and which the calibration is told."""
APART_M, KNOWN_M = 0.27, 2e-5
SEEDED = {name: k for k, name in enumerate(scene.NEAR)}
"""... for draws of their own: arms drawn alike miss alike."""
SENSED = ("irb120", "ur5e", "kr6")
"""Arms whose senses are looked for: with a spherical wrist and without one."""


def drawn(name: str, rng: np.random.Generator) -> tuple[Arm, scene.World, tuple[str, ...], dict[str, float]]:
    """Return a nominal arm, the true one, and by what it is off in which parameters."""
    arm = preset(name)
    names = ArmModel(arm=arm, labels=("",), turned=False).geometry
    rows, off = scene.true_rows(arm, rng, names, LENGTH_M, ANGLE_RAD)
    sense = np.array([joint.sign for joint in arm.joints])
    return arm, scene.World(rows, sense, arm.convention is Convention.CRAIG, scene.TIP), names, off


def touches_of(q: np.ndarray, which: np.ndarray, apart_m: float = APART_M) -> Touches:
    """Return touches of spikes a and b at readings (m, n), which somebody found to be so far apart."""
    m = len(q)
    return Touches(
        q=q,
        feature=tuple("ab"[k] for k in which),
        kind=(Kind.POINT,) * m,
        reading_m=np.zeros(m),
        sigma_m=np.zeros(m),
        lengths=(KnownLength(a="a", b="b", length_m=apart_m, sigma_m=KNOWN_M),),
        row=np.arange(m),
    )


def spikes(seeds: int, arms: list[str]) -> None:
    """Print errors beside the bound, of each arm and of all: of the fit and the choice that `calibrate arm` makes."""
    every: list[np.ndarray] = []
    tolerance = Tolerance(length_m=LENGTH_M, angle_rad=ANGLE_RAD)
    header = [
        "arm",
        "parameters told",
        "error / bound",
        "within 95 %, %",
        "error / claim",
        "of the best estimate",
        "by chance +-",
    ]
    bench.table(f"Two spikes {1e3 * APART_M:.0f} mm apart, 50 postures, {seeds} arms each", header, [])
    for name in arms:
        found: list[np.ndarray] = []
        for seed in range(seeds):
            rng = np.random.default_rng([seed, SEEDED[name]])
            arm, world, names, off = drawn(name, rng)
            places, q, which = scene.two_spikes(world, rng, scene.NEAR[name], APART_M)
            known_off = rng.normal(0.0, KNOWN_M)
            touches = touches_of(q, which, APART_M + known_off)
            model, guess = start(ArmModel(arm=arm, labels=("",), turned=False), touches)
            fitted = fit_touches(model, guess, names, tolerance)
            known = told(model, fitted, names, tolerance).known
            joints = [joint.name for joint in arm.joints]
            least, best = scene.bound(world, q, which, places, off, joints, LENGTH_M, ANGLE_RAD, KNOWN_M, known_off)
            std = fitted.fit.std()
            error = np.array([fitted.fit.value(one) - off[one] for one in known])
            at = [names.index(one) for one in known]
            found.append(np.column_stack([error / least[at], error / [std[one] for one in known], (best / least)[at]]))
        every += found
        row(name, len(np.concatenate(found)) / seeds, *figures(found))
    row("all", "", *figures(every))


def row(*cells: object) -> None:
    """Print a row of a table as it comes."""
    print(
        "| " + " | ".join(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in cells) + " |", flush=True
    )


def figures(arms: list[np.ndarray]) -> list[float]:
    """Return RMS of error over bound, the share within 95 % and RMS of error over claim of arms' (k, 3); the share, on
    the same rows, of an estimate that reaches the bound; and that share's deviation (an arm's errors hang together)."""
    z, each = np.concatenate(arms), [np.mean(np.abs(arm[:, 2]) < 1.96) for arm in arms]
    size, share = np.sqrt(np.mean(z**2, axis=0)), 100.0 * np.mean(np.abs(z) < 1.96, axis=0)
    return [size[0], share[1], size[1], share[2], 100.0 * np.std(each) / np.sqrt(len(each))]


def right(count: int, arms: list[str]) -> None:
    """Print how many right arms are called otherwise by the search for senses and zeros, asked of each at once: the
    calibration asks it only where nothing else explains the rows."""
    bench.table("Right arms, worn", ["measured", "arms", "a sense or zero invented"], [])
    for kind, search in (("touches", of_worn_touches), ("positions", of_worn_points)):
        found = [search(arms[seed % len(arms)], np.random.default_rng([seed, 7])) for seed in range(count)]
        row(kind, count, sum(one is not None for one in found))


def worn(name: str, rng: np.random.Generator) -> tuple[Arm, scene.World]:
    """Return a nominal arm and a true one as they are: zeros off to 2 degrees, noise of 0.05 to 1 mm."""
    arm, world, _, _ = drawn(name, rng)
    rows = world.rows.copy()
    rows[:, scene.KEYS.index("theta_rad")] += rng.normal(0.0, 0.01, len(rows))
    noise_m = 10.0 ** rng.uniform(np.log10(5e-5), -3.0)
    return arm, replace(world, rows=rows, touch_m=noise_m, joint_rad=10.0 ** rng.uniform(-5.0, -3.0))


def read(world: scene.World, rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """Return readings (m, n) of joints at q: with scales to 0.5 %, giving way to a load by up to 5 mrad."""
    lever_m = replace(world, tip=np.zeros(3)).there(q)[1][:, 2]
    return q / (1.0 + rng.normal(0.0, 2e-3, q.shape[1])) + lever_m * rng.uniform(0.0, 5e-3, q.shape[1])


def of_worn_touches(name: str, rng: np.random.Generator) -> object:
    """Return what the search says of touches of which one in 25 is of the other spike."""
    arm, world = worn(name, rng)
    _, q, which = scene.two_spikes(world, rng, scene.NEAR[name], APART_M)
    which = np.where(rng.random(len(q)) < 0.04, 1 - which, which)
    return touch_senses.other_senses(arm, touches_of(read(world, rng, q), which))


def of_worn_points(name: str, rng: np.random.Generator) -> object:
    """Return the same of positions of which one in 25 is off by 50 mm."""
    arm, world = worn(name, rng)
    q = np.asarray(scene.NEAR[name]) + rng.uniform(-1.0, 1.0, (50, arm.n))
    seen = positions(world, q, rng)
    gross = (rng.random(50) < 0.04) * rng.normal(0.0, 0.03, (3, 50))
    xyz_m = seen.xyz_m + rng.normal(0.0, world.touch_m, (50, 3)) + gross.T
    return other_senses(arm, replace(seen, q=read(world, rng, q), xyz_m=xyz_m))


def positions(world: scene.World, q: np.ndarray, rng: np.random.Generator) -> ArmPoints:
    """Return positions that a tracker sees, 0.1 mm off in each coordinate."""
    tracker = RigidTransform.from_components([0.9, -0.2, 0.4], Rotation.from_rotvec([0.3, -0.5, 1.2]))
    there = world.there(q)[0]
    return ArmPoints(q=q, xyz_m=tracker.apply(there) + rng.normal(0.0, 1e-4, (len(q), 3)))


def patterns(arms: list[str], named: Callable[[str, np.random.Generator, np.ndarray], str], title: str) -> None:
    """Print of how many of the 64 senses of each arm's joints the right ones are named, first or among those alike."""
    kinds = ("alone or first", "among those alike", "wrong", "not found")
    bench.table(title, ["arm", *kinds], [])
    for name in arms:
        count = dict.fromkeys(kinds, 0)
        for k, signs in enumerate(product((1, -1), repeat=6)):
            if min(signs) < 0:
                count[named(name, np.random.default_rng([k, 3]), np.array(signs))] += 1
        row(name, *count.values())


def said(senses: object, arm: Arm, signs: np.ndarray) -> str:
    """Return how senses that were found stand to the true ones."""
    true = tuple(joint.name for joint, sign in zip(arm.joints, signs, strict=True) if sign < 0)
    if senses is None:
        return "not found"
    if senses.joints == true:
        return "alone or first"
    return "among those alike" if true in [one[0] for one in senses.alike] else "wrong"


def of_points(name: str, rng: np.random.Generator, signs: np.ndarray) -> str:
    arm, world, _, _ = drawn(name, rng)
    q = np.asarray(scene.NEAR[name]) + rng.uniform(-1.0, 1.0, (50, 6))
    zeros = rng.uniform(-0.3, 0.3, 6)
    found = other_senses(arm, ArmPoints(q=q * signs - zeros, xyz_m=positions(world, q, rng).xyz_m))
    return said(None if found is None else found[0], arm, signs)


def of_touches(name: str, rng: np.random.Generator, signs: np.ndarray) -> str:
    arm, world, _, _ = drawn(name, rng)
    _, q, which = scene.two_spikes(world, rng, scene.NEAR[name], APART_M)
    zeros = rng.uniform(-0.3, 0.3, 6)
    return said(touch_senses.other_senses(arm, touches_of(q * signs - zeros, which)), arm, signs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=["spikes", "right", "points", "touched", []])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--right", type=int, default=200, help="how many right arms")
    parser.add_argument("--arms", nargs="*", default=None)
    given = parser.parse_args()
    print(bench.machine())
    parts = given.parts or ["spikes", "right", "points", "touched"]
    if "spikes" in parts:
        spikes(given.seeds, given.arms or list(scene.NEAR))
    if "right" in parts:
        right(given.right, given.arms or list(scene.NEAR))
    if "points" in parts:
        patterns(
            given.arms or list(SENSED), of_points, "All senses of six joints, zeros off to 17 degrees: 50 positions"
        )
    if "touched" in parts:
        patterns(given.arms or list(SENSED), of_touches, "The same: 50 touches of two spikes")


if __name__ == "__main__":
    main()
