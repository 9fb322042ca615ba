"""An arm identified from sweeps before two, three and four cameras, between which its links stand: share of the
readings used, errors of the beacon at joint positions that no sweep had, and how often their 95 % ellipsoids hold.

The world is the simulation's arm-cell: a UR10 as capsules, lamps that shine to one side, four webcams round it. Which
camera sees which lamp, and where, is told by it; noise of 0.1 px is added. Each joint is swept once, from a pose drawn
anew in each run; the same sweeps for all cameras. A beacon is the lamp that is seen most often: by two cameras at once,
as a target of one lamp needs it, or by one where the target's other lamps say where it is.

    python benchmarks/identify_cameras.py [--runs 20]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import numpy as np
import yaml
from scipy.stats import chi2

from armsight.arrays import Array
from armsight.calibrate.identify import Sweeps, identify
from armsight.errors import DataRefused
from armsight.ops.simulation.scenarios import build_world, scenario_model
from armsight.store import rig_from_mapping
from bench import machine, table

PAIR = ("left", "right")
ALL = (*PAIR, "far-left", "far-right")
RIGS = (PAIR, ALL[:3], ALL)
READINGS, JOINTS, SIGMA_PX, FURTHER = 12, 6, 0.1, 60
HOME_DEG = np.array([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])
REST_DEG, SPAN_DEG = np.array([15.0, 8.0, 12.0, 15.0, 15.0, 30.0]), np.array([60.0, 30.0, 45.0, 80.0, 80.0, 120.0])
"""Rest poses are drawn so far about the home pose; a sweep goes over so much about its rest."""


@cache
def scene(seed: int) -> tuple[object, dict[str, Array], Array]:
    """Return a world whose arm sweeps joint after joint from poses drawn at random, the true pixels (m, 4, 2) of each
    lamp, NaN where it is hidden, and the joint values (m, n)."""
    rng = np.random.default_rng(seed)
    keys = yaml.safe_load((files("armsight_sim") / "scenarios" / "arm-cell.yaml").read_text())
    keys["arm"]["vibration"]["amplitude_m"] = 0.0
    sweeps = []
    for j in range(JOINTS):
        rest = HOME_DEG + rng.uniform(-REST_DEG, REST_DEG)
        begin, end = rest[j] - SPAN_DEG[j] / 2.0, rest[j] + SPAN_DEG[j] / 2.0
        ends = {"begin": float(begin), "end": float(end)}
        sweeps.append({"joint": j + 1, **ends, "readings": READINGS, "rest": rest.tolist()})
    keys["motion"] = {"kind": "sweeps", "every_s": 8.0, "sweeps": sweeps}
    keys["frames"], keys["fps"] = READINGS * JOINTS, 1.0 / 8.0
    world = build_world("arm-cell", scenario_model(keys, "arm-cell"), seed=None, frames=READINGS * JOINTS)
    seen = {light.name: np.full((READINGS * JOINTS, len(ALL), 2), np.nan) for light in world.lights}
    for i in range(READINGS * JOINTS):
        for one in world.sights(i):
            if not one.hidden_by:
                seen[one.light][i, ALL.index(one.camera)] = one.uv_px
    return world, seen, np.array([world.servo.at(np.array([i / world.fps]))[0] for i in range(READINGS * JOINTS)])


def beacon_at(world: object, light: str, q: Array) -> Array:
    """Return where a lamp truly is (m, 3) in rig axes at joint values q (m, n)."""
    place = next(np.asarray(one.xyz_m) for one in world.lights if one.name == light)
    flange = np.stack([world.true.frames(one)[-1] for one in q])
    T = world.T_base_rig.inv().as_matrix() @ flange @ world.T_flange_tool.as_matrix()
    return np.asarray(T[:, :3, :3] @ place + T[:, :3, 3])


def run(seed: int, cameras: Sequence[str], fewest: int) -> tuple[float, Array | None, Array | None]:
    """Return the share of readings used, errors (k,) in m, and their squares over what is claimed; None refused."""
    world, everywhere, values = scene(seed)
    rng = np.random.default_rng(seed + 1000)
    seen = {name: uv[:, [ALL.index(camera) for camera in cameras]] for name, uv in everywhere.items()}
    n = {light: np.isfinite(uv[:, :, 0]).sum(axis=1) for light, uv in seen.items()}
    light = max(seen, key=lambda name: int((n[name] >= fewest).sum()))
    rows = np.flatnonzero(n[light] >= fewest)
    joint = np.array([j - 1 for _, j in world.sweeps])[rows]
    q = values[rows]
    uv = seen[light][rows] + rng.normal(0.0, SIGMA_PX, seen[light][rows].shape)
    xyz = beacon_at(world, light, q) + rng.normal(0.0, 2e-3, (len(rows), 3))
    rig = rig_from_mapping(world.rig, "rig").only(*cameras)
    share = len(rows) / (READINGS * JOINTS)
    try:
        found = identify(Sweeps(joint=joint, q=q, xyz_m=xyz, uv_px=uv, cameras=tuple(cameras)), rig=rig)
    except DataRefused as refusal:
        print(f"run {seed}, {len(cameras)} cameras: {refusal}")
        return share, None, None
    further = np.deg2rad(HOME_DEG + rng.uniform(-0.5, 0.5, (FURTHER, JOINTS)) * SPAN_DEG)
    X, C = found.uncertainty.positions(further)
    off = X - beacon_at(world, light, further)
    known = np.isfinite(C[:, 0, 0])
    d2 = np.einsum("mi,mi->m", off[known], np.linalg.solve(C[known], off[known][:, :, None])[:, :, 0])
    return share, np.linalg.norm(off, axis=1), d2


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    rows: list[list[object]] = []
    for cameras in RIGS:
        for fewest in (2,) if len(cameras) == 2 else (2, 1):
            done = [run(seed, cameras, fewest) for seed in range(runs)]
            kept = [one for one in done if one[1] is not None]
            off, d2 = (np.concatenate([one[k] for one in kept]) if kept else np.array([np.nan]) for k in (1, 2))
            rows.append(
                [
                    f"{len(cameras)}, seen by {fewest}",
                    f"{100 * np.mean([one[0] for one in done]):.0f} %",
                    len(done) - len(kept),
                    f"{1e3 * np.median(off):.2f}",
                    f"{np.sqrt(np.mean(d2) / 3.0):.2f}",
                    f"{100 * np.mean(d2 <= chi2.ppf(0.95, 3)):.1f} %",
                ]
            )
    machine()
    table(
        f"arm-cell swept joint by joint, {runs} runs, {SIGMA_PX} px",
        ["cameras", "readings used", "refused", "median error, mm", "error over claim, RMS", "95 % ellipsoids hold"],
        rows,
    )


if __name__ == "__main__":
    main()
