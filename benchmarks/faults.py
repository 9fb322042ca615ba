"""Faults of the setup: are they told, is the cause named, and do the ellipsoids hold where there is none?

A pair of 1280x720 webcams 120 mm apart is calibrated once by `armsight.calibrate` from simulated corners with 0.1 px of
noise; its covariance says how far the true rig of each trial lies from the file's, as a target's std_m of 0.05 mm does
for its lights. A hand moves a target of 3 to 5 lights through 0.45 to 0.8 m for 60 to 150 frames. Spots are drawn with
0.03 to 0.3 px of noise from projections written here, which share nothing with the product's, and go through
`measure_spots`. Each fault lies on top of these honest errors. Claims are those of the covariances without the check.
`--quick` takes a tenth of the trials.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from armsight.calibrate.cameras import calibrate_stereo
from armsight.errors import Inconsistent
from armsight.geometry import pose_difference
from armsight.measure.consistency.check import RunCheck
from armsight.measure.consistency.findings import Consistency
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup, warm_up
from armsight.optics import RIG_PARAMETERS, Camera, Rig, converged_rig
from armsight.optics.parallelism import moved_rig
from armsight.records import BoardView, PoseStatus, Spots, TargetKind, board_target, spot_target
from bench import interleaved_ms, machine, table

Array = NDArray[np.float64]

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.12, 0.05, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
LIGHTS = np.array(
    [[-0.045, 0.0, 0.0], [0.035, 0.04, 0.0], [0.018, -0.034, 0.012], [0.06, 0.0, 0.03], [-0.02, 0.055, 0.01]]
)
FLAT = np.array([[-0.045, 0.0, 0.0], [0.035, 0.04, 0.0], [0.018, -0.034, 0.0]])
STD_M = 5e-5
CORNER_PX = 0.1
FAMILIES = {
    "baseline": ("scale",),
    "target scale": ("scale",),
    "one light": ("light",),
    "right turned": ("turned",),
    "lens": ("focal", "distortion"),
    "timing": ("timing",),
    "none": (),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """What is true: per camera (k (10,), R, t) with p_camera = R p + t, the lights (n, 3), the right one's delay."""

    cameras: tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]
    lights: Array
    delay_s: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What one run came to. error, claim: RMS of the position's error and claim in m."""

    fault: str
    size: float
    error: float
    claim: float
    lost: int
    frames: int
    check: Consistency


def project(camera: tuple[Array, Array, Array], points: Array) -> Array:
    """Return pixels (n, 2): pinhole with Brown-Conrady distortion, written out."""
    k, R, t = camera
    x, y, z = (points @ R.T + t).T
    a, b = x / z, y / z
    r2 = a**2 + b**2
    radial = 1.0 + k[5] * r2 + k[6] * r2**2 + k[9] * r2**3
    ad = a * radial + 2.0 * k[7] * a * b + k[8] * (r2 + 2.0 * a**2)
    bd = b * radial + k[7] * (r2 + 2.0 * b**2) + 2.0 * k[8] * a * b
    return np.column_stack([k[0] * ad + k[4] * bd + k[2], k[1] * bd + k[3]])


def world_of(rig: Rig, lights: Array) -> World:
    sides = []
    for camera, T in ((rig.left, rig.T_rig_left), (rig.right, rig.T_rig_right)):
        R = T.rotation.as_matrix().T
        sides.append((np.array(camera.intrinsics), R, -R @ np.asarray(T.translation)))
    return World(cameras=(sides[0], sides[1]), lights=lights)


def calibrated(seed: int, pairs: int = 20) -> Rig:
    """Return the pair as armsight calibrates it from a simulated checkerboard; its axes are the left camera's."""
    rng, board = np.random.default_rng(seed), board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
    world = world_of(RIG, board.xyz_m)
    views: tuple[list[BoardView], list[BoardView]] = ([], [])
    while len(views[0]) < pairs:
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.35, 3) * [1.0, 1.0, 0.5])
        middle = rng.uniform([-0.12, -0.09, 0.4], [0.12, 0.09, 0.7])
        points = turn.apply(board.xyz_m - board.xyz_m.mean(axis=0)) + middle
        uv = [project(camera, points) for camera in world.cameras]
        if any((pixels < 5.0).any() or (pixels > [1275.0, 715.0]).any() for pixels in uv):
            continue
        for side, pixels in enumerate(uv):
            seen = pixels + rng.normal(0.0, CORNER_PX, pixels.shape)
            name = f"{side}/{len(views[0])}"
            views[side].append(
                BoardView(uv_px=seen, index=np.arange(54), sigma_px=CORNER_PX, width=1280, height=720, source=name)
            )
    return calibrate_stereo(*views, board).rig


def drawn(rig: Rig, rng: np.random.Generator) -> Rig:
    """Return a rig as far from this one as its own covariance says."""
    step, known = np.zeros(26), [i for i, name in enumerate(RIG_PARAMETERS) if name in rig.covariance.names]
    block = rig.covariance.block(tuple(RIG_PARAMETERS[i] for i in known))
    step[known] = rng.multivariate_normal(np.zeros(len(known)), block, method="eigh")
    return moved_rig(rig, step)


def with_fault(world: World, fault: str, rng: np.random.Generator) -> tuple[World, float]:
    """Return the world with the fault in it, and its size in SI units (a share, m, rad or s)."""
    (kl, Rl, tl), (kr, Rr, tr) = world.cameras
    sign = rng.choice([-1.0, 1.0])
    if fault == "baseline":
        size = sign * log_uniform(rng, 3e-3, 3e-2)
        centre = -Rr.T @ tr
        return replace(world, cameras=((kl, Rl, tl), (kr, Rr, -Rr @ (centre * (1.0 + size))))), size
    if fault == "target scale":
        size = sign * log_uniform(rng, 3e-3, 3e-2)
        return replace(world, lights=world.lights * (1.0 + size)), size
    if fault == "one light":
        size, lights = log_uniform(rng, 5e-4, 3e-3), world.lights.copy()
        direction = rng.normal(size=3)
        if len(lights) == 3:  # a move square to the plane of three lights turns the triangle and leaves it congruent
            normal = np.cross(lights[1] - lights[0], lights[2] - lights[0])
            direction -= normal * (direction @ normal) / (normal @ normal)
        lights[rng.integers(len(lights))] += size * direction / np.linalg.norm(direction)
        return replace(world, lights=lights), size
    if fault == "right turned":
        size, axis = np.deg2rad(log_uniform(rng, 0.05, 0.5)), rng.normal(size=3)
        turn = Rotation.from_rotvec(size * axis / np.linalg.norm(axis)).as_matrix()
        centre = -Rr.T @ tr
        return replace(world, cameras=((kl, Rl, tl), (kr, turn @ Rr, -turn @ Rr @ centre))), float(size)
    if fault == "lens":
        kl, kr = kl.copy(), kr.copy()
        if rng.random() < 0.5:
            size = sign * log_uniform(rng, 3e-3, 3e-2)
            for k in ((kl, kr), (kl,), (kr,))[rng.integers(3)]:
                k[:2] *= 1.0 + size
        else:
            size = sign * log_uniform(rng, 0.02, 0.2)
            for k in ((kl, kr), (kl,), (kr,))[rng.integers(3)]:
                k[5] += size
        return replace(world, cameras=((kl, Rl, tl), (kr, Rr, tr))), size
    if fault == "timing":
        size = sign * log_uniform(rng, 1e-3, 5e-3)
        return replace(world, delay_s=size), size
    return world, 0.0


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def hand(rng: np.random.Generator) -> Callable[[float], RigidTransform]:
    """Return a smooth motion through the working volume, T_rig_target by time."""
    middle, reach = np.array([0.06, 0.0, 0.62]), np.array([0.1, 0.07, 0.13])
    rate, phase = rng.uniform(0.15, 0.6, (2, 6)), rng.uniform(0.0, 2.0 * np.pi, (2, 6))

    def at(t_s: float) -> RigidTransform:
        wave = (np.sin(2.0 * np.pi * rate * t_s + phase) * [[0.7], [0.3]]).sum(axis=0)
        return RigidTransform.from_components(middle + reach * wave[:3], Rotation.from_rotvec(0.5 * wave[3:]))

    return at


def spots(uv: Array, sigma_px: float, noise: float, rng: np.random.Generator) -> Spots:
    n = len(uv)
    order = rng.permutation(n)
    return Spots(
        uv_px=(uv + rng.normal(0.0, noise * sigma_px, uv.shape))[order],
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def run(rig: Rig, fault: str, seed: int, *, noise: float = 1.0, exact: bool = False) -> Outcome:
    """Measure one run; noise: true noise over the claimed one; exact: but for the fault the files are the truth."""
    rng = np.random.default_rng([seed, list(FAMILIES).index(fault)])
    n = int(rng.integers(3, 6))
    lights = FLAT if n == 3 else LIGHTS[:n]
    names = tuple("ABCDE"[:n])
    target = spot_target(
        {name: tuple(x) for name, x in zip(names, lights.tolist(), strict=True)},
        covariance=None if exact else STD_M**2 * np.eye(3 * n),
    )
    world = world_of(drawn(rig, rng), lights + rng.normal(0.0, STD_M, lights.shape))
    if exact:
        rig, world = replace(rig, covariance=None), world_of(rig, lights)
    world, size = with_fault(world, fault, rng)
    sigma, count, at = log_uniform(rng, 0.03, 0.3), int(rng.integers(60, 151)), hand(rng)
    setup, track = Setup(rig, target), None
    check, errors, claims, lost = RunCheck(setup), [], [], 0
    for i in range(count):
        t_s = i / 30.0
        T = at(t_s)
        left = spots(project(world.cameras[0], T.apply(world.lights)), sigma, noise, rng)
        later = at(t_s + world.delay_s)
        right = spots(project(world.cameras[1], later.apply(world.lights)), sigma, noise, rng)
        try:
            measured = measure_spots(setup, t_s, left, right, track)
        except Inconsistent:  # the views look exchanged: a refusal as well
            lost += 1
            continue
        track = measured.track
        check.add(measured)
        if measured.pose.status is not PoseStatus.OK:
            lost += 1
            continue
        d = pose_difference(measured.pose.pose, T)
        errors.append(float(d[:3] @ d[:3]))
        claims.append(float(np.trace(measured.pose.covariance[:3, :3])))
    done = check.finish()
    mean = (float(np.sqrt(np.mean(x))) if x else np.nan for x in (errors, claims))
    return Outcome(fault=fault, size=size, error=next(mean), claim=next(mean), lost=lost, frames=count, check=done)


def told(outcome: Outcome) -> bool:
    """Whether the run says that something is wrong: by its verdict, or because most frames are refused."""
    return outcome.check.verdict in ("doubtful", "inconsistent") or outcome.lost > outcome.frames / 2


def right_cause(outcome: Outcome, places: int = 1) -> bool:
    """Whether the true cause is among the first so many named."""
    named = [f.cause.key.split()[0] for f in outcome.check.findings[:places]]
    return any(name in FAMILIES[outcome.fault] for name in named)


def faults(rig: Rig, trials: int, *, exact: bool) -> None:
    rows: list[list[object]] = []
    for fault in FAMILIES:
        if fault == "none":
            continue
        done = [run(rig, fault, seed, exact=exact) for seed in range(trials)]
        wrong = [o for o in done if not np.isfinite(o.error) or o.error > 3.0 * o.claim]
        heard, named = [o for o in done if told(o)], [o for o in wrong if told(o)]
        missed = [f"{o.error / o.claim:.1f}" for o in wrong if not told(o)]
        first = Counter(o.check.findings[0].cause.key.split()[0] if o.check.findings else "-" for o in heard)
        rows.append(
            [
                fault,
                f"{len(heard)} of {len(done)}",
                f"{len(named)} of {len(wrong)}",
                ", ".join(missed) or "-",
                *(share(right_cause(o) for o in part) for part in (named, heard)),
                share(right_cause(o, 3) for o in heard),
                ", ".join(f"{key} {count}" for key, count in first.most_common()),
            ]
        )
    header = ["fault", "told", "told where the error exceeds 3 claims", "error / claim of those not told"]
    header += ["right cause first, of these", "of all told", "among the first three", "first cause named"]
    files = (
        "files without covariance, exact but for the fault" if exact else "rig and target drawn from their covariances"
    )
    table(f"Faults: {files}", header, rows)


def share(flags: Iterable[bool]) -> str:
    values = list(flags)
    return f"{100 * sum(values) / len(values):.0f} %" if values else "-"


def good(rig: Rig, trials: int) -> None:
    rows: list[list[object]] = []
    for exact in (False, True):
        for noise in (0.7, 1.0, 1.4):
            done = [run(rig, "none", seed, noise=noise, exact=exact) for seed in range(trials)]
            alarms, found = [o for o in done if told(o)], float(np.median([o.check.noise_scale for o in done]))
            rows.append(["exact" if exact else "drawn", noise, len(done), len(alarms), found])
    table(
        "Runs without a fault",
        ["rig and target", "noise / claimed", "runs", "alarms", "noise found / claimed, median"],
        rows,
    )


def coverage(trials: int) -> None:
    """Every trial calibrated anew; three frames of each are looked at."""
    q = []
    for seed in range(trials):
        rig = calibrated(seed)
        # the truth is known here: the axes are those of the true left camera
        q += against_truth(rig, seed)
    inside = 100.0 * float(np.mean(np.array(q) < chi2.ppf(0.95, 6)))
    table("Total covariance", ["calibrations", "poses", "in 95 % ellipsoid, %", "mean chi2 / 6"],
          [[trials, len(q), inside, float(np.mean(q) / 6.0)]])  # fmt: skip


def against_truth(rig: Rig, seed: int, frames: int = 3) -> list[float]:
    rng = np.random.default_rng([seed, 99])
    base = RIG.T_rig_left
    true = Rig(kind=RIG.kind, left=RIG.left, right=RIG.right, T_rig_left=RigidTransform.identity(),
               T_rig_right=base.inv() * RIG.T_rig_right)  # fmt: skip
    n = int(rng.integers(3, 6))
    lights = FLAT if n == 3 else LIGHTS[:n]
    target = spot_target(
        {name: tuple(x) for name, x in zip("ABCDE"[:n], lights.tolist(), strict=True)},
        covariance=STD_M**2 * np.eye(3 * n),
    )
    world = world_of(true, lights + rng.normal(0.0, STD_M, lights.shape))
    setup, sigma, at, q = Setup(rig, target), log_uniform(rng, 0.03, 0.3), hand(rng), []
    for t_s in rng.uniform(0.0, 5.0, frames):
        T = at(t_s)
        views = [spots(project(camera, T.apply(world.lights)), sigma, 1.0, rng) for camera in world.cameras]
        measured = measure_spots(setup, t_s, *views)
        if measured.pose.status is PoseStatus.OK:
            d = pose_difference(measured.pose.pose, T)
            q.append(float(d @ np.linalg.solve(measured.pose.covariance, d)))
    return q


def time(rig: Rig, repeats: int) -> None:
    """What carrying and checking costs."""
    lights = {name: tuple(x) for name, x in zip("ABC", FLAT.tolist(), strict=True)}
    setups = {
        "exact rig and target": Setup(replace(rig, covariance=None), spot_target(lights)),
        "rig with covariance": Setup(rig, spot_target(lights)),
        "rig and target with covariance": Setup(rig, spot_target(lights, covariance=STD_M**2 * np.eye(9))),
    }
    rng, T, world = np.random.default_rng(0), hand(np.random.default_rng(0))(0.0), world_of(rig, FLAT)
    views = [spots(project(camera, T.apply(FLAT)), 0.05, 1.0, rng) for camera in world.cameras]
    measured = measure_spots(setups["rig and target with covariance"], 0.0, *views)
    check = RunCheck(setups["rig and target with covariance"])
    calls = {name: (lambda s=setup: measure_spots(s, 0.0, *views)) for name, setup in setups.items()}
    ms = interleaved_ms({**calls, "the check, per frame": lambda: check.add(measured)}, repeats)
    table("Time in ms of three lights found, matched and placed", ["", "median", "99 %"],
          [[name, *np.percentile(values, [50, 99]).tolist()] for name, values in ms.items()])  # fmt: skip


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    fewer = 10 if parser.parse_args().quick else 1
    print(machine())
    warm_up()
    rig = calibrated(0)
    time(rig, 2000 // fewer)
    coverage(500 // fewer)
    good(rig, 500 // fewer)
    for exact in (False, True):
        faults(rig, 200 // fewer, exact=exact)


if __name__ == "__main__":
    main()
