"""Planted faults: boards, lenses, pairs and lights, drawn by the world's own cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fresh_judge import Try, beyond, block, document, fault, healthy, poses_of
from fresh_world import (
    Array,
    Eye,
    board_picture,
    eye,
    light_picture,
    lights_yaml,
    pair,
    pose,
    rig_yaml,
)

# Boards.

PER_M, RIM = 4000.0, 0.03
"""Of the prints: pixels a metre, and white paper around."""


def chess(columns: int, rows: int, across_m: float, down_m: float) -> tuple[Array, Array]:
    """Return a print of columns x rows inner corners, and where its first corner lies on it, in px."""
    step = np.round(np.array([across_m, down_m]) * PER_M).astype(int)
    field = (np.indices((rows + 1, columns + 1)).sum(axis=0) % 2 * 220 + 15).astype(np.uint8)
    squares = np.kron(field, np.ones((step[1], step[0]), np.uint8))
    rim = int(RIM * PER_M)
    return cv2.copyMakeBorder(squares, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=235), rim + step


def charuco(columns: int, rows: int, square_m: float, marker_m: float, dictionary: int) -> tuple[Array, Array]:
    words = cv2.aruco.getPredefinedDictionary(dictionary)
    board = cv2.aruco.CharucoBoard((columns, rows), square_m, marker_m, words)
    rim, size = int(RIM * PER_M), (round(columns * square_m * PER_M), round(rows * square_m * PER_M))
    print_ = board.generateImage((size[0] + 2 * rim, size[1] + 2 * rim), marginSize=rim)
    return print_, np.array([rim, rim])


def views(folder: Path, eyes: tuple[Eye, ...], print_: Array, rng: np.random.Generator, count: int = 12) -> None:
    """Write pictures of a print held before the cameras, tilted to all sides, into a folder for each camera."""
    size = np.array(print_.shape[::-1]) / PER_M
    for k in range(count):
        angle = 2 * np.pi * k / count
        tilt = Rotation.from_rotvec(rng.uniform(0.25, 0.6) * np.array([np.cos(angle), np.sin(angle), 0.15]))
        middle = np.array([0.13 * np.cos(5 * angle), 0.08 * np.sin(3 * angle + 1), rng.uniform(0.4, 0.55)])
        middle[0] += np.mean([e.T[0, 3] for e in eyes])
        T = pose(middle - tilt.apply([*size / 2, 0.0]), tilt)
        for e, side in zip(eyes, ("left", "right"), strict=False):
            (folder / side).mkdir(exist_ok=True)
            picture = board_picture(e, T, print_, PER_M, rng)
            cv2.imwrite(str(folder / side / f"{k:03d}.png"), picture)


def camera_found(folder: Path, e: Eye, board: str, *more: object) -> Try:
    """Calibrate one camera; right where focal lengths and centre are within what is claimed."""

    def miss() -> float | None:
        found = document(folder / "c.yaml")
        if found is None:
            return None
        true = e.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        names = ["fx", "fy", "cx", "cy"]
        return beyond(np.array([found[n] for n in names]) - true, block(found, names))

    words = ["calibrate", "camera", folder / "left", "--board", board, "-o", folder / "c.yaml"]
    return Try([*words, *more], miss)


def board_case(kind: int, true: str, name: str, draw: Callable[[], tuple[Array, Array]], said: str) -> None:
    def make(folder: Path, rng: np.random.Generator) -> Try:
        e = eye(560.0, bend=-0.1)
        views(folder, (e,), draw()[0], rng)
        asked = camera_found(folder, e, said)
        return asked if true else replace(asked, flag="")  # twelve views leave corners bare, which --check tells

    make.__name__ = name
    (fault(kind, true) if true else healthy(kind))(make)


board_case(6, "", "a checkerboard", lambda: chess(8, 5, 0.022, 0.022), "checkerboard:8x5:0.022")
board_case(
    6,
    r"8x5|8 x 5|another size",
    "a checkerboard counted by its squares",
    lambda: chess(8, 5, 0.022, 0.022),
    "checkerboard:9x6:0.022",
)
board_case(
    6,
    r"square|stretch|aspect|across|not as wide|longer|print",
    "squares of 22 x 23 mm",
    lambda: chess(8, 5, 0.022, 0.023),
    "checkerboard:8x5:0.022",
)
board_case(
    6,
    r"dictionary|DICT|marker",
    "markers of another dictionary",
    lambda: charuco(7, 5, 0.028, 0.02, cv2.aruco.DICT_5X5_100),
    "charuco:7x5:0.028:0.02:DICT_4X4_50",
)
board_case(
    6,
    r"5x7|exchanged|columns|rows|count",
    "columns and rows of a charuco exchanged",
    lambda: charuco(7, 5, 0.028, 0.02, cv2.aruco.DICT_4X4_50),
    "charuco:5x7:0.028:0.02:DICT_4X4_50",
)
board_case(6, r"mm|metre|m\b", "squares in millimetres", lambda: chess(8, 5, 0.022, 0.022), "checkerboard:8x5:22")

# Lights before two cameras.

LIGHTS = {"A": [-0.05, 0.006, 0.0], "B": [0.038, 0.043, 0.004], "C": [0.03, -0.054, -0.009]}


def lit(
    folder: Path, rng: np.random.Generator, eyes: tuple[Eye, Eye], lights: dict[str, list[float]], frames: int = 14
) -> Array:
    """Write pairs of pictures of a target that moves; return its poses (n, 4, 4) in rig axes."""
    t = np.arange(frames)
    turn = Rotation.from_rotvec(np.c_[0.25 * np.sin(0.5 * t), 0.25 * np.cos(0.37 * t), 0.2 * np.sin(0.23 * t)])
    place = np.c_[0.08 + 0.05 * np.sin(0.31 * t), 0.04 * np.cos(0.4 * t), 0.8 + 0.06 * np.sin(0.27 * t)]
    T = pose(place, turn)
    for e, side in zip(eyes, ("left", "right"), strict=True):
        (folder / side).mkdir()
        for k in range(frames):
            points = np.array(list(lights.values())) @ T[k, :3, :3].T + T[k, :3, 3]
            cv2.imwrite(str(folder / side / f"{k:03d}.png"), light_picture(e.see(points), e.size, rng))
    return T


def measured(folder: Path, T: Array, **swap: str) -> Try:
    """Measure; right where all places are within 1 mm, three times what such a pair can tell."""

    def miss() -> float | None:
        found = poses_of(folder / "run" / "poses.csv")
        if found is None or len(found) != len(T):
            return None
        return float(np.nanmax(np.linalg.norm(found[:, :3, 3] - T[:, :3, 3], axis=1)) / 1.0e-3)

    words = ["measure", "--rig", folder / "rig.yaml", "--target", folder / "target.yaml"]
    words += ["--left", folder / swap.get("left", "left"), "--right", folder / swap.get("right", "right")]
    return Try([*words, "--fps", "20", "-o", folder / "run"], miss)


def set_up(
    folder: Path,
    rng: np.random.Generator,
    *,
    rig: Callable[[Eye, Eye], tuple[Eye, Eye]] = lambda a, b: (a, b),
    target: float | None = None,
    flip: bool = False,
) -> Array:
    """Write pictures of the true cell, and a rig and a target as somebody has them: changed, scaled, y up."""
    eyes = pair()
    rig_yaml(folder / "rig.yaml", rig(*eyes))
    told = {
        n: [v[0] * (target or 1), v[1] * (target or 1) * (-1 if flip else 1), v[2] * (target or 1)]
        for n, v in LIGHTS.items()
    }
    lights_yaml(folder / "target.yaml", told)
    return lit(folder, rng, eyes, LIGHTS)


def zoomed(e: Eye, factor: float) -> Eye:
    return replace(
        e, K=np.diag([factor, factor, 1.0]) @ e.K, size=(round(factor * e.size[0]), round(factor * e.size[1]))
    )


def apart(e: Eye, factor: float) -> Eye:
    return replace(e, T=pose(e.T[:3, 3] * factor, Rotation.from_matrix(e.T[:3, :3])))


@healthy(8)
def lights_before_a_pair(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng))


@fault(8, r"swap|exchang|left and right|other way")
def left_and_right_exchanged(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng), left="right", right="left")


@fault(8, r"y |mirror|sign")
def a_target_measured_with_y_up(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, flip=True))


@fault(8, r"scale|larger|smaller|times|factor|0\.9[34]|1\.0[67]")
def a_target_7_percent_too_large(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, target=1.07))


@fault(8, r"baseline|scale|factor|times|0\.9|1\.0|1\.1")
def a_baseline_6_percent_short(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, rig=lambda a, b: (a, apart(b, 0.94))))


@fault(8, r"size|640|twice|half")
def intrinsics_of_pictures_half_as_large(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, rig=lambda a, b: (zoomed(a, 0.5), zoomed(b, 0.5))))


@fault(8, r"baseline|the rig's")
def a_rig_in_millimetres(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, rig=lambda a, b: (a, apart(b, 1000.0))))


@fault(6, r"unit|mm|millimet|metre|far")
def a_target_in_millimetres(folder: Path, rng: np.random.Generator) -> Try:
    return measured(folder, set_up(folder, rng, target=1000.0))


@fault(6, r"lens|fisheye|distortion|focal|turned|inconsistent|calibrat")
def a_rig_without_its_distortion(folder: Path, rng: np.random.Generator) -> Try:
    def flat(e: Eye) -> Eye:
        return replace(e, D=np.zeros(5), K=np.diag([1.06, 1.06, 1.0]) @ e.K)

    return measured(folder, set_up(folder, rng, rig=lambda a, b: (flat(a), flat(b))))


@fault(4, r"pair|frame|late|moment|time|count")
def a_frame_dropped_on_one_side(folder: Path, rng: np.random.Generator) -> Try:
    T = set_up(folder, rng)
    right = folder / "right"
    for k in range(6, 13):
        (right / f"{k + 1:03d}.png").replace(right / f"{k:03d}.png")
    (folder / "left" / "013.png").unlink()
    return measured(folder, T[:13])
