"""A robot's cell: an arm with a target of lights at its flange, and two webcams that run free, by numpy alone.

One recording: the joints by the robot's clock, and the spots, without names, that each camera saw by its own clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cell_arm import (
    SPREAD_DEG,
    TABLES,
    Array,
    JointDrift,
    Motion,
    TrueArm,
    around,
    home,
    motion,
    nominal_mapping,
    true_arm,
    wander,
)
from cell_cameras import DEG, Track, WebCam, draw_cameras, watched
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

LOG_HZ, ENCODER_RAD = 125.0, 2e-5
NAMES = ("A", "B", "C", "D")
FACING_DEG = 50.0
SHAPE_M = 3e-4
"""How well the target's shape is known, standard deviation of a coordinate."""
FAULTS = ("slipping_target", "touched_camera", "clock_jump", "elastic_arm", "wrong_arm", "degrees", "mirrored")
FAULTS += ("other_day", "wrong_target", "joint_zero_jump", "dark_frames", "still_joint", "one_camera_blind")


@dataclass(frozen=True, kw_only=True)
class CellTruth:
    """What is true; lights (4, 3) and their axes in flange axes; target axes are fitted to the nominal shape.

    samples, places (k, 6): joints over the work volume, at which the target is seen. told: what the planted fault is.
    """

    arm: TrueArm
    left: WebCam
    right: WebCam
    lights: Array
    normals: Array
    T_flange_target: Array
    tip_target_m: Array
    samples: Array
    places: Array
    motion: Motion
    wander: JointDrift
    lamps: Array
    told: dict[str, object]

    def flange(self, q: Array) -> Array:
        """Return T_base_flange (m, 4, 4) at readings (m, 6)."""
        return self.arm.flange(q)

    def joints(self, t_s: Array) -> Array:
        """Return what the joints truly stand at (m, 6) at the robot's time, strays and all."""
        return self.motion(t_s) + self.wander(t_s)

    def seen(self, q: Array) -> NDArray[np.bool_]:
        """Return where (m,) both cameras see all lights, turned towards them."""
        return in_view(q, self.arm, (self.left, self.right), self.lights, -self.T_flange_target[:3, 2])

    def tips(self, q: Array) -> Array:
        """Return the tip (m, 3) in base axes at readings (m, 6)."""
        tip = self.T_flange_target[:3, :3] @ self.tip_target_m + self.T_flange_target[:3, 3]
        return self.arm.points(q, np.tile(tip, (len(q), 1)))


@dataclass(frozen=True, kw_only=True)
class CellWorld:
    """One recording of a cell, and what is known beforehand: the maker's arm and the target's shape as it was built."""

    seed: int
    nominal: dict[str, object]
    log_t_s: Array
    log_q: Array
    left: Track
    right: Track
    target: dict[str, tuple[float, float, float]]
    truth: CellTruth


def fitted(true: Array, nominal: Array) -> Array:
    """Return T (4, 4) that takes the nominal shape (n, 3) best to the true places (n, 3)."""
    R, _ = Rotation.align_vectors(true - true.mean(axis=0), nominal - nominal.mean(axis=0))
    T = np.eye(4)
    T[:3, :3] = R.as_matrix()
    T[:3, 3] = true.mean(axis=0) - T[:3, :3] @ nominal.mean(axis=0)
    return T


def draw_shape(rng: np.random.Generator) -> Array:
    """Return four lights (4, 3), not in a plane, that no turn or mirror takes to each other; z points away from the
    cameras."""
    while True:
        turn = np.arange(4) * 0.5 * np.pi + rng.uniform(-0.4, 0.4, 4)
        r = rng.uniform(0.03, 0.065, 4)
        shape = np.stack([r * np.cos(turn), r * np.sin(turn), rng.uniform(-0.02, 0.02, 4)], axis=1)
        apart = np.sort(np.linalg.norm(shape[:, None] - shape, axis=2)[np.triu_indices(4, 1)])
        solid = abs(np.linalg.det(shape[1:] - shape[0]))
        if np.diff(apart).min() > 0.003 and apart[0] > 0.03 and solid > 2e-5:
            return shape * [1.0, -1.0, -1.0]


def in_view(q: Array, arm: TrueArm, cameras: tuple[WebCam, WebCam], lights: Array, normal: Array) -> NDArray[np.bool_]:
    """Return where (m,) both cameras see all lights of a target that faces them."""
    T = arm.flange(q)
    points = np.einsum("mij,lj->mli", T[:, :3, :3], lights) + T[:, None, :3, 3]
    axis = T[:, :3, :3] @ normal
    out = np.ones(len(q), bool)
    for camera in cameras:
        out &= camera.inside(camera.project(points), 10.0).all(axis=1)
        out &= camera.facing(points.mean(axis=1), axis) < FACING_DEG * DEG
    return out


def _slipped(rng: np.random.Generator, T: Array, normals: Array, lights: Array) -> tuple[Array, Array]:
    """Return lights and axes after the target moved by 0.5 to 2 mm, or turned by as many degrees."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    by = rng.uniform(0.5, 2.0)
    if rng.random() < 0.5:
        return lights + 1e-3 * by * way, normals
    turn = Rotation.from_rotvec(by * DEG * way)
    return turn.apply(lights - T[:3, 3]) + T[:3, 3], turn.apply(normals)


def _scene(
    rng: np.random.Generator, seed: int, arm_name: str | None, noise_px: float | None, seconds: float
) -> tuple[CellTruth, Array]:
    """Return a cell without faults, and the target's shape as drawn (4, 3)."""
    name = arm_name or sorted(TABLES)[rng.integers(len(TABLES))]
    arm = true_arm(rng, name)
    shape = draw_shape(rng)
    for _ in range(200):
        middle = home(rng, arm)
        turn = Rotation.from_rotvec(rng.normal(0.0, 18.0 * DEG, 3))
        turn *= Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
        lights = turn.apply(shape + rng.normal(0.0, SHAPE_M, shape.shape)) + rng.uniform(-1.0, 1.0, 3) * 0.07
        lights[:, 2] += 0.05
        normals = turn.apply(Rotation.from_rotvec(rng.normal(0.0, 5.0 * DEG, (4, 3))).apply([0.0, 0.0, -1.0]))
        T = fitted(lights, shape)
        normal = -T[:3, 2]
        centre = arm.points(middle[None], lights.mean(axis=0)[None])[0]
        cameras = draw_cameras(rng, centre, arm.flange(middle)[0, :3, :3] @ normal, noise_px)

        def seen(
            q: Array, cameras: tuple[WebCam, WebCam] = cameras, lights: Array = lights, axis: Array = normal
        ) -> NDArray[np.bool_]:
            return in_view(q, arm, cameras, lights, axis)

        places = around(rng, middle, seen)
        if len(places) < 120 or min(camera.T_base_camera[2, 3] for camera in cameras) < -0.4:
            continue
        samples, vias = places[:60], places[60:]
        begin = rng.uniform(5.0, 60.0)
        beyond = middle + rng.normal(size=(int(rng.uniform(0.0, 0.3) * len(vias)), 6)) * 1.8 * SPREAD_DEG * DEG
        moves = motion(rng, np.concatenate([vias, beyond]), seen, begin, begin + seconds)
        if (np.ptp(moves(np.linspace(begin, begin + seconds, 400)), axis=0)[3:] > 40.0 * DEG).all():
            break
    else:
        raise RuntimeError(f"seed {seed}: no cell was found")
    tip = np.array([*rng.uniform(-0.03, 0.03, 2), -rng.uniform(0.03, 0.12)])
    lamps = centre + rng.uniform(-1.0, 1.0, (rng.integers(4), 3)) * 0.8 - 1.5 * arm.flange(middle)[0, :3, :3] @ normal
    truth = CellTruth(
        arm=arm,
        left=cameras[0],
        right=cameras[1],
        lights=lights,
        normals=normals,
        T_flange_target=T,
        tip_target_m=tip,
        samples=samples,
        places=vias,
        motion=moves,
        wander=wander(rng, arm),
        lamps=lamps,
        told={},
    )
    return truth, shape


def _faults(
    rng: np.random.Generator, truth: CellTruth, fault: str | None, begin_s: float, seconds: float
) -> dict[str, object]:
    """Return what the planted fault is, drawn."""
    if fault is not None and fault not in FAULTS:
        raise ValueError(f"no fault {fault!r}; there are {', '.join(FAULTS)}")
    at_s = begin_s + seconds * rng.uniform(0.25, 0.75)
    side = ("left", "right")[rng.integers(2)]
    way = rng.normal(size=3)
    turn_rad = way / np.linalg.norm(way) * rng.uniform(0.2, 1.0) * DEG
    told: dict[str, dict[str, object]] = {
        "slipping_target": {"at_s": at_s},
        "touched_camera": {"at_s": at_s, "side": side, "turn_rad": turn_rad},
        "clock_jump": {"at_s": at_s, "side": side, "by_s": rng.uniform(0.03, 0.2)},
        "joint_zero_jump": {
            "at_s": at_s,
            "joint": int(rng.integers(6)),
            "by_rad": rng.uniform(0.3, 1.0) * DEG * rng.choice([-1, 1]),
        },
        "still_joint": {"joint": int(rng.integers(6))},
        "mirrored": {"side": side},
        "one_camera_blind": {"side": side},
        "elastic_arm": {"soft_rad": tuple(rng.uniform(1e-3, 3e-3, 2).tolist())},
        "wrong_arm": {"name": sorted(set(TABLES) - {truth.arm.name})[rng.integers(2)]},
    }
    return {} if fault is None else {"fault": fault, **told.get(fault, {})}


def record(
    rng: np.random.Generator, truth: CellTruth, begin_s: float, seconds: float, moves: Motion | None = None
) -> tuple[Array, Array, Track, Track]:
    """Return the robot's log (k,), (k, 6) of a motion, and what both cameras saw of it."""
    told, moves = truth.told, moves or truth.motion
    fault = told.get("fault")
    log_t = begin_s + np.arange(int(seconds * LOG_HZ)) / LOG_HZ
    log_q = moves(log_t) + rng.normal(0.0, ENCODER_RAD, (len(log_t), 6))
    places = [(truth.lights, truth.normals)] * 2
    if fault == "slipping_target":
        places[1] = _slipped(rng, truth.T_flange_target, truth.normals, truth.lights)
    slip_s = float(told["at_s"]) if fault == "slipping_target" else np.inf  # type: ignore[arg-type]

    def way(t: Array, light: int) -> Array:
        at = np.where((t < slip_s)[:, None], places[0][0][light], places[1][0][light])
        return truth.arm.points(moves(t) + truth.wander(t), at)

    def axes(t: Array) -> Array:
        R = truth.arm.flange(moves(t))[:, :3, :3]
        own = np.where((t < slip_s)[:, None, None], places[0][1], places[1][1])
        return np.einsum("mij,mlj->mli", R, own)

    tracks = []
    for side, camera in (("left", truth.left), ("right", truth.right)):
        hit = told.get("side") == side
        turn = (
            (float(told["at_s"]), Rotation.from_rotvec(told["turn_rad"])) if fault == "touched_camera" and hit else None
        )  # type: ignore[arg-type]
        begin = begin_s + rng.uniform(-0.5, 0.5)
        dark, blind = fault == "dark_frames", fault == "one_camera_blind" and hit
        track = watched(rng, camera, begin, seconds, way, axes, truth.lamps, turn=turn, dark=dark, blind=blind)
        if fault == "mirrored" and hit:
            track = replace(track, uv_px=track.uv_px * [-1.0, 1.0] + [camera.size[0] - 1.0, 0.0])
        if fault == "clock_jump" and hit:
            jumped = track.t_s + float(told["by_s"]) * (camera.robot_time(track.t_s) >= told["at_s"])  # type: ignore[arg-type,operator]
            track = replace(track, t_s=jumped)
        tracks.append(track)
    if fault == "joint_zero_jump":
        log_q[:, told["joint"]] += told["by_rad"] * (log_t >= told["at_s"])  # type: ignore[call-overload,operator]
    return log_t, log_q, tracks[0], tracks[1]


def make_cell(
    seed: int,
    *,
    seconds: float = 120.0,
    fault: str | None = None,
    arm: str | None = None,
    noise_px: float | None = None,
    lamps: bool = True,
) -> CellWorld:
    """Return the world of a seed. arm: one of TABLES; lamps: whether other lights may stand in view."""
    rng = np.random.default_rng([seed, 2611])
    truth, shape = _scene(rng, seed, arm, noise_px, seconds)
    begin_s = float(truth.motion.begin_s[0])
    told = _faults(rng, truth, fault, begin_s, seconds)
    truth = replace(truth, told=told, lamps=truth.lamps if lamps else np.empty((0, 3)))
    if fault == "elastic_arm":
        truth = replace(truth, arm=replace(truth.arm, soft_rad=told["soft_rad"]))
    if fault == "still_joint":
        truth = replace(truth, motion=truth.motion.without(told["joint"]))
    log_t, log_q, left, right = record(rng, truth, begin_s, seconds)
    if fault == "other_day":
        other = motion(rng, truth.places, truth.seen, begin_s, begin_s + seconds)
        log_q = other(log_t) + rng.normal(0.0, ENCODER_RAD, log_q.shape)
    if fault == "degrees":
        log_q = log_q / DEG
    if fault == "wrong_target":
        shape = draw_shape(rng)
    return CellWorld(
        seed=seed,
        nominal=nominal_mapping(str(told["name"]) if fault == "wrong_arm" else truth.arm.name),
        log_t_s=log_t,
        log_q=log_q,
        left=left,
        right=right,
        target={name: tuple(xyz) for name, xyz in zip(NAMES, shape.tolist(), strict=True)},
        truth=truth,
    )


BESIDE_DEG = 50.0
NAMED = ("left", "right", "east", "west")


def beside(camera: WebCam, centre: Array, by_deg: float, delay_s: float) -> WebCam:
    """Return a camera carried about a vertical through a centre, by a clock of its own."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.0, 0.0, by_deg * DEG]).as_matrix()
    T[:3, 3] = centre - T[:3, :3] @ centre
    return replace(camera, T_base_camera=T @ camera.T_base_camera, delay_s=delay_s, drift_ppm=-0.7 * camera.drift_ppm)


def watched_by_four(seed: int, seconds: float) -> tuple[CellWorld, tuple[WebCam, ...], tuple[Track, ...]]:
    """Return a cell, its four cameras by NAMED, and what they saw of one motion.

    Two look from beside the first two, and see the lights, which shine to one side, seldom or in part.
    """
    world = make_cell(seed, seconds=seconds)
    truth = world.truth
    centre = truth.tips(truth.samples).mean(axis=0)
    more = [beside(truth.left, centre, BESIDE_DEG, 0.7), beside(truth.right, centre, -BESIDE_DEG, -1.1)]
    rng = np.random.default_rng([seed, 4])
    _, _, east, west = record(rng, replace(truth, left=more[0], right=more[1]), float(world.log_t_s[0]), seconds)
    return world, (truth.left, truth.right, *more), (world.left, world.right, east, west)
