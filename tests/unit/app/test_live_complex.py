"""A mirror rig live: one camera, both views in its one picture, measured as the command measures it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armsight.app.live.measurement import LiveJob, LiveMeasurement, MeasuredMoment
from armsight.app.live.views import complex_view
from armsight.clock import ManualClock
from armsight.console.state import Console
from armsight.errors import UsageError
from armsight.ops.simulation.run import simulate
from armsight.store import read_poses
from armsight.store.cell_file import COMPLEX, CellFile
from refusals import refuses

FRAMES = 3


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a simulated mirror rig sees of a lit target, traced surface by surface."""
    folder = tmp_path_factory.mktemp("mirror") / "cell"
    simulate("pachidis2005-static", folder, frames=FRAMES, room="dark")
    return folder


def job(cell: Path, **more: Any) -> LiveJob:
    return LiveJob(cameras={COMPLEX: str(cell / "image")}, rig=cell / "rig.yaml", target=cell / "target.yaml", **more)


def moments(measurement: LiveMeasurement) -> list[MeasuredMoment]:
    with measurement.source:
        return list(measurement.moments())


@pytest.fixture(scope="module")
def seen(cell: Path) -> list[MeasuredMoment]:
    return moments(LiveMeasurement(job(cell), ManualClock()))


def test_the_poses_are_the_simulated_ones(cell: Path, seen: list[MeasuredMoment]) -> None:
    truth = read_poses(cell / "truth.csv")
    assert [one.view.status for one in seen] == ["ok"] * FRAMES
    for one, true in zip(seen, truth, strict=True):
        off_m = np.array(one.view.xyz_m) - true.T_parent_target[:3, 3]
        assert np.abs(off_m / np.array(one.view.std[:3])).max() < 5.0 and np.abs(off_m).max() < 1e-3


def test_the_one_picture_tells_which_spot_is_of_which_view(seen: list[MeasuredMoment]) -> None:
    """The left view of a point lies to the right of its right view (MATH 3.2), and each on a curve of its own view."""
    for one in seen:
        view = complex_view(one.view)
        at = {(spot.name, spot.view): np.array([spot.u_px, spot.v_px]) for spot in view.spots if spot.name}
        assert set(at) == {(name, side) for name in "ABC" for side in ("left", "right")}
        assert not [spot for spot in view.spots if not spot.name], "each of the six spots has a name"
        assert view.n_clipped == 0 and view.advice == "good"
        for name in "ABC":
            assert at[name, "left"][0] > at[name, "right"][0] + 50.0
        assert view.epipolar_views == ["left"] * 3 + ["right"] * 3
        for side in ("left", "right"):
            curves = [np.array(c) for c, v in zip(view.epipolar, view.epipolar_views, strict=True) if v == side]
            for name in "ABC":
                assert min(np.linalg.norm(near(c, at[name, side])) for c in curves) < 1.0


def near(curve: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the way from a place to a curve's line, straight between its points."""
    a, b = curve[:-1], curve[1:]
    along = np.clip(((place - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0.0, 1.0)
    ways = a + along[:, None] * (b - a) - place
    return np.asarray(ways[np.argmin(np.linalg.norm(ways, axis=1))])


def test_the_wrong_number_of_cameras_is_refused(cell: Path, scene: Any) -> None:
    with refuses(UsageError, "one picture", "left, right"):
        LiveMeasurement(
            LiveJob(cameras={COMPLEX: str(scene.folder / "left")}, rig=scene.folder / "rig.yaml"), ManualClock()
        )
    with refuses(UsageError, "has mirrors"):
        LiveMeasurement(LiveJob(cameras={"left": "a", "right": "b"}, rig=cell / "rig.yaml"), ManualClock())
    with refuses(UsageError, "left camera", "missing"):
        Console(folder=cell).job_of(CellFile(right="camera:0"))
    console = Console(folder=cell, cell=CellFile(left="image"))
    assert console.pictures == (COMPLEX,) and Console(folder=cell).pictures == ("left", "right")
