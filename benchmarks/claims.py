"""Do claimed deviations hold? Errors that are not independent, and few rows, against simulated truth.

    python benchmarks/claims.py [tip] [stereo] [arm] [world] [handeye] [--seeds 25]

Of every kind: how many of the true values lie within 1.96 claimed deviations, the root mean square of error over claim,
and the claimed deviation itself (RMS), to be compared with that of another commit where rows are independent.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.arm import ArmPoints, calibrate_arm, calibrate_world
from armsight.calibrate.cameras import BoardOptions, calibrate_stereo
from armsight.calibrate.handeye import Setup, calibrate_from_views
from armsight.calibrate.tooltip import calibrate_tooltip
from armsight.errors import DataRefused
from armsight.kinematics import Arm, fk, preset
from armsight.optics import Camera, parallel_rig
from armsight.records import BoardView, TargetKind, board_target
from armsight.units import DEG, MM

Claims = tuple[np.ndarray, np.ndarray]
"""Errors and claimed deviations of one run, in one unit."""


def judged(name: str, seeds: int, run: Callable[[int], Claims], unit: float = MM) -> list[object]:
    """Return a row of the table: what share holds, how large the errors are, how large the claims."""
    found: list[Claims] = []
    refused: Counter[str] = Counter()
    for seed in range(seeds):
        try:
            found.append(run(seed))
        except DataRefused as refusal:
            refused[str(refusal)[:60]] += 1
    told = "; ".join(f"{count} x {text}" for text, count in refused.items())
    if not found:
        return [name, "-", "-", "-", "-", told]
    error, std = (np.concatenate(parts) for parts in zip(*found, strict=True))
    z = error / std
    inside = 100.0 * float(np.mean(np.abs(z) < 1.96))
    return [name, inside, float(np.sqrt(np.mean(z**2))), *(rms(v) / unit for v in (error, std)), told]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# A tool's tip: few poses, and several readings at each.

TIP_M, POST_M = np.array([0.0, 0.005, 0.145]), np.array([0.6, 0.1, 0.3])


def pivoted(seed: int, places: int, readings: int, sigma: tuple[float, float], own: float = 0.1) -> Claims:
    """Return the tip's error and claim. sigma: of a place, m and rad; own: share of it that each reading has anew."""
    rng = np.random.default_rng([places, readings, seed])
    about, tilt = rng.uniform(0, 2 * np.pi, places), 30 * DEG * np.sqrt(rng.random(places))
    if places <= 4:  # as robots' manuals have it: upright, and tilted to three sides
        about = np.arange(places) * 2 * np.pi / 3 + rng.normal(0, 0.2, places)
        tilt = 30 * DEG * np.r_[0.0, rng.uniform(0.8, 1.0, places - 1)]
    R = Rotation.from_rotvec(np.c_[tilt * np.cos(about), tilt * np.sin(about), 0 * about])
    R = R * Rotation.from_euler("x", 160, degrees=True) * Rotation.from_euler("z", rng.uniform(-0.5, 0.5, (places, 1)))
    shared = [rng.normal(0, s, (places, 3)) for s in sigma]
    i = np.repeat(np.arange(places), readings)
    dt, dw = (s[i] + rng.normal(0, own * size, (len(i), 3)) for s, size in zip(shared, sigma, strict=True))
    t = POST_M - R[i].apply(TIP_M) + dt
    result = calibrate_tooltip(RigidTransform.from_components(t, Rotation.from_rotvec(dw) * R[i]))
    return result.tip_m - TIP_M, np.array(list(result.std.values()))


def tips(seeds: int) -> list[list[object]]:
    """Return the rows of the tip, 12 times as many runs as seeds: each takes milliseconds."""
    rows = []
    for places, readings in ((4, 1), (5, 1), (8, 1), (12, 1), (40, 1), (4, 10), (5, 10), (8, 5), (20, 5)):
        for sigma in ((0.2 * MM, 0.5e-3), (0.05 * MM, 3e-3)):
            name = f"tip, {places} poses x {readings}, {sigma[0] / MM:g} mm, {1e3 * sigma[1]:g} mrad"
            rows.append(judged(name, 12 * seeds, partial(pivoted, places=places, readings=readings, sigma=sigma)))
    return rows


# A pair of cameras whose views each have something in common that no rigid rig has.

BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
RIG = parallel_rig(Camera.pinhole(1280, 720, 1100.0, 1100.0, 640.0, 360.0), 0.1)
SIGMA_PX = 0.05


def paired(seed: int, shift_px: tuple[float, float], turn_rad: float, n_views: int = 15) -> Claims:
    """Return errors and claims of the right camera's pose: mm, and mrad, which both are about one to a pixel."""
    rng, views = np.random.default_rng(seed), ([], [])
    while len(views[0]) < n_views:
        turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
        middle = rng.uniform([-0.15, -0.1, 0.4], [0.25, 0.1, 0.7])
        T = RigidTransform.from_components(middle - turn.apply(BOARD.xyz_m.mean(0)), turn)
        T_left_right = RIG.T_rig_right * RigidTransform.from_rotation(
            Rotation.from_rotvec(rng.normal(0, max(turn_rad, 1e-12), 3))
        )
        rig = replace(RIG, T_rig_right=T_left_right)
        seen = rig.project(T.apply(BOARD.xyz_m))
        if not all((uv > 0).all() and (uv < [1280, 720]).all() for uv in seen):
            continue
        common = rng.normal(0, 1, 2) * shift_px
        for side in (0, 1):
            uv = seen[side] + rng.normal(0, SIGMA_PX, (54, 2)) + common * side
            views[side].append(
                BoardView(
                    uv_px=uv,
                    index=np.arange(54),
                    sigma_px=SIGMA_PX,
                    width=1280,
                    height=720,
                    source=f"{len(views[side])}",
                )
            )
    done = calibrate_stereo(*views, BOARD, BoardOptions(folds=0))
    T = done.rig.T_rig_right
    names = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")
    off = np.r_[T.translation - RIG.T_rig_right.translation, T.rotation.as_rotvec()]
    return off, np.array([done.std["right." + name] for name in names])


def pairs(seeds: int) -> list[list[object]]:
    """Return the rows of pairs of cameras."""
    cases = [((0.0, shift), 0.0) for shift in (0.0, 0.05, 0.1, 0.2, 0.4)]
    cases += [((0.1, 0.1), 0.0), ((0.0, 0.0), 0.2e-3)]
    return [
        judged(
            f"stereo, {across:g} and {down:g} px, {1e3 * turn:g} mrad a view",
            seeds,
            partial(paired, shift_px=(across, down), turn_rad=turn),
        )
        for (across, down), turn in cases
    ]


# An arm measured at places, with gears that err alike in all readings of a place.


def placed(seed: int, readings: int, mixed: bool = False) -> Claims:
    """Return by how much two draws of one arm differ and what their claims say of that, rad and m, of what both freed.

    Parameters of parallel axes stand for each other, so that the truth of one alone cannot be told; draws can.
    """
    rng = np.random.default_rng([readings, seed])
    nominal = preset("irb120")
    off = ("theta_rad", 0.6e-3), ("d_m", 0.3 * MM), ("a_m", 0.3 * MM), ("alpha_rad", 0.6e-3)
    joints = [
        replace(joint, **{name: getattr(joint, name) + rng.normal(0, size) for name, size in off})
        for joint in nominal.joints
    ]
    true = replace(nominal, joints=tuple(joints))
    first, second = (calibrate_arm(nominal, _measured(rng, true, readings, mixed), scale=False) for _ in range(2))
    names = sorted(set(first.std()) & set(second.std()) & set(first.free) & set(second.free))
    return (
        np.array([first.change(name) - second.change(name) for name in names]),
        np.array([np.hypot(first.std()[name], second.std()[name]) for name in names]),
    )


def _measured(rng: np.random.Generator, true: Arm, readings: int, mixed: bool) -> ArmPoints:
    """Return 40 places of so many readings each, by gears that err by 0.12 mrad and a tracker that repeats to 2 um."""
    q = rng.uniform(-1.5, 1.5, (40, 6))
    i = np.repeat(np.arange(40), readings)
    if mixed:
        rng.shuffle(i)
    tool = fk(true, (q + rng.normal(0, 0.12e-3, q.shape))[i]) @ np.array([0.03, 0.02, 0.1, 1.0])
    return ArmPoints(q=q[i], xyz_m=tool[:, :3] + rng.normal(0, 2e-6, (len(i), 3)))


def arms(seeds: int) -> list[list[object]]:
    """Return the rows of arms."""
    return [
        judged(
            f"arm, 40 places x {readings}{', mixed' * mixed}", seeds, partial(placed, readings=readings, mixed=mixed)
        )
        for readings, mixed in ((1, False), (10, False), (10, True))
    ]


# Where the rig stands: readings of one place, and a stream whose errors drift.

WORLD_ERROR_M = 1e-3


def stood(seed: int, kind: str, n: int) -> Claims:
    """Return the error of T_base_rig and its claims, m and rad. kind: independent, repeats (12 of a place), drifts."""
    rng, arm = np.random.default_rng([n, seed]), preset("ur10")
    each = 12 if kind == "repeats" else 1
    q = np.repeat(rng.uniform(-1, 1, (n // each, 6)), each, axis=0)
    off = np.repeat(rng.normal(0, WORLD_ERROR_M, (n // each, 3)), each, axis=0)
    off += rng.normal(0, 0.3 * WORLD_ERROR_M * (each > 1), off.shape)
    for i in range(1, n if kind == "drifts" else 0):  # forgotten over 40 rows
        off[i] = np.exp(-1 / 40) * off[i - 1] + np.sqrt(-np.expm1(-2 / 40)) * off[i]
    T = RigidTransform.from_components(rng.uniform(-1, 1, 3), Rotation.random(random_state=rng))
    xyz = T.inv().apply(fk(arm, q)[:, :3, 3] + off)
    done = calibrate_world(arm, ArmPoints(q=q, xyz_m=xyz, t_s=0.1 * np.arange(n) if kind == "drifts" else None))
    turn = (done.T_base_rig.rotation * T.rotation.inv()).as_rotvec()
    return np.r_[done.T_base_rig.translation - T.translation, turn], np.array(list(done.covariance.std().values()))


def worlds(seeds: int) -> list[list[object]]:
    """Return the rows of rigs beside an arm, eight times as many runs as seeds."""
    kinds = (("independent", 25), ("independent", 100), ("repeats", 108), ("repeats", 240), ("drifts", 400))
    return [judged(f"rig, {n} rows, {kind}", 8 * seeds, partial(stood, kind=kind, n=n)) for kind, n in kinds]


# A camera on the hand, by images of a board: the scenes of tests/truth/handeye_scenes.py.

SCENES = bench.test_scene("handeye_scenes")


def on_hand(seed: int, cell: str, n: int) -> Claims:
    """Return the error of T_flange_camera and its claims, m and rad."""
    s = SCENES.scene(SCENES.CELLS[cell], n, seed)
    done = calibrate_from_views(s.views, list(s.robot), SCENES.CAMERA, SCENES.BOARD, Setup.EYE_IN_HAND).result
    off = done.T_parent_camera.translation - s.T_flange_camera.translation
    turn = (done.T_parent_camera.rotation * s.T_flange_camera.rotation.inv()).as_rotvec()
    std = done.covariance.std()
    return np.r_[off, turn], np.array([std[f"camera.{name}"] for name in POSE])


POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")


def hands(seeds: int) -> list[list[object]]:
    """Return the rows of cameras on a hand."""
    cells = ("good robot, noisy corners", "noisy robot", "parts of the board")
    return [
        judged(f"hand-eye, {n} images, {cell}", seeds, partial(on_hand, cell=cell, n=n))
        for cell in cells
        for n in (6, 8, 12, 20)
    ]


KINDS: dict[str, Callable[[int], list[list[object]]]] = {
    "tip": tips,
    "stereo": pairs,
    "arm": arms,
    "world": worlds,
    "handeye": hands,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], help="what to judge; all without")
    parser.add_argument("--seeds", type=int, default=25)
    given = parser.parse_args()
    print(bench.machine())
    columns = ["what", "within 95 %, %", "error / claim", "error, mm", "claimed, mm", "refused"]
    for kind in given.kinds or KINDS:
        bench.table(f"Claims: {kind}, {given.seeds} seeds", columns, KINDS[kind](given.seeds))


if __name__ == "__main__":
    main()
