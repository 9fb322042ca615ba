"""Live measurement for screens: the same poses as the command gives, in a process that tells and records."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armsight.app.live.measurement import DetectionSettings, LiveJob, LiveMeasurement, MeasuredMoment
from armsight.app.live.station import MeasurementProcess
from armsight.clock import ManualClock, SystemClock
from armsight.errors import DeviceFailed
from armsight.measure.poses.outcome import judged_by

PATIENCE_S = 60.0


def job(scene: Any, **more: Any) -> LiveJob:
    return LiveJob(
        cameras={side: str(scene.folder / side) for side in ("left", "right")},
        rig=scene.folder / "rig.yaml",
        target=scene.folder / "target.yaml",
        **more,
    )


def moments(measurement: LiveMeasurement) -> list[MeasuredMoment]:
    with measurement.source:
        return list(measurement.moments())


def test_the_poses_are_the_scenes(scene: Any) -> None:
    seen = moments(LiveMeasurement(job(scene), ManualClock()))
    assert [one.view.status for one in seen] == ["ok"] * len(scene.xyz_m)
    np.testing.assert_allclose([one.view.xyz_m for one in seen], scene.xyz_m, atol=1e-3)
    last = seen[-1].view
    assert (last.counts.ok, last.counts.lost, last.sequence) == (len(seen), 0, len(seen))
    assert {spot.name for spot in last.cameras["left"].spots} == {"A", "B", "C"}
    assert all(
        spot.residual_px is not None and np.hypot(*spot.residual_px) < 0.5 for spot in last.cameras["left"].spots
    )


def test_the_residual_on_the_page_is_the_one_that_measure_tells(
    scene: Any, armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = moments(LiveMeasurement(job(scene), ManualClock()))[0]
    worst = [np.linalg.eigvalsh(spots.covariance_px2)[:, 1] for spots in first.spots]
    sights = np.sqrt(np.sort(np.concatenate(worst)))
    monkeypatch.setattr(sys.modules[judged_by.__module__], "JUDGED_PX", 0.5 * (sights[3] + sights[4]))
    done = armsight("measure", *scene.inputs, *scene.sources(), "--frames", 1, "-o", tmp_path / "out").json
    assert done["n_aside"] == 2
    shown = moments(LiveMeasurement(job(scene), ManualClock()))[0].view.residual_px
    assert shown == pytest.approx(done["reprojection_rms_px"]) and shown != pytest.approx(first.view.residual_px)


def test_nothing_is_looked_for_under_a_mask(scene: Any) -> None:
    measurement = LiveMeasurement(job(scene), ManualClock())
    light = moments(measurement)[0].view.cameras["left"].spots[0]
    box = (light.u_px - 15.0, light.v_px - 15.0, light.u_px + 15.0, light.v_px + 15.0)
    measurement = LiveMeasurement(job(scene), ManualClock())
    measurement.look(DetectionSettings(masked={"left": (box,)}))
    view = moments(measurement)[0].view
    assert light.name not in {spot.name for spot in view.cameras["left"].spots}
    assert view.status != "ok"
    assert len(view.cameras["right"].spots) == 3, "the other camera is not masked"


@pytest.fixture(scope="module")
def station(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """One process for all tests of this module: it takes seconds to start."""
    scene = request.getfixturevalue("scene")
    made = MeasurementProcess(job(scene, again=True, fps=60.0))
    made.start()
    yield made
    made.stop()


def wait(what: Any) -> None:
    """Wait until a condition holds; fails where it never does."""
    ready = threading.Event()
    for _ in range(int(PATIENCE_S / 0.02)):
        if what():
            return
        ready.wait(0.02)
    raise AssertionError("it never came to be")


def test_a_process_shows_what_it_measures(station: MeasurementProcess) -> None:
    wait(lambda: station.shown is not None and station.shown.view.status == "ok")
    assert station.shown is not None
    assert station.shown.jpegs["left"][:2] == b"\xff\xd8"
    first = station.shown.view.sequence
    wait(lambda: station.shown is not None and station.shown.view.sequence > first)


def test_what_is_shown_since_a_moment_was_exposed_after_it(station: MeasurementProcess) -> None:
    wait(lambda: station.shown is not None)
    now_s = SystemClock().now_s()
    assert station.shown_since(now_s).view.t_s >= now_s


def test_a_recording_that_cannot_be_begun_is_told_and_measuring_goes_on(
    station: MeasurementProcess, tmp_path: Path
) -> None:
    wait(lambda: station.shown is not None)
    (tmp_path / "file").write_text("no folder")
    station.record(tmp_path / "file" / "live.mcap")
    wait(lambda: station.recording.failure)
    assert "cannot be written" in station.recording.failure and station.recording.file is None
    before = station.shown
    wait(lambda: station.shown is not before)
    assert station.failure == ""


def test_a_pair_is_saved_bit_for_bit(station: MeasurementProcess, scene: Any, tmp_path: Path) -> None:
    import cv2

    wait(lambda: station.shown is not None)
    left, right = tmp_path / "l" / "a.png", tmp_path / "r" / "a.png"
    station.save({"left": left, "right": right})
    for file, side in ((left, "left"), (right, "right")):
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        originals = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (scene.folder / side).iterdir()]
        assert any(np.array_equal(image, original) for original in originals)


def test_what_cannot_be_measured_is_told(tmp_path: Path) -> None:
    made = MeasurementProcess(LiveJob(cameras={"left": str(tmp_path / "none"), "right": str(tmp_path / "none2")}))
    made.start()
    wait(lambda: made.failure)
    assert "none" in made.failure
    with pytest.raises(DeviceFailed):
        made.save({"left": tmp_path / "a.png"})
    with pytest.raises(DeviceFailed, match="none"):
        made.shown_since(0.0)
    made.stop()
