"""`measure` by rigs that are no pairs: files, JSON and page by the cameras' names; what only pairs have is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.truth.camera_ring import pose, ring
from tests.truth.test_knocked_camera import TURN_RAD, knocked
from tests.truth.test_views import draw, setup_of

import armsight
from armsight.errors import Inconsistent, UsageError
from armsight.store import read_poses
from refusals import names_it, refuses

CAMERAS, MOMENTS = ("c0", "c1", "c2", "c3"), 11


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[np.ndarray]]:
    """Folders of pictures by camera of a target that moves on; one was turned by 0.1 degrees."""
    folder, rng = tmp_path_factory.mktemp("seen"), np.random.default_rng(4)
    world, T, poses = knocked(ring(4), 2, rng, TURN_RAD), pose(rng, tilt_rad=0.1), []
    for i in range(MOMENTS):
        T[0, 3] += 0.004
        T[1, 3] -= 0.003
        poses.append(T.copy())
        for name, frame in zip(CAMERAS, draw(world, T, rng), strict=True):
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"{i:03d}.png"), frame.image)
    setup_of(world)
    return folder, poses


def by_name(folder: Path, names: tuple[str, ...] = CAMERAS) -> dict[str, str]:
    return {name: str(folder / name) for name in names}


def test_the_knocked_camera_is_left_out_of_all_files(seen: tuple[Path, list[np.ndarray]], tmp_path: Path) -> None:
    folder, true = seen
    setup = setup_of(ring(4))
    with pytest.warns(UserWarning, match="c2"):
        done = armsight.measure(setup.rig, setup.target, cameras=by_name(folder), out=tmp_path / "out")
    assert done.n_ok == MOMENTS and done.exit_code == 0 and done.verdict_.level == "care"
    parts = json.loads((tmp_path / "out/measure.json").read_text())["by_camera"]
    assert [parts[name]["left_out"] is not None for name in CAMERAS] == [False, False, True, False]
    assert [parts[name]["n_used"] for name in CAMERAS] == [MOMENTS, MOMENTS, 0, MOMENTS]
    assert names_it(done.verdict_.next[0], "c2")
    rows = list(csv.DictReader((tmp_path / "out/spots.csv").read_text().splitlines()))
    assert {row["camera"] for row in rows} == {"c0", "c1", "c3"}
    written = read_poses(tmp_path / "out/poses.csv")
    assert len(written) == len(true) == len(done.poses)
    page = (tmp_path / "out/report.html").read_text()
    assert all(names_it(page, name) for name in CAMERAS) and "pair" not in page.split("<main>")[1].split("</header>")[0]


def test_what_a_rig_of_four_cannot_take_is_refused(seen: tuple[Path, list[np.ndarray]], tmp_path: Path) -> None:
    folder, _ = seen
    setup = setup_of(ring(4))
    given = by_name(folder)
    for wrong, told in (
        ({"cameras": by_name(folder, CAMERAS[:3])}, "c3"),
        ({"cameras": {**given, "top": given["c0"] + "/*"}}, "top"),
        ({"cameras": {**given, "c1": given["c0"]}}, "c0"),
        ({"cameras": given, "timing": "free"}, "timing"),
        ({"cameras": given, "image": given["c0"]}, "image"),
    ):
        with refuses(UsageError, told):
            armsight.measure(setup.rig, setup.target, **wrong)
    small = tmp_path / "small"
    small.mkdir()
    for path in (folder / "c1").iterdir():
        cv2.imwrite(str(small / path.name), cv2.resize(cv2.imread(str(path), 0), None, fx=0.5, fy=0.5))
    with refuses(Inconsistent, "c1"):
        armsight.measure(setup.rig, setup.target, cameras={**given, "c1": str(small)})
