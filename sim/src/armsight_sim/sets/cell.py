"""A moving arm with four lights on its flange before two webcams that run free: its joints' log, and the spots seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight_sim.arms import SimArm, pose_mapping
from armsight_sim.lens import Lens
from armsight_sim.sets.arm import NOMINAL
from armsight_sim.sets.dataset import Dataset, Table, checked_size

USUAL, LEAST = 1350, 600
"""Frames of each camera: 45 s at 30 a second; 20 s are the least that is calibrated."""
FPS, LOG_HZ, BEGIN_S, LEAD_S = 30.0, 125.0, 20.0, 0.6
"""Of the cameras and of the log, when by the robot's clock, and how much longer the log is at both ends."""
LENGTH_M, ANGLE_RAD, ENCODER_RAD = 0.0003, 0.002, 2e-5
"""Normal errors of the arm that was built, of lengths and of angles; and of a joint's reading."""
NOISE_PX, SHAPE_M, STAMP_S = 0.08, 0.0002, 0.001
"""Normal errors of a spot's coordinate, of a light's place on the target as built, and of a frame's stamp."""
WIDTH, HEIGHT = 1280, 720
LIGHTS_M = {"A": (0.05, 0.01, 0.0), "B": (-0.02, 0.055, 0.018), "C": (-0.045, -0.02, -0.012), "D": (0.015, -0.04, 0.01)}
"""Of the target, in its own axes."""
TIP_M = (0.0, 0.0, 0.08)
T_FLANGE_TARGET = RigidTransform.from_components([0.012, -0.03, 0.06], Rotation.from_euler("xyz", [4, -7, 25], True))
HOME = np.array([0.1, -1.1, 1.6, -0.6, 1.3, 0.2])
SWING = np.array([0.28, 0.22, 0.28, 0.6, 0.55, 1.2])
"""How far the joints swing to either side."""
PERIOD_S = (5.0, 9.0)
SEEN_RAD = 1.1
"""A light that is turned away further shows no spot."""
FAR_M, APART_M = 1.15, 0.55
MOTION, NOISE = 1, 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Webcam:
    """A camera by itself: robot's time = stamp + delay_s + drift stamp; a line v is exposed readout_s (v / (h - 1) -
    0.5) later."""

    lens: Lens
    T_base_camera: RigidTransform
    delay_s: float
    drift_ppm: float
    readout_s: float

    def mapping(self) -> dict[str, object]:
        """Return it as a document."""
        return {
            **self.lens.mapping(),
            "T_base_camera": pose_mapping(self.T_base_camera),
            "delay_s": self.delay_s,
            "drift_ppm": self.drift_ppm,
            "readout_s": self.readout_s,
        }

    def robot_time(self, stamp_s: Array) -> Array:
        """Return the robot's time of stamps (m,)."""
        return stamp_s + self.delay_s + 1e-6 * self.drift_ppm * stamp_s


def cell_set(seed: int, size: int | None = None) -> Dataset:
    """Return a set for `calibrate cell`: the log of a UR10 beside its data sheet, and spots of two webcams.

    size: frames of each camera. Raises UsageError for too few.
    """
    n = checked_size(size, USUAL, LEAST, "frames")
    rng = np.random.default_rng([seed, MOTION])
    arm = NOMINAL.with_errors(rng, LENGTH_M, ANGLE_RAD)
    swing = _Swing(period_s=rng.uniform(*PERIOD_S, (2, 6)), phase=rng.uniform(0.0, 2.0 * np.pi, (2, 6)))
    built = np.array(list(LIGHTS_M.values()))
    lights = T_FLANGE_TARGET.apply(built + rng.normal(0.0, SHAPE_M, built.shape))
    cameras = _cameras(arm)
    rng = np.random.default_rng([seed, NOISE])
    seconds = n / FPS
    return Dataset(
        name="cell",
        seed=seed,
        arms={"arm.yaml": NOMINAL.mapping(RigidTransform.identity()), "arm_true.yaml": arm.mapping(T_FLANGE_TARGET)},
        targets={"target.yaml": _target()},
        tables={
            "joints.csv": _log(swing, seconds, rng),
            **{f"{side}.csv": _spots(camera, arm, swing, lights, n, rng) for side, camera in cameras.items()},
        },
        truths={
            "cell_true.yaml": {
                "T_flange_target": pose_mapping(T_FLANGE_TARGET),
                "lights_flange_m": dict(zip(LIGHTS_M, lights.tolist(), strict=True)),
                "cameras": {side: camera.mapping() for side, camera in cameras.items()},
            }
        },
        commands=(
            f"armsight calibrate cell --robot-log joints.csv --left-spots left.csv --right-spots right.csv --size "
            f"{WIDTH}x{HEIGHT} --target target.yaml --model arm.yaml --tip {','.join(map(str, TIP_M))} -o cell",
        ),
        assumptions=_assumptions(seconds),
    )


def _assumptions(seconds: float) -> tuple[str, ...]:
    return (
        f"arm: a UR10 whose lengths differ from the data sheet by {LENGTH_M} m, whose angles by {ANGLE_RAD} rad; its "
        f"joints swing {SWING.tolist()} rad about {HOME.tolist()} in {PERIOD_S} s, for {seconds:g} s",
        f"cameras: {WIDTH}x{HEIGHT}, {FPS:g} Hz, {FAR_M} m away and {APART_M} m apart, by clocks of their own",
        f"normal errors: {NOISE_PX} px of a spot, {STAMP_S} s of a stamp, {ENCODER_RAD} rad of a reading, {SHAPE_M} m "
        "of a light on the target",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Swing:
    """Joints on two sines each, whose periods have nothing in common; they begin and end at rest."""

    period_s: Array
    phase: Array

    def __call__(self, t_s: Array) -> Array:
        waves = np.sin(2.0 * np.pi * t_s[:, None, None] / self.period_s + self.phase)
        return np.asarray(HOME + SWING * (waves * [[0.6], [0.4]]).sum(axis=1))


def _cameras(arm: SimArm) -> dict[str, Webcam]:
    """Return two webcams that look at the lights at home, from where the target faces."""
    T = arm.flange(HOME) * T_FLANGE_TARGET
    centre, out = T.translation, T.rotation.apply([0.0, 0.0, 1.0])
    across = np.cross([0.0, 0.0, 1.0], out)
    across /= np.linalg.norm(across)
    found = {}
    for side, focal, k1, delay_s, ppm, readout_s in (
        ("left", 930.0, -0.12, -14.2, 42.0, 0.021),
        ("right", 955.0, -0.08, -13.7, -31.0, 0.017),
    ):
        at = centre + FAR_M * out + (0.5 if side == "right" else -0.5) * APART_M * across + [0.0, 0.0, 0.05]
        z = (centre - at) / np.linalg.norm(centre - at)
        x = np.cross([0.0, 0.0, -1.0], z)
        x /= np.linalg.norm(x)
        R = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))
        lens = Lens(
            width=WIDTH,
            height=HEIGHT,
            focal_px=(focal, focal * 1.0007),
            centre_px=(648.0 if side == "left" else 627.0, 352.0 if side == "left" else 371.0),
            distortion=(k1, 0.05, 3e-4, -2e-4, 0.0),
        )
        found[side] = Webcam(
            lens=lens,
            T_base_camera=RigidTransform.from_components(at, R),
            delay_s=delay_s,
            drift_ppm=ppm,
            readout_s=readout_s,
        )
    return found


def _log(swing: _Swing, seconds: float, rng: np.random.Generator) -> Table:
    t = np.arange(BEGIN_S - LEAD_S, BEGIN_S + seconds + LEAD_S, 1.0 / LOG_HZ)
    q = swing(t) + rng.normal(0.0, ENCODER_RAD, (len(t), len(HOME)))
    return ("t_s", *(f"q{i + 1}" for i in range(len(HOME)))), np.column_stack([t, q]).tolist()


def _spots(camera: Webcam, arm: SimArm, swing: _Swing, lights: Array, n: int, rng: np.random.Generator) -> Table:
    """Return what a camera saw of the lights, without names, frame by frame by its own stamps."""
    first = (BEGIN_S - camera.delay_s) / (1.0 + 1e-6 * camera.drift_ppm)
    stamp = first + np.arange(n) / FPS
    t, late = camera.robot_time(stamp), np.zeros((n, len(lights)))
    to_camera = camera.T_base_camera.inv()
    uv, facing = np.empty((n, len(lights), 2)), np.empty((n, len(lights)))
    for _ in range(3):
        for k, light in enumerate(lights):
            T = arm.flanges(swing(t + late[:, k]))
            X = T[:, :3, :3] @ light + T[:, :3, 3]
            uv[:, k] = camera.lens.project(to_camera.apply(X))
            way = camera.T_base_camera.translation - X
            normal = T[:, :3, :3] @ T_FLANGE_TARGET.rotation.apply([0.0, 0.0, 1.0])
            facing[:, k] = np.arccos((way * normal).sum(axis=1) / np.linalg.norm(way, axis=1))
        late = np.nan_to_num(camera.readout_s * (uv[..., 1] / (HEIGHT - 1) - 0.5))
    seen = (facing < SEEN_RAD) & (uv > 3.0).all(axis=2) & (uv < [WIDTH - 4.0, HEIGHT - 4.0]).all(axis=2)
    uv = uv + rng.normal(0.0, NOISE_PX, uv.shape)
    told = stamp + rng.normal(0.0, STAMP_S, n)
    rows: list[list[float | str]] = []
    for at_s, spots, lit in zip(told.tolist(), uv, seen, strict=True):
        rows += [[at_s, u, v, NOISE_PX, NOISE_PX] for u, v in rng.permutation(spots[lit]).tolist()]
    return ("t_s", "u_px", "v_px", "su_px", "sv_px"), rows


def _target() -> dict[str, object]:
    return {"kind": "spots", "spots_m": {name: list(xyz) for name, xyz in LIGHTS_M.items()}}
