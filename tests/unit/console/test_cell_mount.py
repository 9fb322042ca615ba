"""What the page Cell says before anything moves: each lamp that is not good names cause and cure."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from armsight.console import texts_cell
from armsight.console.cell_mount import Lamp, mount_lamps
from armsight.console.state import Console
from armsight.errors import DeviceLost
from armsight.kinematics import presets
from armsight.records import Target, TargetKind
from armsight.store import write_target
from armsight.store.arm_file import write_arm
from armsight.store.cell_file import CellFile
from refusals import names_it

LIGHTS = {"A": (0.05, 0.01, 0.0), "B": (-0.02, 0.055, 0.018), "C": (-0.045, -0.02, -0.012), "D": (0.015, -0.04, 0.01)}


def station(left: int = 4, right: int = 4, **said: Any) -> Any:
    view = SimpleNamespace(width=640, height=360)
    moment = SimpleNamespace(
        spots=("x" * left, "x" * right), view=SimpleNamespace(fps=30.0, cameras={"left": view, "right": view})
    )
    return SimpleNamespace(**{"shown": moment, "failure": "", "ended": False, "silent_s": 0.0, "current": True} | said)


def robot(n: int | None) -> Any:
    def reading() -> Any:
        if n is None:
            raise DeviceLost("the loop does not run", consequence="It is not known", cure="Start anew")
        return SimpleNamespace(q=np.zeros(n))

    return SimpleNamespace(reading=reading)


def cell(folder: Path, lights: dict[str, tuple[float, float, float]] | None = LIGHTS, arm: bool = True) -> CellFile:
    if lights is not None:
        write_target(
            folder / "target.yaml",
            Target(kind=TargetKind.SPOTS, names=tuple(lights), xyz_m=np.array(list(lights.values()))),
        )
    if arm:
        write_arm(folder / "arm.yaml", presets.preset("ur10"))
    return CellFile(left="a", right="b", target="target.yaml" if lights else "", arm="arm.yaml" if arm else "")


def lamp_of(console: Console, key: str) -> Lamp:
    return next(lamp for lamp in mount_lamps(console) if lamp.key == key)


def test_a_cell_that_is_ready_is_told_so_and_every_lamp_has_its_name(tmp_path: Path) -> None:
    console = Console(folder=tmp_path, cell=cell(tmp_path), station=station(), robot=robot(6))
    lamps = mount_lamps(console)
    assert [lamp.level for lamp in lamps] == ["good"] * 5
    assert {lamp.key for lamp in lamps} == set(texts_cell.LAMPS)
    assert names_it(lamps[0].words, 30, "640x360")


@pytest.mark.parametrize(
    ("made", "key", "level", "names"),
    [
        ({"station": None}, "cameras", "bad", "Settings"),
        ({"station": station(failure="camera:1 is gone")}, "cameras", "bad", "camera:1 is gone"),
        ({"station": station(silent_s=4.0)}, "cameras", "bad", "4 s"),
        ({"station": station(left=3)}, "lights", "bad", "3"),
        ({"station": station(right=6)}, "lights", "warn", "6"),
        ({"robot": robot(None)}, "joints", "bad", "loop does not run"),
        ({"robot": robot(7)}, "joints", "bad", "7"),
    ],
)
def test_what_is_missing_is_told_by_its_lamp(
    tmp_path: Path, made: dict[str, Any], key: str, level: str, names: str
) -> None:
    console = Console(folder=tmp_path, cell=cell(tmp_path), **{"station": station(), "robot": robot(6)} | made)
    found = lamp_of(console, key)
    assert found.level == level and names_it(found.words, names), found


@pytest.mark.parametrize(
    ("lights", "level", "names"),
    [
        (None, "bad", "Settings"),
        ({name: LIGHTS[name] for name in "ABC"}, "bad", "four"),
        ({name: (x, y, 0.0) for name, (x, y, _) in LIGHTS.items()}, "warn", "plane"),
    ],
)
def test_a_target_that_tells_too_little_is_told(tmp_path: Path, lights: Any, level: str, names: str) -> None:
    found = lamp_of(Console(folder=tmp_path, cell=cell(tmp_path, lights), station=station()), "target")
    assert found.level == level and names_it(found.words, names), found


def test_files_that_are_wrong_or_gone_are_told_and_a_mended_one_is_seen(tmp_path: Path) -> None:
    console = Console(folder=tmp_path, cell=cell(tmp_path), station=station())
    (tmp_path / "arm.yaml").write_text("format: armsight/arm\n")
    (tmp_path / "target.yaml").unlink()
    assert lamp_of(console, "arm").level == "bad" and "arm.yaml" in lamp_of(console, "arm").words
    assert lamp_of(console, "target").level == "bad" and "target.yaml" in lamp_of(console, "target").words
    cell(tmp_path)
    assert lamp_of(console, "arm").level == lamp_of(console, "target").level == "good"


def test_lamps_tell_cameras_by_their_own_names(tmp_path: Path) -> None:
    cell(tmp_path)
    kept = CellFile(cameras={"Top-Left": "a", "c1": "b"}, target="target.yaml", arm="arm.yaml")
    seen = station(4, 3)
    seen.shown.view.cameras = dict(zip(("Top-Left", "c1"), seen.shown.view.cameras.values(), strict=True))
    console = Console(folder=tmp_path, cell=kept, station=seen, robot=robot(6))
    assert names_it(lamp_of(console, "lights").words, "Top-Left 4", "c1 3")
    assert names_it(lamp_of(console, "cameras").words, "Top-Left", "c1")
