"""Good recordings: how often does `measure` blame rig, target or clocks all the same? And what does it still find?

A run is a false alarm where its verdict is neither ok nor unchecked, or where it gives advice. Spots of the webcams of
faults.py are drawn from projections written there and go through `measure_spots` and the run's check: 8 to 200 frames,
3 to 5 lights, standing still, slowly or quickly moved or put from place to place, claimed noise of 0.02 to 0.3 px that
differs from spot to spot by half as much again, true noise 0.6 to 1.4 times the claimed one, an error of the place in
the pixel of up to 0.02 px; one in 100 spots is off by 0.1 to 1 px whatever it claims. The rig is the true one, or one
calibrated from its own simulated corners with the covariance that came with it. Then the same with a fault; and
rendered pictures through all of `measure`. `--quick` takes a tenth, `--only` one of the parts.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent, NotEnoughData
from armsight.measure.consistency.check import RunCheck, advice, sentence
from armsight.measure.consistency.findings import Consistency
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup, warm_up
from armsight.measure.results import ConsistencyOutput
from armsight.ops.measurement.run import run as measure_run
from armsight.ops.simulation.cells import CellPairs, load_cell
from armsight.optics import Rig
from armsight.records import Silent, Spots, spot_target
from armsight.store import rig_from_mapping, target_from_mapping
from bench import machine, table
from faults import FLAT, LIGHTS, RIG, STD_M, World, calibrated, hand, log_uniform, project, world_of

Array = NDArray[np.float64]

FPS = 30.0
STRAY, STRAY_PX = 0.01, (0.1, 1.0)  # share of spots, and how far these are off
PIXEL_PX = 0.02
SPREAD = 0.5  # of the logarithm of the claims
CALIBRATIONS = 20
MOTIONS = ("still", "slow", "moving", "from place to place")
FAULTS = {
    "right camera turned by 0.1 deg": ("turned",),
    "right camera turned by 0.2 deg": ("turned",),
    "right camera turned by 0.5 deg": ("turned",),
    "turned by 0.2 deg during the run": ("moved",),
    "a light bent away by 1 mm": ("light",),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What one run came to."""

    motion: str
    rig: str
    frames: int
    check: Consistency | ConsistencyOutput

    @property
    def alarm(self) -> bool:
        """Whether it blames something."""
        told = advice(self.check) if isinstance(self.check, Consistency) else self.check.advice
        return self.check.verdict not in ("ok", "unchecked") or bool(told)

    @property
    def quoted(self) -> float:
        """The quoted size over its own standard deviation."""
        first = self.check.findings[0]
        return abs(first.size) / first.std if first.cause.unit else np.nan


@cache
def fresh(seed: int) -> Rig:
    """A pair calibrated from 12 to 25 simulated board poses, with its covariance; its axes are the left camera's."""
    return calibrated(1000 + seed, 12 + seed % 14)


def path(rng: np.random.Generator, motion: str) -> Callable[[float], RigidTransform]:
    at, jump = hand(rng), rng.uniform(0.0, 100.0, 400)
    speed = {"still": 0.0, "slow": 0.05, "moving": 1.0}.get(motion)
    if speed is None:
        return lambda t_s: at(float(jump[int(t_s * FPS + 0.5)]))
    start = rng.uniform(0.0, 100.0)
    return lambda t_s: at(start + speed * t_s)


def see(uv: Array, sigma: Array, noise: float, phase: Array, rng: np.random.Generator) -> Spots:
    """Spots of lights at uv (n, 2) with claimed deviations sigma (n,), in no order."""
    n = len(uv)
    seen = uv + noise * sigma[:, None] * rng.normal(size=uv.shape) + PIXEL_PX * np.sin(2.0 * np.pi * uv + phase)
    stray = rng.random(n) < STRAY
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    far = np.exp(rng.uniform(*np.log(STRAY_PX), n)) * stray
    seen += far[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    order = rng.permutation(n)
    return Spots(
        uv_px=seen[order],
        covariance_px2=(sigma**2)[order, None, None] * np.eye(2),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def turned(world: World, degrees: float, rng: np.random.Generator) -> World:
    (left, (k, R, t)), axis = world.cameras, rng.normal(size=3)
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    return replace(world, cameras=(left, (k, turn @ R, turn @ t)))


def bent(world: World, rng: np.random.Generator) -> World:
    """The last of four or five lights bent away by 1 mm in any direction."""
    by, lights = rng.normal(size=3), world.lights.copy()
    lights[-1] += 1e-3 * by / np.linalg.norm(by)
    return replace(world, lights=lights)


def spot_run(seed: int, fault: str = "") -> Outcome:
    """Measure one run."""
    rng = np.random.default_rng([seed, 17])
    motion = MOTIONS[seed % 4]
    kind = ("true", "calibrated")[seed // 4 % 2]
    lights = (FLAT, LIGHTS[:4], LIGHTS)[rng.integers(1 if fault.startswith("a light") else 0, 3)]
    rig = fresh(seed % CALIBRATIONS) if kind == "calibrated" else RIG
    known = bool(rng.integers(2))
    names = tuple("ABCDE"[: len(lights)])
    target = spot_target(
        {name: tuple(x) for name, x in zip(names, lights.tolist(), strict=True)},
        covariance=STD_M**2 * np.eye(lights.size) if known else None,
    )
    world = world_of(RIG, lights + known * rng.normal(0.0, STD_M, lights.shape))
    later, frames = world, round(log_uniform(rng, 8.0, 200.0))
    since = rng.uniform(0.3, 0.7) * frames
    if "turned" in fault:
        later = turned(world, float(fault.split(" deg")[0].split()[-1]), rng)
    elif fault:
        later = bent(world, rng)
    world = world if "during" in fault else later
    setup, track = Setup(rig, target), None  # axes of the left camera or of the pair: residuals do not care
    check = RunCheck(setup)
    at, sigma, noise = path(rng, motion), log_uniform(rng, 0.02, 0.3), rng.uniform(0.6, 1.4)
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(lights), 2))
    for i in range(frames):
        now = world if i < since else later
        points = at(i / FPS).apply(now.lights)
        claimed = sigma * np.exp(SPREAD * rng.normal(size=(2, len(lights))))
        left, right = (
            see(project(camera, points), claimed[s], noise, phase[s], rng) for s, camera in enumerate(now.cameras)
        )
        try:
            measured = measure_spots(setup, i / FPS, left, right, track if motion != MOTIONS[3] else None)
        except Inconsistent:  # the views look exchanged: as a refused frame
            continue
        track = measured.track
        check.add(measured)
    return Outcome(motion=motion, rig=kind, frames=frames, check=check.finish())


def rendered_run(seed: int) -> Outcome | None:
    """Measure one rendered recording of the hand-held target by all of `measure`, with the true rig; None where no pose
    of it is found, and `measure` says why."""
    frames = (15, 20, 30, 45)[seed % 4]
    cell = load_cell("hand-cell", seed=5000 + seed, frames=frames)
    rig = rig_from_mapping(cell.rig, "the rig")
    setup = Setup(rig, target_from_mapping(cell.target, "the target"))
    with TemporaryDirectory() as folder:
        try:
            found = measure_run(setup, CellPairs(cell, frames), Path(folder), progress=Silent())
        except NotEnoughData:
            return None
    return Outcome(motion="rendered", rig="true", frames=frames, check=found.consistency)


def rate(done: Sequence[Outcome]) -> str:
    n, k = len(done), sum(o.alarm for o in done)
    return f"{k} of {n}, {100.0 * k / n:.2f} ± {100.0 * np.sqrt((k + 1) * (n - k + 1) / (n + 2) ** 3):.2f} %"


def false_alarms(runs: int, first: int) -> None:
    done = [spot_run(first + seed) for seed in range(runs)]
    rows = [[name, rate([o for o in done if chosen(o)])] for name, chosen in PARTS.items()]
    table("False alarms, spots", ["runs", "alarms"], rows)
    blamed = Counter(o.check.findings[0].cause.key.split()[0] for o in done if o.alarm and o.check.findings)
    print("blamed:", dict(blamed))
    for o in [o for o in done if o.alarm][:12]:
        print(f"- {o.motion}, {o.rig}, {o.frames} frames: {o.check.verdict}: {sentence(o.check)}")


PARTS: dict[str, Callable[[Outcome], bool]] = {
    "all": lambda _: True,
    **{f"rig {name}": (lambda o, name=name: o.rig == name) for name in ("true", "calibrated")},  # type: ignore[misc]
    **{name: (lambda o, name=name: o.motion == name) for name in MOTIONS},  # type: ignore[misc]
    "8 to 20 frames": lambda o: o.frames <= 20,
    "21 to 60 frames": lambda o: 20 < o.frames <= 60,
    "61 to 200 frames": lambda o: o.frames > 60,
}


def power(runs: int, first: int) -> None:
    rows: list[list[object]] = []
    for fault, right in FAULTS.items():
        done = [spot_run(first + seed, fault) for seed in range(runs)]
        told = [o for o in done if o.alarm]
        keys = [[f.cause.key.split()[0] for f in o.check.findings[: max(1, o.check.equal)]] for o in told]
        best = sum(bool(k) and k[0] in right for k in keys)
        among = sum(any(name in right for name in k) for k in keys)
        weakest = min((o.quoted for o in told if o.check.findings), default=np.nan)
        firsts = Counter(k[0] if k else "-" for k in keys)
        rows.append([fault, rate(done), f"{best} of {len(told)}", f"{among} of {len(told)}", weakest, dict(firsts)])
    header = ["fault", "told", "right cause first", "right cause named", "least quoted size / deviation", "first"]
    table("Faults, spots", header, rows)


def rendered(runs: int) -> None:
    done = [o for o in map(rendered_run, range(runs)) if o is not None]
    told = [["hand-cell before rooms", rate(done), runs - len(done)]]
    table("False alarms, rendered pictures", ["runs", "alarms", "no pose found"], told)
    for o in [o for o in done if o.alarm]:
        print(f"- {o.frames} frames: {o.check.verdict}: {o.check.sentence}")  # type: ignore[attr-defined]


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", choices=("alarms", "power", "rendered"))
    parser.add_argument("--runs", type=int, default=2000, help="good runs of spots")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    asked = parser.parse_args()
    fewer = 10 if asked.quick else 1
    print(machine())
    warm_up()
    if asked.only in (None, "alarms"):
        false_alarms(asked.runs // fewer, asked.first)
    if asked.only in (None, "power"):
        power(asked.runs // 10 // fewer, asked.first)
    if asked.only in (None, "rendered"):
        rendered(60 // fewer)


if __name__ == "__main__":
    main()
