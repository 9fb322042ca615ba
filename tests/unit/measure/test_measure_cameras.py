"""`measure` by rigs that are no pairs: files, JSON and page by the cameras' names; what only pairs have is refused."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.truth.camera_ring import LIGHTS, pose, ring
from tests.truth.test_knocked_camera import TURN_RAD, knocked
from tests.truth.test_views import draw, setup_of

import armsight
from armsight.errors import Inconsistent, UsageError
from armsight.measure.consistency.findings import Consistency
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.views import measure_views
from armsight.measure.results import grounds_of
from armsight.ops.measurement.outputs import Outputs
from armsight.records import Spots
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


def test_python_has_the_pose_of_one_moment_and_the_track_of_many(seen: tuple[Path, list[np.ndarray]]) -> None:
    folder, true = seen
    setup = setup_of(ring(4))
    tracker = armsight.PoseTracker(setup.rig, setup.target)
    for i, T in enumerate(true):
        pictures: dict[str, object] = {name: folder / name / f"{i:03d}.png" for name in CAMERAS}
        if i == 2:
            pictures["c1"] = None
        done = tracker.update(cameras=pictures, t_s=i / 30.0)
        assert np.abs(done.xyz_m - T[:3, 3]).max() < 3e-4
        assert len(done.detail.spots[1]) == (0 if i == 2 else 6)
    assert done.ok and np.abs(done.xyz_m - true[-1][:3, 3]).max() < 1e-4
    assert [one.names for one in tracker.left_out] == [("c2",)] and len(done.detail.spots[2]) == 0
    found = tracker.consistency
    assert found is not None and found.verdict == "ok" and len(tracker.track) == MOMENTS
    alone = armsight.estimate_pose(cameras={**pictures, "c2": None}, rig=setup.rig, target=setup.target)
    assert alone.ok and np.abs(alone.xyz_m - true[-1][:3, 3]).max() < 1e-4
    again = dict(zip(CAMERAS, alone.detail.seen, strict=True))
    by_spots = armsight.estimate_pose_from_spots(cameras=again, rig=setup.rig, target=setup.target)
    np.testing.assert_allclose(by_spots.T_rig_target, alone.T_rig_target, atol=1e-9)
    with refuses(UsageError, "c3", "left"):
        armsight.estimate_pose(pictures["c0"], pictures["c1"], setup.rig, setup.target)
    with refuses(UsageError, "without any frame"):
        tracker.update(cameras=dict.fromkeys(CAMERAS), t_s=9.0)


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


@pytest.mark.parametrize("views", [2, 3])
def test_a_half_hidden_sight_that_claims_little_is_no_part_of_the_residual_that_is_told(views: int) -> None:
    world, rng, sigma_px = ring(views), np.random.default_rng(7), 0.05
    setup, T, poses = setup_of(world), pose(np.random.default_rng(1), tilt_rad=0.1), []
    outputs = Outputs(None, names=setup.rig.names)
    for number in range(20):
        uv = world.pixels(LIGHTS @ T[:3, :3].T + T[:3, 3])
        uv += rng.normal(0.0, sigma_px, uv.shape)
        cov = np.tile(sigma_px**2 * np.eye(2), (len(LIGHTS), views, 1, 1))
        uv[2, 0] += (3.0, -2.0)
        cov[2, 0] = 4.0**2 * np.eye(2)
        seen = [Spots.of_centres(uv[:, s], cov[:, s]) for s in range(views)]
        found = measure_spots(setup, float(number), *seen) if views == 2 else measure_views(setup, float(number), seen)
        poses.append(outputs.add(found))
    done = outputs.summary(setup, poses, Consistency(verdict="unchecked", frames=20), grounds_of(poses))
    assert done.n_ok == done.n_aside == 20
    sights = len(LIGHTS) * views - 1
    left_over = np.sqrt(2.0 * (2 * sights - 6) / (2 * sights)) * sigma_px  # six numbers of the pose are taken from it
    assert done.reprojection_rms_px == pytest.approx(left_over, rel=0.15)
    assert "20 known to no 1 px aside" in str(list(done.summary()))
