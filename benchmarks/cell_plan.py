"""A cell calibrated from a planned motion, beside motions that nobody planned: foretold and true deviation of the tip.

    python benchmarks/cell_plan.py [--cells 5] [--first SEED] [--seconds 120] [--speed 0.25] [--cautious]

Cells are drawn in tests/truth/cell_world.py. What is known beforehand is rough: the maker's arm, lenses without
distortion, cameras 10 mm and 1 deg off, the target as built. Each motion takes as long, within the same limits:
planned; random: through places in view in random order, by the same road map and timing; sines: each joint about the
middle, a rhythm and 12 deg for each, nobody looks at the view; drawn: reaches from place to place as a person may
program them, up to 0.9 rad/s. Each is recorded and calibrated alike. Error: as in benchmarks/cell.py, RMS over the
work volume. Floor: what is left after ten thousand times the planned motion; how large the cell is, by the arm's
lengths and the target, which no motion tells. Excess: root of the difference of squares, what a motion can better;
of true errors what is left beside one factor of all lengths and a height of the shoulder. --cautious: instead,
from small moves about the start, of which nothing need be known.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cell.knowledge import ArmTolerance
from armsight.calibrate.cell.model import CellModel, start_vector
from armsight.calibrate.cell.observations import recording_of
from armsight.calibrate.cell.rounds import solve_cell
from armsight.errors import ArmsightError
from armsight.geometry import align_points
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup
from armsight.optics import Rig, RigKind
from armsight.records import Motion, Silent, Spots, Target, spot_target
from armsight_lab.cell_plan.cautious import cautious_motion
from armsight_lab.cell_plan.information import blank_recording, known_before, motion_information, noise_px
from armsight_lab.cell_plan.path import MotionBounds
from armsight_lab.cell_plan.plan import ENDLESS, PlanSettings, plan_motion
from armsight_lab.cell_plan.scene import Scene, places, roadmap
from armsight_lab.cell_plan.tour import longest
from bench import machine, table, test_scene
from cell_records import EXACT_PX, arm_of, target_of, track_of

made = test_scene("cell_world")

Array = NDArray[np.float64]
DEG, MM = np.pi / 180.0, 1e-3
OFF_M, OFF_RAD = 0.01, 1.0 * DEG
SWING_RAD = 12.0 * DEG
KINDS = ("foretold", "excess", "true", "excess of true")


def scene_of(world: Any, seed: int, speed_m_s: float) -> tuple[Scene, Target, RigidTransform]:
    """Return what is roughly known of a world: its scene, target and where that is on the flange."""
    rng, truth = np.random.default_rng([seed, 9]), world.truth
    arm, target, T = arm_of(world), target_of(world), RigidTransform.from_matrix(truth.T_flange_target)
    cameras = []
    for camera in (truth.left, truth.right):
        f, (w, h) = camera.intrinsics[0], camera.size
        at = RigidTransform.from_matrix(camera.T_base_camera)
        turn = Rotation.from_rotvec(rng.normal(0.0, OFF_RAD, 3)) * at.rotation
        place = np.asarray(at.translation) + rng.normal(0.0, OFF_M, 3)
        lens = [f, f, (w - 1) / 2.0, (h - 1) / 2.0, *np.zeros(6)]
        cameras.append(np.concatenate([lens, place, turn.as_rotvec(), [0.0, 0.0, 0.5 / camera.rate_hz]]))
    recording = blank_recording(arm, (truth.left.size, truth.right.size), 30.0)
    model = CellModel(recording=recording, lights=target.names)
    middle, n = truth.samples.mean(axis=0), arm.n
    tips = truth.tips(truth.samples)
    scene = Scene(
        model=model,
        x=start_vector(model, cameras, np.asarray(T.apply(target.xyz_m))),
        bounds=MotionBounds(
            lower=middle - 2.0,
            upper=middle + 2.0,
            speed=np.full(n, 1.0),
            acceleration=np.full(n, 5.0),
            speed_m_s=speed_m_s,
            turn_rad_s=60.0 * DEG,
            acceleration_m_s2=2.0,
            turn_acceleration_rad_s2=20.0,
        ),
        free=lambda q: np.ones(len(q), bool),
        tip_m=np.asarray(T.apply(truth.tip_target_m)),
        volume=np.stack([tips.min(axis=0), tips.max(axis=0)], axis=1),
        normal=-np.asarray(truth.T_flange_target[:3, 2]),
        facing_rad=50.0 * DEG,
        margin_px=(30.0, 30.0),
    )
    return scene, target, T


def sines(scene: Scene, start: Array, settings: PlanSettings) -> Motion:
    """Return each joint swinging about the start at a rhythm of its own."""
    T = settings.duration_s
    t = np.arange(int(T * settings.rate_hz) + 1) / settings.rate_hz
    ease = np.clip(np.minimum(t, T - t) / 4.0, 0.0, 1.0)
    rhythm = np.rint(T / 12.0) + 2.0 * np.arange(len(start)) + 1.0
    size = SWING_RAD * np.ones(len(start))
    return Motion(t_s=t, q=start + size * ease[:, None] * np.sin(2.0 * np.pi * np.outer(t / T, rhythm)))


def moves(motion: Motion, begin_s: float) -> Callable[[Array], Array]:
    """Return a motion as a function of the robot's time, at rest before and after."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(motion.t_s, motion.q)
    return lambda t: np.asarray(spline(np.clip(t - begin_s, 0.0, motion.t_s[-1])))


def calibrated(world: Any, motion: Callable[[Array], Array], seconds: float) -> tuple[float, float, float, float]:
    """Return the RMS errors of the tip as measured and as commanded after a calibration, then both beside one factor.

    Raises DataRefused.
    """
    truth = world.truth
    rng = np.random.default_rng([world.seed, 77])
    log_t, log_q, left, right = made.record(rng, truth, float(truth.motion.begin_s[0]), seconds, motion)
    sizes = (truth.left.size, truth.right.size)
    recording = recording_of(arm_of(world), Motion(t_s=log_t, q=log_q), (track_of(left), track_of(right)), sizes)
    solved = solve_cell(recording, target_of(world), ArmTolerance(), progress=Silent())
    model, x = solved.model, solved.fit.x
    lights = model.lights_m(x)
    nominal = np.array([world.target[name] for name in model.lights])
    tip = np.asarray(align_points(lights, nominal).T_a_b.apply(truth.tip_target_m))
    q, true = truth.samples, truth.tips(truth.samples)
    T = model.flange(x, q)
    commanded = T[:, :3, :3] @ tip + T[:, :3, 3] - true
    # the cameras see the true lights, and measure the flange, whose axes the lights are in
    T_true = truth.flange(q)
    seen = np.einsum("mij,lj->mli", T_true[:, :3, :3], truth.lights) + T_true[:, None, :3, 3]
    order = [list(world.target).index(name) for name in model.lights]
    poses = [model.T_base_camera(x, side) for side in (0, 1)]
    rig = Rig(
        kind=RigKind.STEREO,
        left=model.camera(x, 0),
        right=model.camera(x, 1),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=poses[0].inv() * poses[1],
    )
    target = spot_target(dict(zip(world.target, map(tuple, lights[np.argsort(order)].tolist()), strict=True)))
    setup, measured, at = Setup(rig=rig, target=target), [], []
    uv = [camera.project(seen) for camera in (truth.left, truth.right)]
    for k in range(len(q)):
        pair = [Spots.of_centres(side[k], EXACT_PX**2 * np.eye(2)) for side in uv]
        pose = measure_spots(setup, 0.0, *pair).pose
        if pose.T_parent_target is not None and pose.status.size == 6:
            flange = poses[0] * RigidTransform.from_matrix(np.asarray(pose.T_parent_target))
            measured.append(flange.apply(tip) - true[k])
            at.append(true[k])
    seen, there = np.array(measured).reshape(-1, 3), np.array(at).reshape(-1, 3)
    return _rms(seen), _rms(commanded), _rms(_beside(seen, there)), _rms(_beside(commanded, true))


def _beside(errors: Array, tips: Array) -> Array:
    """Return errors (m, 3) of tips without what a factor of all lengths about the shoulder's height explains."""
    if not len(errors):
        return errors
    columns = np.column_stack([tips.ravel(), np.tile([0.0, 0.0, 1.0], len(tips))])
    return np.asarray((errors.ravel() - columns @ np.linalg.lstsq(columns, errors.ravel())[0]).reshape(-1, 3))


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean((errors**2).sum(axis=1)))) / MM if len(errors) else float("nan")


def compared(seed: int, seconds: float, speed_m_s: float) -> dict[str, list[float]]:
    """Return the figures of each motion of a cell in mm, each as measured and as commanded, in the order of KINDS."""
    world = made.make_cell(seed, seconds=seconds)
    truth = world.truth
    scene, target, T = scene_of(world, seed, speed_m_s)
    settings = PlanSettings(duration_s=seconds, spot_px=max(truth.left.noise_px, truth.right.noise_px), seed=seed)
    start = truth.samples[0]
    rng = np.random.default_rng(seed)
    plan = plan_motion(scene, target, T, settings, start=start)
    road = roadmap(scene, places(scene, rng, start))
    any_ = longest(scene, road, (1 + rng.permutation(len(road.q) - 1)).tolist(), seconds)
    begin = float(truth.motion.begin_s[0])
    t = plan.motion.t_s
    motions: dict[str, Motion | None] = {
        "planned": plan.motion,
        "random": None if any_ is None else any_.way.motion(seconds, settings.rate_hz),
        "sines": sines(scene, start, settings),
        "drawn": Motion(t_s=t, q=truth.motion(begin + t)),
    }
    px = noise_px(scene, settings.spot_px, settings.stray_m, settings.frames_hz)
    known = known_before(scene, target, T, road.q, settings.tolerance, px)

    def information(motion: Motion) -> Array:
        return motion_information(scene, known, motion, px, settings.frames_hz)

    floor = np.array(known.tip_m(known.information + ENDLESS * information(plan.motion))) / MM
    out = {"floor": [*floor, 0.0, 0.0, *[float("nan")] * 4]}
    print(f"seed {seed:3d} floor    : foretold {floor[0]:.3f} {floor[1]:.3f}", flush=True)
    for name, motion in motions.items():
        if motion is None:
            continue
        told = np.array(known.tip_m(known.information + information(motion))) / MM
        excess = np.sqrt(np.maximum(told**2 - floor**2, 0.0))
        try:
            true = calibrated(world, moves(motion, begin) if name != "drawn" else truth.motion, seconds)
        except ArmsightError as error:
            print(f"seed {seed}, {name}: {error}")
            true = (float("nan"),) * 4
        out[name] = [*told, *excess, *true]
        print(
            f"seed {seed:3d} {name:8s}: foretold {told[0]:.3f} {told[1]:.3f}, excess {excess[0]:.3f} {excess[1]:.3f}; "
            f"true {true[0]:.3f} {true[1]:.3f}, excess {true[2]:.3f} {true[3]:.3f}",
            flush=True,
        )
    return out


def from_small_moves(seed: int, seconds: float, speed_m_s: float) -> str:
    """Return how a cell is calibrated from small moves about a place, in words."""
    world = made.make_cell(seed, seconds=seconds)
    scene, _, _ = scene_of(world, seed, speed_m_s)
    start = world.truth.samples.mean(axis=0)
    motion = cautious_motion(scene.arm, scene.bounds, scene.free, start, PlanSettings(duration_s=seconds))
    seen = 100.0 * world.truth.seen(motion.q[::50]).mean()
    try:
        measured, commanded = calibrated(world, moves(motion, float(world.truth.motion.begin_s[0])), seconds)
    except ArmsightError as error:
        return f"in view {seen:.0f} %, refused: {error.cause}"
    return f"in view {seen:.0f} %, true: measured {measured:.3f}, commanded {commanded:.3f} mm"


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cells", type=int, default=5)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--speed", type=float, default=0.25)
    parser.add_argument("--cautious", action="store_true")
    given = parser.parse_args()
    print(machine())
    if given.cautious:
        for seed in range(given.first, given.first + given.cells):
            print(f"seed {seed:3d} {from_small_moves(seed, given.seconds, given.speed)}", flush=True)
        return
    found = [compared(seed, given.seconds, given.speed) for seed in range(given.first, given.first + given.cells)]
    rows = []
    for name in ("floor", "planned", "random", "sines", "drawn"):
        values = np.array([one[name] for one in found if name in one])
        done = np.isfinite(values[:, 4])
        middle = [
            float(np.median(column[np.isfinite(column)])) if np.isfinite(column).any() else "" for column in values.T
        ]
        rows.append([name, *middle, "" if name == "floor" else f"{done.sum()} of {len(found)}"])
    table(
        f"Tip over the work volume, mm, medians of {given.cells} cells, {given.seconds:g} s",
        ["motion", *(f"{kind}, {how}" for kind in KINDS for how in ("measured", "commanded")), "calibrated"],
        rows,
    )


if __name__ == "__main__":
    main()
