"""Where an arm lets enough of its lights be seen for a full pose: one to four cameras, three targets.

A UR10's links, as capsules, and the lamps' own directions hide lights; lenses are pinholes. Each share is of stands at
which a pose is possible by the rule of two views (three lights seen twice), or where every sight counts. Nothing of
the simulation's or of armsight's projection is used here; `scene` gives the same stands as a scenario to be rendered.
`--positions N` (3,000), `--seed S`, `--rendered N` compares sights with those that the simulation tells of N stands.
`--pictures N` measures rendered pictures in the dark while the arm goes through N stands, `--cameras V` of the
arrangements of so many cameras alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation
from scipy.special import comb, perm
from scipy.stats import chi2

from armsight.measure.poses.moments import measure_moment
from armsight.measure.poses.setup import Setup
from armsight.ops.simulation.scenarios import build_world, scenario_model, scenario_text
from armsight.optics import Rig
from armsight.records import PoseStatus, TargetPose
from armsight.store import rig_from_mapping, target_from_mapping
from bench import machine, table

MIDDLE_M = np.array([-0.8, -0.1, 0.4])
"""Of the arm's moves, base axes: what all cameras look at."""
SPREAD_DEG = np.array([45.0, 30.0, 40.0, 70.0, 75.0, 180.0])
HOME_DEG = np.array([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])
BOX_M = np.array([[-1.15, -0.55, 0.05], [-0.45, 0.35, 0.75]])
"""Corners of where the flange may be."""
FOCAL_PX, SIZE_PX = 950.0, np.array([1280, 720])


def eye(azimuth_deg: float, up_deg: float, reach_m: float, across_m: float = 0.0) -> np.ndarray:
    """Return where a camera stands, base axes; the cell's front is at 180 degrees. across_m: moved along y."""
    a, e = np.deg2rad([azimuth_deg, up_deg])
    way = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return MIDDLE_M + reach_m * way + [0.0, across_m, 0.0]


ARRANGEMENTS = {
    "1 in front": [eye(180, 10, 1.3)],
    "2 parallel, 0.12 m": [eye(180, 10, 1.3, across) for across in (0.06, -0.06)],
    "2 parallel, 0.5 m": [eye(180, 10, 1.3, across) for across in (0.25, -0.25)],
    "2 orthogonal": [eye(135, 15, 1.4), eye(225, 15, 1.4)],
    "3, 60 degrees apart": [eye(azimuth, 20, 1.4) for azimuth in (120, 180, 240)],
    "4 in front, 50 degrees apart": [eye(155, 35, 1.4), eye(205, 35, 1.4), eye(105, 20, 1.4), eye(255, 20, 1.4)],
    "4 round the cell": [eye(45, 35, 1.6), eye(135, 25, 1.6), eye(225, 25, 1.6), eye(315, 35, 1.6)],
}


def crown(n: int, radius_m: float, out_m: float, turn: float, forward: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return places and directions of n lights round the flange, in its axes, so that no turn brings them together."""
    angle = 2.0 * np.pi * np.arange(n) / n + turn + np.array([0.0, 0.2, -0.25, 0.35, 0.05, -0.2])[:n]
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    return [(radius_m * one + out_m * up, one + forward * up) for one in ring]


SIX = crown(6, 0.05, 0.03, 0.0, 0.5)
OUT_M, AHEAD = np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.0, 1.0])
FLAT = [(np.array([x, y, 0.02]), AHEAD) for x, y in ((-0.04, 0.0), (0.03, 0.032), (0.03, -0.032))]
TARGETS = {
    "three flat": (65.0, FLAT),
    "six round the flange": (75.0, [(place + OUT_M * (k % 2 == 0), way) for k, (place, way) in enumerate(SIX)]),
    "twelve round it": (75.0, [*crown(6, 0.055, 0.03, 0.0, 0.2), *crown(6, 0.04, 0.07, np.pi / 6.0, 0.8)]),
}
"""How far from its direction a light is seen, degrees; places and directions in flange axes."""


def stands(arm: Mapping[str, Any], n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return joints (n, 6) rad within the box, drawn evenly, and the frames' origins and axes (n, 7, 4, 4)."""
    rng, kept, frames = np.random.default_rng(seed), [np.empty((0, 6))], [np.empty((0, 7, 4, 4))]
    while sum(map(len, kept)) < n:
        q = np.deg2rad(HOME_DEG + SPREAD_DEG * rng.uniform(-1.0, 1.0, (4 * n, 6)))
        F = chain(arm, q)
        p = F[:, -1, :3, 3]
        inside = ((p > BOX_M[0]) & (p < BOX_M[1])).all(axis=1) & (F[:, 1:, 2, 3].min(axis=1) > -0.05)
        kept.append(q[inside])
        frames.append(F[inside])
    return np.concatenate(kept)[:n], np.concatenate(frames)[:n]


def chain(arm: Mapping[str, Any], q: np.ndarray) -> np.ndarray:
    """Return the frames (n, 7, 4, 4) of a table of joints, standard Denavit-Hartenberg, at joints (n, 6)."""
    out = [np.tile(np.eye(4), (len(q), 1, 1))]
    for joint, theta in zip(arm["joints"], q.T, strict=True):
        c, s, alpha = np.cos(theta), np.sin(theta), np.deg2rad(joint.get("alpha_deg", 0.0))
        ca, sa, a = np.full_like(c, np.cos(alpha)), np.full_like(c, np.sin(alpha)), joint.get("a_m", 0.0)
        d, none, one = np.full_like(c, joint.get("d_m", 0.0)), 0.0 * c, np.ones_like(c)
        rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [none, sa, ca, d], [none, none, none, one]]
        out.append(out[-1] @ np.moveaxis(np.array(rows), 2, 0))
    return np.stack(out, axis=1)


def nearest(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances (...) of segments a-b from segments c-d: their ends', or where they pass in between."""

    def from_end(p: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        way = end - start
        along = np.clip(((p - start) * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-15), 0.0, 1.0)
        return np.asarray(np.linalg.norm(p - start - along[..., None] * way, axis=-1))

    ends = np.minimum.reduce([from_end(a, c, d), from_end(b, c, d), from_end(c, a, b), from_end(d, a, b)])
    u, v, w = b - a, d - c, c - a
    normal = np.cross(u, v)
    square = np.maximum((normal * normal).sum(-1), 1e-18)
    s, t = ((np.cross(w, x) * normal).sum(-1) / square for x in (v, u))
    between = (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    return np.asarray(np.where(between, np.abs((w * normal).sum(-1)) / np.sqrt(square), ends))


def axes(at: np.ndarray) -> np.ndarray:
    """Return the axes (3, 3; rows x right, y down, z ahead) of a level camera that looks at the middle."""
    z = (MIDDLE_M - at) / np.linalg.norm(MIDDLE_M - at)
    x = np.cross(z, [0.0, 0.0, 1.0])
    return np.stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z])


def seen(arm: Mapping[str, Any], frames: np.ndarray, target: str, eyes: Sequence[np.ndarray]) -> np.ndarray:
    """Return which light is seen by which camera at which stand (n, lights, cameras)."""
    wide_deg, lights = TARGETS[target]
    T, radii = frames[:, -1], [joint["radius_m"] for joint in arm["joints"]]
    X, way = (np.array(one) for one in zip(*lights, strict=True))
    P = X @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]  # (n, lights, 3)
    N = way @ T[:, :3, :3].transpose(0, 2, 1) / np.linalg.norm(way, axis=1)[:, None]
    out = np.empty((*P.shape[:2], len(eyes)), bool)
    for k, at in enumerate(eyes):
        ray = at - P
        clear = (ray * N).sum(-1) > np.cos(np.deg2rad(wide_deg)) * np.linalg.norm(ray, axis=-1)
        c = -ray @ axes(at).T
        clear &= (c[..., 2] > 0.1) & (np.abs(FOCAL_PX * c[..., :2] / c[..., 2:]) < 0.5 * SIZE_PX).all(axis=-1)
        for start, end, radius in zip(frames[:, :-1].swapaxes(0, 1), frames[:, 1:].swapaxes(0, 1), radii, strict=True):
            a, b = start[:, None, :3, 3], end[:, None, :3, 3]
            carries = nearest(P, P, a, b) <= radius  # the link that holds a light does not hide it
            clear &= carries | (nearest(np.broadcast_to(at, P.shape), P, a, b) > radius)
        out[:, :, k] = clear
    return out


def possible(sights: np.ndarray) -> dict[str, np.ndarray]:
    """Return at which stands a full pose is possible (n,): lights seen twice only; every sight; in a track."""
    lights, per_view = sights.any(axis=2).sum(axis=1) >= 3, sights.sum(axis=1)
    many = (2 * per_view.sum(axis=1) >= 8) & ((per_view > 0).sum(axis=1) >= 2)
    every = lights & (many | (per_view.max(axis=1) >= 4))
    return {
        "twice": (sights.sum(axis=2) >= 2).sum(axis=1) >= 3,
        "every sight": every,
        "in a track": every | (per_view.max(axis=1) >= 3),
    }


NAMINGS_BY_CHANCE = 1e-4
"""Expected number of namings of chance from which sights of one camera name no light."""
LEAST_RMS_PX = 0.15
"""What an uncalibrated part of a lens may leave of residuals, in px."""
GAP_S = 0.5
"""Beyond which no motion before names a light."""


def named_alone(n: np.ndarray, target: str, depth_m: np.ndarray) -> np.ndarray:
    """Tell where n sights (k,) of one camera name their lights, the target being at a depth (k,).

    Three of them have m (m - 1) (m - 2) names and mostly two poses; each further one lies by chance where one of the
    lights left is expected, to four times the residual, as often as such circles fill the target's image.
    """
    X = np.array([place for place, _ in TARGETS[target][1]])
    wide_px = FOCAL_PX * np.linalg.norm(X[:, None] - X[None], axis=2).max() / depth_m
    m, further = len(X), np.maximum(n - 3, 0)
    near = np.minimum(n * (4.0 * LEAST_RMS_PX / wide_px) ** 2, 1.0)
    return np.asarray((n >= 4) & (2.0 * perm(m, 3) * comb(m - 3, further) * near**further < NAMINGS_BY_CHANCE))


def since_named(could: np.ndarray, named: np.ndarray, fps: float) -> np.ndarray:
    """Return the frames that could have a pose (k,) and name their lights, or follow two such by GAP_S at most.

    One pose tells where the target is and not how fast it goes: a light may then be anywhere among the others.
    """
    out = np.zeros(len(could), bool)
    for k in np.flatnonzero(could):
        out[k] = named[k] or out[max(k - int(GAP_S * fps), 0) : k].sum() > 1
    return out


def scene(q: np.ndarray, target: str, eyes: Sequence[np.ndarray], between: int = 1) -> Any:
    """Return a world to be rendered: the arm at home, where lights are seen, then at q[k] in frame (k + 1) between.

    between: frames from one stand to the next, at 30 Hz; 1: the arm rests at each.
    """
    found = scenario_text("arm-cell")
    keys = yaml.safe_load(found[0]) if found else {}
    wide_deg, lights = TARGETS[target]
    names = [chr(ord("A") + k) for k in range(len(lights))]
    # target axes are the flange's, turned half about x
    turned = {name: [(one * [1, -1, -1]).tolist() for one in light] for name, light in zip(names, lights, strict=True)}
    keys["target"] |= {"spots_m": {name: one[0] for name, one in turned.items()}, "wide_deg": wide_deg}
    keys["target"]["facing"] = {name: one[1] for name, one in turned.items()}
    cameras = keys["cameras"]
    lens = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 0.5 * (SIZE_PX[0] - 1.0), "cy": 0.5 * (SIZE_PX[1] - 1.0)}
    placed = {}
    for k, at in enumerate(eyes):
        R, place = axes(eyes[0]) @ axes(at).T, axes(eyes[0]) @ (at - eyes[0])
        placed[f"camera{k + 1}"] = lens | {"T_rig_camera": pose_keys(R, place)}
    placed.pop("camera1")
    cameras["sensor"]["hot_pixels"] = 0  # as where the cameras' masks are known
    cameras |= {"left": lens, "right": None, "others": placed, "T_mount_rig": pose_keys(axes(eyes[0]).T, eyes[0])}
    keys["arm"] |= {"error": {}} if between > 1 else {"cycle_s": 1.0, "error": {}, "vibration": {}, "lag_s": 0.0}
    frames, fps = len(q) * between + 1, 30.0 if between > 1 else 0.02
    keys |= {"frames": frames, "fps": fps, "room": "dark"}
    keys["motion"] = {"kind": "ways", "q": [HOME_DEG.tolist(), *np.rad2deg(q).tolist()], "lasts_s": between / fps}
    return build_world("arm-cell", scenario_model(keys, "views_hidden"), seed=1, frames=frames)


def pose_keys(R: np.ndarray, place_m: np.ndarray) -> dict[str, list[float]]:
    """Return a pose as a scenario has it, with R = Rz Ry Rx."""
    rx, ry, rz = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1.0, 1.0)), np.arctan2(R[1, 0], R[0, 0])
    return {"xyz_m": place_m.tolist(), "turn_deg": np.rad2deg([rx, ry, rz]).tolist()}


def told(world: Any, n: int) -> np.ndarray:
    """Return which light which camera sees in frames 1 to n (n, lights, cameras), as the rendered world tells it."""
    flat = [[not one.hidden_by for one in world.sights(index)] for index in range(1, n + 1)]
    return np.array(flat).reshape(n, len(world.cameras), len(world.lights)).transpose(0, 2, 1)


def bounds(n: int, seed: int) -> None:
    """Print the geometric bound of every arrangement and target."""
    found = scenario_text("arm-cell")
    arm = yaml.safe_load(found[0])["arm"] if found else {}
    _, frames = stands(arm, n, seed)
    rows = []
    for name, eyes in ARRANGEMENTS.items():
        row: list[object] = [name]
        for target in TARGETS:
            shares = possible(seen(arm, frames, target, eyes)).values()
            row.append(" / ".join(f"{100.0 * share.mean():.0f}" for share in shares))
        rows.append(row)
    table(
        f"Full poses that are possible at {n} stands of the arm, %: lights seen twice / every sight / in a track",
        ["cameras", *TARGETS],
        rows,
    )


def compared(n: int, seed: int) -> None:
    """Print how many sights of n stands are not as the simulation tells them."""
    found = scenario_text("arm-cell")
    arm = yaml.safe_load(found[0])["arm"] if found else {}
    q, frames = stands(arm, n, seed)
    for name in ("3, 60 degrees apart", "4 round the cell"):
        for target in TARGETS:
            here, there = seen(arm, frames, target, ARRANGEMENTS[name]), told(scene(q, target, ARRANGEMENTS[name]), n)
            print(
                f"{name}, {target}: {np.count_nonzero(here != there)} of {here.size} sights differ; {here.sum()} seen"
            )


BETWEEN = 60
"""Frames from one stand to the next."""
WRONG = float(chi2.isf(1e-8, 6))
"""Squared Mahalanobis distance beyond which a pose is no unlucky draw, but wrong."""


def measured(n: int, seed: int, cameras: Sequence[int]) -> None:
    """Print the shares of frames with a pose beside the bound, and how many of the poses are wrong."""
    found = scenario_text("arm-cell")
    q, _ = stands(yaml.safe_load(found[0])["arm"] if found else {}, n, seed)
    rows = [
        [name, target, *of_pictures(scene(q, target, eyes, BETWEEN), n, len(eyes), target)]
        for name, eyes in ARRANGEMENTS.items()
        if len(eyes) in cameras
        for target in TARGETS
    ]
    head = ["cameras", "target", "possible, %", "followed, %", "by itself, %", "in 95 %, %", "poses", "wrong"]
    table(f"Frames with a pose, as far as possible, on the way through {n} stands of the arm, 2 s each", head, rows)


def of_pictures(world: Any, n: int, views: int, target: str) -> list[object]:
    """Return a row: where a pose could be, of these how many are in a track and without, what the poses are worth.

    Of two cameras both must see a light. One camera must name them, now or in the track before (named_alone). Without a
    track is every tenth frame, as if it were the first.
    """
    sights = told(world, n * BETWEEN)
    could = possible(sights)["twice" if views == 2 else "every sight"]
    alone = could
    if views == 1:
        depth_m = np.array([mean_pose(world, k + 1)[2, 3] for k in range(len(could))])
        alone = could & named_alone(sights[:, :, 0].sum(axis=1), target, depth_m)
        could = since_named(could, alone, world.fps)
    rig = rig_from_mapping(world.rig, "rig")
    if views == 2:
        rig = Rig(cameras=[replace(one, name=side) for one, side in zip(rig.cameras, ("left", "right"), strict=True)])
    setup = Setup(rig, target_from_mapping(world.target, "target"))
    q: list[float] = []
    ok, cold = np.zeros(len(could), bool), np.zeros(len(could), bool)
    track = None
    for k in range(len(could)):
        frames = [world.frame(k + 1, view) for view in world.views]
        T = mean_pose(world, k + 1)
        tries = [measure_moment(setup, frames, track), *([measure_moment(setup, frames)] if k % 10 == 0 else [])]
        track = tries[0].track
        for found, one in zip((ok, cold), tries, strict=False):
            found[k] = one.pose.status is PoseStatus.OK
            if found[k]:
                q.append(squared_distance(one.pose, T))
    of = [
        100.0 * one[there].mean() if there.any() else np.nan for one, there in ((ok, could), (cold[::10], alone[::10]))
    ]
    inside = 100.0 * float((np.array(q) < chi2.ppf(0.95, 6)).mean()) if q else float("nan")
    return [100.0 * could.mean(), *of, inside, len(q), sum(x > WRONG for x in q)]


def mean_pose(world: Any, index: int) -> np.ndarray:
    """Return the mean pose (4, 4) over a frame's exposure: the middle of what a light draws meanwhile.

    Not the pose at the exposure's middle: set points come 125 times a second, and speed changes with each.
    """
    exposure_s = next(iter(world.cameras.values())).exposure_s
    nodes, weights = np.polynomial.legendre.leggauss(16)
    mean = np.einsum("k,kij->ij", 0.5 * weights, world.path(index / world.fps + 0.5 * exposure_s * nodes).as_matrix())
    U, _, V = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = U @ V
    return np.asarray(mean)


def squared_distance(pose: TargetPose, T: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of a pose from the true one."""
    found, C = np.array(pose.T_parent_target), np.array(pose.covariance)
    d = np.concatenate([found[:3, 3] - T[:3, 3], Rotation.from_matrix(found[:3, :3] @ T[:3, :3].T).as_rotvec()])
    return float(d @ np.linalg.solve(C, d))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positions", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rendered", type=int, default=0, metavar="N")
    parser.add_argument("--pictures", type=int, default=0, metavar="N")
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 2, 3, 4], metavar="V")
    asked = parser.parse_args()
    print(machine())
    if asked.pictures:
        measured(asked.pictures, asked.seed, asked.cameras)
    elif asked.rendered:
        compared(asked.rendered, asked.seed)
    else:
        bounds(asked.positions, asked.seed)


if __name__ == "__main__":
    main()
