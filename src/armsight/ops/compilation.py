"""The compiler's work for every command, done ahead: at the installation, or whenever `python -m` calls this module.

Numba compiles a kernel when it is first called and keeps it on disk. GROUPS calls each once, on the smallest problem
that reaches it, as its command does. Two processes share the work; no kernel belongs to both, for numba's index of a
kernel is one file, which two writers at once would spoil.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.drivers import CELLS, known, load
from armsight.errors import Cancelled
from armsight.ops.demo import measure_pictures
from armsight.ops.measurement.warm_up import compile_beside, compile_views
from armsight.records import BoardView, Progress, Silent, Spots

COMPILING = "compiling"
SIZE = (640, 480)
PLAIN = {"NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
"""Numba colours the text of each trial of a type that fails, where colorama is there: a twentieth of the work."""
VARIANCE_PX2 = 0.01 * np.eye(2)
SEED = 1


def spots() -> None:
    """Compile the search for spots, of any kind, grey and in colour."""
    from armsight.measure.settings import SpotSettings
    from armsight.measure.spots import find_spots, track_spots, warm_up
    from armsight.records import Colour

    warm_up()
    y, x = np.mgrid[0:96, 0:128]
    grey = (10.0 + 150.0 * np.exp(-((x - 60.3) ** 2 + (y - 50.2) ** 2) / 8.0)).astype(np.uint8)
    red = np.stack([0 * grey, 0 * grey, grey], axis=2)
    find_spots(red)
    find_spots(grey, SpotSettings(method="seed"))
    coloured = SpotSettings(colour=Colour(hue_deg=(340.0, 20.0)), threshold=60)
    find_spots(red, coloured)
    track_spots(red, [[60.0, 50.0]], 16.0, coloured)


def poses() -> None:
    """Compile what comes after the spots of a pair: names, poses and the check of a run."""
    compile_beside()
    _far_away()


def views() -> None:
    """Compile the poses of other rigs than pairs, and what Python calls for points."""
    from armsight.optics import Camera, PackedRig, epipolar_distance, parallel_rig, triangulate, triangulate_closed
    from armsight.optics.triangulate import epipolar_chi2

    compile_views()
    camera = Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0)
    rig = parallel_rig(camera, 0.1)
    left, right = rig.project(np.array([[0.0, 0.0, 0.5], [0.1, 0.1, 0.6]]))
    camera.rays(left)
    noise = np.tile(np.eye(2), (2, 1, 1))
    triangulate(rig, left, right, noise, noise)
    triangulate_closed(rig, left, right, noise, noise)
    epipolar_distance(rig, left, right)
    epipolar_chi2(PackedRig.of(rig), left, noise, right, noise)


def boards() -> None:
    """Compile the fits of a board's corners and dots."""
    from armsight.measure.boards import warm_up

    warm_up()


def circles() -> None:
    """Compile the lattice of circles."""
    from armsight.measure.boards import find_board
    from armsight.store import parse_board

    y, x = np.mgrid[0:180, 0:220]
    dots = [np.hypot(x - 40 - 44 * column, y - 44 - 44 * row) < 13 for row in range(3) for column in range(4)]
    image = cv2.GaussianBlur(np.where(np.any(dots, axis=0), 30, 230).astype(np.uint8), (0, 0), 1.0)
    find_board(np.asarray(image, np.uint8), parse_board("circles:4x3:0.03"), source="")


def cameras() -> None:
    """Compile the bundle adjustment of cameras and pairs."""
    from armsight.calibrate.cameras import calibrate_stereo
    from armsight.optics import Camera, parallel_rig
    from armsight.store import parse_board

    rng = np.random.default_rng(SEED)
    board = parse_board("checkerboard:7x5:0.03")
    rig = parallel_rig(Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0), 0.1)
    seen: tuple[list[BoardView], list[BoardView]] = ([], [])
    view = partial(BoardView, sigma_px=0.05, width=SIZE[0], height=SIZE[1])
    for number in range(12):
        turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
        middle = [rng.uniform(-0.05, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.45, 0.6)]
        xyz_m = turn.apply(board.xyz_m - board.xyz_m.mean(0)) + middle
        for side, uv_px in enumerate(rig.project(xyz_m)):
            noisy = uv_px + rng.normal(0.0, 0.05, uv_px.shape)
            seen[side].append(view(uv_px=noisy, index=np.arange(len(noisy)), source=str(number)))
    calibrate_stereo(*seen, board)


def light_target() -> None:
    """Compile the calibration of a lit target."""
    from armsight.calibrate.light_target import LitFrame, calibrate_target
    from armsight.optics import Camera, parallel_rig

    rng = np.random.default_rng(SEED)
    rig = parallel_rig(Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0), 0.1)
    lights = np.array([[-0.045, 0.0, 0.0], [0.03, 0.03, 0.0], [0.015, -0.03, 0.0]])
    frames = []
    for number in range(12):
        xyz_m = Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)).apply(lights)
        xyz_m += np.array([0.05, 0.0, rng.uniform(0.4, 0.6)])
        left, right = (
            Spots.of_centres(uv_px + rng.normal(0.0, 0.05, uv_px.shape), VARIANCE_PX2) for uv_px in rig.project(xyz_m)
        )
        frames.append(LitFrame(name=str(number), left=left, right=right))
    calibrate_target(rig, frames)


def handeye() -> None:
    """Compile the hand-eye calibration."""
    from armsight.calibrate.handeye import PosePairs, calibrate_eye_in_hand, warm_up

    warm_up()
    rng = np.random.default_rng(SEED)
    X = RigidTransform.from_components([0.02, 0.05, 0.11], Rotation.from_euler("z", 1.5))
    Z = RigidTransform.from_components([0.6, 0.1, 0.05], Rotation.from_euler("x", 3.0))
    robot, camera = [], []
    for _ in range(12):
        turn = Rotation.from_euler("x", 3.14) * Rotation.from_rotvec(rng.normal(0.0, 0.35, 3))
        flange = RigidTransform.from_components(rng.normal([0.6, 0.1, 0.5], 0.08), turn)
        noise = RigidTransform.from_components(rng.normal(0.0, 2e-4, 3), Rotation.from_rotvec(rng.normal(0, 5e-4, 3)))
        robot.append(flange.as_matrix())
        camera.append(((flange * X).inv() * Z * noise).as_matrix())
    pairs = PosePairs(
        T_base_flange=RigidTransform.from_matrix(np.array(robot)),
        T_camera_target=RigidTransform.from_matrix(np.array(camera)),
        names=tuple(str(i) for i in range(12)),
    )
    calibrate_eye_in_hand(pairs)
    known = np.tile(np.diag([2e-4] * 3 + [5e-4] * 3) ** 2, (12, 1, 1))
    calibrate_eye_in_hand(replace(pairs, camera_covariance=known))


def kinematics() -> None:
    """Compile forward and inverse kinematics, on one core and on all."""
    from armsight.kinematics import fk, fk_jacobian, presets, warm_up
    from armsight.kinematics.forward_kinematics import ALL_CORES_FROM

    warm_up()
    many = np.zeros((ALL_CORES_FROM, 6))
    fk(presets.ur10(), many, all_cores=True)
    fk_jacobian(presets.ur10(), many, all_cores=True)


def arm() -> None:
    """Compile the calibration of a known arm, and what that of its cell asks of cameras."""
    from armsight.calibrate.arm import ArmPoints, calibrate_arm
    from armsight.kinematics import fk, presets
    from armsight.optics import Camera
    from armsight.optics.kernels.light_image import see_points

    rng = np.random.default_rng(SEED)
    nominal = presets.ur10()
    q = rng.uniform(-1.5, 1.5, (30, 6))
    xyz_m = fk(nominal, q)[:, :3, 3] + rng.normal(0.0, 1e-4, (30, 3))
    calibrate_arm(nominal, ArmPoints(q=nominal.values(q), xyz_m=xyz_m))
    k, by = Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0).packed, (np.empty((1, 2, n)) for n in (3, 10))
    see_points(k, np.eye(3), np.zeros(3), np.ones((1, 3)), np.empty((1, 2)), *by)


def identify() -> None:
    """Compile the identification of an unknown arm, from positions and from pixels."""
    from armsight.calibrate.identify import Sweeps
    from armsight.calibrate.identify import identify as identify_arm
    from armsight.kinematics import fk, presets
    from armsight.optics import Camera, parallel_rig

    rng = np.random.default_rng(SEED)
    rig = parallel_rig(Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0), 0.5)
    home, n = np.array([0.2, 0.3, 0.5]), 25
    joint, q = np.repeat([0, 1, 2], n), np.tile(home, (3 * n, 1))
    for number, travel in enumerate((1.2, 1.0, 0.4)):
        q[joint == number, number] += np.linspace(-0.5, 0.5, n) * travel
    xyz_m = fk(presets.stanford_rrp(), q)[:, :3, 3]
    xyz_m += [0.25, 0.0, 1.5] - xyz_m.mean(0)
    uv_px = np.stack(rig.project(xyz_m), axis=1) + rng.normal(0.0, 0.05, (3 * n, 2, 2))
    xyz_m += rng.normal(0.0, 2e-4, xyz_m.shape)
    identify_arm(Sweeps(joint=joint, q=q, xyz_m=xyz_m))
    identify_arm(Sweeps(joint=joint, q=q, xyz_m=xyz_m, uv_px=uv_px), rig=rig)


def motion() -> None:
    """Compile the filter of a moving target, its smoother, and the check of a run of single views."""
    from armsight.measure.begin import SpotFrame
    from armsight.measure.consistency.check import check_motion
    from armsight.measure.follow import Follower
    from armsight.measure.motion.estimate import MotionFilter, Start, smooth
    from armsight.measure.motion.states import View
    from armsight.measure.poses.setup import Setup
    from armsight.optics import Camera, PackedRig, parallel_rig
    from armsight.records import Spots, spot_target

    rig = parallel_rig(Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0), 0.1)
    lights = np.array([[-0.05, 0.0, 0.0], [0.05, 0.04, 0.0], [0.03, -0.04, 0.0]])
    T = np.eye(4)
    T[2, 3] = 0.6
    seen = rig.project(lights + T[:3, 3])
    cov = np.tile(0.01 * np.eye(2), (3, 1, 1))
    views = [
        View(t_s=0.01 * n, side=n % 2, lights=np.arange(3), uv_px=seen[n % 2], cov_px2=cov, tau_s=np.zeros(3))
        for n in range(4)
    ]
    packed, covariance = PackedRig.of(rig), 1e-6 * np.eye(6)
    starts = [Start(view=0, T=T, covariance=covariance)]
    setup = Setup(rig, spot_target({"A": lights[0], "B": lights[1], "C": lights[2]}))
    smooth(packed, setup.model.xyz_m, views, starts, np.array([-0.01, 0.015]))
    check_motion(setup, views, starts, np.ones(len(views)))
    filtered = MotionFilter.begin(packed, setup.model.xyz_m, 0.0, T, covariance)
    for view in views:
        filtered = filtered.add(view)
        filtered.at(view.t_s - 0.001)
    follower, spots = Follower(setup=setup), [Spots.of_centres(uv_px, cov[0]) for uv_px in seen]
    for n in range(20):
        follower.add(SpotFrame(t_s=0.01 * n, spots=spots[n % 2], width=SIZE[0], height=SIZE[1]), n % 2)


def guard() -> None:
    """Compile what a control cycle runs, and the planning of a path."""
    from armsight.control.guard import Guard, Limits
    from armsight.control.play.kernels import reachable_speeds
    from armsight.kinematics import preset

    arm = preset("ur10")
    watcher = Guard(arm, Limits(), 0.008)
    watcher.begin(np.array([0.3, -1.0, 1.2, 0.4, 0.9, 0.1]), 0.0)
    watcher.warm_up()
    reachable_speeds(*[np.ones((4, 8))] * 4, np.ones(4), 1e-3, np.empty(4))


def room() -> None:
    """Compile the renderer of a room with a hand-held target, which the demo shows; nothing where there is none."""
    if known(CELLS):
        next(iter(load(CELLS, "hand-cell")(0, 1).frames()))


def simulator() -> None:
    """Compile the renderers of the other simulated cells: lights and boards; nothing where there are none."""
    if not known(CELLS):
        return
    makers = {name: load(CELLS, name) for name in ("led-cell", "board-cell", "beacon-cell")}
    small, dark = {"width": 320, "height": 180}, {"room": "dark"}  # the light of a room takes long, and is `room`'s
    for cell in (
        makers["led-cell"](0, 1, small, pipeline="ideal", **dark),
        makers["led-cell"](0, 1, {"diameter_m": 0.01, **small}, **dark),
        makers["board-cell"](0, 1, **small, **dark),
        makers["beacon-cell"](0, 1, **small, **dark),
    ):
        next(iter(cell.frames()))


def together() -> None:
    """Measure frames from end to end: what is left of `armsight measure`, and a check that it works.

    They are simulated, or, where the simulation is not installed, the real pictures of a board.
    """
    from armsight.measure.poses.pipeline import warm_up
    from armsight.ops.demo import demo

    warm_up()
    with tempfile.TemporaryDirectory() as folder:
        if known(CELLS):
            demo(Path(folder), seed=0, frames=4, cell="hand-cell")
        else:
            measure_pictures(Path(folder), Silent())


GROUPS: Mapping[str, Callable[[], None]] = {
    "spots": spots,
    "poses": poses,
    "views": views,
    "boards": boards,
    "circles": circles,
    "cameras": cameras,
    "light target": light_target,
    "hand-eye": handeye,
    "kinematics": kinematics,
    "arm": arm,
    "identify": identify,
    "motion": motion,
    "guard": guard,
    "room": room,
    "simulator": simulator,
    "measure": together,
}
"""What is compiled, by command; each alone, or in this order."""

SHARES = (
    ("spots", "boards", "circles", "room", "simulator", "hand-eye"),
    ("poses", "views", "cameras", "light target", "kinematics", "arm", "identify", "motion", "guard"),
)
"""The groups of each process, of like length; the rest follows when both are done. No kernel that Python calls belongs
to both: tests/unit/app/test_compilation.py."""

DEMO = ("spots", "boards", "room", "poses", "cameras", "measure")
"""What `armsight demo` runs."""


def compile_all(progress: Progress | None = None, groups: Collection[str] = tuple(GROUPS)) -> list[str]:
    """Compile all of the groups that is not compiled yet, in two processes; a minute, or seconds where it is there.

    Returns the groups that failed, or were not begun after one that did. Raises Cancelled.
    """
    shown, lock, left = progress or Silent(), Lock(), list(groups)

    def run(names: tuple[str, ...]) -> None:
        if not names:
            return
        command = [sys.executable, "-m", "armsight.ops.compilation", *names]
        with subprocess.Popen(command, env=os.environ | PLAIN, stdout=subprocess.PIPE, text=True) as process:
            for line in process.stdout or ():
                with lock:
                    left.remove(line.strip())
                    shown.update(len(groups) - len(left), len(groups), f"{COMPILING}: {line.strip()}")
                if shown.cancelled():
                    process.terminate()

    shown.update(0, len(groups), COMPILING)
    shared = [tuple(name for name in share if name in groups) for share in SHARES]
    with ThreadPoolExecutor(len(SHARES)) as pool:
        list(pool.map(run, shared))
    if not shown.cancelled():
        run(tuple(name for name in groups if not any(name in share for share in shared)))
    if shown.cancelled():
        raise Cancelled(f"compiling was stopped; not compiled: {', '.join(left)}")
    return left


def main(names: list[str]) -> int:
    """Compile the named groups in turn and print the name of each when done.

    Without names all are compiled, and with `demo` what it needs, in two processes.
    """
    if not names or names == ["demo"]:
        return 1 if compile_all(_Lines(), DEMO if names else tuple(GROUPS)) else 0
    for name in names:
        GROUPS[name]()
        sys.stdout.write(name + "\n")
        sys.stdout.flush()
    return 0


def _far_away() -> None:
    """Measure a target so far away that its tilt has a mirror image that fits, then with a spot that is off."""
    from armsight.measure.poses.from_spots import measure_spots
    from armsight.measure.poses.pipeline import Setup
    from armsight.optics import Camera, parallel_rig
    from armsight.records import spot_target

    xyz_m = {"A": (-0.05, 0.0, 0.0), "B": (0.05, 0.04, 0.0), "C": (0.03, -0.04, 0.0)}
    rig = parallel_rig(Camera.pinhole(*SIZE, 500.0, 500.0, 320.0, 240.0), 0.1)
    setup = Setup(rig, spot_target(xyz_m))
    turn = Rotation.from_rotvec([0.5, 0.2, 0.0])
    left, right = rig.project(turn.apply(np.array(list(xyz_m.values()))) + np.array([0.05, 0.0, 3.0]))
    for off_px in (0.0, 1.0):
        left[0, 1] += off_px
        one, other = (Spots.of_centres(uv_px, VARIANCE_PX2) for uv_px in (left, right))
        measure_spots(setup, 0.0, one, other)


class _Lines(Silent):
    """Tells of progress in one line that is written over."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Print the line, and end it with the last group."""
        end = "\n" if done == total else ""
        sys.stdout.write(f"\r\033[K{note} ({done:g} of {total:g} groups of kernels){end}")
        sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
