"""Frames drawn from first principles: a pinhole pair by hand, lights as Gaussians, boards warped by homographies."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy; for processes that tests begin too: see cli.main
if "PYTHONPATH" in os.environ:  # a process that a test begins in another folder has to find this source too
    os.environ["PYTHONPATH"] = os.pathsep.join(map(os.path.abspath, os.environ["PYTHONPATH"].split(os.pathsep)))
sys.path.insert(0, str(Path(__file__).parent))  # tests/refusals.py

import cv2
import numpy as np
import pytest
import typer.testing
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import lit_rooms
import warm_python

warm_python.begin()
typer.testing._get_command = cache(typer.testing._get_command)  # all commands, which each call made anew


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Of what runs alone, read the files that hold such tests: all others take half a minute."""
    if config.option.markexpr != "alone" or not collection_path.name.startswith("test_"):
        return None
    return None if "mark.alone" in collection_path.read_text(encoding="utf-8") else True


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems() -> None:
    """Draw at random alike whichever modules were read before: hypothesis would parse them all for their constants."""
    if "hypothesis" in sys.modules:
        from hypothesis.internal.conjecture import providers

        providers._get_local_constants = lambda: providers._local_constants


def pytest_collection_finish() -> None:
    """Leave what is there for good out of every collection of garbage from here on."""
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Bare the rooms of simulated cells, or share them with all other processes, as soon as there may be some."""
    if item.nodeid.startswith(lit_rooms.LIT):
        lit_rooms.share(warm_python.rooms())
    else:
        lit_rooms.bare()


WIDTH, HEIGHT, FOCAL, BASELINE = 320, 240, 400.0, 0.1
CX, CY = 160.3, 119.6
LIGHTS = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.03, 0.0), "C": (0.03, -0.03, 0.0)}
COUNT = 12

RIG = f"""\
format: armsight/rig
version: 1
kind: stereo
cameras:
  left: {{width: {WIDTH}, height: {HEIGHT}, fx: {FOCAL}, fy: {FOCAL}, cx: {CX}, cy: {CY}, skew: 0.0,
    distortion: [0.0, 0.0, 0.0, 0.0, 0.0], T_rig_camera: {{xyz_m: [0.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}}}}
  right: {{width: {WIDTH}, height: {HEIGHT}, fx: {FOCAL}, fy: {FOCAL}, cx: {CX}, cy: {CY}, skew: 0.0,
    distortion: [0.0, 0.0, 0.0, 0.0, 0.0],
    T_rig_camera: {{xyz_m: [{BASELINE}, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}}}}
"""
TARGET = "format: armsight/target\nversion: 1\nkind: spots\nspots_m:\n" + "".join(
    f"  {name}: [{x}, {y}, {z}]\n" for name, (x, y, z) in LIGHTS.items()
)


@dataclass(frozen=True)
class Result:
    """How a command ended: exit code, the object on stdout, the text on stderr."""

    code: int
    json: Any
    text: str


@pytest.fixture(scope="session")
def armsight() -> Callable[..., Result]:
    """Run a command with --json in this process; stdout must hold exactly one object."""
    from armsight.cli.commands import app

    def run(*words: object) -> Result:
        done = CliRunner().invoke(app, [*(str(word) for word in words), "--json"])
        return Result(done.exit_code, json.loads(done.stdout) if done.stdout else None, done.stderr)

    return run


@dataclass(frozen=True)
class Scene:
    """A folder with left/, right/, rig.yaml, target.yaml, and the truth: positions (n, 3) in m and rotations."""

    folder: Path
    xyz_m: np.ndarray
    rotation: Rotation

    @property
    def inputs(self) -> list[object]:
        """The options that name rig and target."""
        return ["--rig", self.folder / "rig.yaml", "--target", self.folder / "target.yaml"]

    def sources(self, left: Path | None = None, right: Path | None = None) -> list[object]:
        """The options that name the frames."""
        return ["--left", left or self.folder / "left", "--right", right or self.folder / "right"]


def draw(xyz_m: np.ndarray, camera_x_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return the image of lights (n, 3) in left camera axes, seen by a camera shifted along x."""
    image = rng.normal(12.0, 1.5, (HEIGHT, WIDTH))
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    for x, y, z in xyz_m:
        u, v = FOCAL * (x - camera_x_m) / z + CX, FOCAL * y / z + CY
        image += 150.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2.0 * 1.8**2))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Three lights that move slowly before a parallel pair, COUNT frames."""
    steps = np.arange(COUNT)
    xyz = np.stack([0.05 + 0.002 * steps, 0.01 - 0.001 * steps, 0.6 + 0.001 * steps], axis=1)
    rotation = Rotation.from_rotvec(np.stack([0.1 + 0.01 * steps, -0.05 + 0.0 * steps, 0.02 * steps], axis=1))

    def fill(folder: Path) -> None:
        rng = np.random.default_rng(11)
        for side, shift in (("left", 0.0), ("right", BASELINE)):
            (folder / side).mkdir(parents=True)
            for i in steps:
                lights = rotation[i].apply(np.array(list(LIGHTS.values()))) + xyz[i]
                cv2.imwrite(str(folder / side / f"frame{i}.png"), draw(lights, shift, rng))
        (folder / "rig.yaml").write_text(RIG)
        (folder / "target.yaml").write_text(TARGET)

    return Scene(warm_python.once("scene", fill), xyz, rotation)


@dataclass(frozen=True)
class Boards:
    """A folder with left/ and right/ images of a 7x5 checkerboard, squares of 20 mm; FOCAL_PX, BASELINE_M true."""

    folder: Path
    board: str = "checkerboard:7x5:0.02"
    focal_px: float = 560.0
    baseline_m: float = 0.08


@pytest.fixture(scope="session")
def boards() -> Boards:
    """Ten pairs of a board in different poses, seen by a parallel pair of 640x480 cameras."""
    return Boards(warm_python.once("boards", lambda folder: draw_boards(Boards(folder))))


def draw_boards(made: Boards) -> None:
    """Draw the pairs."""
    K = np.array([[made.focal_px, 0.0, 322.0], [0.0, made.focal_px, 238.0], [0.0, 0.0, 1.0]])
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((40, 40)))  # black and white, 40 px a square
    sheet = np.pad(200.0 * squares + 25.0, 40, constant_values=225.0).astype(np.uint8)
    to_m = np.array([[0.02 / 40, 0.0, -0.04 + 0.00025], [0.0, 0.02 / 40, -0.04 + 0.00025], [0.0, 0.0, 1.0]])
    turns = [(0, 0), (25, 0), (-25, 5), (0, 25), (5, -25), (20, 20), (-20, 20), (20, -20), (-20, -20), (10, 30)]
    places = [(-10, -50, 360), (90, -50, 360), (40, 0, 340), (-10, 50, 360), (90, 50, 360), (40, 20, 380)]
    double = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])  # drawn twice as large, then averaged
    rng = np.random.default_rng(3)
    for side in ("left", "right"):
        (made.folder / side).mkdir(parents=True)
    for i, (rx, ry) in enumerate(turns):
        R = Rotation.from_euler("xyz", [rx, ry, 7.0 * i - 20.0], degrees=True).as_matrix()
        t = np.array(places[i % len(places)]) / 1e3 + R @ np.array([-0.06, -0.04, 0.0])
        for side, shift in (("left", 0.0), ("right", made.baseline_m)):
            H = K @ np.column_stack([R[:, 0], R[:, 1], t - np.array([shift, 0.0, 0.0])]) @ to_m
            large = cv2.warpPerspective(sheet, double @ H, (1280, 960), flags=cv2.INTER_LINEAR, borderValue=225)
            image = large.reshape(480, 2, 640, 2).mean(axis=(1, 3))
            noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 3.0, image.shape)
            cv2.imwrite(str(made.folder / side / f"shot{i}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


@dataclass(frozen=True)
class MirrorBoards:
    """Folders with complex images of a 7x5 checkerboard before a camera with mirrors: straight ones, and with mirror 2
    off by TILT. camera: (fx, fy, cx, cy) of the lens, without distortion."""

    straight: Path
    off: Path
    board: str = "checkerboard:7x5:0.02"
    camera: tuple[float, float, float, float] = (520.0, 521.0, 321.0, 238.0)
    baseline_m: float = 0.16
    tilt: tuple[float, float] = (3e-3, -2e-3)


@pytest.fixture(scope="session")
def mirror_boards() -> MirrorBoards:
    """Eight complex images of 640x480, and two with a mirror turned; where corners are is traced by the simulation."""
    folder = warm_python.once("mirror-boards", lambda made: draw_mirror_boards(mirror_boards_of(made)))
    return mirror_boards_of(folder)


def mirror_boards_of(folder: Path) -> MirrorBoards:
    return MirrorBoards(folder / "straight", folder / "off")


def draw_mirror_boards(made: MirrorBoards) -> None:
    """Draw the images."""
    rng = np.random.default_rng(5)
    turns = [(0, 0), (28, 5), (-28, 0), (5, 28), (0, -28), (22, 22), (-22, 22), (20, -22)]
    places = [
        (0, 0, 320),
        (-110, -110, 400),
        (110, -110, 400),
        (-110, 110, 400),
        (110, 110, 400),
        (0, 60, 310),
        (0, -60, 330),
    ]
    for goal, count, tilt in ((made.straight, len(turns), (0.0, 0.0)), (made.off, 2, made.tilt)):
        goal.mkdir(parents=True)
        for i, (rx, ry) in enumerate(turns[:count]):
            R = Rotation.from_euler("xyz", [rx, ry, 5.0 * i - 15.0], degrees=True)
            image = complex_board(made, R, np.array(places[i % len(places)]) / 1e3, tilt)
            noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 1.5, image.shape)
            cv2.imwrite(str(goal / f"shot{i}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def complex_board(made: MirrorBoards, turned: Rotation, middle_m: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
    """Return the light (480, 640) of a board's two views, one upon the other; tilt: of mirror 2."""
    from armsight_sim.lens import Lens
    from armsight_sim.rigs import Mirrors, mirror_views

    fx, fy, cx, cy = made.camera
    lens = Lens(width=640, height=480, focal_px=(fx, fy), centre_px=(cx, cy))
    tilts = ((0.0, 0.0), tilt, (0.0, 0.0), (0.0, 0.0))
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((40, 40)))
    sheet = np.pad(100.0 * squares + 12.0, 40, constant_values=112.0).astype(np.float32)
    flat = np.array([[x, y] for x in np.linspace(-0.02, 0.14, 7) for y in np.linspace(-0.02, 0.10, 5)])  # saw corner 0
    on_sheet = 80.0 + 40.0 * flat / 0.02 - 0.5
    X = turned.apply(np.pad(flat - [0.06, 0.04], ((0, 0), (0, 1)))) + middle_m
    light = np.zeros((480, 640))
    for view in mirror_views(lens, Mirrors(baseline_m=made.baseline_m, tilts_rad=tilts)).values():
        H, _ = cv2.findHomography(on_sheet, view.project(X))
        double = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
        large = cv2.warpPerspective(sheet, double @ H, (1280, 960), flags=cv2.INTER_LINEAR, borderValue=20)
        light += large.reshape(480, 2, 640, 2).mean(axis=(1, 3))
    return light
