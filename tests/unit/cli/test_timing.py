"""armsight calibrate timing: from live cameras, which are read side by side, to a rig.yaml with the timing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.errors import BadFile, Cancelled
from armsight.ops.calibration import spots_of_frames
from armsight.ops.calibration.spots_of_frames import side_by_side
from armsight.records import Frame, Progress, Silent, SpotTrack
from refusals import refuses

Run = Callable[..., Any]
FOCAL, CX, CY, WIDTH, HEIGHT, BASELINE = 400.0, 160.3, 119.6, 320, 240, 0.1  # of the scene's rig
LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])
RATE = 30.0
READOUT_S = 0.015


def place(t: float) -> np.ndarray:
    """Where the lights (3, 3) are at a time of the left clock."""
    x = 0.05 + 0.05 * np.sin(4.1 * t) + 0.03 * np.sin(6.7 * t + 1.0)
    y = 0.05 * np.sin(3.3 * t + 0.4) + 0.04 * np.sin(7.3 * t + 2.0)
    z = 0.6 + 0.04 * np.sin(2.9 * t + 0.7)
    a = 0.4 * np.sin(3.7 * t) + 0.2
    turn = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(LIGHTS @ turn.T + [x, y, z])


def pixels(t: float, side: int, lights: int, readout_s: float = READOUT_S) -> np.ndarray:
    """Where the lights (n, 2) are in a frame of the left clock's time t."""
    uv = np.full((lights, 2), CY)
    for _ in range(6):
        for i in range(lights):
            X = place(t + readout_s * (uv[i, 1] / (HEIGHT - 1) - 0.5))[i] - [BASELINE * side, 0.0, 0.0]
            uv[i] = FOCAL * X[:2] / X[2] + [CX, CY]
    return uv


def draw(uv: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    image = rng.normal(12.0, 1.5, (HEIGHT, WIDTH))
    rows, columns = np.arange(HEIGHT)[:, None], np.arange(WIDTH)
    for u, v in uv:
        image += 150.0 * np.exp(-((columns - u) ** 2) / (2.0 * 1.8**2)) * np.exp(-((rows - v) ** 2) / (2.0 * 1.8**2))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_exchanged_views_are_said(armsight: Run, scene: Any, tmp_path: Path) -> None:
    """Of tables to calibrate timing, of drawn frames to calibrate target: neither is written."""
    rng, heads = np.random.default_rng(1), "t_s,u_px,v_px,su_px,sv_px,spot\n"
    for side, name in enumerate(("left", "right")):
        (tmp_path / name).mkdir()
        rows = []
        for k in range(int(8.0 * RATE)):
            uv = pixels((k + 0.37 * side) / RATE, side, 3) + rng.normal(0.0, 0.03, (3, 2))
            rows += [
                f"{k / RATE!r},{u!r},{v!r},0.03,0.03,{light}" for (u, v), light in zip(uv.tolist(), "ABC", strict=True)
            ]
        (tmp_path / f"{name}.csv").write_text(heads + "\n".join(rows) + "\n")
        for k in range(10):
            cv2.imwrite(str(tmp_path / name / f"frame{k}.png"), draw(pixels(0.31 * k, side, 3, 0.0), rng))
    out = ["--rig", scene.folder / "rig.yaml", "-o", tmp_path / "out.yaml"]
    for words in (
        ["timing", "--left-spots", tmp_path / "right.csv", "--right-spots", tmp_path / "left.csv"],
        ["target", "--left", tmp_path / "right", "--right", tmp_path / "left", "--lights", 3],
    ):
        exchanged = armsight("calibrate", *words, *out)
        assert exchanged.code == 3 and "swapped" in exchanged.text, exchanged.text
    assert not (tmp_path / "out.yaml").exists()


class LiveLights:
    """A live camera before one waved light, its stamps late by up to some milliseconds; it never ends by itself."""

    total = None

    def __init__(self, side: int, origin_s: float) -> None:
        self.side, self.origin_s = side, origin_s
        self.n_read = 0

    def __enter__(self) -> LiveLights:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Frame]:
        rng = np.random.default_rng(self.side)
        for n in count():
            t = (n + 0.37 * self.side) / RATE
            self.n_read += 1
            image = draw(pixels(t, self.side, 1), rng)
            yield Frame(image=image, t_s=t + rng.exponential(0.003), sequence=n, source=f"camera:{self.side}")


def test_live_cameras_are_read_side_by_side_for_a_while(
    armsight: Run, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: dict[str, LiveLights] = {}

    def camera(text: str, side: str, **asked: Any) -> LiveLights:
        assert text == {"left": "camera:0", "right": "camera:2"}[side]
        opened[side] = LiveLights(("left", "right").index(side), asked["origin_s"])
        return opened[side]

    monkeypatch.setattr(spots_of_frames, "camera_source", camera)
    monkeypatch.setattr(spots_of_frames, "LIVE_S", 7.0)
    sources = ["--left", "camera:0", "--right", "camera:2"]
    done = armsight("calibrate", "timing", "--rig", scene.folder / "rig.yaml", *sources, "-o", tmp_path / "timed.yaml")
    assert done.code == 0, done.text
    got = done.json
    assert opened["left"].origin_s == opened["right"].origin_s
    assert {live.n_read for live in opened.values()} <= set(range(208, 216))  # 7 s at 30 a second
    shift = got["delay_s"] + 1e-6 * got["drift_ppm"] * got["middle_s"]  # the stamps have the frames' own times
    assert abs(shift) < max(2e-4, 4.0 * got["std_middle_s"])
    assert got["std_middle_s"] < 1e-3


class Told(Silent):
    """Keeps what is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def update(self, done: float, total: float, note: str = "") -> None:
        self.notes.append(note)


def test_cameras_side_by_side_end_together_and_the_first_shows_how_far_they_are() -> None:
    begun, told = threading.Event(), Told()

    def look(name: str, text: str, progress: Progress) -> SpotTrack:
        progress.update(1.0, 2.0, f"{name} of {text}")
        if name == "left":
            assert begun.wait(60.0)
            raise BadFile("a.mp4 breaks off")
        begun.set()
        while not progress.cancelled():  # as one that reads for hours
            begun.wait()
        raise Cancelled("stopped")

    with refuses(BadFile, "a.mp4"):
        side_by_side(look, {"left": "a.mp4", "right": "b.mp4"}, told)
    assert told.notes == ["left of a.mp4"]
